"""A step of a joint beside ``mj_step``, 4,096 joints in one call, and the sag of a closed loop.

A sphere of 5 kg on the bar of 1 m: its linear table, and kriging of 40 and of 120 rows. Each figure
is the best of short rounds that take turns: the machine is shared.
"""

from __future__ import annotations

import timeit

import numpy as np
import pytest

from tests.service.client.answers import bar_compliance
from tests.service.client.joint_scenes import (
    FREEDOMS,
    HIGH,
    SILENT,
    known_law,
    known_table,
    linear_table,
    mujoco,
    scene,
    sphere,
)
from wrenchbook.service.client.joint.joint import quaternion
from wrenchbook.service.client.joint.mujoco_callback import joints_in_mj_step
from wrenchbook.service.client.joint.mujoco_joint import MujocoJoint, step_joints

ROUNDS, STEPS, MANY, THREADS = 200, 40, 4096, 2


def test_a_step_of_a_joint_beside_mj_step() -> None:
    print()
    tables = {"linear": linear_table(), "40 rows": known_table(40), "120 rows": known_table(120)}
    for name, table in tables.items():
        bare, (model, data) = (scene(sphere(5, "0.02 0 0.03")) for _ in range(2))
        joint, spent = MujocoJoint(model, data, table), []
        for _ in range(ROUNDS):
            spent.append([timeit.timeit(joint.step, number=STEPS)])
            with joints_in_mj_step():
                spent[-1] += [timeit.timeit(lambda: mujoco.mj_step(model, data), number=STEPS)]  # noqa: B023
            spent[-1] += [timeit.timeit(lambda: mujoco.mj_step(*bare), number=STEPS)]  # noqa: B023
        step, inside, plain = 1e6 / STEPS * np.min(spent, axis=0)
        assert joint.report().covered == 1.0
        text = f"{step:.1f} us, {step / plain:.1f} times mj_step, {plain:.1f} us"
        print(f"{name:>9}: joint.step {text}; in mj_step {inside:.1f} us")


def test_many_joints_in_one_call() -> None:
    steps, rng, spent = known_table(40).packed.joints(MANY), np.random.default_rng(1), []
    steps.inverse_masses[:] = np.diag([0.2, 0.2, 0.2, 50, 50, 50])
    wrenches = rng.uniform(-0.7, 0.7, (MANY, 6)) * HIGH
    for _ in range(ROUNDS // 10):
        moved, wrenches = known_law(wrenches), wrenches * (1 + 0.01 * rng.normal(size=(MANY, 6)))
        steps.poses[:] = [[*item[:3], *quaternion(item[3:])] for item in moved]
        spent.append(timeit.timeit(lambda: steps.step(1e-3, 0.05, THREADS), number=1))
        assert not steps.replies["status"].any()
    print(
        f"\n{MANY} joints, 40 rows, {THREADS} threads: {1e3 * min(spent):.1f} ms, "
        f"{1e6 * min(spent) / MANY:.2f} us each"
    )


@pytest.mark.parametrize("dt", [2e-3, 1e-3, 5e-4])
def test_the_sag_of_two_bars_whose_ends_are_held_together(dt: float) -> None:
    """Two bars, one 0.2 m above the other, with 1 kg at each end; 50 N, that grow within 1 s."""
    stiff = f'solref="{2 * dt} 1" solimp="0.9999 0.9999 0.001"'
    ends = 'body1="tip1" body2="tip2"'
    points = ("0 0 .1", ".1 0 .1", "0 .1 .1")
    constraints = {
        "weld by default": f"<weld {ends}/>",
        "stiff weld": f"<weld {ends} {stiff}/>",
        "... torquescale 10": f'<weld {ends} {stiff} torquescale="10"/>',
        "three connects": "".join(f'<connect {ends} anchor="{p}" {stiff}/>' for p in points),
    }
    stiffness, lever = np.linalg.inv(bar_compliance()), np.eye(6)
    lever[0, 4] = 0.2  # the upper bar's end moves along x by the block's rotation about y
    both = stiffness + lever.T @ stiffness @ lever
    closed = 1e3 * np.linalg.solve(both, [0, 0, 50, 0, 0, 0])[2]
    print(f"\ntwo bars, step {1e3 * dt} ms: closed form {closed:.3f} mm")
    for name, constraint in constraints.items():
        bodies = "".join(
            f'<body name="base{n}" pos="0 0 {z}"><geom size=".02" mass="5" {SILENT}/>'
            f'<body name="tip{n}" pos="1 0 0">{FREEDOMS}{sphere(1)}</body></body>'
            for n, z in ((1, 0.0), (2, 0.2))
        )
        model = mujoco.MjModel.from_xml_string(
            f'<mujoco><option timestep="{dt}" gravity="0 0 0"/><worldbody>{bodies}</worldbody>'
            f"<equality>{constraint}</equality></mujoco>"
        )
        data, table = mujoco.MjData(model), linear_table()
        joints = [MujocoJoint(model, data, table, f"base{n}", f"tip{n}", 1.0) for n in (1, 2)]
        while data.time < 10:
            data.xfrc_applied[[2, 4], 2] = -25 * min(data.time, 1.0)
            step_joints(*joints)
        print(f"{name:>20}: {-1e3 * joints[0].displacement[2]:.3f} mm")
    assert joints[0].displacement[2] == pytest.approx(-1e-3 * closed, rel=0.01)
