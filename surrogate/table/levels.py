"""Whether rows have enough values of each load to show what a response does between them."""

from __future__ import annotations

import numpy as np

from .rows import Floats

# Through three values, -1, 0 and 1 say, any response that is odd, as most are, is straight: rows
# that are left out err by nothing there, and answers between them by a quarter of the range.
LEVELS = 4
# Of the range: what a load cell scatters by is no value of its own. Loads of a composite design
# that scattered by 1e-6 to 1e-3 of the range made everything covered, 97 % of it outside the bars.
APART = 0.05


def has_levels(points: Floats) -> bool:
    """Return whether each load that varies over scaled points (n, k) has `LEVELS` values."""
    return all(_levels(column) >= LEVELS for column in points.T if np.ptp(column) > APART)


def _levels(values: Floats) -> int:
    """Return how many groups of values there are whose firsts are `APART` of their span apart."""
    count, last = 0, -np.inf
    step = APART * min(float(np.ptp(values)) / 2, 1.0)
    for value in np.sort(values).tolist():
        if value > last + step:
            count, last = count + 1, value
    return count
