"""Composition of the three axes to one displacement.

With z = u(0), the displacement at no load, a_i that of axis i at (F_i, M_j, M_k) and b_m that of
the moment M_m alone, all six outputs each,

    additive:  u(w) = z + sum_i (a_i - z) - sum_m (b_m - z)
    griddata:  rotations as above; u_i is the translation of axis i alone

It is the second-order part, for these groups, of a high-dimensional model representation (Rabitz
and Alis 1999, "General foundations of high-dimensional model representations"). An axis without
loads adds nothing and a moment that is zero takes nothing away. For an axis that only one moment
acts on the answer is b_m itself, so that its part and the part taken away are the same number: at a
row of one axis the sum is that row. Slopes are composed alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from ..table.axes import AXES, ZERO_LOAD, LoadAxis, OffAxis, axis_rows, single_axis_rows
from ..table.compliance import ComplianceFit
from ..table.rows import Floats, LoadRange, Rows
from ..table.space import LOADS
from .axis_table import AxisTable, axis_table
from .triangulation import Triangulation

SAME_STATION = 1e-12  # stations closer than this, in scaled units, are the same station
IN_SIMPLEX = 1e-9  # lower limit of a barycentric coordinate below 0: rounding of a station
BOX_MARGIN = 1e-6  # part of the points' size: above the rounding at thin simplices

# States of a stretch of a cut, within the hull of the points or not: WB_INSIDE and WB_OFF_HULL.
INSIDE, OFF_HULL = 0, 9

MAX_SPOTS = 5  # simplices in a list of gaps, the largest ones
MAX_VERTICES = 200  # vertices of a listed hull: a page draws no more


def build_axes(
    rows: Rows,
    load_range: LoadRange,
    fit: ComplianceFit,
    off_axis: OffAxis,
    before: Axes | None = None,
) -> Axes:
    """Build the three axes over rows within the load range.

    `before`: the axes of another version of the table. An axis whose points, values and slopes are
    equal is reused, since a new build would give the same bits.
    """
    earlier = before.tables if before is not None else (None,) * len(AXES)
    tables = [
        _axis_table(rows, load_range, axis, fit, off_axis, table)
        for axis, table in zip(AXES, earlier, strict=True)
    ]
    return Axes(tables, answer_at_zero(rows, load_range, tables), before)


def _axis_table(
    rows: Rows,
    load_range: LoadRange,
    axis: LoadAxis,
    fit: ComplianceFit,
    off_axis: OffAxis,
    before: AxisTable | None,
) -> AxisTable | None:
    """Return the table of one axis; None where no row loads it."""
    clean = axis_rows(rows, load_range, axis, fit, "exclude")
    table = axis_table(clean, load_range, before) if len(clean.points) else None
    if off_axis == "exclude" or single_axis_rows(rows, load_range).any(axis=1).all():
        return table
    chosen = axis_rows(rows, load_range, axis, fit, off_axis)
    if off_axis == "correct" and table is not None:
        # The displacement of a multi-axis row without its off-axis part is as uncertain as the
        # linear fit. Between single-axis rows that is far more than their error, and the row would
        # only add its nonlinear part to all three axes; beyond them it is better than nothing.
        beyond = table.triangulation.locate(chosen.points) < 0
        chosen = chosen.take(chosen.single_axis | beyond)
    if not len(chosen.points):
        return None
    if table is not None and chosen.single_axis.all():
        return table
    return axis_table(chosen, load_range, before)


def answer_at_zero(rows: Rows, load_range: LoadRange, tables: Sequence[AxisTable | None]) -> Floats:
    """Return the displacement at no load, shape (6,), m and rad.

    It is the mean of the rows at zero load or, without any, the mean of the interpolations at zero
    by the axes whose hull contains zero (measured tables have offsets). It is zero if there are
    none either.
    """
    unloaded = (np.abs(rows.wrench) <= ZERO_LOAD * load_range.scale).all(axis=1)
    if unloaded.any():
        return rows.displacement[unloaded].mean(axis=0)
    zero = np.zeros((1, 3))
    answers = list[Floats]()
    for table in tables:
        if table is not None:
            simplices = table.triangulation.locate(zero)
            answers += [table.interpolate(simplices, zero)] if simplices[0] >= 0 else []
    return np.concatenate(answers).mean(axis=0) if answers else np.zeros(6)


class Axes:
    """Three axis tables (None where there are no rows) and the answer at no load.

    `cuts`: for each moment, x, y, z: along the axis that has it as the first moment, then along the
    other.
    `at_zero` (6,), m and rad: displacement at no load.
    """

    def __init__(
        self, tables: Sequence[AxisTable | None], at_zero: Floats, before: Axes | None = None
    ) -> None:
        """Combine tables; cuts of axes that `before` shares are reused."""
        self.tables = tuple(tables)
        self.at_zero = at_zero
        known = before.cuts if before is not None else ((),) * 3
        self.cuts = tuple(
            _cuts(self.tables, moment, cuts) for moment, cuts in zip((3, 4, 5), known, strict=True)
        )

    def summary(self) -> list[dict[str, Any]]:
        """Return, per axis, rows, spans, covered part of the range and error bars, JSON-able."""
        return [_axis_summary(*each) for each in zip(AXES, self.tables, strict=True)]

    def gaps(self, load_range: LoadRange) -> list[dict[str, Any]]:
        """Return, per axis, hull, corners of the range outside it and worst spots, JSON-able."""
        return [_gaps(*each, load_range) for each in zip(AXES, self.tables, strict=True)]


def _cuts(
    tables: Sequence[AxisTable | None], moment: int, known: Sequence[PureMomentCut]
) -> tuple[PureMomentCut, ...]:
    """Return the cuts along a moment, that of the axis that has it as the first moment first."""
    cuts = []
    for column in (1, 2):
        index = next(index for index, axis in enumerate(AXES) if axis.inputs[column] == moment)
        table = tables[index]
        if table is None:
            continue
        shape = table.triangulation
        same = [cut for cut in known if cut.column == column and cut.shape is shape]
        cuts.append(same[0] if same else PureMomentCut(table, column))
    return tuple(cuts)


def _gaps(axis: LoadAxis, table: AxisTable | None, load_range: LoadRange) -> dict[str, Any]:
    """Return the gaps of an axis: its hull, corners of the range outside, largest simplices."""
    # The low and high ends, (3,) each, of an axis' loads, stretched to hold zero.
    inputs = list(axis.inputs)
    low, high = np.minimum(load_range.low[inputs], 0.0), np.maximum(load_range.high[inputs], 0.0)
    ends = [sorted({float(a), float(b)}) for a, b in zip(low, high, strict=True)]
    corners = np.array(list(product(*ends)))
    if table is None:
        return {"axis": axis.name, "hull": [], "outside": _loads(axis, corners), "worst": []}
    scale = table.scale
    outside = table.triangulation.locate(corners / scale) < 0
    middles = table.triangulation.points[table.triangulation.simplices].mean(axis=1)
    fractions = table.fractions()
    largest = np.argsort(-fractions)[:MAX_SPOTS].tolist()
    return {
        "axis": axis.name,
        "hull": _loads(axis, _hull(table) * scale),
        "outside": _loads(axis, corners[outside]),
        "worst": [
            {"loads": loads, "part_of_range": float(fractions[simplex])}
            for simplex, loads in zip(largest, _loads(axis, middles[largest] * scale), strict=True)
        ],
    }


def _loads(axis: LoadAxis, points: Floats) -> list[dict[str, float]]:
    names = [LOADS[load] for load in axis.inputs]
    return [dict(zip(names, point, strict=True)) for point in points.tolist()]


def _hull(table: AxisTable) -> Floats:
    """Return the vertices of the rows' hull, scaled, shape (k, 3); its ends in one dimension."""
    points, dimension = table.triangulation.points, table.triangulation.dimension
    local = (points - table.triangulation.origin) @ table.triangulation.basis.T
    if dimension == 0:
        return points[:1]
    if dimension == 1:
        return points[[int(local[:, 0].argmin()), int(local[:, 0].argmax())]]
    try:
        return points[ConvexHull(local).vertices][:MAX_VERTICES]
    except QhullError:
        return points[:MAX_VERTICES]


