"""The loop of scene and component: it comes to rest where the closed form says, or says why not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import root
from scipy.spatial.transform import Rotation

from tests.service.client.answers import LinearTable, bar_compliance
from wrenchbook.service.client.mount import CouplingDiverged, Mount, MountWarning
from wrenchbook.service.client.mount.coupling import spectral_radius, stable_factor

WEIGHT = np.array([0.0, 0.0, -40.0])  # N, at the end of a lever
LEVER = np.array([0.3, 0.1, 0.05])  # m, from the bar's end, turning with it
STILL = (np.eye(3), np.zeros(3))


def lever(R: np.ndarray, p: np.ndarray) -> np.ndarray:
    """A weight on a rigid lever on the bar's end: its moment about the end where it is now."""
    return np.concatenate([WEIGHT, np.cross(R @ LEVER, WEIGHT)])


def lever_at_rest(compliance: np.ndarray) -> np.ndarray:
    """The coupled equilibrium u = C w(u), solved apart, (6,)."""

    def off(u: np.ndarray) -> np.ndarray:
        return compliance @ lever(Rotation.from_rotvec(u[3:]).as_matrix(), u[:3]) - u

    result = root(off, np.zeros(6), tol=1e-15)
    assert np.abs(off(result.x)).max() < 1e-15
    return result.x


@pytest.mark.parametrize(("relaxation", "most"), [("newton", 4), ("aitken", 10)])
def test_a_lever_on_a_bar_comes_to_rest_at_the_closed_form(relaxation, most):
    mount = Mount(LinearTable(), "plate", *STILL, relaxation=relaxation)
    settled = mount.settle(lever, accuracy=1e-7)
    expected = lever_at_rest(bar_compliance())
    off = np.abs(settled.displacement - expected).reshape(2, 3).max(axis=1)
    assert (off <= 1e-9 * np.abs(expected).reshape(2, 3).max(axis=1)).all()
    assert settled.iterations <= most
    assert np.array_equal(settled.p, mount.pose[1])


def press(G: float, direction: int = 2):
    """A stop that gives way: 100 N less the stiffness that makes G with the bar."""
    stiffness = G / bar_compliance()[direction, direction]

    def read(R: np.ndarray, p: np.ndarray) -> np.ndarray:
        wrench = np.zeros(6)
        wrench[direction] = 100.0 - stiffness * p[direction]
        return wrench

    return read, 100.0 * bar_compliance()[direction, direction] / (1.0 + G)


@pytest.mark.parametrize("relaxation", ["aitken", "newton", 0.3])
def test_a_press_with_g_5_converges(relaxation):
    read, expected = press(5.0)
    settled = Mount(LinearTable(), "plate", *STILL, relaxation=relaxation).settle(read, most=200)
    assert settled.displacement[2] == pytest.approx(expected, abs=1e-9)


def test_newton_tells_g():
    read, _ = press(5.0)
    settled = Mount(LinearTable(), "plate", *STILL, relaxation="newton").settle(read)
    assert settled.spectral_radius == pytest.approx(5.0, rel=1e-6)


@pytest.mark.parametrize("relaxation", ["off", 0.4])
def test_a_press_with_g_5_is_reported_as_diverging_where_the_factor_is_too_large(relaxation):
    read, _ = press(5.0)
    mount = Mount(LinearTable(), "plate", *STILL, relaxation=relaxation)
    with pytest.raises(CouplingDiverged, match=r"overshot the answer .* 2/\(1 \+ G\)") as caught:
        mount.settle(read)
    assert caught.value.residuals[-1] > caught.value.residuals[0]
    assert not mount.displacement.any()


@pytest.mark.parametrize("G", [0.5, 5.0, 40.0])
def test_a_factor_just_below_the_stable_one_converges_and_one_just_above_does_not(G):
    read, expected = press(G)
    bound = 2.0 / (1.0 + G)
    below = Mount(LinearTable(), "plate", *STILL, relaxation=min(1.0, 0.97 * bound))
    result = below.settle(read, most=2000).displacement[2]
    assert result == pytest.approx(expected, abs=1e-8)
    if bound < 1.0:
        above = Mount(LinearTable(), "plate", *STILL, relaxation=1.03 * bound)
        with pytest.raises(CouplingDiverged):
            above.settle(read, most=2000)


def test_the_stable_factor_is_that_of_the_stiffest_direction():
    stiffness = -np.diag([1e5, 2e5, 3e5, 10.0, 20.0, 30.0])
    G = np.abs(np.linalg.eigvals(bar_compliance() @ stiffness)).max()
    assert spectral_radius(bar_compliance(), stiffness) == pytest.approx(G)
    assert stable_factor(bar_compliance(), stiffness) == pytest.approx(2 / (1 + G))


