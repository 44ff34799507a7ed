"""A joint's error bars, and the report of its steps."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from tests.service.client.answers import bar_compliance
from tests.service.client.joint_scenes import (
    HIGH,
    known_law,
    known_table,
    linear_table,
    scene,
    sphere,
)
from wrenchbook.service.client.joint import Joint
from wrenchbook.service.client.joint.joint import quaternion
from wrenchbook.service.client.joint.mujoco_joint import MujocoJoint

TABLE = known_table(40)


@pytest.mark.parametrize("seed", [11, 12, 13])
def test_nine_of_ten_wrenches_at_a_pose_are_within_their_bars(seed: int):
    """Of 40 rows of a known law, at poses whose wrench the table covers."""
    steps = known_table(40, seed).packed.joints(400, 0)
    wrenches = np.random.default_rng(100 + seed).uniform(-0.9, 0.9, (400, 6)) * HIGH
    moved = known_law(wrenches)
    steps.poses[:, :3], steps.poses[:, 3:] = moved[:, :3], [quaternion(r) for r in moved[:, 3:]]
    steps.state()
    covered = steps.replies["coverage"] == 0
    off = np.abs(steps.replies["still"] - wrenches)[covered]
    assert covered.mean() > 0.8
    assert (off <= steps.replies["wrench_error"][covered]).mean(axis=0).min() >= 0.9


def test_the_report_has_the_largest_bars_and_their_steps():
    model, data = scene(sphere(5, "0.02 0 0.03"))
    joint, bars = MujocoJoint(model, data, TABLE, damping=0.02), []
    data.time = 3.0
    for _ in range(500):
        joint.step()
        bars.append(joint.error)
    report, all_of = joint.report(), np.array(bars)
    assert (report.steps, report.covered) == (500, 1.0)
    assert report.time == pytest.approx(0.5)
    largest = report.wrench_error["fz"]
    assert largest.value == all_of[:, 2].max()
    assert largest.step == all_of[:, 2].argmax() + 1
    assert largest.time == pytest.approx(3.0 + 1e-3 * all_of[:, 2].argmax())
    assert 0.0 < report.pose_error["uz"].value < 0.05 * abs(joint.displacement[2])


def test_a_load_that_the_table_knows_too_badly_is_named_with_the_bar_that_would_do():
    model, data = scene(sphere(5))
    joint = MujocoJoint(model, data, known_table(9))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        joint.step()
    report = joint.report()
    assert "--for-joint" in report.remedy
    print(report)
    axis = report.stiff[0]
    assert axis.allowed == pytest.approx(0.05 * HIGH[0])
    print(axis)


def test_numbers_that_are_not_known_are_none():
    joint = Joint(linear_table())
    assert np.isnan(joint.error).all()
    report = joint.report()
    assert (report.steps, report.covered, report.stored) == (0, None, None)
    assert set(report.wrench_error.values()) == {None}


@pytest.mark.parametrize("dt", [1e-3, 2e-3])
def test_a_minute_of_a_swing_without_damping_keeps_its_energy_within_half_a_per_cent(dt):
    model, data = scene(sphere(5, "0.02 0 0.03"), dt)
    joint = MujocoJoint(model, data, linear_table(), damping=0.0)
    swing, drift = 0.5 * (5 * 9.81) ** 2 * bar_compliance()[2, 2], []
    for count in range(round(60 / dt)):
        joint.step()
        if count % 997 == 0:
            drift.append(joint.report().energy_drift)
    assert np.abs(drift).max() < 5e-3 * swing
