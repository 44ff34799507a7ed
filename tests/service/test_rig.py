"""Readings in a rig's frame and at its points become loads and displacements of the interface."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.refusals import assert_told, cases
from wrenchbook.service.formats.logs import loads_between
from wrenchbook.service.formats.rig import Rig, RigError, rig_text

LEFT = "x=-y,y=z,z=x"  # determinant -1
SEEDS = range(20)


def some_rig(seed, handed=None):
    """Return a rig with axes of any direction, and its random numbers."""
    rng = np.random.default_rng(seed)
    axes = Rotation.random(random_state=seed).as_matrix() * (handed or rng.choice([-1, 1]))
    return Rig(axes, *rng.uniform(-0.5, 0.5, (2, 3))), rng


def readings(rng, count=50, turn=0.2):
    wrench = rng.uniform(-1, 1, (count, 6)) * np.repeat([1000.0, 100.0], 3)
    return wrench, rng.uniform(-1, 1, (count, 6)) * np.repeat([0.01, turn / 3**0.5], 3)


def inverse(rig):
    back = -np.stack((rig.load_point, rig.displacement_point)) @ rig.axes.T
    return Rig(rig.axes.T, *back)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_rig_and_its_inverse_give_the_readings_back(seed):
    rig, rng = some_rig(seed)
    wrench, moved = readings(rng)
    back = inverse(rig)
    np.testing.assert_allclose(back.loads(rig.loads(wrench)), wrench, rtol=0, atol=1e-12 * 1000)
    result = back.displacements(rig.displacements(moved))
    np.testing.assert_allclose(result, moved, rtol=0, atol=1e-12)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_work_of_loads_is_the_same_in_every_frame(seed):
    rig, rng = some_rig(seed)
    rig = Rig(rig.axes, np.zeros(3), np.zeros(3))
    wrench, moved = readings(rng)
    result = (rig.loads(wrench) * rig.displacements(moved)).sum(axis=1)
    np.testing.assert_allclose(result, (wrench * moved).sum(axis=1), rtol=1e-12, atol=1e-11)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_work_is_the_same_to_first_order_at_every_point(seed):
    rig, rng = some_rig(seed)
    rig = Rig(rig.axes, rig.load_point, rig.load_point)
    wrench, moved = readings(rng, turn=1e-5)
    moved[:, :3] *= 1e-3
    result = (rig.loads(wrench) * rig.displacements(moved)).sum(axis=1)
    work = (wrench * moved).sum(axis=1)
    second_order = 1000 * 3**0.5 * 0.9 * 1e-5**2  # |F| |r|² |p|
    np.testing.assert_allclose(result, work, rtol=0, atol=second_order)
    assert np.abs(work).max() > 1e3 * second_order


def test_in_left_handed_axes_moments_and_rotations_turn_their_sign():
    rig = Rig.read(rig_text(LEFT, "", ""))
    assert round(np.linalg.det(rig.axes)) == -1
    result = rig.loads(np.array([[1.0, 2, 3, 4, 5, 6]]))
    np.testing.assert_array_equal(result, [[3, -1, 2, -6, 4, -5]])
    np.testing.assert_array_equal(rig.displacements(np.array([[1.0, 2, 3, 4, 5, 6]])), result)


def test_the_moment_of_a_force_is_the_same_computed_in_left_handed_axes_or_after_them():
    rig = Rig.read(rig_text(LEFT, "", ""))
    force, lever = np.array([3.0, -1, 2]), np.array([0.1, 0.4, -0.2])
    (result,) = rig.loads(np.hstack((force, np.cross(lever, force)))[None])
    np.testing.assert_allclose(result[3:], np.cross(lever @ rig.axes, force @ rig.axes), atol=1e-15)


def test_a_force_at_a_load_point_has_the_moment_of_its_lever():
    rig = Rig.read(rig_text("", "0,0,0.05", ""))
    result = rig.loads(np.array([[100.0, 0, 0, 0, 1, 0]]))
    np.testing.assert_allclose(result, [[100, 0, 0, 0, 6, 0]], atol=1e-12)  # 1 + 0.05 * 100


@pytest.mark.parametrize("angle", [1e-9, 1e-3, 0.34])
def test_a_point_beside_the_interface_swings_on_a_circle_around_it(angle):
    rig = Rig.read(rig_text("", "", "0.5,0,0"))
    swung = 0.5 * np.array([-2 * np.sin(angle / 2) ** 2, np.sin(angle), 0])  # about z
    result = rig.displacements(np.array([[*swung, 0, 0, angle]]))
    np.testing.assert_allclose(result, [[0, 0, 0, 0, 0, angle]], rtol=0, atol=1e-17)


def test_a_point_that_turns_about_any_axis_moves_as_scipy_says():
    rig, rng = some_rig(3)
    rig = Rig(np.eye(3), rig.load_point, rig.displacement_point)
    _, moved = readings(rng)
    swing = Rotation.from_rotvec(moved[:, 3:]).apply(rig.displacement_point)
    expected = moved[:, :3] - (swing - rig.displacement_point)
    np.testing.assert_allclose(rig.displacements(moved)[:, :3], expected, rtol=0, atol=1e-15)


def test_a_number_that_was_not_measured_leaves_those_of_other_axes():
    rig = Rig.read(rig_text(LEFT, "", ""))
    result = rig.displacements(np.array([[1.0, np.nan, 3, 4, 5, np.nan]]))
    np.testing.assert_array_equal(result, [[3, -1, np.nan, np.nan, 4, -5]])


def test_uncertainties_turn_with_their_axes_and_have_that_of_the_lever():
    rig = Rig.read(rig_text(LEFT, "", "0,0,2"))
    result = rig.uncertainties(np.array([[3.0, 4, 5, 0.1, 0.2, np.nan]]))
    # The interface's x is the rig's z, its y the rig's -x; r_y moves u_x by 2 m, r_x u_y.
    np.testing.assert_allclose(result, [[np.hypot(5, 0.2), np.nan, 4, np.nan, 0.1, 0.2]])


def test_axes_written_with_three_digits_are_made_perpendicular():
    rig = Rig.read("frame = [[0.707, 0.707, 0], [-0.707, 0.707, 0], [0, 0, 1]]")
    np.testing.assert_allclose(rig.axes @ rig.axes.T, np.eye(3), atol=1e-15)
    assert (rig.axes == 0).sum() == 4


def test_a_refused_value_beyond_the_basic_plane_is_quoted():
    """JSON's pair of surrogates was refused as no TOML."""
    with pytest.raises(RigError, match="load_cell: must be moving or fixed, not '🦾'"):
        Rig.read(rig_text("", "", "", "🦾"))


