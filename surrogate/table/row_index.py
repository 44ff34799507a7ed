"""Which row has a wrench, or one so near that rows there are one: looked up along one direction."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .merging import NEAR, ROUNDING
from .rows import Floats

# Wrenches that are near each other are so along any direction; of those apart few are. The parts
# are roots of primes, of which no two loads' steps cancel, and their sum is 1, so that what is
# within `NEAR` in each load is so along it.
_PRIMES = (
    2,
    3,
    5,
    7,
    11,
    13,
    17,
    19,
    23,
    29,
    31,
    37,
    41,
    43,
    47,
    53,
    59,
    61,
    67,
    71,
    73,
    79,
    83,
    89,
)


WINDOW = NEAR * (1 + ROUNDING)


class RowIndex:
    """The nearest row of each wrench, if that is within 1e-6 of the range in each load.

    Rows as near as that are one (`merging`): a rounding error beside a row is the row's own place.
    Of several rows of one wrench the first counts.

    Parameters
    ----------
    wrenches : ndarray, shape (n, 6), N and N·m
    scale : ndarray, shape (6,), N and N·m
        Of the load range.

    Attributes
    ----------
    keys : ndarray, shape (m,)
        Each distinct wrench along the direction, ascending, dimensionless.
    order : ndarray of int, shape (m,)
        Its row.
    rates : ndarray, shape (6,), 1/N and 1/(N·m)
        What a wrench's loads add to its key.
    """

    def __init__(self, wrenches: Floats, scale: Floats) -> None:
        self._wrenches, self._scale = wrenches, scale
        # A direction whose parts have no common measure, shape (n,).
        roots = np.sqrt(np.array(_PRIMES[: len(scale)], dtype=float))
        self.rates = (roots / roots.sum()) / scale
        self._one_over: list[float] = self.rates.tolist()
        keys = wrenches @ self.rates
        order = np.argsort(keys, kind="stable")
        placed = wrenches[order]
        first = np.ones(len(order), dtype=bool)
        first[1:] = (placed[1:] != placed[:-1]).any(axis=1)
        self.order: NDArray[np.intp] = order[first]
        self.keys: Floats = keys[self.order]

    def places(self, wrenches: Floats) -> NDArray[np.intp]:
        """Return the row of each wrench (k, 6), N and N·m, shape (k,); -1 where none is near."""
        found = np.full(len(wrenches), -1, dtype=np.intp)
        with np.errstate(over="ignore", invalid="ignore"):  # a load may be 1e300
            keys = wrenches @ self.rates
            first = np.searchsorted(self.keys, keys - WINDOW)
            last = np.searchsorted(self.keys, keys + WINDOW, side="right")
        for place in np.flatnonzero(first < last).tolist():
            found[place] = self._nearest(wrenches[place].tolist(), first[place], last[place])
        return found

    def place(self, wrench: Sequence[float]) -> int:
        """Return the row of one wrench (6,), N and N·m, or -1: `places` without arrays."""
        key = 0.0
        for load, rate in zip(wrench, self._one_over, strict=True):
            key += load * rate
        first = int(self.keys.searchsorted(key - WINDOW))
        if first == len(self.keys) or not self.keys[first] <= key + WINDOW:
            return -1
        last = int(self.keys.searchsorted(key + WINDOW, side="right"))
        return self._nearest(wrench, first, last)

    def _nearest(self, wrench: Sequence[float], first: int, last: int) -> int:
        """Return the nearest row of a part of the order, or -1; of equally near ones the first."""
        rows = np.sort(self.order[first:last])
        steps = np.abs(self._wrenches[rows] - wrench) / self._scale
        apart = steps.max(axis=1)
        nearest = int(np.argmin(apart))
        return int(rows[nearest]) if apart[nearest] <= NEAR else -1
