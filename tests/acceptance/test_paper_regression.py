"""A line through points, and the standard error of its slope."""

import numpy as np
import pytest
from scipy.stats import linregress

from data.paper.spring import line_through


def test_slope_and_standard_error_are_scipys():
    rng = np.random.default_rng(3)
    x = rng.uniform(0, 10, 25)
    y = 0.582 * x + 0.1 + rng.normal(0, 0.05, 25)
    found, expected = line_through(x, y), linregress(x, y)
    assert found.slope == pytest.approx(expected.slope, rel=1e-12)
    assert found.intercept == pytest.approx(expected.intercept, rel=1e-10)
    assert found.error == pytest.approx(expected.stderr, rel=1e-12)


def test_points_on_a_line_have_no_error():
    assert line_through([0, 1, 2, 3], [1, 3, 5, 7]).error < 1e-15


@pytest.mark.parametrize(
    ("x", "y", "told"),
    [
        ([0, 1], [0, 1], "three points"),
        ([1, 1, 1], [0, 1, 2], "same x"),
        ([0, 1, np.nan], [0, 1, 2], "finite"),
    ],
)
def test_points_that_tell_no_line_are_refused(x, y, told):
    with pytest.raises(ValueError, match=told):
        line_through(x, y)
