"""The line of one moment alone through an axis' triangulation, as one piecewise polynomial.

Every composed answer counts from the answer to a moment alone. Those points lie on one line, so
their simplices are found by bisection and need no walk.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrogate.interpolation.delaunay import Indices, Interpolant
from surrogate.table.rows import Floats

APART = 1e-12  # stations closer than this, in scaled units, are one


class LineReading(NamedTuple):
    """What `axistable.Reading` holds, each (k, 4), m and rad; and which are sound, (k,)."""

    outputs: Floats
    bends: Floats
    rest: Floats
    known: NDArray[np.bool_]


class MomentLine:
    """The pieces of an axis table along its second input, the other two being zero.

    Attributes
    ----------
    stations : ndarray, shape (s + 1,)
        Where the line passes from one simplex to the next, scaled.
    simplices : ndarray of int, shape (s,)
        The simplex of each stretch, -1 outside the hull.
    """

    def __init__(
        self,
        shape: Interpolant,
        pieces: Floats,
        weak: NDArray[np.intp],
        bending: tuple[float, ...],
    ) -> None:
        """Find the stretches of a triangulation of three dimensions.

        Parameters
        ----------
        pieces : ndarray, shape (m, 13 or 25, 4)
            What `AxisTable` holds of each simplex.
        weak : ndarray of int, shape (m,)
            Which simplices are not sound: not 0.
        bending : tuple of float, length 4, dimensionless
        """
        self.stations = _crossings(shape)
        middle = np.zeros((max(len(self.stations) - 1, 0), 3))
        middle[:, 1] = (self.stations[:-1] + self.stations[1:]) / 2
        self.simplices: Indices = shape.locate(middle)
        self.sound = (self.simplices >= 0) & (weak[self.simplices] == 0)
        pieces, anchors = pieces[self.simplices], shape.anchors[self.simplices]
        # pieces * (-a_0, y - a_1, -a_2, 1) = start + y * slope
        ends = np.concatenate((-anchors, np.ones((len(anchors), 1))), axis=1)
        self.start = np.einsum("sij,sj->si", pieces, ends)
        self.slope = pieces[:, :, 1].copy()
        # The bubble's part |x - anchor|^2 = |a|^2 - 2 y a_1 + y^2
        self.start[:, 12] -= (anchors**2).sum(axis=1)
        self.slope[:, 12] += 2 * anchors[:, 1]
        self.anchors, self.bending = anchors, bending

    def read(self, along: Floats) -> LineReading:
        """Return outputs and bars at scaled moments, shape (k,)."""
        if not len(self.simplices):
            none = np.zeros((len(along), 4))
            return LineReading(none, none.copy(), none.copy(), np.zeros(len(along), dtype=bool))
        found = np.searchsorted(self.stations, along, side="right") - 1
        inside = (along >= self.stations[0] - APART) & (along <= self.stations[-1] + APART)
        found = np.clip(found, 0, len(self.simplices) - 1)
        told = self.slope.take(found, axis=0)
        told *= along[:, None]
        told += self.start.take(found, axis=0)
        bubble = told[:, 12] - along**2
        rest = np.abs(told[:, 4:8] + told[:, 8:12] * bubble[:, None])
        bends = np.zeros_like(rest)
        if told.shape[1] > 13:
            apart = -self.anchors.take(found, axis=0)
            apart[:, 1] += along
            bends = np.einsum("kqi,ki->kq", told[:, 13:].reshape(-1, 4, 3), apart)
            rest += np.abs(bends) * self.bending
        return LineReading(told[:, :4], bends, rest, inside & self.sound[found])


def _crossings(shape: Interpolant) -> Floats:
    """Return, ascending, where the line (0, y, 0) meets faces of the simplices it passes."""
    count = len(shape.simplices)
    start = np.zeros((count, 3))
    at_zero = shape.barycentric(np.arange(count), start)
    start[:, 1] = 1.0
    slope = shape.barycentric(np.arange(count), start) - at_zero
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        roots = np.where(slope != 0, -at_zero / slope, np.nan)
        others = at_zero[:, None, :] + slope[:, None, :] * roots[:, :, None]
        # A root counts if it lies in the simplex, and so within the points' box.
        inside = (others > -1e-9).all(axis=2) & (np.abs(roots) <= np.abs(shape.points).max())
    stations = np.unique(roots[inside])
    if not len(stations):
        return stations
    return stations[np.concatenate(([True], np.diff(stations) > APART))]
