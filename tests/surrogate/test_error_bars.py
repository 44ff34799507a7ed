"""The contract: 90 % of true errors inside the bar, median bar at most 5 x median error."""

import numpy as np
import pytest

from surrogate.bars.conformal import conformal_factor
from surrogate.build import build
from surrogate.interpolation.delaunay import Triangulation
from tests.surrogate.calibrating import calibration, noisy, shipped, synthetic, with_slopes
from tests.surrogate.responses import (
    HIGH,
    RANGE,
    clean_wrenches,
    coupled,
    full_wrenches,
    kinked,
    smooth,
    table,
)

# What does not meet the contract yet, for every run to see.
KINK_SHARP = "without slopes, translations' bars spread to simplices beside the kink: 5.8 to 12.6 x"
FEW_NOISY = "56 noisy rows an axis tell noise from curvature only in part: up to 5.8 x"

SIZES = [(n, seed) for n in (56, 200, 600) for seed in (1, 2)]


@pytest.mark.parametrize(("per_axis", "seed"), SIZES)
def test_bars_hold_and_are_sharp_on_a_smooth_response(per_axis: int, seed: int) -> None:
    inside, ratio, _ = synthetic(smooth, table(smooth, clean_wrenches(per_axis, seed)))
    assert inside.min() >= 0.9
    assert ratio.max() <= 5


@pytest.mark.parametrize(("per_axis", "seed"), SIZES)
def test_bars_hold_under_noise(per_axis: int, seed: int) -> None:
    """Against the response itself: what the rows' noise makes of an answer, not of a new row."""
    assert synthetic(smooth, noisy(per_axis, seed)).inside.min() >= 0.9


@pytest.mark.parametrize(
    ("per_axis", "seed"),
    [
        pytest.param(*size, marks=[pytest.mark.xfail(strict=True, reason=FEW_NOISY)])
        if size == (56, 2)
        else size
        for size in SIZES
    ],
)
def test_bars_are_sharp_under_noise(per_axis: int, seed: int) -> None:
    assert synthetic(smooth, noisy(per_axis, seed)).ratio.max() <= 5


@pytest.mark.parametrize(("per_axis", "seed"), SIZES)
def test_bars_hold_on_a_kinked_response(per_axis: int, seed: int) -> None:
    inside, ratio, _ = synthetic(kinked, table(kinked, clean_wrenches(per_axis, seed)))
    assert inside.min() >= 0.9
    assert ratio[3:].max() <= 5


@pytest.mark.xfail(strict=True, reason=KINK_SHARP)
@pytest.mark.parametrize(("per_axis", "seed"), SIZES)
def test_bars_are_sharp_on_a_kinked_response(per_axis: int, seed: int) -> None:
    _, ratio, _ = synthetic(kinked, table(kinked, clean_wrenches(per_axis, seed)))
    assert ratio.max() <= 5


@pytest.mark.parametrize("per_axis", [56, 200])
@pytest.mark.parametrize("response", [smooth, kinked])
def test_bars_with_the_rows_own_slopes_hold(response, per_axis: int) -> None:
    rows = with_slopes(response, clean_wrenches(per_axis, 1))
    assert synthetic(response, rows).inside.min() >= 0.9


@pytest.mark.parametrize(
    ("response", "per_axis"),
    [
        (smooth, 56),
        (smooth, 200),
        (kinked, 56),
        pytest.param(
            kinked, 200, marks=pytest.mark.xfail(strict=True, reason="translations, 5.2 x")
        ),
    ],
)
def test_bars_with_the_rows_own_slopes_are_sharp(response, per_axis: int) -> None:
    rows = with_slopes(response, clean_wrenches(per_axis, 1))
    assert synthetic(response, rows).ratio.max() <= 5


@pytest.mark.parametrize("full", [20, 40, 80])
def test_full_wrench_bars_hold_and_are_sharp_on_the_thin_plate(full: int) -> None:
    component = shipped("plate_thin", full)
    surrogate = build(component.rows, component.load_range)
    inside, ratio, _ = calibration(surrogate, component.asked, component.true)
    assert inside.min() >= 0.9
    assert ratio.max() <= 5


@pytest.mark.parametrize("name", ["plate", "spring", "bar"])
def test_full_wrench_bars_hold_and_are_sharp_on_the_other_components(name: str) -> None:
    component = shipped(name, 20)
    surrogate = build(component.rows, component.load_range)
    inside, ratio, _ = calibration(surrogate, component.asked, component.true)
    assert inside.min() >= 0.9
    assert ratio.max() <= 5


