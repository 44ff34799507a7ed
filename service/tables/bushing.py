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
from wrenchbook.surrogate.table.rows import Floats, why_beyond

Others = Literal["displacement", "load"]
_HALVINGS = 40  # steps of the bisection for the end of a curve: to 2^-40, 1e-12, of its length
_MIN_SPAN = 1e-3  # part of the load range: a shorter curve is left out
_ROUNDING = 1e-9  # part of the load range: rows this near to an end of a curve count as on it
_NO_ROWS = "the table has no rows; fill it (wrenchbook fill), or import some"
_LOAD_TOLERANCE = 1e-15  # part of the load range: tolerance of the root search for a load
_OUTSIDE, _COVERED = NAMES.index("outside"), NAMES.index("covered")
_HEAD = "axis,displacement [m or rad],load [N or N*m],bar [N or N*m],loop [N or N*m],coverage\n"


class BushingError(ValueError):
    """The table has no such curves; the message has the remedy."""


class _Point(NamedTuple):
    """One point of a curve: the load of a displacement, SI."""

    load: float
    bar: float  # 95 % half width of the load, NaN if unknown
    stiffness: float  # stiffness of the axis, N/m or N·m/rad
    displacement_bar: float  # 95 % half width of the axis' displacement
    coverage: int  # index in `NAMES`


def bushing_csv(table: ServedTable, points: int, others: Others) -> str:
    """Return the curves of all axes that move as CSV, each at `points` displacements.

    `others` is zero on the other axes: their displacement, so that the curves are the diagonal of
    the stiffness, or their load. A curve ends with the load range and the table's rows. The loop's
    width is empty if rows do not show it.

    Raises BushingError if the table has no such curves.
    """
    if not table.load_range.space.is_default:
        raise BushingError(
            "a bushing needs one interface and no further inputs, but the table has the inputs "
            f"{', '.join(table.load_range.space.input_names)}; use an FMU or the C library"
        )
    loop, hidden = loop_of(table.rows, table.load_range)
    lines = [_HEAD]
    problem = ""  # of the first axis without a curve
    for axis in range(len(LOADS)):
        if axis in table.locked:
            continue
        try:
            curve = _Curve(table, axis, others)
            low, high = curve.end(-1), curve.end(1)
            loads = curve.at(high).load - curve.at(low).load
            if not abs(loads) > _MIN_SPAN * (curve.high - curve.low):
                span = f"{_MIN_SPAN:.1%} of its load range {curve.low:g} to {curve.high:g}"
                raise BushingError(f"its rows cover less than {span}; add rows under load")
        except (InverseError, BushingError) as error:
            problem = problem or f"{OUTPUTS[axis]}: {error}"
            continue
        for displacement in np.linspace(low, high, points).tolist():
            try:
                point = curve.at(displacement)
            except (InverseError, BushingError):  # a gap between the ends
                point = _Point(np.nan, np.nan, np.nan, np.nan, _OUTSIDE)
            width = abs(loop[axis]) * point.stiffness
            if not loop[axis] and not hidden[axis] <= point.displacement_bar:
                width = np.nan  # no loop shows, but rows would not show a loop as large as the bar
            numbers = (displacement, point.load, point.bar, width)
            cells = ["" if value != value else repr(float(value)) for value in numbers]
            lines.append(",".join([OUTPUTS[axis], *cells, NAMES[point.coverage]]) + "\n")
    if len(lines) == 1:
        remedy = "" if others == "load" else "; others=load needs rows that load one axis only"
        text = f"the table has no curve of any axis: {problem}{remedy}"
        raise BushingError(text if table.row_count else _NO_ROWS)
    return "".join(lines)


