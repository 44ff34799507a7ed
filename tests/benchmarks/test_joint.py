"""How much a joint adds to a step of MuJoCo, and how much faster than real time its scene runs.

Both are taken in the same rounds, so that a noisy machine slows both.
"""

from __future__ import annotations

import time
from functools import partial
from typing import Any

import numpy as np

from tests.service.client.joint_scenes import linear_table, mujoco, scene, sphere
from tests.service.client.test_joint_scenes import turning_table
from wrenchbook.service.client.joint.mujoco_joint import MujocoJoint

STEPS, ROUNDS = 100, 40
ARM = (
    sphere(2)
    + '<body name="upper" pos="0 0 -.05"><joint type="hinge" axis="0 1 0" damping="1"/>'
    + '<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass="1"/>'
    + '<body name="lower" pos="0 0 -.3"><joint type="hinge" axis="0 1 0" damping="1"/>'
    + '<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass=".5"/></body></body>'
)


def best(step: Any) -> float:
    """The least time of a step of all rounds, us."""
    found = []
    for _ in range(ROUNDS):
        began = time.perf_counter()
        for _ in range(STEPS):
            step()
        found.append((time.perf_counter() - began) / STEPS)
    return 1e6 * float(np.min(found))


def test_a_joints_step_against_mujocos_own(capsys):
    lines = []
    for name, table, gravity in (
        ("linear", linear_table(), "0 0 -9.81"),
        ("kriging of 120 rows", turning_table(), "0 0 -0.2"),
    ):
        model, data = scene(ARM, 1e-3, gravity=gravity)
        joint = MujocoJoint(model, data, table)
        bare = mujoco.MjData(model)
        own, whole = best(partial(mujoco.mj_step, model, bare)), best(joint.step)
        lines.append(
            f"{name}: MuJoCo {own:.1f} us, with the joint {whole:.1f} us, "
            f"the joint {whole - own:.1f} us, {1e3 / whole:.0f} times real time at 1 ms"
        )
        assert whole < 1e3 / 10
    with capsys.disabled():
        print("\n" + "\n".join(lines))
