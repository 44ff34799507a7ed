"""Composition of the three axes to one displacement.

With z = u(0), the displacement at no load, a_i that of axis i at (F_i, M_j, M_k) and b_m that of
the moment M_m alone, all six outputs each,

    additive:  u(w) = z + sum_i (a_i - z) - sum_m (b_m - z)
    griddata:  rotations as above; u_i is the translation of axis i alone

It is the second-order part, for these groups, of a high-dimensional model representation (Rabitz
and Alis 1999, "General foundations of high-dimensional model representations"). An axis without
loads adds nothing and a moment that is zero takes nothing away. An axis that one moment acts on
alone answers by that moment's own answer, so that its part and the one taken away are the same
number: at a row of one axis the sum is that row. Slopes are composed alike. Errors are
independent to a good approximation and add up in quadrature, each times how often its part counts:

    error bar^2 = sum_i (n_i e_i)^2 + sum_m (n_m e_m)^2 + ((1 - sum_i n_i - sum_m n_m) e_z)^2

with n_i 1 for an axis that a force or two moments load, n_m the number of axes that M_m loads
alone, less one if it is there.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from ..table.axes import (
    AXES,
    ZERO_LOAD,
    AxisRows,
    LoadAxis,
    OffAxis,
    axis_rows,
    evenly_chosen,
    single_axis_rows,
)
from ..table.compliance import ComplianceFit
from ..table.rows import Floats, LoadRange, Rows
from ..table.space import LOADS, OUTPUTS
from .axis_table import SOUND, WEAK, AxisTable, axis_table
from .triangulation import Indices, Triangulation

APART = 1e-12  # stations closer than this, in scaled units, are one
HOLE = 9  # the state of a stretch that no simplex holds: worse than any simplex'

# What an axis' part of an answer rests on, from the best to the worst: see `axis_table`; then a
# point off the hull, and an axis that has no rows at all.
OFF_HULL, NO_ROWS = HOLE, HOLE + 1

MOST_SPOTS = 5
MOST_VERTICES = 200


def build_axes(
    rows: Rows,
    load_range: LoadRange,
    fit: ComplianceFit,
    off_axis: OffAxis,
    before: Axes | None = None,
) -> Axes:
    """Build the three axes over rows within the load range.

    Parameters
    ----------
    before : Axes, optional
        Of another version of the table: an axis whose points have not changed is taken from it, as
        it would be made again to the last bit.
    """
    kept = before.tables if before is not None else (None,) * len(AXES)
    tables = [
        _axis_table(rows, load_range, axis, fit, off_axis, own)
        for axis, own in zip(AXES, kept, strict=True)
    ]
    at_rest = answer_at_rest(rows, load_range, tables)
    return Axes(tables, at_rest, fit, load_range.scale, before)


def _axis_table(
    rows: Rows,
    load_range: LoadRange,
    axis: LoadAxis,
    fit: ComplianceFit,
    off_axis: OffAxis,
    before: AxisTable | None,
) -> AxisTable | None:
    clean = axis_rows(rows, load_range, axis, fit, "exclude")
    table = _thinned(clean, load_range, before) if len(clean.points) else None
    if off_axis == "exclude" or single_axis_rows(rows, load_range).any(axis=1).all():
        return table
    chosen = axis_rows(rows, load_range, axis, fit, off_axis)
    if off_axis == "correct" and table is not None:
        chosen = _worth_joining(chosen, table)
    if not len(chosen.points):
        return None
    if table is not None and chosen.single_axis.all():
        return table
    return _thinned(chosen, load_range, before)


def _thinned(rows: AxisRows, load_range: LoadRange, before: AxisTable | None) -> AxisTable:
    """Return the table of an axis' rows, or of an even choice of them where they are many."""
    chosen = evenly_chosen(rows.points)
    if chosen.all():
        return axis_table(rows, load_range, before)
    return axis_table(rows.take(chosen), load_range, before, rows.take(~chosen))


def _worth_joining(joined: AxisRows, table: AxisTable) -> AxisRows:
    """Return the points of an axis without those between its clean rows.

    What is left of a full wrench's displacement after its off-axis part is as uncertain as the
    linear fit. Between clean rows that is far more than their own error, and such a row would only
    put its nonlinear part into all three axes; beyond them it is better than nothing.
    """
    if not table.enough:
        return joined
    found = table.triangulation.locate(joined.points)
    between = (found >= 0) & (table.shape_state[found] == SOUND)
    return joined.take(joined.single_axis | ~between)


