"""How a table covers its load range, as JSON-able values for the API and the page."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from surrogate.axes import AXES
from surrogate.axistable import SOUND, AxisTable
from surrogate.conflicts import row_conflicts
from surrogate.rows import LOADS, OUTPUTS

if TYPE_CHECKING:
    from surrogate.surrogate import Surrogate


def summarise(surrogate: Surrogate) -> dict[str, Any]:
    """Return rows, default method, conflicts, spans and error bars per axis, what is left out."""
    fit, summary = surrogate.fit, {"rows": len(surrogate.rows), "method": surrogate.default}
    summary["table_version"] = surrogate.version
    summary["compliance"] = {
        "origin": fit.origin,
        "loads": [LOADS[load] for load in np.flatnonzero(fit.known)],
        "error": fit.bar.tolist(),
    }
    summary.update(row_conflicts(surrogate.rows, surrogate.load_range))
    if surrogate.default == "linear":
        return {**summary, "axes": [], "left_out": None}
    composition = surrogate.composition
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
