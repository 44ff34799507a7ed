"""Load over displacement of each axis: the curves of a bushing in a multibody program."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from scipy.optimize import root_scalar

from wrenchbook.service.contract import LOADS, OUTPUTS
from wrenchbook.service.tables.mapped import ServedTable
from wrenchbook.surrogate.answer import NAMES
from wrenchbook.surrogate.findings.find import loop_of
from wrenchbook.surrogate.kernel.replies import InverseError
from wrenchbook.surrogate.table.rows import Floats

Others = Literal["displacement", "load"]
HALVINGS = 40  # of the way to the end of a curve: to 1e-12 of it
_OUTSIDE = NAMES.index("outside")
_HEAD = "axis,displacement [m or rad],load [N or N*m],bar [N or N*m],loop [N or N*m],coverage\n"


class BushingError(ValueError):
    """The table has no such curves; the message says what to do."""


class _Point(NamedTuple):
    load: float
    bar: float  # 95 % of the load, NaN where not known
    stiffness: float  # of the axis
    moved: float  # 95 % of the axis' displacement
    coverage: int


def bushing_csv(table: ServedTable, points: int, others: Others) -> str:
    """Return the curves of all axes that move as CSV, each at `points` displacements.

    `others` is zero on the other axes: their displacement, so that the curves are the diagonal of
    the stiffness, or their load. A curve ends with the load range and the table's rows. The loop's
    width is empty where rows do not tell it. Raises BushingError.
    """
    if not table.load_range.space.is_default:
        raise BushingError(
            "a bushing has one interface and no further inputs: use an FMU or the C library"
        )
    loop, hidden = loop_of(table.rows, table.load_range)
    lines, why = [_HEAD], ""
    for axis in range(len(LOADS)):
        if axis in table.locked:
            continue
        try:
            curve = _Curve(table, axis, others)
            low, high = curve.end(-1), curve.end(1)
        except (InverseError, BushingError) as error:
            why = why or f"{OUTPUTS[axis]}: {error}"
            continue
        for d in np.linspace(low, high, points).tolist():
            point = curve.at(d)
            width = abs(loop[axis]) * point.stiffness
            if not loop[axis] and not hidden[axis] <= point.moved:
                width = np.nan  # no loop is seen, and rows would not show one as large as the bar
            numbers = (d, point.load, point.bar, width)
            cells = ["" if value != value else repr(float(value)) for value in numbers]
            lines.append(",".join([OUTPUTS[axis], *cells, NAMES[point.coverage]]) + "\n")
    if len(lines) == 1:
        remedy = "" if others == "load" else "; others=load needs rows of one axis alone"
        raise BushingError(f"the table has no curve: {why}{remedy}")
    return "".join(lines)


class _Curve:
    """The load of one axis over its displacement."""

    def __init__(self, table: ServedTable, axis: int, others: Others) -> None:
        self.table, self.axis, self.others = table, axis, others
        self.low, self.high = table.load_range.low[axis], table.load_range.high[axis]
        self.rest = self._moved(0.0)
        self.start = np.zeros(len(LOADS))
        if not self.low < self.high:
            raise BushingError("its load has no range")
        if others == "load" and not np.isfinite(self.rest):
            raise BushingError("no row has this displacement")
        self.at(self._zero())

    def _zero(self) -> float:
        return 0.0 if self.others == "displacement" else self.rest

    def _wrench(self, load: float) -> Floats:
        wrench = np.zeros(len(LOADS))
        wrench[self.axis] = load
        return wrench

    def _moved(self, load: float) -> float:
        replies = self.table.packed.batch(self._wrench(load)[None], without_rows=True)
        return float(replies.outputs[0, self.axis])

    def end(self, side: int) -> float:
        """Return the last displacement of a side that the table covers, m or rad."""
        inside, outside = self._zero(), self._moved(self.high if side > 0 else self.low)
        if self._is_covered(outside):
            return outside
        for _ in range(HALVINGS):
            middle = 0.5 * (inside + outside)
            inside, outside = (middle, outside) if self._is_covered(middle) else (inside, middle)
        return inside

    def _is_covered(self, d: float) -> bool:
        try:
            self.at(d)
        except (InverseError, BushingError):
            return False
        return True

    def at(self, d: float) -> _Point:
        """Return the point of a displacement, m or rad.

        Raises InverseError or BushingError if the table has none within its load range.
        """
        packed, axis = self.table.packed, self.axis
        if self.others == "displacement":
            wrench, stiffness = packed.inverse(self._wrench(d), self.start)
            row = stiffness[axis]
        else:
            low, high = (self._moved(load) - d for load in (self.low, self.high))
            if not low * high <= 0:
                raise BushingError("no load of the range has this displacement")
            span = self.low, self.high
            tight = 1e-15 * (self.high - self.low)
            load = root_scalar(lambda f: self._moved(f) - d, bracket=span, xtol=tight).root
            wrench, row = self._wrench(load), np.zeros(len(OUTPUTS))
            row[axis] = 1 / packed.derivatives(wrench[None], without_rows=True)[0, axis, axis]
        reply = packed.batch(wrench[None], without_rows=True)
        coverage, errors = int(reply.coverage[0]), reply.errors[0]
        if not self.table.load_range.holds(wrench[None])[0] or coverage == _OUTSIDE:
            raise BushingError("the load there is outside the load range or the rows")
        bar = float(np.abs(row) @ np.where(row == 0, 0.0, errors))
        return _Point(wrench[axis], bar, abs(row[axis]), errors[axis], coverage)
