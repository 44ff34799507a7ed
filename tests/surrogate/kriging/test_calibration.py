"""Factors of the posterior deviation: what left-out rows show, and which rows count."""

import numpy as np
import pytest

from tests.surrogate.kriging.responses import RESPONSES, solved
from tests.surrogate.responses import HIGH, RANGE
from tests.surrogate.scenarios import corner, motion, spread, twins
from wrenchbook.surrogate.kriging import Kriging
from wrenchbook.surrogate.kriging.calibration import Errors, factors_of

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
        found = _factors(whole[..., 0], np.sqrt((whole**2).mean(axis=2)))
        held += bool((found >= 1.645).all())  # 90 % of a normal distribution
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
    assert not _kriging("smooth", spread(5, 8)).knows_errors
    assert _kriging("smooth", spread(12, 8)).knows_errors


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
