"""What rounding leaves of a kriging's answers, and which of equally near rows tells a bar."""

import numpy as np
import pytest

from tests.surrogate.kriging.responses import RESPONSES, solved
from tests.surrogate.responses import HIGH, RANGE, full_wrenches
from wrenchbook.surrogate.kriging import Kriging


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
