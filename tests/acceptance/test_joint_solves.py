"""A mass on a part that stiffens: the joint, from its table, against a finite-element solve."""

from __future__ import annotations

import numpy as np
import pytest

from tests.service.live import served

mujoco = pytest.importorskip("mujoco", reason="has no wheel here")

SCENE = """<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>
<body name="base"><geom size=".01" mass="1" contype="0"/><body name="tip">
{joints}<geom size=".02" mass="{mass}" pos="{at}" contype="0"/><body/></body></body>
</worldbody></mujoco>"""
SLIDES = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
ALL, GUIDED = SLIDES + '<joint type="ball"/>', '<joint type="slide"/><joint/>'
SOLVES = 15  # of `plate_thin`: with 12 its errors are not known
AT_REST_S = 6.0  # of simulated time, with a quarter of critical damping


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    with served(tmp_path_factory.mktemp("solving"), solvers=1) as created:
        yield created


# Half of the load range, off the interface point: all the part's freedoms move.
@pytest.mark.parametrize(
    ("name", "mass", "at", "joints"),
    [("plate_thin", 60.0, ".02 .03 .01", ALL), ("spring", 0.5, "0 0 0", GUIDED)],
)
def test_a_mass_rests_where_a_solve_of_its_wrench_puts_it(client, name, mass, at, joints):
    from wrenchbook import MujocoJoint

    for _ in client.fill_until(name, budget=SOLVES):
        pass
    table = client.download(name)
    model = mujoco.MjModel.from_xml_string(SCENE.format(mass=mass, at=at, joints=joints))
    data = mujoco.MjData(model)
    joint = MujocoJoint(model, data, table, damping=0.25)
    while data.time < AT_REST_S:
        joint.step()
    assert np.abs(data.qvel).max() < 1e-9
    assert joint.coverage == "covered"
    solved = client.solve(name, joint.wrench[:3], joint.wrench[3:], wait_s=100)
    answer = table.answer(joint.wrench[:3], joint.wrench[3:])
    bars = np.concatenate([answer.error_translation, answer.error_rotation])
    truth = np.concatenate([solved.translation, solved.rotation])
    assert (np.abs(joint.displacement - truth) <= bars).all()
    assert joint.wrench[2] == pytest.approx(-9.81 * mass, rel=1e-6)
