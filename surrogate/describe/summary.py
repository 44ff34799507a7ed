"""How a table covers its load range, as JSON-able values for the API and the page."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..composition.axis_table import SOUND, AxisTable
from ..composition.composition import Composition
from ..table.axes import AXES
from ..table.compliance import ComplianceFit
from ..table.conflicts import row_conflicts
from ..table.rows import LOADS, OUTPUTS, LoadRange, Rows


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
            "loads": [LOADS[load] for load in np.flatnonzero(fit.known)],
            "error": fit.bar.tolist(),
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