def answer_at_rest(rows: Rows, load_range: LoadRange, tables: Sequence[AxisTable | None]) -> AtRest:
    """Return the row at zero load, or what the axes whose hull holds zero interpolate there.

    Of several axes that is the mean, with half their spread in the bar (measured tables
    have offsets). Without any the answer is zero and not known: its bar is the rows' size.
    """
    unloaded = (np.abs(rows.wrench) <= ZERO_LOAD * load_range.scale).all(axis=1)
    if unloaded.any():
        found = rows.displacement[unloaded]
        stored = np.nan_to_num(rows.uncertainty[unloaded]).max(axis=0)
        return AtRest(found.mean(axis=0), np.maximum(np.ptp(found, axis=0) / 2, stored), True)
    readings = [table.read(np.zeros((1, 3))) for table in tables if table is not None]
    inside = [reading for reading in readings if reading.inside[0]]
    if not inside:
        size = np.abs(rows.displacement).max(axis=0, initial=0.0)
        return AtRest(np.zeros(6), size, False)
    outputs = np.concatenate([reading.outputs for reading in inside])
    own = np.concatenate([reading.rest for reading in inside])
    return AtRest(outputs.mean(axis=0), np.ptp(outputs, axis=0) / 2 + own.mean(axis=0), True)


@dataclass(frozen=True)
class AtRest:
    """The answer at no load.

    Attributes
    ----------
    displacement, error : ndarray, shape (6,), m and rad
    known : bool
        Whether a row or the hull of an axis tells it.
    """

    displacement: Floats
    error: Floats
    known: bool


@dataclass(frozen=True)
class Composed:
    """What the axes answer to n wrenches.

    Attributes
    ----------
    additive, griddata : ndarray, shape (n, 6), m and rad
        The answers of these two methods; rotations are the same.
    rest : ndarray, shape (n, 6), m and rad
        Error bars of `additive`; NaN where errors are unknown.
    states : ndarray of int, shape (n, 3), dimensionless
        What each axis' part rests on: `SOUND`, `WEAK`, `DEGENERATE`, `OFF_HULL` or `NO_ROWS`.
    """

    additive: Floats
    griddata: Floats
    rest: Floats
    states: NDArray[np.int_]

    @property
    def state(self) -> NDArray[np.int_]:
        """The worst of the three axes, shape (n,)."""
        return self.states.max(axis=1)


