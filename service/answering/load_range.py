"""Saying which loads lie beyond a component's load range."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surrogate.table.rows import LOAD_UNITS, LOADS, LoadRange


def why_beyond(load_range: LoadRange, wrench: NDArray[np.float64]) -> str:
    """Say which loads of a wrench, shape (6,), N and N·m, are outside the range."""
    found = []
    for load in np.flatnonzero(load_range.exceeded(wrench)).tolist():
        low, high, unit = load_range.low[load], load_range.high[load], LOAD_UNITS[load]
        amount = f"{LOADS[load]} is {wrench[load]:.10g} {unit}"
        found.append(f"{amount}, its load range {low:.10g} to {high:.10g} {unit}")
    return "; ".join(found)
