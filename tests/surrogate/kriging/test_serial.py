"""Errors that consecutive readings have in common count, and the response does not."""

import numpy as np
import pytest

from tests.surrogate.law import build
from tests.surrogate.responses import RANGE
from wrenchbook.surrogate.findings.find import correlation_findings
from wrenchbook.surrogate.kriging.serial import dependence_of
from wrenchbook.surrogate.table.rows import Rows

LEVELS = np.linspace(-1, 1, 12)
N_READINGS = 15


def holds(seed, offset, white, levels=LEVELS, readings=N_READINGS):
    """Return rows of levels up and down: errors of each hold and of each reading, of 1e-3 m."""
    rng = np.random.default_rng(seed)
    loads = np.concatenate((levels, levels[::-1])).repeat(readings)
    loads += rng.normal(0, 1e-4, len(loads))
    wrench = np.zeros((len(loads), 6))
    wrench[:, 2] = loads * RANGE.scale[2]
    moved = 1e-3 * np.outer(np.tanh(1.5 * loads) + 0.2 * loads**2, np.linspace(1, 2, 6))
    of_hold = rng.normal(0, offset, (2 * len(levels), 6)).repeat(readings, axis=0)
    moved += of_hold + rng.normal(0, white, moved.shape)
    return Rows.of(wrench, moved, source=["measured"] * len(loads))


def test_readings_of_a_hold_with_a_common_error_count_as_one():
    ratios = [dependence_of(holds(seed, 5e-6, 1e-6), RANGE) for seed in range(20)]
    # 1 + 14 * 25 / 26 by the variances; the differences of 12 holds show it to a third.
    assert np.median(ratios) == pytest.approx(14.5, rel=0.2)


def test_error_bars_of_held_loads_count_their_common_errors():
    rows = holds(3, 5e-6, 1e-6)
    truth = holds(3, 0.0, 0.0, np.linspace(-0.9, 0.9, 50), 1)
    moved, bars = build(rows, RANGE).groups[0].kriging.answer_many(truth.wrench)
    # 0.48 if each reading counts, 0.84 with their common errors.
    assert (np.abs(moved - truth.displacement) <= bars).mean() >= 0.8


def test_independent_readings_count_each():
    ratios = [dependence_of(holds(seed, 0.0, 5e-6), RANGE) for seed in range(20)]
    np.testing.assert_array_equal(ratios, 1.0)


@pytest.mark.parametrize(("count", "readings"), [(12, 1), (200, 1), (12, 15)])
def test_a_response_without_noise_is_no_correlation(count, readings):
    rows = holds(1, 0.0, 0.0, np.linspace(-1, 1, count), readings)
    np.testing.assert_array_equal(dependence_of(rows, RANGE), 1.0)


def test_single_readings_of_each_hold_are_independent():
    ratios = [dependence_of(holds(seed, 5e-6, 1e-6, readings=1), RANGE) for seed in range(20)]
    np.testing.assert_array_equal(ratios, 1.0)


def test_the_finding_names_the_factor_and_the_means_of_holds():
    (finding,) = correlation_findings(np.array([1.0, 1.2, 16.0, 9.0, 1.0, 1.0]))
    assert finding.numbers == {"factors": {"uz": 4.0, "rx": 3.0}}
    assert "4 times as large" in finding.message
    assert "Import the mean of each hold" in finding.message