class Axes:
    """Three axis tables (None where there are no rows) and the answer at no load.

    Attributes
    ----------
    tables : tuple of AxisTable or None, length 3
    cuts : tuple of tuple of PureMomentCut, length 3
        Of each moment, x, y, z: from the axis it comes first in, then from the other.
    at_rest : AtRest
    """

    def __init__(
        self,
        tables: Sequence[AxisTable | None],
        at_rest: AtRest,
        fit: ComplianceFit,
        scale: Floats,
        before: Axes | None = None,
    ) -> None:
        """Compose; cuts of axes that another composition has too are taken from it."""
        self.tables = tuple(tables)
        self.at_rest, self.fit, self.scale = at_rest, fit, scale
        known = before.cuts if before is not None else ((),) * 3
        self.cuts = tuple(
            _cuts(self.tables, moment, own) for moment, own in zip((3, 4, 5), known, strict=True)
        )

    @property
    def thinning(self) -> str:
        """Which axes are made of a choice of their points, in words; empty if none is."""
        found = [
            f"axis {table.axis.name} of {len(table.values)} of its {table.given} points"
            for table in self.tables
            if table is not None and table.given > len(table.values)
        ]
        return f"an even choice is triangulated: {', '.join(found)}" if found else ""

    def summary(self) -> list[dict[str, Any]]:
        """Return, per axis, rows, spans, covered part of the range and error bars, JSON-able."""
        return [_axis_summary(*each) for each in zip(AXES, self.tables, strict=True)]

    def gaps(self, load_range: LoadRange) -> list[dict[str, Any]]:
        """Return, per axis, hull, corners of the range outside it and worst spots, JSON-able."""
        return [_gaps(*each, load_range) for each in zip(AXES, self.tables, strict=True)]

    def evaluate(self, wrenches: Floats) -> Composed:
        """Compose the answers to wrenches, shape (n, 6), N and N·m."""
        count = len(wrenches)
        loaded = np.abs(wrenches) > ZERO_LOAD * self.scale
        total = _Total(self.at_rest, count)
        acting = [np.flatnonzero(loaded[:, moment + 3]) for moment in range(3)]
        alone = [self._alone(m, wrenches[rows, m + 3]) for m, rows in enumerate(acting)]
        times = -loaded[:, 3:].astype(float)  # how often each moment's own answer is added
        for index, axis in enumerate(AXES):
            force, first, second = (loaded[:, load] for load in axis.inputs)
            for load, single in (
                (axis.inputs[1], first & ~second & ~force),
                (axis.inputs[2], second & ~first & ~force),
            ):
                times[single, load - 3] += 1.0
                rows = np.flatnonzero(single)
                part = alone[load - 3].take(np.searchsorted(acting[load - 3], rows))
                total.put_own(rows, axis, part)
                total.state[rows, index] = part.state
            rows = np.flatnonzero(force | (first & second))
            if len(rows):
                part = self._read(axis, wrenches[rows])
                total.put_own(rows, axis, part)
                total.add(rows, part, np.ones(len(rows)))
                total.state[rows, index] = part.state
        for moment in range(3):
            rows = np.flatnonzero(times[:, moment])
            part = alone[moment].take(np.searchsorted(acting[moment], rows))
            total.add(rows, part, times[rows, moment])
            total.mark_base(rows, moment, part.state)
        return total.composed()

    def _read(self, axis: LoadAxis, wrenches: Floats) -> _Part:
        """Return one axis' part at wrenches (k, 6) that load it."""
        table, inputs = self.tables[AXES.index(axis)], list(axis.inputs)
        if table is None:
            return self._guess(wrenches[:, inputs], inputs)
        x = wrenches[:, inputs] / table.scale
        reading = table.read(x)
        state = np.where(reading.inside, table.state[reading.simplices], OFF_HULL)
        if not table.shows_together:
            several = (np.abs(x) > ZERO_LOAD).sum(axis=1) > 1
            state = np.where(several, np.maximum(state, WEAK), state)
        part = _Part(reading.outputs, reading.rest + np.abs(reading.stepped), state)
        outside = np.flatnonzero(~reading.inside)
        if len(outside):
            # Account for steps (k, 3), scaled, from the hull's nearest point to the query. The
            # step along what the points span is in the outputs already, by the slope there. Off
            # it, where a table of fewer dimensions knows no slope, the fitted compliance tells
            # one; the bar grows by as much as the step moves the answer.
            rows, step = outside, (x - reading.at)[outside]
            basis = table.triangulation.basis
            off = step - step @ basis.T @ basis
            # Of each wrench by itself: batches change nothing.
            leaves = np.abs(off).max(axis=1) > ZERO_LOAD
            if leaves.any():
                rows, off = rows[leaves], off[leaves]
                loads = off * table.scale
                part.outputs[rows] += loads @ self.fit.matrix[:, inputs].T
                part.rest[rows] += (
                    np.abs(loads) @ np.abs(self.fit.matrix[:, inputs]).T + self.fit.error
                )
                unknown = (np.abs(off) > ZERO_LOAD) & ~self.fit.known[inputs]
                part.rest[rows[unknown.any(axis=1)]] = np.nan
        return part

    def _guess(self, loads: Floats, inputs: Sequence[int]) -> _Part:
        """Return the fitted compliance's part, for an axis or moment that has no rows."""
        matrix = self.fit.matrix[:, inputs]
        moved = self.at_rest.displacement + loads @ matrix.T
        rest = np.abs(loads) @ np.abs(matrix).T + self.fit.error
        rest[((loads != 0) & ~self.fit.known[inputs]).any(axis=1)] = np.nan
        return _Part(moved, rest, np.full(len(loads), NO_ROWS))

    def _alone(self, moment: int, amounts: Floats) -> _Part:
        """Return the answers to amounts (k,), N·m, of one moment alone, from whichever axis tells.

        That is the axis it comes first in, or the other one where that one's rows do not hold it.
        """
        part = self._guess(amounts[:, None], [moment + 3])
        for cut in self.cuts[moment]:
            if not len(cut.state):  # the axis has rows, but none with this moment alone
                part.state = np.minimum(part.state, OFF_HULL)
                continue
            reading = cut.read(amounts)
            better = np.flatnonzero((part.state >= OFF_HULL) & (reading.state < part.state))
            part.put(better, reading.take(better))
        return part


