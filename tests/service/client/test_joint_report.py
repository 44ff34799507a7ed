"""A joint's error bars, and the report of its steps."""

from __future__ import annotations

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
from wrenchbook.service.client.joint import Joint, JointWarning
from wrenchbook.service.client.joint.joint import quaternion
from wrenchbook.service.client.joint.mujoco_joint import MujocoJoint
from wrenchbook.service.client.rotation import rotation_matrix


@pytest.mark.parametrize("seed", [11, 12, 13])
def test_nine_of_ten_wrenches_at_a_pose_are_within_their_bars(seed: int):
    """Of 40 rows of a known law, at poses whose wrench the table covers."""
    steps = known_table(40, seed).packed.joints(400)
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
    joint, bars = MujocoJoint(model, data, known_table(40)), []
    data.time = 3.0
    for _ in range(500):
        joint.step()
        bars.append(joint.error[2])
    report, at = joint.report(), int(np.argmax(bars))
    assert (report.steps, report.covered, report.stiff) == (500, 1.0, ())
    assert report.wrench_error["fz"] == (bars[at], at + 1, pytest.approx(3.0 + 1e-3 * at))
    assert report.pose_error["uz"].value > 0.0


def test_a_load_whose_bar_is_too_large_is_named_with_the_displacements_bar_that_would_do():
    joint, moved = Joint(known_table(12)), known_law(0.8 * HIGH * [1, -1, 1, 1, 1, -1])
    joint.step(rotation_matrix(moved[3:]), moved[:3], np.zeros(6), 0.1 * np.eye(6), 1e-3)
    report = joint.report()
    assert {axis.load: axis.output for axis in report.stiff} == {"fy": "uy", "mz": "rz"}
    for axis in report.stiff:
        assert axis.error == report.wrench_error[axis.load].value > axis.allowed
        bar = report.pose_error[axis.output].value
        assert axis.needed == pytest.approx(bar * axis.allowed / axis.error)
    assert report.remedy == "solve more rows (wrenchbook fill bar --for-joint)"


def test_numbers_that_are_not_known_are_none():
    joint = Joint(linear_table())
    report = joint.report()
    assert np.isnan(joint.error).all()
    assert (report.covered, report.stored, report.energy_drift) == (None, None, None)
    assert set(report.wrench_error.values()) == {None}


@pytest.mark.parametrize("dt", [1e-3, 2e-3])
def test_a_minute_of_a_swing_without_damping_keeps_its_energy_within_half_a_per_cent(dt: float):
    model, data = scene(sphere(5, "0.02 0 0.03"), dt)
    joint = MujocoJoint(model, data, linear_table(), damping=0.0)
    swing, drift = 0.5 * (5 * 9.81) ** 2 * bar_compliance()[2, 2], []
    for count in range(round(60 / dt)):
        joint.step()
        if count % 997 == 0:
            drift.append(joint.report().energy_drift)
    assert np.abs(drift).max() < 5e-3 * swing


def test_the_energy_of_a_scene_that_is_put_elsewhere_is_not_known():
    model, data = scene(sphere(5, "0.02 0 0.03"))
    joint = MujocoJoint(model, data, linear_table())
    joint.step()
    assert joint.report().energy_drift is not None
    data.time = 7.0
    joint.step()
    assert joint.report().energy_drift is None


def test_the_remedy_of_a_linear_part_beyond_its_range_is_not_more_solves():
    joint = Joint(linear_table())
    moved = bar_compliance() @ (1.5 * HIGH)
    with pytest.warns(JointWarning, match="outside the load range"):
        joint.step(rotation_matrix(moved[3:]), moved[:3], np.zeros(6), 0.1 * np.eye(6), 1e-3)
    assert (
        "widen the load range, which a pose of the steps exceeds; more solves do not help"
        in joint.report().remedy
    )


@pytest.mark.parametrize("dt", [1e-3, 2e-3])
def test_a_blow_to_a_part_without_damping_keeps_its_energy_within_half_a_per_cent(dt: float):
    model, data = scene(sphere(5, "0.02 0 0.03"), dt, gravity="0 0 0")
    joint, drift = MujocoJoint(model, data, linear_table(), damping=0.0), []
    data.qvel[1:3] = 0.05
    for count in range(round(10 / dt)):
        joint.step()
        drift += [joint.report().energy_drift] if count % 97 == 0 else []
    assert np.abs(drift).max() < 5e-3 * 0.5 * 5 * 2 * 0.05**2
