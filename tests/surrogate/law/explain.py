"""What each axis contributes to an answer, as JSON-able values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tests.surrogate.law.answer import Answer
from wrenchbook.surrogate.answer import COVERED, NAMES, OUTSIDE
from wrenchbook.surrogate.axes.axes import OFF_HULL, Axes
from wrenchbook.surrogate.table.axes import AXES, LoadAxis
from wrenchbook.surrogate.table.compliance import ComplianceFit
from wrenchbook.surrogate.table.rows import Floats, Rows
from wrenchbook.surrogate.table.space import LOADS, OUTPUTS

from .reasons import Look, look, why_axis


def explain_axes(
    composition: Axes,
    members: Sequence[tuple[int, ...]],
    wrench: Floats,
) -> list[dict[str, Any]]:
    """Return what each axis answers to its own loads of a wrench, and from which rows.

    Parameters
    ----------
    members : sequence of tuple of int
        The numbers of the rows behind each row that the composition was made from.
    wrench : ndarray, shape (6,), N and N·m
    """
    found = composition.evaluate(wrench[None])
    return [
        _axis(composition, members, index, wrench, int(found.states[0, index]))
        for index in range(len(AXES))
    ]


def explain_linear(
    fit: ComplianceFit,
    rows: Rows,
    members: Sequence[tuple[int, ...]],
    wrench: Floats,
    answer: Answer,
) -> list[dict[str, Any]]:
    """Return what each axis' three loads contribute to a linear answer.

    The rows are those the compliance comes from; the error bars are those of the whole answer.
    The wrench has shape (6,), N and N·m.
    """
    places = range(len(rows))
    if fit.origin == "stored":
        places = np.flatnonzero(np.isfinite(rows.compliance).all(axis=(1, 2))).tolist()
    used = sorted(row for place in places for row in members[place])
    parts = []
    for axis in AXES:
        moved = fit.matrix @ np.where(np.isin(np.arange(6), axis.inputs), wrench, 0.0)
        bars = None if answer.error is None else np.array(answer.error)
        parts.append(
            _part(axis, wrench, moved, bars)
            | {"coverage": answer.coverage, "reason": answer.reason, "rows": used}
        )
    return parts


def _axis(
    composition: Axes,
    members: Sequence[tuple[int, ...]],
    index: int,
    wrench: Floats,
    worst: int,
) -> dict[str, Any]:
    axis, seen = AXES[index], look(composition, index, wrench)
    state = OUTSIDE if worst >= OFF_HULL else COVERED
    reason = why_axis(composition, index, wrench) if state != COVERED else ""
    return _part(axis, wrench, seen.found.additive[0], None) | {
        "coverage": NAMES[state],
        "reason": reason,
        "rows": _rows_of(seen, members),
    }


def _part(axis: LoadAxis, wrench: Floats, moved: Floats, bars: Floats | None) -> dict[str, Any]:
    return {
        "axis": axis.name,
        "inputs": {LOADS[load]: float(wrench[load]) for load in axis.inputs},
        "outputs": {OUTPUTS[k]: float(moved[k]) for k in axis.outputs},
        "error": None if bars is None else {OUTPUTS[k]: float(bars[k]) for k in axis.outputs},
    }


def _rows_of(look: Look, members: Sequence[tuple[int, ...]]) -> list[int]:
    """Return the ids of the rows at the corners of the simplex that was read."""
    if look.table is None or look.simplex is None:
        return []
    corners = look.table.triangulation.simplices[look.simplex]
    places = sorted({row for corner in corners for row in look.table.rows.members[corner]})
    return sorted(row for place in places for row in members[place])