def test_a_known_stiffness_spares_aitken_the_first_overshoot():
    read, expected = press(5.0)
    stiffness = np.zeros((6, 6))
    stiffness[2, 2] = -5.0 / bar_compliance()[2, 2]
    settled = Mount(LinearTable(), "plate", *STILL, stiffness=stiffness).settle(read)
    assert settled.displacement[2] == pytest.approx(expected, abs=1e-9)
    assert settled.iterations <= 4
    assert max(settled.residuals) == settled.residuals[0]


@pytest.mark.parametrize("relaxation", ["aitken", "newton"])
@pytest.mark.parametrize("G", [2.0, 5.0, 30.0])
def test_a_contact_that_opens_does_not_end_in_a_limit_cycle(relaxation, G):
    read, expected = press(G)

    def pushes_only(R: np.ndarray, p: np.ndarray) -> np.ndarray:
        return np.maximum(read(R, p), 0.0)

    settled = Mount(LinearTable(), "plate", *STILL, relaxation=relaxation).settle(pushes_only)
    assert settled.displacement[2] == pytest.approx(expected, abs=1e-8)


def test_that_contact_with_relaxation_off_is_a_named_failure_and_no_silent_limit_cycle():
    read, _ = press(5.0)
    mount = Mount(LinearTable(), "plate", *STILL, relaxation="off")
    with pytest.raises(CouplingDiverged):
        mount.settle(lambda R, p: np.maximum(read(R, p), 0.0))


def test_many_stiff_directions_at_once_converge():
    rng = np.random.default_rng(3)
    root_ = np.linalg.cholesky(bar_compliance() + 1e-12 * np.eye(6))
    turned = np.linalg.qr(rng.normal(size=(6, 6)))[0]
    back = np.linalg.inv(root_)
    stiffness = back.T @ turned @ np.diag([5.0, 3.0, 1.0, 0.5, 0.1, 0.0]) @ turned.T @ back
    load = np.array([10.0, 20.0, -30.0, 1.0, 2.0, 3.0])
    expected = np.linalg.solve(np.eye(6) + bar_compliance() @ stiffness, bar_compliance() @ load)

    def scene(R: np.ndarray, p: np.ndarray) -> np.ndarray:
        turn = Rotation.from_matrix(R).as_rotvec()
        return load - stiffness @ np.concatenate([p, turn])

    for relaxation in ("aitken", "newton"):
        settled = Mount(LinearTable(), "plate", *STILL, relaxation=relaxation).settle(scene)
        assert np.abs(settled.displacement - expected).max() < 1e-8, relaxation


def test_a_scene_that_tips_is_told_from_one_that_overshoots():
    read, _ = press(-1.5)
    for relaxation in ("aitken", "off"):
        mount = Mount(LinearTable(), "plate", *STILL, relaxation=relaxation)
        with pytest.raises(CouplingDiverged, match="tips or buckles"):
            mount.settle(read)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"relaxation": "off"}, "tips or buckles"),
        ({"relaxation": "newton", "stiffness": np.zeros((6, 6))}, "Newton does not converge"),
    ],
)
def test_a_runaway_is_named_soon_where_the_tolerances_grow_with_the_answers(options, named):
    """Residuals seemed to shrink, as each was compared in its own tolerances."""
    read, _ = press(-1.5)
    mount = Mount(LinearTable(tolerance=None), "plate", *STILL, **options)
    with pytest.raises(CouplingDiverged, match=named) as caught:
        mount.settle(read)
    assert len(caught.value.residuals) <= 7


@pytest.mark.parametrize("relaxation", ["aitken", "off", "newton"])
def test_without_load_and_tolerance_a_start_at_1_mm_returns_to_zero(relaxation):
    """Answers of zero gave no tolerance, so that the start itself passed for the equilibrium."""
    mount = Mount(LinearTable(tolerance=None), "plate", *STILL, relaxation=relaxation)
    mount.displacement = np.array([1e-3, 0, 0, 0, 0, 0])
    assert not mount.settle(lambda R, p: np.zeros(6)).displacement.any()


def test_newton_names_a_scene_whose_stiffness_is_not_finite():
    """Its spectral radius ended in "Array must not contain infs or NaNs"."""
    mount = Mount(LinearTable(), "plate", *STILL, relaxation="newton")
    with np.errstate(all="ignore"), pytest.raises(CouplingDiverged, match="is not finite at"):
        mount.settle(lambda R, p: np.array([0, 0, 1e305 if p.any() else 10.0, 0, 0, 0]))


def run(mount: Mount, read) -> None:
    """Sixty syncs of a scene that has no time of its own."""
    for _ in range(60):
        mount.step(read(*mount.pose))


