"""A step of a joint in MuJoCo beside ``mj_step``, and 4,096 joints in one call of the kernel.

A sphere of 5 kg on the bar of 1 m: its linear table, and kriging of 40 and of 120 rows. Each figure
is the best of short rounds that take turns: the machine is shared.
"""

from __future__ import annotations

import timeit

import numpy as np

from tests.service.client.joint_scenes import (
    HIGH,
    known_law,
    known_table,
    linear_table,
    mujoco,
    scene,
    sphere,
)
from wrenchbook.service.client.joint.joint import quaternion
from wrenchbook.service.client.joint.mujoco_callback import joints_in_mj_step
from wrenchbook.service.client.joint.mujoco_joint import MujocoJoint

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