class _Curve:
    """The load of one axis over its displacement.

    `low` and `high` are the ends of the axis' load range, `row_loads` the least and the largest
    load of the table's rows and 0, N or N·m; `at_zero` is the displacement at zero load, m or rad.

    Raises BushingError if the axis has no curve.
    """

    def __init__(self, table: ServedTable, axis: int, others: Others) -> None:
        self.table = table
        self.axis = axis
        self.others = others
        self.unit = np.eye(len(LOADS))[axis]
        self.low, self.high = table.load_range.low[axis], table.load_range.high[axis]
        if not self.low < self.high:
            raise BushingError(f"its load range {self.low:g} to {self.high:g} is empty; widen it")
        if not self.low <= 0.0 <= self.high:
            unit = "N" if axis < 3 else "N*m"
            raise BushingError(
                f"the load range of {LOADS[axis]}, {self.low:g} to {self.high:g} {unit}, does not "
                f"contain 0 {unit}, where the curve starts; widen it under [range]"
            )
        loads = table.rows.wrench[:, axis]
        rounding = _ROUNDING * (self.high - self.low)
        self.row_loads = loads.min(initial=0.0) - rounding, loads.max(initial=0.0) + rounding
        self.at_zero = 0.0 if others == "displacement" else self._displacement_by(0.0)
        if self.at_zero != self.at_zero:
            raise BushingError("its displacement at zero load is unknown; add rows")
        self.at(self.at_zero)  # raises if the curve has no start

    def _displacement_by(self, load: float) -> float:
        """Return the displacement of the axis by its load alone, m or rad."""
        wrench = load * self.unit[None] + 0.0  # no negative zeros
        return float(self.table.packed.batch(wrench, without_rows=True).outputs[0, self.axis])

    def end(self, side: int) -> float:
        """Return the last covered displacement on a side, m or rad."""
        inside, outside = self.at_zero, self._displacement_by(self.high if side > 0 else self.low)
        middle = outside
        for _ in range(_HALVINGS):
            try:
                self.at(middle)
                inside = middle
            except (InverseError, BushingError):
                outside = middle
            if inside == outside:
                break
            middle = 0.5 * (inside + outside)
        return inside

    def at(self, displacement: float) -> _Point:
        """Return the point of a displacement, m or rad.

        Raises InverseError or BushingError if the table has none within its load range.
        """
        wrench, stiffness = self._wrench_at(displacement)
        load, load_range = wrench[self.axis], self.table.load_range
        if not load_range.holds(wrench[None])[0]:
            raise BushingError(f"{why_beyond(load_range, wrench)}; widen the load range")
        reply = self.table.packed.batch(wrench[None], without_rows=True)
        coverage, errors = int(reply.coverage[0]), reply.errors[0]
        # Beyond its rows a thin table extrapolates; a linear one is covered.
        if coverage != _COVERED and not self.row_loads[0] <= load <= self.row_loads[1]:
            ends = f"{self.row_loads[0]:.4g} to {self.row_loads[1]:.4g}"
            raise BushingError(f"its load {load:.4g} is beyond its rows, {ends}; add rows there")
        if coverage == _OUTSIDE:
            raise BushingError(f"no rows surround its wrench at {displacement:.4g}; add rows there")
        bar = float(np.abs(stiffness) @ np.where(stiffness == 0, 0.0, errors))
        return _Point(load, bar, abs(stiffness[self.axis]), errors[self.axis], coverage)

    def _wrench_at(self, displacement: float) -> tuple[Floats, Floats]:
        """Return the wrench of a displacement and the stiffness row of the axis, (6,) each, SI."""
        packed, axis = self.table.packed, self.axis
        if self.others == "displacement":
            wrench, stiffness = packed.inverse(displacement * self.unit)
            return wrench, stiffness[axis]

        def excess(load: float) -> float:
            return self._displacement_by(load) - displacement

        if not excess(self.low) * excess(self.high) <= 0:
            text = f"no load in its range {self.low:g} to {self.high:g} moves it by"
            raise BushingError(f"{text} {displacement:.4g}; widen it")
        tolerance = _LOAD_TOLERANCE * (self.high - self.low)
        load = root_scalar(excess, bracket=(self.low, self.high), xtol=tolerance).root
        wrench = load * self.unit + 0.0  # no negative zeros
        slope = packed.derivatives(wrench[None], without_rows=True)[0, axis, axis]
        if slope == 0.0:  # a stop, or a single row
            why = f"loads near {load:.4g} do not change its displacement"
            raise BushingError(f"{why}; add rows at other loads")
        return wrench, self.unit / slope