@pytest.mark.parametrize("relaxation", ["aitken", "newton"])
def test_in_a_time_loop_a_stiff_scene_is_held(relaxation):
    read, expected = press(5.0)
    stiffness = np.zeros((6, 6))
    stiffness[2, 2] = -5.0 / bar_compliance()[2, 2]
    given = {"stiffness": stiffness} if relaxation == "newton" else {}
    mount = Mount(LinearTable(), "plate", *STILL, relaxation=relaxation, **given)
    run(mount, read)
    assert mount.displacement[2] == pytest.approx(expected, abs=1e-6)


def test_in_a_time_loop_without_relaxation_the_same_scene_is_reported():
    read, _ = press(5.0)
    mount = Mount(LinearTable(), "plate", *STILL, relaxation="off")
    with pytest.raises(CouplingDiverged, match="overshot the answer"):
        run(mount, read)


def test_in_a_time_loop_a_limit_cycle_is_reported():
    read, _ = press(5.0)
    mount = Mount(LinearTable(), "plate", *STILL, relaxation="off")
    with pytest.raises(CouplingDiverged, match="does not decay"):
        run(mount, lambda R, p: np.maximum(read(R, p), 0.0))


@pytest.mark.parametrize("directions", [1, 6])
def test_loads_that_are_noise_are_no_divergence(directions):
    loads = np.zeros((20_000, 6))
    loads[:, :directions] = np.random.default_rng(5).normal(size=(len(loads), directions))
    mount = Mount(LinearTable(), "plate", *STILL)
    for load in loads:
        mount.step(load)


def test_loads_that_change_smoothly_are_followed_without_lag():
    mount = Mount(LinearTable(), "plate", *STILL)
    for time in np.arange(0.0, 1.0, 0.01):
        load = 50.0 * np.array([0, np.sin(20 * time), np.cos(13 * time), 0, 0, 0])
        mount.step(load)
        assert np.allclose(mount.displacement, bar_compliance() @ load, rtol=1e-12, atol=0)


# -- what runs away, and what only looks like it --------------------------------------------------


HEAVY = np.array([0.0, 0.0, -100.0, 0.0, 0.0, 0.0])


def mounted(**options) -> Mount:
    return Mount(LinearTable(), "plate", np.eye(3), np.zeros(3), **options)


def pushed(mount: Mount, load: np.ndarray, stiffness: np.ndarray) -> None:
    """Sixty steps of a scene that pushes with a load and as its stiffness (6, 6) has it."""
    for _ in range(60):
        mount.step(load + stiffness @ mount.displacement)


@pytest.mark.parametrize("growth", [2.0, 30.0])
def test_a_newton_step_by_a_stiffness_of_the_wrong_sign_is_named_soon(growth):
    """It ran away for 248 steps, then ended in "math domain error"."""
    spring = growth / np.abs(np.linalg.eigvals(LinearTable().compliance)).max() * np.eye(6)
    mount = mounted(relaxation="newton", stiffness=spring)
    with pytest.raises(CouplingDiverged, match="signs of the wrench"):
        pushed(mount, HEAVY, -spring)
    assert np.isfinite(mount.displacement).all()


def test_a_scene_that_tips_in_time_is_named():
    tipping = 3.0 / LinearTable().compliance[1, 1] * np.diag([0.0, 1, 0, 0, 0, 0])
    mount, push = mounted(), np.array([0, 1e-9, 0, 0, 0, 0])
    with pytest.raises(CouplingDiverged, match="tips or buckles"):
        pushed(mount, push, tipping)


@pytest.mark.parametrize("loads", [1e-9 * 1.4 ** np.arange(80), 10.0 * np.arange(80), [1e3] * 80])
def test_loads_that_grow_by_themselves_are_followed(loads):
    mount = mounted()
    for load in loads:
        mount.step(load / 100 * HEAVY)
    expected = LinearTable().compliance @ HEAVY * loads[-1] / 100
    np.testing.assert_allclose(mount.displacement, expected, rtol=1e-12)


def test_a_load_far_beyond_the_range_writes_no_pose_beyond_20_degrees():
    mount, turned = mounted(), []

    def push():
        for _ in range(60):
            mount.step(np.array([0, 0, -1e6, 0, 0, 0]))
            turned.append(np.linalg.norm(mount.displacement[3:]))

    with pytest.raises(CouplingDiverged, match=r"tables end at 20. Check the load"):
        push()
    assert np.degrees(max(turned)) <= 20 + 1e-9


def test_statics_beyond_20_degrees_are_refused_and_not_returned():
    mount = mounted()
    with pytest.raises(CouplingDiverged, match="tables end at 20"):
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

    with pytest.raises(CouplingDiverged, match="does not settle: for 256 syncs"):
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
    mount.step(HEAVY)
    mount.place(np.eye(3), [0, 0, 1])  # no motion
    with pytest.warns(MountWarning, match="wrenchbook.MujocoJoint"):
        mount.place(np.eye(3), [0, 0, 1.1])
    mount.place(np.eye(3), [0, 0, 1.2])
