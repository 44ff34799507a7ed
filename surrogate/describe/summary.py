"""How a table covers its load range, as JSON-able values for the API and the page."""

from __future__ import annotations

from typing import Any

import numpy as np

from surrogate.composition.axis_table import SOUND, AxisTable
from surrogate.composition.composition import Composition
from surrogate.table.axes import AXES
from surrogate.table.compliance import ComplianceFit
from surrogate.table.conflicts import row_conflicts
from surrogate.table.rows import LOADS, OUTPUTS, LoadRange, Rows


def summarise(
    rows: Rows,
    used: Rows,
    load_range: LoadRange,
    fit: ComplianceFit,
    composition: Composition | None,
) -> dict[str, Any]:
    """Return rows, conflicts, spans and error bars per axis, what is left out.

    `used` are the rows that answers are made of; without a composition the 6x6 compliance answers.
    """
    summary: dict[str, Any] = {
        "rows": len(rows),
        "beyond_range": int((~load_range.holds(rows.wrench)).sum()),
        "used_rows": len(used),
        "compliance": {
            "origin": fit.origin,
            "loads": [LOADS[load] for load in np.flatnonzero(fit.known)],
            "error": fit.bar.tolist(),
        },
        **row_conflicts(rows, load_range),
    }
    if composition is None:
        return {**summary, "axes": [], "left_out": None}
    left_out = composition.left_out
    summary["axes"] = [
        _axis(axis.name, [LOADS[load] for load in axis.inputs], table)
        for axis, table in zip(AXES, composition.tables, strict=True)
    ]
    summary["left_out"] = {
        "full_wrench_rows": left_out.shown,
        "across_axes": dict(zip(OUTPUTS[:3], left_out.across, strict=True)),
        "acting_together": dict(zip(OUTPUTS, left_out.together, strict=True)),
    }
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
            "calibrated_on": 0,
        }
    shape, points = table.interpolant, table.rows.points * np.array(table.scale)
    parts, weak = table.parts(), np.array(table.weak) != SOUND
    middle = shape.points[shape.simplices].mean(axis=1)
    bars = table.read(np.arange(len(middle)), middle).bars
    typical = np.average(bars, axis=0, weights=np.maximum(parts, np.finfo(float).tiny))
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
        "coverage": "covered" if table.sound and not weak.all() else "thin",
        "part_of_range": float(parts.sum()),
        "thin_part_of_range": float(parts.sum() if not table.sound else parts[weak].sum()),
        "error": {
            OUTPUTS[output]: float(bar)
            for output, bar in zip(table.axis.outputs, typical, strict=True)
        },
        "calibrated_on": table.bars.held_out,
    }