def _axis_summary(axis: LoadAxis, table: AxisTable | None) -> dict[str, Any]:
    """Return an axis' rows, spans (N, N·m) and the part of the range between them."""
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
        }
    shape = table.triangulation
    points = table.rows.points * table.scale
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
        "coverage": "covered",
        "part_of_range": float(table.fractions().sum()),
    }


class PureMomentCut:
    """An axis' table along one of its moments, the other two loads being zero.

    Every combined rotation is relative to these answers. They lie on a line through a
    triangulation, and along it barycentric outputs are straight between two faces of its simplices.

    `shape`: the table's triangulation.
    `stations` (s + 1,), dimensionless: scaled moments at which the line passes from one simplex to
    the next, ascending.
    `outputs` (s, 2, 6), m and rad: constant and linear part of each stretch, by the scaled moment
    less its first station.
    `state` (s,): `INSIDE`; `OFF_HULL` where no simplex contains the stretch.
    """

    def __init__(self, table: AxisTable, column: int) -> None:
        """Cut a table along its input `column`, 1 or 2."""
        self.shape = table.triangulation
        self.column = column
        self.stations = _stations(table.triangulation, column)
        low = self.stations[:-1]
        width = np.diff(self.stations)
        simplices = table.triangulation.locate(self._points(low + 0.5 * width))
        self.state = np.where(simplices >= 0, INSIDE, OFF_HULL).astype(np.int32)
        start, end = (
            table.interpolate(np.maximum(simplices, 0), self._points(along))
            for along in (low, low + width)
        )
        self.outputs = np.stack((start, (end - start) / width[:, None]), axis=1)

    def _points(self, along: Floats) -> Floats:
        points = np.zeros((len(along), 3))
        points[:, self.column] = along
        return points


def _stations(shape: Triangulation, column: int) -> Floats:
    """Return, ascending, where the line crosses faces of the simplices; none or several."""
    if shape.dimension == 0 or not shape.holds_direction(column):
        return np.empty(0)
    # The simplices that the line may cross, by their boxes: a few in a hundred.
    others = [load for load in range(3) if load != column]
    corners = shape.points[:, others][shape.simplices]
    low, high = corners.min(axis=1), corners.max(axis=1)
    margin = BOX_MARGIN * np.abs(shape.points).max(initial=1.0)
    simplices = np.flatnonzero(((low <= margin) & (high >= -margin)).all(axis=1))
    start = np.zeros((len(simplices), 3))
    at_zero = shape.barycentric(simplices, start)
    start[:, column] = 1.0
    slope = shape.barycentric(simplices, start) - at_zero
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        roots = np.where(slope != 0, -at_zero / slope, np.nan)
        barycentric = at_zero[:, None, :] + slope[:, None, :] * roots[:, :, None]
        # A root counts if it lies in the simplex, and so within the points' box.
        inside = (barycentric > -IN_SIMPLEX).all(axis=2)
        inside &= np.abs(roots) <= np.abs(shape.points).max()
    stations = np.unique(roots[inside])
    if len(stations) < 2:
        return np.empty(0)
    return stations[np.concatenate(([True], np.diff(stations) > SAME_STATION))]
