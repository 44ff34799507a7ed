"""Evenly spread wrenches (an additive recurrence: Roberts 2018, the R sequence).

The module also finds where a part's compliance is positive definite, so that a joint can invert it.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from .rows import Floats, LoadRange

INSIDE = 448  # wrenches inside the range: with its 64 corners they are answered in 5 ms
# Inputs whose 4,096 corners are all used; with more inputs so many corners, evenly spread.
ALL_CORNERS = 12
# Part of each load's half range: the error of a joint's wrench, stiffness times error bars, that a
# fill for a joint allows. A stiff freedom needs a smaller error bar than the tolerance.
FORCE_ERROR = 0.05
# Newton steps: 30 reach the last bit, as each leaves at most 0.31 of the error (one dimension).
_ROOT_STEPS = 60
# Part of the largest eigenvalue: a kriging's slopes are accurate to some 1e-11.
SLOPE_ROUNDING = 1e-10


def _spread(count: int, dimensions: int, start: int = 0) -> Floats:
    """Return points of the unit cube, shape (count, dimensions), from point `start` on."""
    root = 2.0  # the root of x^(d + 1) = x + 1, by which the recurrence steps
    for _ in range(_ROOT_STEPS):
        root = (1 + root) ** (1 / (dimensions + 1))
    step = root ** -np.arange(1.0, dimensions + 1)
    return (0.5 + np.arange(start, start + count)[:, None] * step) % 1.0


def spread_wrenches(span: LoadRange, count: int, start: int = 1) -> Floats:
    """Return evenly spread wrenches of a span of n inputs, shape (count, n), SI."""
    vary = np.flatnonzero(span.high > span.low)
    fraction = _spread(count, len(vary), start)
    wrenches = np.tile(span.low, (count, 1))
    wrenches[:, vary] += fraction * (span.high - span.low)[vary]
    return wrenches


def sample_of(ends: Floats, centre: Floats, indices: NDArray[np.intp]) -> Floats:
    """Return corners of a load range and `INSIDE` wrenches within it, shape (count, n), SI.

    `ends`, (2, n), are low and high loads; inputs at indices other than `indices` have the values
    of `centre`, (n,).
    """
    low, high = ends
    count = len(indices)
    corners = np.array(list(product((0.0, 1.0), repeat=min(count, ALL_CORNERS))))
    if count > ALL_CORNERS:
        corners = np.round(_spread(len(corners), count))
    loads = np.tile(centre, (len(corners) + INSIDE, 1))
    within = np.vstack([corners, _spread(INSIDE, count)])
    loads[:, indices] = low[indices] + within * (high - low)[indices]
    return loads


def weakest(compliances: Floats, scale: Floats) -> tuple[Floats, Floats]:
    """Return the least eigenvalue (k,), J, of compliances (k, n, n), SI, and its loads (k, n).

    Compliances are scaled by `scale`, (n,), SI; the loads are over it, the largest 1. Below zero
    the part moves against the loads; NaN where a compliance is not known.
    """
    least = np.full(len(compliances), np.nan)
    loads = np.full(compliances.shape[:2], np.nan)
    known = np.isfinite(compliances).all(axis=(1, 2))
    energy = compliances[known] * np.outer(scale, scale)
    values, vectors = np.linalg.eigh(0.5 * (energy + energy.transpose(0, 2, 1)))
    rounding = np.abs(values[:, 0]) <= SLOPE_ROUNDING * np.abs(values).max(axis=1, initial=0.0)
    least[known] = np.where(rounding, 0.0, values[:, 0])
    mode = vectors[:, :, 0]
    loads[known] = mode / np.take_along_axis(mode, np.abs(mode).argmax(axis=1)[:, None], axis=1)
    return least, loads
