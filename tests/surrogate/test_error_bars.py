"""The contract: 90 % of true errors inside the bar, median bar at most 5 x median error."""

import numpy as np
import pytest

from surrogate.errorbar import conformal_factor
from surrogate.interpolant import Interpolant
from surrogate.rows import Rows
from surrogate.surrogate import Surrogate
from tests.surrogate.responses import (
    HIGH,
    RANGE,
    Response,
    clean_wrenches,
    coupled,
    full_wrenches,
    kinked,
    smooth,
    table,
)


def calibration(rows: Rows, response: Response, **how: object) -> tuple[np.ndarray, np.ndarray]:
    """Return, per output, the part of errors inside the bar and median bar over median error."""
    asked = full_wrenches(2000, 99)
    answers = Surrogate.build(rows, RANGE, **how).batch(asked * HIGH)  # type: ignore[arg-type]
    covered = answers.coverage == 0
    assert covered.mean() > 0.9
    true = np.abs(answers.displacement - response(asked))[covered]
    bars = answers.error[covered]
    return (true <= bars).mean(axis=0), np.median(bars, axis=0) / np.median(true, axis=0)


# What does not meet the contract yet, for every run to see.
KINK_HOLD = "moments alone lie on the kink, with no row there: rotation errors all have one sign"
KINK_SHARP = "bars spread from the few simplices that the kink cuts to those beside it: up to 31 x"
NOISE_SHARP = (
    "a held-out error holds the row's own noise, the answer's error does not: 5.2 to 8.2 x"
)

SIZES = [(n, seed) for n in (56, 200, 600) for seed in (1, 2)]


def misses(why: str, cases: list, missed: set) -> list:
    """Return the cases, those that miss the contract marked as expected failures."""
    mark = pytest.mark.xfail(strict=True, reason=why)
    return [pytest.param(*case, marks=[mark] if case in missed else []) for case in cases]


@pytest.mark.parametrize(("per_axis", "seed"), SIZES)
def test_bars_hold_on_a_smooth_response(per_axis: int, seed: int) -> None:
    inside, _ = calibration(table(smooth, clean_wrenches(per_axis, seed)), smooth)
    assert inside.min() >= 0.9


@pytest.mark.parametrize(
    ("per_axis", "seed"), misses("few rows: rotation bars up to 5.6 x", SIZES, {(56, 1)})
)
def test_bars_are_sharp_on_a_smooth_response(per_axis: int, seed: int) -> None:
    _, ratio = calibration(table(smooth, clean_wrenches(per_axis, seed)), smooth)
    assert ratio.max() <= 5


@pytest.mark.parametrize(
    ("per_axis", "seed"), misses(KINK_HOLD, SIZES, {(200, 2), (600, 1), (600, 2)})
)
def test_bars_hold_on_a_kinked_response(per_axis: int, seed: int) -> None:
    inside, _ = calibration(table(kinked, clean_wrenches(per_axis, seed)), kinked)
    assert inside.min() >= 0.9


@pytest.mark.parametrize(("per_axis", "seed"), misses(KINK_SHARP, SIZES, set(SIZES)))
def test_bars_are_sharp_on_a_kinked_response(per_axis: int, seed: int) -> None:
    _, ratio = calibration(table(kinked, clean_wrenches(per_axis, seed)), kinked)
    assert ratio.max() <= 5


def test_bars_hold_on_a_kink_at_no_force_with_the_pure_moments_that_fill_asks_for() -> None:
    moments = np.zeros((3, 9, 6))
    for moment, block in enumerate(moments):
        block[:, 3 + moment] = np.linspace(-1, 1, 9)
    scaled = np.concatenate((clean_wrenches(400, 2), np.unique(moments.reshape(-1, 6), axis=0)))
    inside, _ = calibration(table(kinked, scaled), kinked)
    assert inside.min() >= 0.9