@cases(__file__, "rigs")
def test_a_rig_that_cannot_be_read_is_refused_with_what_to_write(case):
    with pytest.raises(RigError) as caught:
        Rig.read(case["text"])
    assert_told(case, [str(caught.value)])


def test_a_rig_of_3000_brackets_is_refused():
    with pytest.raises(RigError, match="is not TOML"):
        Rig.read("frame = " + "[" * 3000)


def joined(load, when):
    """Return a load sampled every 0.1 s, at other times; 0.41 Hz bend by 0.8 % between samples."""
    time = np.arange(0, 60, 0.1)
    after = np.searchsorted(time, when, side="right")
    return loads_between(time, load(time)[:, None], when, after)[:, 0]


def test_a_swinging_load_of_a_slow_log_is_not_cut_off_between_its_samples():
    def load(time):
        return np.sin(2 * np.pi * 0.41 * time)

    when = np.arange(1, 59, 1 / 13)
    true, result = load(when), joined(load, when)
    assert abs(result @ true / (true @ true) - 1) < 2e-4  # straight lines: 5e-3 too small
    assert np.abs(result - true).max() < 3e-3


def test_a_load_that_steps_does_not_overshoot_between_its_samples():
    result = joined(lambda time: np.floor(time + 0.01), when := np.arange(1, 58, 0.07))
    assert (np.abs(result - when - 0.01) <= 1 + 1e-9).all()
    np.testing.assert_allclose(result[when % 1 < 0.85], np.floor(when[when % 1 < 0.85] + 0.01))
