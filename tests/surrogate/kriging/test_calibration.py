"""Factors of the posterior deviation: what left-out rows show, and which rows count."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.surrogate.kriging.responses import RESPONSES, noisy_rows, solved
from tests.surrogate.responses import HIGH, RANGE
from tests.surrogate.scenarios import corner, motion, spread, twins
from wrenchbook.surrogate.kriging import Kriging, calibration
from wrenchbook.surrogate.kriging.calibration import (
    Errors,
    errors_of,
    factors_of,
    kinds_of,
    largest_secondary_loads,
    span_of,
)
from wrenchbook.surrogate.kriging.factor import KrigingFactor, LeftOutRows
from wrenchbook.surrogate.kriging.settings import DEFAULTS

RNG = np.random.default_rng(4)


def _factors(errors: np.ndarray, sizes: np.ndarray | None = None) -> np.ndarray:
    """Return the factors of rows of deviation 1, errors in process deviations."""
    sizes = np.abs(errors) if sizes is None else sizes
    return factors_of(Errors(errors, sizes, np.ones(len(errors))), 7, 6)


def test_factors_hold_for_one_more_row_of_each_output() -> None:
    size = np.array([2.0, 4.0, 1.5, 2.0, 6.0, 2.0])
    factors = _factors(RNG.normal(size=(60, 6)) * size)
    inside = (np.abs(RNG.normal(size=(4000, 6)) * size) <= factors).mean(axis=0)
    assert inside.min() > 0.93
    assert inside.max() < 0.995


def test_few_rows_widen_bars_so_that_nearly_all_tables_hold() -> None:
    """Of 15 rows with seven normal numbers each, 95 % of which are to be inside in all outputs."""
    held = 0
    for _ in range(400):
        whole = RNG.normal(size=(15, 6, 7))
        result = _factors(whole[..., 0], np.sqrt((whole**2).mean(axis=2)))
        held += bool((result >= 1.645).all())  # 90 % of a normal distribution
    assert held >= 0.95 * 400


def test_an_output_whose_errors_a_few_rows_make_has_wide_bars_and_no_other_has() -> None:
    """It made the errors of all outputs unknown."""
    even = np.ones((40, 6))
    few = even.copy()
    few[:, 2] = 0.1
    few[0, 2] = 4.0
    wider = _factors(few) / _factors(even)
    assert wider[2] > 2
    assert (np.delete(wider, 2) < 2).all()


def _kriging(name: str, parts: np.ndarray) -> Kriging:
    return Kriging.build(solved(RESPONSES[name], parts), RANGE)


def _known(kriging: Kriging) -> float:
    bars = kriging.answer_many(spread(300, 99) * HIGH)[1]
    return float(np.isfinite(bars).all(axis=1).mean())


def test_fewer_than_six_rows_as_far_as_queries_show_no_errors() -> None:
    assert _known(_kriging("smooth", spread(5, 8))) == 0.0
    assert _known(_kriging("smooth", spread(12, 8))) > 0.0


def test_noise_of_a_left_out_row_is_no_error_of_its_answer() -> None:
    """Of a variance of 1 three quarters are the row's noise: half the error is the answer's."""
    factor = SimpleNamespace(
        output_group=SimpleNamespace(noise=np.array([0.75, 0.0])),
        min_variance=1e-12,
        nugget=0.0,
        variance=np.ones(1),
    )
    errors, variances = np.array([[1.0], [0.5]]), np.array([1.0, 0.25])
    out = LeftOutRows(errors=errors, variances=variances, sizes=np.full((2, 1), 3.0))
    result = errors_of(factor, out, np.arange(2))
    np.testing.assert_allclose(result.errors, [[0.5], [0.5]])
    np.testing.assert_allclose(result.sigma, 0.5)
    np.testing.assert_allclose(result.sizes, [[1.0], [3.0]])


def test_ends_of_loads_are_beyond_rows_by_what_so_many_even_ones_may_leave() -> None:
    """Of n uniform numbers the largest is above the part a^(1/n) at the probability 1 - a."""
    scaling = _kriging("smooth", spread(12, 8)).scaling
    for count in (8, 100):
        x = np.tile(np.linspace(-0.5, 0.5, count)[:, None], 6)
        beyond = span_of(x, scaling, DEFAULTS)[1] - 0.5
        np.testing.assert_allclose(beyond, 100 ** (1 / count) - 1, atol=2e-6)


def test_points_load_no_more_together_than_rows_do() -> None:
    scaling = _kriging("smooth", spread(12, 8)).scaling
    rows = np.zeros((100, 6))
    rows[:, 0] = 0.8
    np.testing.assert_allclose(largest_secondary_loads(rows, scaling, DEFAULTS), 0, atol=2e-6)
    rows[:, 1] = 0.2
    np.testing.assert_allclose(
        largest_secondary_loads(rows, scaling, DEFAULTS)[0], 0.209, atol=1e-3
    )


@pytest.mark.parametrize(("full", "kinds"), [(20, 2), (8, 1)])
def test_rows_of_one_axis_are_a_kind_of_their_own_beside_many_of_several(
    full: int, kinds: int
) -> None:
    scaling = _kriging("smooth", spread(12, 8)).scaling
    axis = np.zeros((24, 6))
    axis[:, 0] = np.linspace(-1, 1, 24)
    x = np.concatenate((spread(full, 5) * 0.1, axis))
    results = kinds_of(x, scaling, span_of(x, scaling, DEFAULTS), DEFAULTS)
    assert len(results) == kinds
    if kinds == 2:
        assert results[0].rows.tolist() == [True] * full + [False] * 24
        assert results[1].rows.tolist() == [False] * full + [True] * 24
    else:  # they stand beside the others, for queries of one axis
        assert results[0].rows.all()
    assert np.abs(results[-1].queries[:, 1:]).max() < 1e-5


def _shown(monkeypatch: pytest.MonkeyPatch, far: int, near: int, size: float = 1.0) -> Kriging:
    """Return the kriging of rows that show `far` errors of 1 and `near` ones of a size."""
    shown = (np.ones((far, 6)), np.full((near, 6), size))
    result = tuple(Errors(item, item, np.ones(len(item))) for item in shown)
    monkeypatch.setattr(calibration, "left_out_as_far", lambda *_: result)
    return _kriging("smooth", spread(12, 8))


def test_six_rows_as_far_as_queries_show_errors_and_five_do_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert _known(_shown(monkeypatch, 5, 0)) == 0.0
    assert _known(_shown(monkeypatch, 6, 0)) > 0.0


def test_larger_errors_of_most_rows_near_others_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    def factors(*shown: float) -> np.ndarray:
        return _shown(monkeypatch, *shown).calibrations[0].factors  # type: ignore[arg-type]

    alone = factors(10, 0)
    np.testing.assert_array_equal(factors(10, 10, 9.0), alone)
    assert (factors(10, 12, 9.0) > 5 * alone).all()
    np.testing.assert_array_equal(factors(10, 12, 0.1), alone)


def test_bars_of_noisy_rows_hold_the_posterior_at_least(monkeypatch: pytest.MonkeyPatch) -> None:
    """Left-out rows show little but noise: errors of nothing would be no bar."""
    none = np.full((20, 6), 1e-9)
    result = Errors(none, none, np.ones(20))
    monkeypatch.setattr(calibration, "left_out_as_far", lambda *_: (result, result))
    rows = noisy_rows(RESPONSES["smooth"], spread(60, 8), 8, told=True)
    kriging = Kriging.build(rows, RANGE)
    assert (kriging.calibrations[0].factors > DEFAULTS.posterior_width).all()


def _left_out(monkeypatch: pytest.MonkeyPatch, parts: np.ndarray) -> tuple[Errors, Errors, float]:
    """Return the errors of rows far and near, and the median deviation at random wrenches."""
    results = []
    sound = calibration.left_out_as_far

    def noted(factor: KrigingFactor, *rest: object) -> tuple[Errors, Errors]:
        points, value = spread(200, 5), np.zeros((200, 7), dtype=bool)
        value[:, 0] = True
        deviation = factor.variance_of(*factor.explained_at(points, value), factor.mean_covariance)
        pair = sound(factor, *rest)  # type: ignore[arg-type]
        results.append((*pair, float(np.sqrt(np.median(deviation)))))
        return pair

    monkeypatch.setattr(calibration, "left_out_as_far", noted)
    _kriging("smooth", parts)
    return results[0]


def test_of_rows_that_are_left_out_together_one_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    far, near, _ = _left_out(monkeypatch, twins(15, 1e-3, 3))
    assert len(near.sigma) == 30
    assert 6 <= len(far.sigma) <= 15


def test_rows_of_a_motion_are_left_out_until_they_are_as_far_as_queries(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The median is that of other random wrenches than the product's."""
    parts = np.concatenate((spread(15, 3), motion(30, 7)))
    far, near, middle = _left_out(monkeypatch, parts)
    assert far.sigma.min() > 0.5 * middle
    assert near.sigma.max() < 0.7 * middle


OTHERS = {
    "a motion": motion(30, 7),
    "a corner": corner(25, 7) / 2 + 0.5,
    "twins": twins(15, 0.01, 3)[15:],
}


@pytest.mark.parametrize("others", OTHERS)
@pytest.mark.parametrize("name", ["smooth", "hardening", "clearance"])
def test_rows_near_others_never_hide_what_spread_rows_showed(name: str, others: str) -> None:
    """The sixteenth row of 15 spread ones, and 30 of a motion, made all errors unknown."""
    before = _known(_kriging(name, spread(15, 3)))
    assert before > 0.5
    for count in (1, 2, 5, 10, 30):
        parts = np.concatenate((spread(15, 3), OTHERS[others][:count]))
        assert _known(_kriging(name, parts)) >= 0.9 * before


def test_rows_near_each_other_do_not_calibrate_what_lies_far_from_them() -> None:
    """Twins predict each other to 1e-4 of what the response between the pairs is predicted to."""
    alone, paired = (_kriging("smooth", parts) for parts in (spread(15, 3), twins(15, 1e-3, 3)))
    (before,), (after,) = alone.calibrations, paired.calibrations
    assert (after.factors > 0.5 * before.factors).all()
    assert after.max_sigma > 0.5 * before.max_sigma