def noisy(per_axis: int, seed: int) -> Rows:
    noise = np.random.default_rng(seed).normal(size=(3 * per_axis, 6)) * 3e-4
    return table(lambda x: smooth(x) + noise, clean_wrenches(per_axis, seed))


@pytest.mark.parametrize(("per_axis", "seed"), SIZES)
def test_bars_hold_under_noise(per_axis: int, seed: int) -> None:
    """Against the truth, not the noisy rows, which a bar over noisy rows must hold as well."""
    inside, _ = calibration(noisy(per_axis, seed), smooth)
    assert inside.min() >= 0.9


@pytest.mark.parametrize(("per_axis", "seed"), misses(NOISE_SHARP, SIZES, set(SIZES)))
def test_bars_are_sharp_under_noise(per_axis: int, seed: int) -> None:
    _, ratio = calibration(noisy(per_axis, seed), smooth)
    assert ratio.max() <= 5


def test_few_rows_make_wide_bars() -> None:
    inside, _ = calibration(table(smooth, clean_wrenches(20, 1)), smooth)
    assert inside.min() >= 0.95


FULL = [(n, off) for n in (20, 80) for off in ("correct", "exclude")]


@pytest.mark.parametrize(
    ("full", "off_axis"), misses("20 rows hold u_z at 89 % only", FULL, {(20, "correct")})
)
def test_full_wrench_rows_show_what_straight_influence_leaves_out(full: int, off_axis: str) -> None:
    scaled = np.concatenate((clean_wrenches(60, 1), full_wrenches(full, 2)))
    without, _ = calibration(table(coupled, scaled[:180]), coupled)
    inside, _ = calibration(table(coupled, scaled), coupled, off_axis=off_axis)
    assert without.min() < 0.8  # no bar can know this without such rows
    assert inside.min() >= 0.9


@pytest.mark.parametrize(("full", "off_axis"), misses("bars up to 7.3 x", FULL, set(FULL)))
def test_bars_with_full_wrench_rows_are_sharp(full: int, off_axis: str) -> None:
    scaled = np.concatenate((clean_wrenches(60, 1), full_wrenches(full, 2)))
    _, ratio = calibration(table(coupled, scaled), coupled, off_axis=off_axis)
    assert ratio.max() <= 5


def test_rows_of_another_axis_show_the_influence_across_axes() -> None:
    def response(x: np.ndarray) -> np.ndarray:
        return smooth(x) + np.outer(x[:, 1], [2e-4, 0, 0, 0, 0, 0])  # u_x under F_y

    inside, _ = calibration(table(response, clean_wrenches(60, 1)), response)
    assert inside.min() >= 0.9


def test_stored_uncertainty_of_rows_is_in_the_bar() -> None:
    scaled = clean_wrenches(60, 1)
    plain = Surrogate.build(table(smooth, scaled), RANGE).batch(full_wrenches(50, 2) * HIGH)
    doubt = np.full((len(scaled), 6), 5e-4)
    rows = table(smooth, scaled, uncertainty=doubt)
    wide = Surrogate.build(rows, RANGE).batch(full_wrenches(50, 2) * HIGH)
    assert (wide.error >= 5e-4 - 1e-15).all()
    np.testing.assert_array_equal(wide.displacement, plain.displacement)


def test_slivers_at_the_hull_make_the_bar_grow_but_not_blow_up() -> None:
    rng = np.random.default_rng(3)
    scaled = clean_wrenches(80, 3)
    scaled[8:80, [0, 4, 5]] = np.clip(rng.uniform(-1, 1, (72, 3)) * 1.3, -1, 1 - 1e-7)
    surrogate = Surrogate.build(table(smooth, scaled), RANGE)
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
    shape = Interpolant(points)
    x = rng.dirichlet(np.ones(60), 200) @ points
    found = shape.locate(x)
    height = (points**2).sum(axis=1)[shape.simplices[found]]
    error = (height * shape.barycentric(found, x)).sum(axis=1) - (x**2).sum(axis=1)
    np.testing.assert_allclose(shape.bubbles(found, x), error, atol=1e-10)
