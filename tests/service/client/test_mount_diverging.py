"""A loop that runs away without turning round, and what only looks like one."""

from __future__ import annotations

import numpy as np
import pytest

from tests.service.client.answers import LinearTable
from wrenchbook.service.client.mount import CouplingDiverged, Mount, MountWarning

WEIGHT = np.array([0.0, 0.0, -100.0, 0.0, 0.0, 0.0])


def mounted(**options) -> Mount:
    return Mount(LinearTable(), "plate", np.eye(3), np.zeros(3), **options)


def run(mount: Mount, load: np.ndarray, stiffness: np.ndarray) -> None:
    """Sixty steps of a scene that pushes with a load and as its stiffness (6, 6) has it."""
    for _ in range(60):
        mount.step(load + stiffness @ mount.displacement)


@pytest.mark.parametrize("growth", [2.0, 30.0])
def test_a_newton_step_by_a_stiffness_of_the_wrong_sign_is_named_soon(growth):
    """It ran away for 248 steps, then ended in "math domain error"."""
    spring = growth / np.abs(np.linalg.eigvals(LinearTable().compliance)).max() * np.eye(6)
    mount = mounted(relaxation="newton", stiffness=spring)
    with pytest.raises(CouplingDiverged, match="sign is wrong"):
        run(mount, WEIGHT, -spring)
    assert np.isfinite(mount.displacement).all()


def test_a_scene_that_tips_in_time_is_named():
    tipping = 3.0 / LinearTable().compliance[1, 1] * np.diag([0.0, 1, 0, 0, 0, 0])
    mount, push = mounted(), np.array([0, 1e-9, 0, 0, 0, 0])
    with pytest.raises(CouplingDiverged, match="tips or buckles"):
        run(mount, push, tipping)


def test_a_load_far_beyond_the_range_writes_no_pose_beyond_20_degrees():
    mount, turned = mounted(), []

    def push():
        for _ in range(60):
            mount.step(np.array([0, 0, -1e6, 0, 0, 0]))
            turned.append(np.linalg.norm(mount.displacement[3:]))

    with pytest.raises(CouplingDiverged, match="tables hold 20: the load is far beyond"):
        push()
    assert np.degrees(max(turned)) <= 20 + 1e-9


def test_statics_beyond_20_degrees_are_refused_and_not_returned():
    mount = mounted()
    with pytest.raises(CouplingDiverged, match="tables hold 20"):
        mount.settle(lambda R, p: np.array([0, 0, -5000 * 9.81, 0, 0, 0]))
    assert not mount.displacement.any()


def cycle(k):
    """A limit cycle of a foot on a contact, as it was seen at a sync of 10 ms."""
    return [1.56, -5.89, -0.25, 8.55, 13.8][k % 5]


def test_a_limit_cycle_is_raised_and_not_followed_without_end():
    mount = mounted()

    def swing():
        for k in range(2000):
            mount.step(np.array([0, 0, cycle(k), 0, 0, 0]))

    with pytest.raises(CouplingDiverged, match="does not come to rest: for 256 syncs"):
        swing()


def test_a_swing_that_the_syncs_resolve_is_followed():
    mount = mounted()
    for k in range(2000):
        mount.step(np.array([0, 0, 10 * np.sin(2 * np.pi * k / 40), 0, 0, 0]))
    assert mount.coverage.covered == 2000


def test_a_swing_that_dies_away_is_followed():
    mount = mounted()
    for k in range(1000):
        mount.step(np.array([0, 0, cycle(k) * 0.99**k, 0, 0, 0]))
    assert mount.coverage.covered == 1000


def test_a_base_that_moves_while_time_passes_is_warned_of_once_with_the_joint():
    mount = mounted()
    mount.place(np.eye(3), [0, 0, 1])  # before the first step it is the set-up
    mount.step(WEIGHT)
    mount.place(np.eye(3), [0, 0, 1])  # no motion
    with pytest.warns(MountWarning, match="wrenchbook.MujocoJoint"):
        mount.place(np.eye(3), [0, 0, 1.1])
    mount.place(np.eye(3), [0, 0, 1.2])
