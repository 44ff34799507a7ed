"""Whether rows have enough values of each load to show what a response does between them."""

from __future__ import annotations

import numpy as np

from .rows import Floats

# Through three values, -1, 0 and 1 say, any response that is odd, as most are, is straight: rows
# that are left out err by nothing there, and answers between them by a quarter of the range.
LEVELS = 4
SAME = 6  # decimals of the scaled loads: closer than 1e-6 of the range is one value


def has_levels(points: Floats) -> bool:
    """Return whether each load that varies over scaled points (n, k) has `LEVELS` values."""
    counts = [len(np.unique(column)) for column in np.round(points.T, SAME)]
    return all(count == 1 or count >= LEVELS for count in counts)