@dataclass
class _Part:
    """What an axis or a moment alone answers at k wrenches: (k, 6) each, m and rad; state (k,)."""

    outputs: Floats
    rest: Floats
    state: NDArray[np.int_]

    def take(self, rows: Indices) -> _Part:
        return _Part(*(column[rows] for column in self._columns()))

    def put(self, rows: Indices, other: _Part) -> None:
        for column, new in zip(self._columns(), other._columns(), strict=True):
            column[rows] = new

    def _columns(self) -> tuple[NDArray, ...]:
        return self.outputs, self.rest, self.state


class _Total:
    """The sum so far; what no load answers is added at the end, as often as the parts leave."""

    def __init__(self, at_rest: AtRest, count: int) -> None:
        self.at_rest = at_rest
        self.sum, self.squares = np.zeros((count, 6)), np.zeros((count, 6))
        self.own = np.tile(at_rest.displacement[:3], (count, 1))
        self.times = np.zeros((count, 1))
        self.state = np.zeros((count, 3), dtype=int)

    def put_own(self, rows: Indices, axis: LoadAxis, part: _Part) -> None:
        """Take the axis' own translation from its part."""
        own = axis.outputs[0]
        self.own[rows, own] = part.outputs[:, own]

    def add(self, rows: Indices, part: _Part, times: Floats) -> None:
        """Add a part so many times, shape (k,)."""
        often = times[:, None]
        self.sum[rows] += often * part.outputs
        self.squares[rows] += (often * part.rest) ** 2
        self.times[rows] += often

    def mark_base(self, rows: Indices, moment: int, state: NDArray[np.int_]) -> None:
        """Hold the axis a moment comes first in to what its own answer rests on."""
        first = next(place for place, axis in enumerate(AXES) if axis.inputs[1] == moment + 3)
        self.state[rows, first] = np.maximum(self.state[rows, first], state)

    def composed(self) -> Composed:
        """Return the sum."""
        zero, left = self.at_rest, 1.0 - self.times
        additive = self.sum + left * zero.displacement
        squares = self.squares + np.where(left == 0, 0.0, (left * zero.error) ** 2)
        return Composed(
            additive=additive,
            griddata=np.concatenate((self.own, additive[:, 3:]), axis=1),
            rest=np.sqrt(squares),
            states=self.state,
        )


def _cuts(
    tables: Sequence[AxisTable | None], moment: int, known: Sequence[PureMomentCut]
) -> tuple[PureMomentCut, ...]:
    """Return the cuts along a moment, the one of the axis it comes first in before the other."""
    cuts = []
    for column in (1, 2):
        index = next(place for place, axis in enumerate(AXES) if axis.inputs[column] == moment)
        table = tables[index]
        if table is None:
            continue
        same = [cut for cut in known if cut.column == column and cut.table.is_made_like(table)]
        cuts.append(same[0].of(table) if same else PureMomentCut(table, column))
    return tuple(cuts)


def _gaps(axis: LoadAxis, table: AxisTable | None, load_range: LoadRange) -> dict[str, Any]:
    # The low and high ends, (3,) each, of an axis' loads, stretched to hold zero.
    inputs = list(axis.inputs)
    low, high = np.minimum(load_range.low[inputs], 0.0), np.maximum(load_range.high[inputs], 0.0)
    ends = [sorted({float(a), float(b)}) for a, b in zip(low, high, strict=True)]
    corners = np.array(list(product(*ends)))
    if table is None:
        return {"axis": axis.name, "hull": [], "outside": _loads(axis, corners), "worst": []}
    scale = table.scale
    outside = table.triangulation.locate(corners / scale) < 0
    # The middles of the simplices with the largest error bars, for their outputs' range. Of the
    # largest simplices, where errors are unknown.
    middle, bars = table.in_middles()
    bars = bars[:, list(axis.outputs)]
    size = np.maximum(np.abs(table.values[:, list(axis.outputs)]).max(axis=0), np.finfo(float).tiny)
    fractions, thin = table.fractions(), table.state != SOUND
    spots = []
    worst = (bars / size).max(axis=1) if table.law.known else fractions
    for place in np.argsort(-worst)[:MOST_SPOTS].tolist():
        loads = middle[place : place + 1] * table.scale
        names = [OUTPUTS[output] for output in axis.outputs]
        spots.append(
            {
                "loads": _loads(axis, loads)[0],
                "error": dict(zip(names, bars[place].tolist(), strict=True))
                if table.law.known
                else None,
                "part_of_range": float(fractions[place]),
                "thin": bool(thin[place]),
            }
        )
    return {
        "axis": axis.name,
        "hull": _loads(axis, _hull(table) * scale),
        "outside": _loads(axis, corners[outside]),
        "worst": spots,
    }


