"""How a table covers its load range: a summary, and the gaps of each axis, as JSON-able values."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from .axes.axes import Composition
from .axes.axis_table import SOUND, AxisTable
from .table.axes import AXES, LoadAxis
from .table.compliance import ComplianceFit
from .table.merging import row_conflicts
from .table.rows import Floats, LoadRange, Rows
from .table.space import LOADS, OUTPUTS

MOST_SPOTS = 5
MOST_VERTICES = 200


def axis_gaps(composition: Composition, load_range: LoadRange) -> list[dict[str, Any]]:
    """Return, per axis, hull, corners of the range outside it and worst spots, JSON-able."""
    tables = zip(AXES, composition.tables, strict=True)
    return [_gaps(axis, table, load_range) for axis, table in tables]


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


def summarise(
    rows: Rows,
    used: Rows,
    load_range: LoadRange,
    fit: ComplianceFit,
    composition: Composition | None,
) -> dict[str, Any]:
    """Return rows, conflicts, spans and error bars per axis.

    `used` are the rows that answers are made of; without a composition the 6x6 compliance answers.
    """
    summary: dict[str, Any] = {
        "rows": len(rows),
        "beyond_range": int((~load_range.holds(rows.wrench)).sum()),
        "used_rows": len(used),
        "compliance": {
            "origin": fit.origin,
            "loads": [rows.space.input_names[load] for load in np.flatnonzero(fit.known)],
            "error": fit.error.tolist(),
        },
        **row_conflicts(rows, load_range),
    }
    if composition is None:
        return {**summary, "axes": []}
    summary["axes"] = [
        _axis(axis.name, [LOADS[load] for load in axis.inputs], table)
        for axis, table in zip(AXES, composition.tables, strict=True)
    ]
    return summary


def _axis(name: str, inputs: list[str], table: AxisTable | None) -> dict[str, Any]:
    """Return one axis' rows, spans (N, N·m), covered part of the range and median error bars."""
    if table is None:
        return {
            "axis": name,
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
        "axis": name,
        "inputs": inputs,
        "rows": len(points),
        "corrected": int((~table.rows.clean).sum()),
        "dimensions": shape.dimension,
        "spans": {
            load: [float(points[:, column].min()), float(points[:, column].max())]
            for column, load in enumerate(inputs)
        },
        "coverage": "thin" if weak.all() else "covered",
        "part_of_range": float(fractions.sum()),
        "thin_part_of_range": float(fractions[weak].sum()),
        "error": {OUTPUTS[output]: float(typical[output]) for output in table.axis.outputs}
        if table.law.known
        else None,
    }
