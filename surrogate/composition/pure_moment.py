"""The answers to one moment alone, as one piecewise function of that moment.

Every composed rotation counts from them. They lie on one line through a triangulation, and along
it barycentric outputs are straight between two faces of its simplices; bends and unit errors are
parabolas.
"""

from __future__ import annotations

from copy import copy
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..interpolation.delaunay import Triangulation
from ..table.rows import Floats
from .axis_table import AxisTable

APART = 1e-12  # stations closer than this, in scaled units, are one
ON_HULL = 1e-9  # of the range: a moment that far beyond the last station counts as on it
HOLE = 9  # the state of a stretch that no simplex holds: worse than any simplex'


class CutReading(NamedTuple):
    """What a cut answers at k moments: (k, 6) each, m and rad, and how sound it is, (k,).

    `slopes` are derivatives by the moment, m/(N·m) and rad/(N·m).
    """

    outputs: Floats
    rest: Floats
    slopes: Floats
    state: NDArray[np.int_]


class PureMomentCut:
    """One axis' table along one of its moments, the other two loads being zero.

    Attributes
    ----------
    table : AxisTable
        Whose answers they are.
    stations : ndarray, shape (s + 1,), dimensionless
        Scaled moments at which the line passes from one simplex to the next, ascending.
    outputs : ndarray, shape (s, 2, 6), m and rad
        Of each stretch, by the scaled moment less its first station: constant and straight part.
    unit_errors : ndarray, shape (s, 3), dimensionless
        Constant, straight and square part of the unit errors.
    stated : ndarray, shape (s, 2, 6), m and rad
        Constant and straight part of the rows' uncertainty.
    state : ndarray of int, shape (s,)
        As the table's; `HOLE` where no simplex holds the stretch.
    """

    def __init__(self, table: AxisTable, column: int) -> None:
        """Cut a table along its input `column`, 1 or 2."""
        self.table, self.column = table, column
        self.stations = _stations(table.triangulation, column)
        low, width = self.stations[:-1], np.diff(self.stations)
        middle = self._points(low + 0.5 * width)
        found = table.triangulation.locate(middle)
        self.state = np.where(found >= 0, table.state[found], HOLE).astype(np.int32)
        start, centre, end = (
            table.read_in(np.maximum(found, 0), self._points(low + share * width))
            for share in (0.0, 0.5, 1.0)
        )
        over = 1.0 / width[:, None]
        self.outputs = np.stack((start.outputs, (end.outputs - start.outputs) * over), axis=1)
        units = [one.unit_errors[:, None] for one in (start, centre, end)]
        self.unit_errors = np.concatenate(_parabola(units[0], units[1], units[2], over), axis=1)
        self.stated = np.stack((start.stated, (end.stated - start.stated) * over), axis=1)

    def of(self, table: AxisTable) -> PureMomentCut:
        """Return this cut as one of a table that was taken over from its own."""
        same = copy(self)
        same.table = table
        return same

    def read(self, moments: Floats) -> CutReading:
        """Read the cut at moments (k,), N·m; beyond its ends along its last stretch."""
        scale = self.table.scale[self.column]
        along = moments / scale
        if not len(self.state):
            none = np.zeros((len(along), 6))
            blank = np.full(len(along), HOLE)
            return CutReading(none, none, none, blank)
        found = np.searchsorted(self.stations, along, side="right") - 1
        found = np.clip(found, 0, len(self.state) - 1)
        y = (along - self.stations[found])[:, None]
        outputs, stated, unit = self.outputs[found], self.stated[found], self.unit_errors[found]
        unit = np.maximum(unit[:, 0] + y[:, 0] * (unit[:, 1] + y[:, 0] * unit[:, 2]), 0.0)
        beyond = (along < self.stations[0] - ON_HULL) | (along > self.stations[-1] + ON_HULL)
        return CutReading(
            outputs[:, 0] + y * outputs[:, 1],
            self.table.law.bars(unit) + stated[:, 0] + y * stated[:, 1],
            outputs[:, 1] / scale,
            np.where(beyond, HOLE, self.state[found]),
        )

    def _points(self, along: Floats) -> Floats:
        points = np.zeros((len(along), 3))
        points[:, self.column] = along
        return points


def _parabola(start: Floats, centre: Floats, end: Floats, over: Floats) -> tuple[Floats, ...]:
    """Return constant, straight and square part, (s, q) each, from three values of each stretch.

    `over`, (s, 1), is one over the length of the stretch.
    """
    square = 2 * (start - 2 * centre + end) * over**2
    return start, (end - start) * over - square / over, square


def _stations(shape: Triangulation, column: int) -> Floats:
    """Return, ascending, where the line meets faces of the simplices it passes; none or several."""
    if shape.dimension == 0 or not shape.holds_direction(column):
        return np.empty(0)
    near = _around_the_line(shape, column)
    start = np.zeros((len(near), 3))
    at_zero = shape.barycentric(near, start)
    start[:, column] = 1.0
    slope = shape.barycentric(near, start) - at_zero
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        roots = np.where(slope != 0, -at_zero / slope, np.nan)
        others = at_zero[:, None, :] + slope[:, None, :] * roots[:, :, None]
        # A root counts if it lies in the simplex, and so within the points' box.
        inside = (others > -1e-9).all(axis=2) & (np.abs(roots) <= np.abs(shape.points).max())
    stations = np.unique(roots[inside])
    if len(stations) < 2:
        return np.empty(0)
    return stations[np.concatenate(([True], np.diff(stations) > APART))]


def _around_the_line(shape: Triangulation, column: int) -> NDArray[np.intp]:
    """Return the simplices that the line may pass, by their boxes: a few in a hundred."""
    others = [place for place in range(3) if place != column]
    corners = shape.points[:, others][shape.simplices]
    low, high = corners.min(axis=1), corners.max(axis=1)
    room = 1e-6 * np.abs(shape.points).max(initial=1.0)  # more than rounding at thin simplices
    return np.flatnonzero(((low <= room) & (high >= -room)).all(axis=1))
