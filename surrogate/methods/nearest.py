"""`nearest`: the row nearest to the wrench, in loads scaled by the load range."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from ..answer import COVERED, OUTSIDE
from ..table.rows import Floats, LoadRange, Rows
from .method import Estimates, Method, why_beyond
from .reference import Reference


class Nearest(Method):
    """The nearest row's displacement; its derivative is zero, as that of any step function."""

    name = "nearest"

    def __init__(self, rows: Rows, load_range: LoadRange, reference: Reference) -> None:
        """Index the rows, at least one."""
        self.rows, self.load_range, self.reference = rows, load_range, reference
        self._tree = KDTree(rows.wrench / load_range.scale)

    def estimate(self, wrenches: Floats) -> Estimates:
        """Answer wrenches, shape (n, 6), N and N·m."""
        near = np.asarray(self._tree.query(wrenches / self.load_range.scale)[1], dtype=np.intp)
        displacement = self.rows.displacement[near]
        best, bars = self.reference.estimate(wrenches)
        outside = ~self.load_range.holds(wrenches)
        state = np.where(outside, OUTSIDE, COVERED).astype(np.uint8)
        return Estimates(displacement, np.abs(displacement - best) + bars, state)

    def derivatives(self, wrenches: Floats) -> Floats:
        """Return zeros, shape (n, 6, 6), SI, for wrenches (n, 6)."""
        return np.zeros((len(wrenches), 6, 6))

    def reason(self, wrench: Floats) -> str:
        """Return which load of a wrench (6,), N and N·m, lies outside the load range."""
        return why_beyond(self.load_range, wrench)
