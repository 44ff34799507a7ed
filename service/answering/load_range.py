"""Which wrenches lie beyond a component's load range, and saying so."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from service.contract import WRENCH_NAMES
from surrogate.rows import LoadRange

Floats = NDArray[np.float64]

EDGE = 1e-9  # of a load's scale: a load this little beyond its range counts as on it


def beyond(load_range: LoadRange, wrenches: Floats) -> NDArray[np.bool_]:
    """Tell which wrenches, shape (n, 6), N and N·m, are outside the range, shape (n,)."""
    return np.any(_excess(load_range, wrenches), axis=1)


def why_beyond(load_range: LoadRange, wrench: Floats) -> str:
    """Say which loads of a wrench, shape (6,), N and N·m, are outside the range."""
    told = []
    for load in np.flatnonzero(_excess(load_range, wrench[None])[0]).tolist():
        unit = "N" if load < 3 else "N·m"
        low, high = load_range.low[load], load_range.high[load]
        name = WRENCH_NAMES[load]
        told.append(f"{name} is {wrench[load]:g} {unit}, its load range {low:g} to {high:g} {unit}")
    return "; ".join(told)


def _excess(load_range: LoadRange, wrenches: Floats) -> NDArray[np.bool_]:
    edge = EDGE * load_range.scale
    return (wrenches > load_range.high + edge) | (wrenches < load_range.low - edge)
