"""Straight direction influence plus a six-dimensional correction learnt from what it misses.

What the straight splines miss at a full wrench, and the slope of that by every load, is
interpolated by one spline in all six loads. A clean row takes part as well: its tangent says how
the displacement changes with loads that the row does not have.
"""

from __future__ import annotations

import numpy as np

from surrogate.spline import MOST, Spline
from surrogate.straight import StraightSplines
from surrogate.table.axes import clean_rows
from surrogate.table.rows import Floats, LoadRange, Rows

CLEAN_SHARE = 0.6  # of the equations, at most, are clean rows'


class Corrected:
    """The straight splines and their correction.

    Attributes
    ----------
    places : ndarray of int, shape (n,)
        The rows that the correction is learnt from.
    left_out : ndarray, shape (n, 6), m and rad
        True less answered at those rows, each left out of the correction.
    """

    def __init__(self, straight: StraightSplines, rows: Rows, load_range: LoadRange) -> None:
        """Learn the correction of straight splines of the same rows."""
        self.straight, self.scale = straight, load_range.scale
        self.places = _chosen(rows, load_range)
        some = rows.take(self.places)
        x = some.wrench / self.scale
        missed = some.displacement - straight.at(x)
        size = np.maximum(np.abs(some.displacement).max(axis=0), np.finfo(float).tiny)
        slopes = some.compliance * self.scale
        if np.isfinite(slopes).any():
            slopes = slopes - straight.slopes(x)
        order = 5 if np.isfinite(slopes).any() else 3
        self.spline = Spline(x, missed / size, slopes / size[:, None], order)
        self.size, self.left_out = size, self.spline.left_out * size

    def at(self, scaled: Floats) -> Floats:
        """Return displacements (n, 6), m and rad, at scaled wrenches (n, 6)."""
        return self.straight.at(scaled) + self.spline.at(scaled) * self.size


def _chosen(rows: Rows, load_range: LoadRange) -> np.ndarray:
    """Return the rows to learn from: as many as the equations allow, full wrenches first."""
    per_row = 7 if np.isfinite(rows.compliance).any() else 1
    most = MOST // per_row
    order = np.random.default_rng(20170726).permutation(len(rows))
    full = np.asarray(~clean_rows(rows, load_range).any(axis=1))[order]
    clean = order[~full][: max(int(CLEAN_SHARE * most), most - int(full.sum()))]
    return np.sort(np.concatenate((order[full][: most - len(clean)], clean)))
