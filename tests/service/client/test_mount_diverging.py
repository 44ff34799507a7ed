"""A loop that runs away without turning round, and what only looks like one."""

from __future__ import annotations

import numpy as np
import pytest

from tests.service.client.answers import LinearTable
from wrenchbook.service.client.mount import CouplingDiverged, Mount

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
    mount, push = mounted(), np.array([0, 1e-3, 0, 0, 0, 0])
    with pytest.raises(CouplingDiverged, match="tips or buckles"):
        run(mount, push, tipping)


@pytest.mark.parametrize("loads", [lambda k: 1e-9 * 1.4**k, lambda k: 1e3 * k, lambda k: 1e6])
def test_loads_that_grow_by_themselves_are_followed(loads):
    mount = mounted()
    for k in range(80):
        mount.step(np.array([0, 0, -loads(k), 0, 0, 0]))
    expected = LinearTable().compliance @ [0, 0, -loads(79), 0, 0, 0]
    assert np.allclose(mount.displacement, expected, rtol=1e-12)


@pytest.mark.parametrize("whole", [False, True])
def test_a_masked_number_is_no_number(whole):
    masked = np.ma.masked_greater([1.0, 2.0, 900.0, 0.0, 0.0, 0.0], 100.0)
    with pytest.raises(ValueError, match="masked"):
        mounted().step(masked) if whole else mounted().step(masked[:3], masked[3:])
