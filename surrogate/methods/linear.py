"""The answer of the 6x6 compliance, for one wrench and in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from surrogate.answer import Answer, judged
from surrogate.table.axes import AXES, CLEAN
from surrogate.table.compliance import ComplianceFit
from surrogate.table.rows import LOAD_UNITS, LOADS, OUTPUTS, LoadRange, Rows, Tolerance


def answer_linearly(
    fit: ComplianceFit, load_range: LoadRange, wrench: Sequence[float], tolerance: Tolerance | None
) -> Answer:
    """Return the compliance times one wrench, and why it is not covered where it is not."""
    loads = np.array(wrench, dtype=float)
    displacement = tuple((fit.matrix @ loads).tolist())
    unknown = ~fit.known & (np.abs(loads) > CLEAN * load_range.scale)
    if unknown.any():
        reason = f"no row tells the influence of {LOADS[int(np.argmax(unknown))]}"
        return Answer(displacement, None, "outside", reason, "linear")
    error = tuple(fit.bar.tolist())
    if load_range.holds(loads[None])[0]:
        return judged(displacement, error, tolerance, "linear")
    beyond = np.maximum(load_range.low - loads, loads - load_range.high) / load_range.scale
    load = int(np.argmax(beyond))
    low, high = load_range.low[load], load_range.high[load]
    reason = (
        f"{LOADS[load]} = {loads[load]:.6g} {LOAD_UNITS[load]} is outside "
        f"the load range, {low:.6g}..{high:.6g} {LOAD_UNITS[load]}"
    )
    return Answer(displacement, error, "outside", reason, "linear")


def explain_linearly(
    fit: ComplianceFit,
    rows: Rows,
    members: Sequence[tuple[int, ...]],
    wrench: Sequence[float],
    answer: Answer,
) -> list[dict[str, Any]]:
    """Return what each axis' three loads contribute to a linear answer, as `explain` lists it.

    The rows are those the compliance comes from; the error bars are those of the whole answer.
    """
    stored = np.isfinite(rows.compliance).all(axis=(1, 2))
    behind = np.flatnonzero(stored) if fit.origin == "stored" else np.arange(len(rows))
    used = sorted(seq for place in behind.tolist() for seq in members[place])
    parts = []
    for axis in AXES:
        loads = np.zeros(6)
        loads[list(axis.inputs)] = np.array(wrench, dtype=float)[list(axis.inputs)]
        moved = fit.matrix @ loads
        parts.append(
            {
                "axis": axis.name,
                "inputs": {LOADS[load]: float(loads[load]) for load in axis.inputs},
                "outputs": {OUTPUTS[k]: float(moved[k]) for k in axis.outputs},
                "error": answer.error and {OUTPUTS[k]: answer.error[k] for k in axis.outputs},
                "coverage": answer.coverage,
                "reason": answer.reason,
                "rows": used,
            }
        )
    return parts
