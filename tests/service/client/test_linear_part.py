"""A part as springs: in a MuJoCo scene without Python, and as a matrix with its error."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest

from tests.service.client.answers import bar_compliance
from tests.service.client.joint_scenes import HIGH, linear_table, mujoco, packed_table
from wrenchbook.service.client.joint import LinearPart
from wrenchbook.service.client.joint.mujoco_joint import MujocoJoint
from wrenchbook.service.client.joint.mujoco_model import scene_with_joint, scene_with_springs
from wrenchbook.surrogate.table.rows import LoadRange, Rows

SCENE = """<mujoco><option timestep="{dt}" {more}/><worldbody><body name="base" pos="0 0 1">{moves}
<geom size=".02" mass="50" contype="0"/><body name="tip" pos="1 0 0">
<geom size=".05" mass="{mass}" pos="{at}" contype="0"/></body></body></worldbody></mujoco>"""


def with_springs(folder, part, dt=1e-3, damping=0.02, mass=3.0, at="0 0 0", moves="", more=""):
    path = folder / "scene.xml"
    path.write_text(SCENE.format(dt=dt, mass=mass, at=at, moves=moves, more=more))
    text = scene_with_springs(path, "base", "tip", part, damping=damping)
    model = mujoco.MjModel.from_xml_string(text)
    return model, mujoco.MjData(model)


def steps(model, data, seconds, read):
    seen = []
    while data.time < seconds:
        mujoco.mj_step(model, data)
        seen.append(read(data))
    return np.array(seen)


def stiffening(excess: float) -> LinearPart:
    """Springs of a part whose u_z differs by a cubic share of the linear one."""
    spread = np.linspace(-1.0, 1.0, 41)
    wrenches = np.zeros((41, 6))
    wrenches[:, 2] = spread * HIGH[2]
    linear = wrenches @ bar_compliance().T
    moved = linear.copy()
    moved[:, 2] *= 1.0 - excess * spread**2
    slopes = np.tile(bar_compliance(), (41, 1, 1))
    slopes[:, 2, 2] *= 1.0 - 3.0 * excess * spread**2
    rows = Rows.of(wrenches, moved, compliance=slopes, source=["fea"] * 41)
    high = np.array([0.0, 0.0, HIGH[2], 0.0, 0.0, 0.0])
    return LinearPart.of(packed_table(rows, LoadRange(-high, high)))


def test_the_damping_is_that_asked_for(tmp_path):
    model, data = with_springs(tmp_path, LinearPart.of(linear_table()), 5e-4, damping=0.02)
    sag = steps(model, data, 1.0, lambda now: now.qpos[2])
    swing = np.abs(sag - sag[-200:].mean())
    omega = math.sqrt(1 / bar_compliance()[2, 2] / 3)
    first, last = swing[:300].max(), swing[1200:1500].max()
    assert math.log(first / last) / (1200 * 5e-4 * omega) == pytest.approx(0.02, rel=0.1)


def test_springs_move_as_the_joint_on_a_shaken_base(tmp_path):
    moves = '<joint name="rail" type="slide" axis="0 0 1"/>'
    table, path = linear_table(), tmp_path / "joint.xml"
    model, data = with_springs(tmp_path, LinearPart.of(table), 5e-4, at=".1 0 0", moves=moves)
    path.write_text(SCENE.format(dt=5e-4, mass=3.0, at=".1 0 0", moves=moves, more=""))
    other = mujoco.MjModel.from_xml_string(scene_with_joint(path, "base", "tip"))
    truth = mujoco.MjData(other)
    joint = MujocoJoint(other, truth, table)
    seen, expected = [], []
    while data.time < 1.0:
        push = 600.0 + 200.0 * math.sin(30.0 * data.time)
        data.qfrc_applied[0] = truth.qfrc_applied[0] = push
        mujoco.mj_step(model, data)
        joint.step()
        seen.append(data.qpos[3])
        expected.append(truth.qpos[3])
    wrong = np.array(seen) - expected
    assert math.sqrt((wrong**2).mean()) < 0.01 * np.std(expected)


def test_the_springs_are_those_of_the_stiffness(tmp_path):
    part = LinearPart.of(linear_table())
    model, data = with_springs(tmp_path, part, more='gravity="0 0 0"')
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    place = np.array([1e-3, 2e-3, -1e-3, 1e-3, -2e-3, 3e-3])
    data.qpos[:] = place
    mujoco.mj_forward(model, data)
    expected = -np.array(part.stiffness) @ place
    np.testing.assert_allclose(
        data.qfrc_spring, expected, rtol=1e-4, atol=1e-5 * abs(expected).max()
    )


def test_about_a_load_the_springs_hold_that_load(tmp_path):
    wrench = np.array([0.0, 100.0, -200.0, 5.0, 0.0, 10.0])
    part = LinearPart.of(linear_table(), wrench)
    model, data = with_springs(tmp_path, part, more='gravity="0 0 0"')
    data.qpos[:] = part.displacement
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.qfrc_spring, -wrench, atol=1e-4 * 200)


def test_the_error_of_a_part_that_stiffens_is_named():
    part = stiffening(0.2)
    assert part.largest_error[2] / part.largest_displacement[2] == pytest.approx(0.25, rel=0.02)
    assert "uz 25 %" in part.error
    assert max(LinearPart.of(linear_table()).largest_error) < 1e-15


def test_a_file_of_the_part_has_plain_numbers():
    mass = np.diag([1.0, 1.1, 1.1, 1e-3, 0.03, 0.03])
    result = json.loads(json.dumps(LinearPart.of(linear_table()).to_dict(mass)))
    np.testing.assert_allclose(np.linalg.inv(result["stiffness"]), bar_compliance(), rtol=1e-9)
    assert result["mass"] == mass.tolist()
    assert LinearPart.of(linear_table()).to_dict()["mass"] is None
    assert result["loads"] == ["fx", "fy", "fz", "mx", "my", "mz"]


def test_springs_of_a_part_that_locks_one_rotation_are_two_hinges(tmp_path):
    part = LinearPart.of(linear_table())
    two = [0, 1, 2, 4, 5]
    fewer = dataclasses.replace(
        part,
        freedoms=tuple(part.freedoms[k] for k in two),
        stiffness=np.array(part.stiffness)[np.ix_(two, two)].tolist(),
        **dict.fromkeys(("wrench", "displacement", "largest_error"), [0.0] * 5),
        largest_displacement=[1.0] * 5,
    )
    model, _ = with_springs(tmp_path, fewer)
    assert [model.joint(k).name for k in range(3, 5)] == ["tip_ry", "tip_rz"]