def test_bars_hold_on_a_kink_at_no_force_with_the_pure_moments_that_fill_asks_for() -> None:
    moments = np.zeros((3, 9, 6))
    for moment, block in enumerate(moments):
        block[:, 3 + moment] = np.linspace(-1, 1, 9)
    scaled = np.concatenate((clean_wrenches(400, 2), np.unique(moments.reshape(-1, 6), axis=0)))
    assert synthetic(kinked, table(kinked, scaled)).inside.min() >= 0.9


def test_few_rows_make_wide_bars() -> None:
    assert synthetic(smooth, table(smooth, clean_wrenches(20, 1))).inside.min() >= 0.95


@pytest.mark.parametrize("off_axis", ["correct", "exclude"])
@pytest.mark.parametrize("full", [20, 80])
def test_full_wrench_rows_show_what_straight_influence_leaves_out(full: int, off_axis: str) -> None:
    scaled = np.concatenate((clean_wrenches(60, 1), full_wrenches(full, 2)))
    without = synthetic(coupled, table(coupled, scaled[:180]))
    inside, ratio, _ = synthetic(coupled, table(coupled, scaled), off_axis=off_axis)
    assert without.inside.min() < 0.8  # no bar can know this without such rows
    assert inside.min() >= 0.9
    assert ratio.max() <= 5


def test_rows_of_another_axis_show_the_influence_across_axes() -> None:
    def response(x: np.ndarray) -> np.ndarray:
        return smooth(x) + np.outer(x[:, 1], [2e-4, 0, 0, 0, 0, 0])  # u_x under F_y

    assert synthetic(response, table(response, clean_wrenches(60, 1))).inside.min() >= 0.9


def test_stored_uncertainty_of_rows_is_in_the_bar() -> None:
    scaled = clean_wrenches(60, 1)
    plain = build(table(smooth, scaled), RANGE).batch(full_wrenches(50, 2) * HIGH)
    doubt = np.full((len(scaled), 6), 5e-4)
    rows = table(smooth, scaled, uncertainty=doubt)
    wide = build(rows, RANGE).batch(full_wrenches(50, 2) * HIGH)
    assert (wide.error >= 5e-4 - 1e-15).all()
    np.testing.assert_array_equal(wide.displacement, plain.displacement)


def test_slivers_at_the_hull_make_the_bar_grow_but_not_blow_up() -> None:
    rng = np.random.default_rng(3)
    scaled = clean_wrenches(80, 3)
    scaled[8:80, [0, 4, 5]] = np.clip(rng.uniform(-1, 1, (72, 3)) * 1.3, -1, 1 - 1e-7)
    surrogate = build(table(smooth, scaled), RANGE)
    shape = surrogate.composition.tables[0]
    assert shape is not None
    middle = shape.interpolant.points[shape.interpolant.simplices].mean(axis=1)
    bars = shape.read(np.arange(len(middle)), middle).bars
    assert np.isfinite(bars).all()
    assert (bars < 20 * np.median(bars, axis=0)).all()


def test_the_factor_covers_its_level_and_is_careful_with_few_errors() -> None:
    rng = np.random.default_rng(4)
    errors = np.abs(rng.normal(size=(400, 1)))
    factor = conformal_factor(errors, np.ones((400, 1)))[0]
    assert 1.75 < factor < 2.2
    assert conformal_factor(errors[:6], np.ones((6, 1)))[0] == pytest.approx(2 * errors[:6].max())
    assert conformal_factor(np.zeros((30, 1)), np.zeros((30, 1)))[0] == 0
    assert np.isinf(conformal_factor(errors[:30], np.zeros((30, 1)))[0])


def test_the_bubble_is_the_error_of_interpolating_a_parabola() -> None:
    rng = np.random.default_rng(5)
    points = rng.uniform(-1, 1, (60, 3))
    shape = Triangulation(points)
    x = rng.dirichlet(np.ones(60), 200) @ points
    found = shape.locate(x)
    height = (points**2).sum(axis=1)[shape.simplices[found]]
    error = (height * shape.barycentric(found, x)).sum(axis=1) - (x**2).sum(axis=1)
    np.testing.assert_allclose(shape.bubbles(found, x), error, atol=1e-10)
