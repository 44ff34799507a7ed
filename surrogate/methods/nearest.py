"""The answer of the nearest row, in loads scaled by the load range."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from surrogate.bars.conformal import conformal_factor
from surrogate.table.compliance import LEAST, SMALLEST
from surrogate.table.rows import Floats, LoadRange, Rows


class NearestRow:
    """The row nearest to a wrench; its bar grows with the distance as rows differ among themselves.

    Attributes
    ----------
    factor : ndarray, shape (6,), m and rad
        Per unit of scaled distance; covers 95 % of the differences of rows to their nearest.
    least : ndarray, shape (6,), m and rad
        The least bar: rounding.
    """

    def __init__(self, rows: Rows, load_range: LoadRange) -> None:
        """Index the rows, at least one."""
        self.rows, self.scale = rows, load_range.scale
        scaled = rows.wrench / self.scale
        self.tree = KDTree(scaled)
        self.factor = np.abs(rows.displacement).max(axis=0)
        kinds = np.repeat([self.factor[:3].max(), self.factor[3:].max()], 3)
        self.least = np.maximum(LEAST * kinds, SMALLEST)
        if len(rows) > 1:
            found = self.tree.query(scaled, k=2)
            far, near = np.asarray(found[0], dtype=float), np.asarray(found[1], dtype=np.intp)
            differ = np.abs(rows.displacement - rows.displacement[near[:, 1]])
            apart = np.repeat(far[:, 1:], 6, axis=1)
            factor = conformal_factor(differ[far[:, 1] > 0], apart[far[:, 1] > 0])
            self.factor = np.where(np.isfinite(factor), factor, self.factor)

    def read(self, wrenches: Floats) -> tuple[Floats, Floats]:
        """Return displacements and error bars, each (n, 6), m and rad, at wrenches (n, 6)."""
        found = self.tree.query(wrenches / self.scale)
        far, near = np.asarray(found[0], dtype=float), np.asarray(found[1], dtype=np.intp)
        bars = far[:, None] * self.factor + self.least + np.nan_to_num(self.rows.uncertainty[near])
        return self.rows.displacement[near], bars
