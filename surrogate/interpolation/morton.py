"""The order in which a batch is looked up: along a space-filling curve.

qhull's point location walks from the last simplex it found. Neighbours on the curve are neighbours
in space, so the walk is a step or two at any table size, and what is read stays in the cache.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..table.rows import Floats

CELLS = 32  # a side: three times five bits fit 16, which numpy sorts by radix
FEWEST = 64  # points below which sorting costs more than it saves


def curve_order(x: Floats) -> NDArray[np.intp]:
    """Return the order of points (k, d), d at most 3, along a Morton curve over their box.

    The order of Morton, "A computer oriented geodetic data base" (1966): the bits of the
    coordinates, interleaved. Points are dimensionless.
    """
    if len(x) < FEWEST or x.shape[1] == 0:
        return np.arange(len(x))
    key = np.zeros(len(x), dtype=np.uint16)
    for place, column in enumerate(x.T):  # by columns, which numpy is quick at
        low, high = column.min(), column.max()
        if high > low:
            cells = (column - low) * (CELLS * (1 - 1e-9) / (high - low))
            key |= _SPREAD.take(cells.astype(np.intp)) << np.uint16(place)
    return np.argsort(key, kind="stable")


def _spread() -> NDArray[np.uint16]:
    """Return each cell number with two zeros between its bits."""
    cells = np.arange(CELLS, dtype=np.uint16)
    bits = [((cells >> bit) & 1) << (3 * bit) for bit in range(5)]
    return np.bitwise_or.reduce(bits).astype(np.uint16)


_SPREAD = _spread()
