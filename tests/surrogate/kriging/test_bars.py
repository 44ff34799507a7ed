"""Bars hold on wrenches that no row has seen, over nine made-up responses and fresh seeds."""

import numpy as np
import pytest

from surrogate.kriging import Kriging
from tests.surrogate.kriging.responses import RESPONSES, noisy_rows, solved, spread_wrenches
from tests.surrogate.responses import HIGH, RANGE, full_wrenches

# Most of its errors are small and a few large: bars hold, but are up to 9 times the median error.
# Left-out rows tell that griddata does better there, so that it answers.
STEEP = "boundary_layer"

ASKED = full_wrenches(1000, 4321)


def _inside_and_ratio(kriging: Kriging, true: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    displacement, bar = kriging.answer_many(ASKED * HIGH)
    error = np.abs(displacement - true)
    return (error <= bar).mean(axis=0), np.median(bar, axis=0) / np.median(error, axis=0)


@pytest.mark.parametrize("name", RESPONSES)
def test_bars_hold_with_ten_clean_rows_an_axis_and_thirty_full_ones(name: str) -> None:
    """Over three tables: one table of 30 full rows tells a 95 % quantile by one or two of them."""
    response = RESPONSES[name]
    told = [
        _inside_and_ratio(
            Kriging.build(solved(response, spread_wrenches(10, 30, seed)), RANGE), response(ASKED)
        )
        for seed in (101, 102, 103)
    ]
    inside = np.mean([one[0] for one in told], axis=0)
    assert inside.min() >= 0.9
    assert np.median([one[1] for one in told]) <= (9 if name == STEEP else 5)


@pytest.mark.parametrize("told", [True, False])
def test_bars_hold_under_noise_told_or_not(told: bool) -> None:
    response = RESPONSES["smooth"]
    rows = noisy_rows(response, spread_wrenches(20, 60, 105), 105, told)
    inside, _ = _inside_and_ratio(Kriging.build(rows, RANGE), response(ASKED))
    assert inside.min() >= 0.9