def _loads(axis: LoadAxis, points: Floats) -> list[dict[str, float]]:
    names = [LOADS[load] for load in axis.inputs]
    return [dict(zip(names, point, strict=True)) for point in points.tolist()]


def _hull(table: AxisTable) -> Floats:
    """Return the vertices of the rows' hull, scaled, shape (k, 3); of a flat table its ends."""
    points, dimension = table.triangulation.points, table.triangulation.dimension
    flat = (points - table.triangulation.origin) @ table.triangulation.basis.T
    if dimension == 0:
        return points[:1]
    if dimension == 1:
        return points[[int(flat[:, 0].argmin()), int(flat[:, 0].argmax())]]
    try:
        return points[ConvexHull(flat).vertices][:MOST_VERTICES]
    except QhullError:
        return points[:MOST_VERTICES]


def _axis_summary(axis: LoadAxis, table: AxisTable | None) -> dict[str, Any]:
    """Return one axis' rows, spans (N, N·m), covered part of the range and median error bars."""
    inputs = [LOADS[load] for load in axis.inputs]
    if table is None:
        return {
            "axis": axis.name,
            "inputs": inputs,
            "rows": 0,
            "corrected": 0,
            "dimensions": None,
            "spans": {},
            "coverage": "outside",
            "part_of_range": 0.0,
            "thin_part_of_range": 0.0,
            "error": None,
        }
    shape, points = table.triangulation, table.rows.points * table.scale
    fractions, weak = table.fractions(), table.state != SOUND
    _, bars = table.in_middles()
    typical = np.average(bars, axis=0, weights=np.maximum(fractions, np.finfo(float).tiny))
    return {
        "axis": axis.name,
        "inputs": inputs,
        "rows": len(points),
        "corrected": int((~table.rows.single_axis).sum()),
        "dimensions": shape.dimension,
        "spans": {
            load: [float(points[:, column].min()), float(points[:, column].max())]
            for column, load in enumerate(inputs)
        },
        "coverage": "thin" if weak.all() else "covered",
        "part_of_range": float(fractions.sum()),
        "thin_part_of_range": float(fractions[weak].sum()),
        "error": {OUTPUTS[output]: float(typical[output]) for output in axis.outputs}
        if table.law.known
        else None,
    }


class PureMomentCut:
    """One axis' table along one of its moments, the other two loads being zero.

    Every composed rotation counts from these answers. They lie on one line through a
    triangulation, and along it barycentric outputs are straight between two faces of its
    simplices; unit errors are parabolas.

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

    def read(self, moments: Floats) -> _Part:
        """Read the cut at moments (k,), N·m; beyond its ends along its last stretch."""
        along = moments / self.table.scale[self.column]
        if not len(self.state):
            none = np.zeros((len(along), 6))
            blank = np.full(len(along), HOLE)
            return _Part(none, none, blank)
        found = np.searchsorted(self.stations, along, side="right") - 1
        found = np.clip(found, 0, len(self.state) - 1)
        y = (along - self.stations[found])[:, None]
        outputs, stated, unit = self.outputs[found], self.stated[found], self.unit_errors[found]
        unit = np.maximum(unit[:, 0] + y[:, 0] * (unit[:, 1] + y[:, 0] * unit[:, 2]), 0.0)
        beyond = (along < self.stations[0] - ZERO_LOAD) | (along > self.stations[-1] + ZERO_LOAD)
        return _Part(
            outputs[:, 0] + y * outputs[:, 1],
            self.table.law.bars(unit) + stated[:, 0] + y * stated[:, 1],
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
