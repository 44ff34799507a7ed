"""Error bars of one axis from what its points' neighbours miss them by."""

from __future__ import annotations

import numpy as np

from ..bars.conformal import conformal_factor
from ..table.rows import Floats
from .delaunay import Indices, Triangulation

ROUNDING = 1e-12  # of an output's size: no bar is smaller, since no number is righter


def local_bars(triangulation: Triangulation, values: Floats, misses: Floats) -> Floats:
    """Return 95 % error bars of outputs with their bends, at each point, shape (n, q).

    The quadratic through a point's neighbours errs by a third-order term and by the rows' noise,
    as outputs with their bends do between the points. So the bar is the size of such misses at
    the point and around it, times the conformal factor for which the misses around would have
    held 95 % of the points' own. Where there are too few points for a quadratic, the bar is what
    the values vary by over the simplices around.

    Parameters
    ----------
    values, misses : ndarray, shape (n, q), m and rad
        `misses` is NaN where there are too few points (`Patches`).
    """
    floor = ROUNDING * np.abs(values).max(axis=0, initial=0.0)
    if np.isnan(misses).any():
        return np.maximum(_variation(triangulation, values), floor)
    corners = triangulation.simplices.shape[1]
    total, count = _around(triangulation.simplices, misses**2)
    beside = np.sqrt(np.maximum(total - count * misses**2, 0.0) / (count * (corners - 1)))
    factor = conformal_factor(np.abs(misses), np.maximum(beside, floor))
    return np.maximum(factor * np.sqrt(total / (count * corners)), floor)


def _around(simplices: Indices, values: Floats) -> tuple[Floats, Floats]:
    """Return the sum of values (n, q) over all corners of each point's simplices, and their count.

    Shapes (n, q) and (n, 1).
    """
    sums = values[simplices].sum(axis=1)
    total, count = np.zeros_like(values), np.zeros((len(values), 1))
    for corner in simplices.T:
        np.add.at(total, corner, sums)
        np.add.at(count, corner, 1.0)
    return total, count


def _variation(triangulation: Triangulation, values: Floats) -> Floats:
    """Return the largest variation over a simplex at each point; of one point alone its size."""
    if triangulation.dimension == 0:
        return np.abs(values)
    largest = np.zeros_like(values)
    spread = np.ptp(values[triangulation.simplices], axis=1)
    for corner in triangulation.simplices.T:
        np.maximum.at(largest, corner, spread)
    return largest
