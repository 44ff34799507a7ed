"""Factors of the posterior deviation: single rows, groups, what they show and what they do not."""

import numpy as np
import pytest

from wrenchbook.surrogate.kriging.calibration import Calibration, Level, calibrate, groupings
from wrenchbook.surrogate.kriging.settings import DEFAULTS

RNG = np.random.default_rng(4)


def _single(errors: np.ndarray, sigma: float = 1.0, sizes: np.ndarray | None = None) -> Level:
    """Return a level of rows that are left out one by one, errors in process deviations."""
    count = len(errors)
    sizes = np.abs(errors) / sigma if sizes is None else sizes
    return Level(np.arange(count), errors, sizes, np.full(count, sigma))


def _calibrated(*levels: Level, asked: float = 1.0, coefficients: float = 0.0) -> Calibration:
    outputs = levels[0].errors.shape[1]
    return calibrate(iter(levels), outputs, np.full(256, asked), coefficients)


def test_factors_hold_for_one_more_row_of_each_output() -> None:
    size = np.array([2.0, 4.0, 1.5, 2.0, 6.0, 2.0])
    errors = RNG.normal(size=(60, 6)) * size
    factors = _calibrated(_single(errors)).factors[0]
    inside = (np.abs(RNG.normal(size=(4000, 6)) * size) <= factors).mean(axis=0)
    assert inside.min() > 0.93
    assert inside.max() < 0.995


def test_few_rows_widen_bars_so_that_nearly_all_tables_hold() -> None:
    """Of 15 rows with seven normal numbers each, 95 % of which are to be inside in all outputs."""
    held = 0
    for _ in range(400):
        whole = RNG.normal(size=(15, 6, 7))
        found = _calibrated(_single(whole[..., 0], sizes=np.sqrt((whole**2).mean(axis=2))))
        held += bool((found.factors[0] >= 1.645).all())  # 90 % of a normal distribution
    assert held >= 0.95 * 400


def test_errors_of_which_a_few_rows_make_all_are_not_known() -> None:
    few = np.full((40, 6), 0.1)
    few[:1] = 4.0
    assert not _calibrated(_single(few), coefficients=7).known
    assert _calibrated(_single(np.ones((40, 6))), coefficients=7).known
    assert _calibrated(_single(1e-7 * few), coefficients=7).known  # rounding has no size


def test_factors_are_those_of_groups_as_far_from_the_rest_as_what_is_asked() -> None:
    near = _single(0.01 * RNG.normal(size=(60, 6)), 0.1)
    errors = 3 * RNG.normal(size=(60, 6))
    far = Level(np.arange(60) // 4, errors, np.abs(errors), np.ones(60))
    found = _calibrated(near, far)
    assert (found.at(np.array([0.1])) == DEFAULTS.half_width).all()  # the normal one, not 0.2
    assert (found.at(np.array([1.0])) > 3 * DEFAULTS.half_width).all()


def test_where_no_groups_are_as_far_as_what_is_asked_errors_are_not_known() -> None:
    found = _calibrated(_single(RNG.normal(size=(60, 6))), asked=2.5)
    assert not found.known
    assert found.max_sigma == 0


def test_factors_never_fall_with_the_deviation() -> None:
    levels = [_single(size * RNG.normal(size=(60, 6)), size) for size in (0.1, 0.3, 0.5, 1.0)]
    found = _calibrated(*levels, asked=2.0 / 1.2)
    assert (np.diff(found.factors, axis=0) >= 0).all()
    assert (np.diff(found.sigma) > 0).all()


@pytest.mark.parametrize("count", [1, 3, 15, 60])
def test_groups_grow_from_single_rows_to_no_fewer_than_three(count: int) -> None:
    labels = list(groupings(RNG.normal(size=(count, 6))))
    sizes = [int(one.max()) for one in labels]
    assert sizes == sorted(set(sizes), reverse=True)
    assert not sizes or sizes[0] == count
    assert all(size >= DEFAULTS.min_groups for size in sizes)
