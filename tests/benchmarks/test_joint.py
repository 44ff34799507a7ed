"""A step of a joint in MuJoCo beside ``mj_step``, and 4,096 joints in one call of the kernel.

A sphere of 5 kg on the bar of 1 m: its linear table, and kriging of 40 and of 120 rows. Each figure
is the best of rounds that take turns: the machine is shared.
"""

from __future__ import annotations

import time
from collections.abc import Callable

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
from wrenchbook.service.client.joint.mujoco_joint import MujocoJoint, joints_in_mj_step

ROUNDS, STEPS, MANY, THREADS = 15, 500, 4096, 2


def best(*calls: Callable[[], object]) -> list[float]:
    """The shortest time of each call, s, of rounds that take turns."""
    least = [np.inf] * len(calls)
    for _ in range(ROUNDS):
        for k, call in enumerate(calls):
            began = time.perf_counter()
            call()
            least[k] = min(least[k], time.perf_counter() - began)
    return least


def swing() -> tuple:
    model, data = scene(sphere(5, "0.02 0 0.03"))
    data.qvel[:3] = [0.01, 0.02, 0.01]
    return model, data


def test_a_step_of_a_joint_beside_mj_step() -> None:
    print()
    tables = {"linear": linear_table(), "40 rows": known_table(40), "120 rows": known_table(120)}
    bare = swing()
    for name, table in tables.items():
        model, data = swing()
        joint = MujocoJoint(model, data, table, damping=0.02)

        def own(joint: MujocoJoint = joint) -> None:
            for _ in range(STEPS):
                joint.step()

        def within(scene: tuple = (model, data)) -> None:
            with joints_in_mj_step():
                mujoco.mj_step(*scene, STEPS)

        def alone() -> None:
            for _ in range(STEPS):
                mujoco.mj_step(*bare)

        step, inside, plain = (1e6 * spent / STEPS for spent in best(own, within, alone))
        assert joint.report().covered == 1.0
        print(
            f"{name:>9}: joint.step {step:5.1f} us, {step / plain:4.1f} times mj_step, "
            f"{plain:.1f} us; in mj_step {inside:5.1f} us"
        )


def test_many_joints_in_one_call() -> None:
    table, rng = known_table(40), np.random.default_rng(1)
    steps = table.packed.joints(MANY, 0)
    steps.inverse_masses[:] = np.diag([0.2, 0.2, 0.2, 50, 50, 50])
    wrenches, rounds = rng.uniform(-0.7, 0.7, (MANY, 6)) * HIGH, []
    for _ in range(ROUNDS):
        moved = known_law(wrenches)
        steps.poses[:, :3] = moved[:, :3]
        steps.poses[:, 3:] = [quaternion(turn) for turn in moved[:, 3:]]
        began = time.perf_counter()
        steps.step(1e-3, 0.05, THREADS)
        rounds.append(time.perf_counter() - began)
        assert not steps.replies["status"].any()
        wrenches *= 1 + 0.01 * rng.normal(size=wrenches.shape)
    took = min(rounds)
    print(f"\n{MANY} joints, 40 rows, {THREADS} threads: {1e3 * took:.1f} ms, ", end="")
    print(f"{1e6 * took / MANY:.2f} us each")
