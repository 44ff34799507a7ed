"""Where a table does not cover a wrench, a row of it, or within 1e-6 of the range of it, does.

Rows within 1e-6 of the range of each other are one row (`table.merging`), so a wrench as near to a
row is that row's: a queue rounds wrenches so, and a load that comes to rest is a rounding error off
the wrench that was solved. The row's tangent leads from its wrench to that of the query; the bar
grows by that step, from the row's own at the row itself. Where a row has no tangent its
displacement stays, and the bar grows by twice what a response in proportion moves: to the range of
each output over the load range, or to the row's own displacement (the largest of its translations,
and of its rotations: a small load may move most) over its wrench, the steeper.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .table.merging import RowIndex
from .table.rows import Floats, LoadRange, Rows, acting_one, without_locked

SOLVED = "fea"  # the source of rows that a solver gave
STEEPER = 2.0  # than in proportion: of a response that bends, at the rows there are


class ExactRows:
    """The rows of a table, each of which answers its own wrench.

    Parameters
    ----------
    wrenches : ndarray, shape (n, 6), N and N·m
    load_range : LoadRange
        A row within it answers for no wrench beyond it, nor the other way round.
    ranges : ndarray, shape (6,), m and rad
        What each output varies by over the rows and from zero.
    merged : Rows
        What those rows became: repeated ones answer as one.
    owner : ndarray of int, shape (n,)
        The place in `merged` of each.
    locked : sequence of int
        Places of the loads on locked freedoms: every call sets them to zero first.

    Attributes
    ----------
    index : RowIndex
        Which row is at or next to a wrench.
    uncertainty : ndarray, shape (k, 6), m and rad
        Of the rows of `merged`; NaN where it is not known.
    steepest : ndarray, shape (6,), m and rad
        What each output moves over half the load range, at most, by a row without a tangent.
    """

    def __init__(
        self,
        wrenches: Floats,
        load_range: LoadRange,
        ranges: Floats,
        merged: Rows,
        owner: NDArray[np.intp],
        locked: Sequence[int] = (),
    ) -> None:
        self.index = RowIndex(wrenches, load_range.scale)
        self.steepest, self._locked = STEEPER * ranges, tuple(locked)
        self.wrenches, self.merged, self.owner = wrenches, merged, owner
        # A solve repeats itself; how far a reading is off is not known where nobody stated it.
        unstated = np.where(merged.source == SOLVED, 0.0, np.nan)[:, None]
        self.uncertainty = np.where(np.isnan(merged.uncertainty), unstated, merged.uncertainty)

    def tangent(self, wrench: Sequence[float]) -> Floats:
        """Return the tangent (6, 6), SI, of the row at or near a wrench (6,); NaN if none has."""
        place = self.index.place(acting_one(wrench, self._locked))
        if place < 0:
            return np.full(self.merged.compliance.shape[1:], np.nan)
        return without_locked(self.merged.compliance[self.owner[place]], self._locked)
