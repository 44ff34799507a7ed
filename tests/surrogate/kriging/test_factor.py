"""Interpolation at rows, and rows left out against refitting without them."""

import numpy as np
import pytest

from tests.surrogate.kriging.responses import RESPONSES, noisy_rows, solved, spread_wrenches
from tests.surrogate.responses import HIGH, RANGE, full_wrenches
from wrenchbook.surrogate.kriging import Kriging
from wrenchbook.surrogate.kriging.correlation import Hyperparameters, covariance, mean_terms
from wrenchbook.surrogate.kriging.equations import (
    Equations,
    equations_of,
    indices_within,
    scaling_of,
)
from wrenchbook.surrogate.kriging.factor import (
    KrigingFactor,
    OutputGroup,
    SingularCovarianceError,
    factorise,
    inverse_factor,
    left_out,
)
from wrenchbook.surrogate.kriging.settings import KrigingSettings
from wrenchbook.surrogate.table.merging import merge

HELD = Hyperparameters.of_logarithms(np.array([0.4, 0.6, 0.5, 0.3, 0.7, 0.2, -1.0]))
SETTINGS = KrigingSettings(nugget=1e-8)
OUTPUTS = np.arange(6)


def _equations(per_axis: int, full: int, measured: bool = False) -> Equations:
    x, response = spread_wrenches(per_axis, full, 5), RESPONSES["strongly_coupled"]
    rows = noisy_rows(response, x, 5, told=True) if measured else solved(response, x)
    inside, _, readings = merge(rows.take(indices_within(rows, RANGE)), RANGE).usable()
    return equations_of(inside, scaling_of(inside, RANGE), readings)


def _factor(equations: Equations, rows: np.ndarray) -> KrigingFactor:
    noise = equations.noise[rows, 0]
    return factorise(equations, HELD, OutputGroup(OUTPUTS, rows, noise), SETTINGS)


def _answer(equations: Equations, factor: KrigingFactor, row: int) -> tuple[np.ndarray, float]:
    """Return value and variance over the process variance at a row, mean's doubt included."""
    own, here = factor.equations, equations.take(np.array([row]))
    value = np.zeros((1, 7), dtype=bool)
    value[0, 0] = True
    across = covariance(here.x, value, own.x, own.known, HELD)
    reported = mean_terms(here.x, value) @ factor.coefficients + across @ factor.weights
    reduced = across @ factor.T.T
    loose = mean_terms(here.x, value) - reduced @ factor.TF
    variance = HELD.prior(1)[0] - reduced @ reduced.T + loose @ factor.mean_covariance @ loose.T
    return reported[0], float(variance[0, 0])


def test_the_inverse_factor_is_that_of_the_covariance() -> None:
    equations = _equations(3, 6)
    factor = _factor(equations, np.arange(len(equations)))
    matrix = covariance(equations.x, equations.known, equations.x, equations.known, HELD)
    added = np.tile(1e-8 * HELD.prior(7), (len(equations), 1))
    added[:, 0] += factor.output_group.noise
    matrix[np.diag_indices_from(matrix)] += added[equations.known]
    unit = factor.T @ matrix @ factor.T.T
    np.testing.assert_allclose(unit, np.eye(len(unit)), atol=1e-7)
    assert (np.triu(factor.T, 1) == 0).all()


@pytest.mark.parametrize("measured", [False, True])
@pytest.mark.parametrize("size", [1, 3])
def test_left_out_groups_equal_refitting_without_them(measured: bool, size: int) -> None:
    equations = _equations(4, 10, measured)
    every = np.arange(len(equations))
    factor, labels = _factor(equations, every), every // size
    reported = left_out(factor, labels)
    for row in every[::3]:
        without = _factor(equations, every[labels != labels[row]])
        value, _ = _answer(equations, without, row)
        np.testing.assert_allclose(reported.errors[row], equations.data[row, 0] - value, atol=1e-8)
    one = left_out(factor, np.where(labels == labels[0], 0, -1))
    np.testing.assert_array_equal(one.errors[:size], reported.errors[:size])
    assert np.isnan(one.errors[size:]).all()


def test_left_out_rows_with_the_mean_kept_equal_refitting_about_it() -> None:
    """Without the mean's part in Q the blocks are those of a known mean."""
    equations = _equations(3, 8)
    every = np.arange(len(equations))
    settings = KrigingSettings(nugget=1e-8, mean_variance=1e-14)
    factor = factorise(equations, HELD, OutputGroup(OUTPUTS, every, np.zeros(len(every))), settings)
    reported = left_out(factor, every)
    for row in every[::4]:
        rest = np.delete(every, row)
        without = factorise(
            equations, HELD, OutputGroup(OUTPUTS, rest, np.zeros(len(rest))), settings
        )
        value, _ = _answer(equations, without, row)
        np.testing.assert_allclose(reported.errors[row], equations.data[row, 0] - value, atol=1e-8)


def test_a_singular_covariance_takes_a_larger_nugget_and_says_so() -> None:
    twice = np.ones((2, 2))
    twice[0, 0] += 1e-18
    _, nugget = inverse_factor(twice - 1e-9 * np.eye(2), 1e-10, 1e-4, np.ones(2))
    assert 1e-9 < nugget <= 1e-4


def test_a_covariance_no_nugget_mends_is_refused_by_name() -> None:
    with pytest.raises(SingularCovarianceError, match="withdraw"):
        inverse_factor(np.array([[1.0, 2.0], [2.0, 1.0]]), 1e-10, 1e-4, np.ones(2))


def _gentle(x: np.ndarray) -> np.ndarray:
    return 1e-4 * np.tanh(x) + 2e-5 * np.roll(x, 1, axis=1) * x


@pytest.fixture(scope="module")
def gentle() -> Kriging:
    return Kriging.build(solved(_gentle, full_wrenches(30, 1)), RANGE)


def _asked(kriging: Kriging) -> np.ndarray:
    """Rows, where bars are smallest, places beside them, and others."""
    rows = kriging.equations.x * HIGH
    return np.concatenate((rows, 0.999 * rows, full_wrenches(300, 2) * HIGH))


def test_weights_that_are_huge_are_told_by_the_floor_of_the_bars(gentle: Kriging) -> None:
    assert np.abs(gentle.weights).sum() > 1e7
    assert gentle.rounding.max() > 10 * gentle.settings.error_floor


def test_the_nugget_keeps_rounding_below_a_thousandth_of_every_bar(gentle: Kriging) -> None:
    _, bars = gentle.answer_many(_asked(gentle))
    bars = bars[np.isfinite(bars).all(axis=1)]
    assert len(bars)
    assert (gentle.rounding * gentle.scaling.spread < 1e-3 * bars).all()


def test_of_equally_near_rows_the_first_tells_the_bar() -> None:
    x = np.concatenate((np.eye(6), -np.eye(6), np.zeros((1, 6)), full_wrenches(12, 4)))
    kriging = Kriging.build(solved(RESPONSES["strongly_coupled"], x), RANGE)
    own = kriging.equations.x
    neighbours = kriging.neighbourhoods[0]
    rates = kriging.hyperparameters.inverse_squares
    pairs = [(own[i] + own[j]) / 2 for i in range(12) for j in range(i)]
    asked = np.array([*pairs, *own])
    distance = ((asked[:, None] - own) ** 2) @ rates
    tied = distance <= distance.min(axis=1, keepdims=True) + 1e-10
    assert (tied.sum(axis=1) > 1).any()
    np.testing.assert_array_equal(neighbours.nearest(asked), tied.argmax(axis=1))
