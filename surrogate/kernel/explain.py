"""The contribution of each axis to an answer of a packed table, as JSON-able values."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from ..table.space import axis_inputs
from .binding import PackedTable
from .format import GROUP_CAN_ANSWER
from .replies import AxisPart, Reply


def explain(
    table: PackedTable,
    wrench: Sequence[float],
    tolerance: Sequence[float] | None = None,
    method: str | None = None,
) -> list[dict[str, Any]]:
    """Return the contribution of each axis' three loads, and its rows, for each group of outputs.

    Parameters are those of `PackedTable.answer`; loads are N and N·m, outputs m and rad.

    Each has ``axis``, ``inputs``, ``outputs``, ``error``, ``coverage``, ``reason`` and ``rows``,
    the numbers of the rows used. The compliance gives them if it answers, else the axes. The axes
    know errors of complete answers only, so their ``error`` is None.
    """
    explanations = []
    for number, group in enumerate(table.meta["groups"]):
        can_answer = table.arrays[f"g{number}/flags"][GROUP_CAN_ANSWER]
        if (method or group["method"]) == "linear" and can_answer:
            parts = _linear(table, number, wrench, tolerance)
        else:
            parts = [_axis(table, number, axis, wrench) for axis in range(3)]
        explanations += [part for part in parts if part is not None and part["outputs"]]
    return explanations


def _named(
    table: PackedTable, group: int, axis: int, values: Sequence[float]
) -> dict[str, float] | None:
    """Return an axis' outputs of a group by name; None if one is unknown."""
    outputs = table.meta["groups"][group]["outputs"]
    names = [output["name"] for output in table.meta["space"]["outputs"]]
    by_name = {names[output]: values[output] for output in (axis, 3, 4, 5)}
    if any(map(math.isnan, by_name.values())):
        return None
    return {name: value for name, value in by_name.items() if name in outputs}


def _contribution(
    table: PackedTable,
    axis: int,
    wrench: Sequence[float],
    outputs: dict[str, float] | None,
    source: AxisPart | Reply,
    rows: list[int],
    error: dict[str, float] | None = None,
) -> dict[str, Any]:
    """Return the JSON-able contribution of an axis; `source` has its coverage and reason."""
    names = [entry["name"] for entry in table.meta["space"]["inputs"]]
    return {
        "axis": "xyz"[axis],
        "inputs": {names[load]: float(wrench[load]) for load in axis_inputs(axis)},
        "outputs": outputs,
        "error": error,
        "coverage": source.coverage,
        "reason": source.reason,
        "rows": rows,
    }


def _axis(
    table: PackedTable, group: int, axis: int, wrench: Sequence[float]
) -> dict[str, Any] | None:
    """Return the contribution of an axis by its triangulation; None without rows."""
    part = table.axis(group, axis, wrench)
    if part is None:
        return None
    rows: set[int] = set()
    for corner in part.corners:
        first, last = table.arrays[f"g{group}/axes/member_first"][corner : corner + 2].tolist()
        rows.update(table.arrays[f"g{group}/axes/members"][first:last].tolist())
    outputs = _named(table, group, axis, part.outputs)
    return _contribution(table, axis, wrench, outputs, part, sorted(rows))


def _linear(
    table: PackedTable, group: int, wrench: Sequence[float], tolerance: Sequence[float] | None
) -> list[dict[str, Any]]:
    """Return the contributions of all axes by a linear group's compliance."""
    answer = table.answer(wrench, tolerance, "linear")
    matrix, rows = (table.arrays[f"g{group}/fit/{name}"] for name in ("matrix", "rows"))
    error = answer.interpolation or (math.nan,) * table.outputs
    unknown = [math.nan if value is None else value for value in error]
    parts = []
    for axis in range(3):
        loads = list(axis_inputs(axis))
        moved = (matrix[:, loads] @ [wrench[load] for load in loads]).tolist()
        outputs, errors = (_named(table, group, axis, values) for values in (moved, unknown))
        part = _contribution(table, axis, wrench, outputs, answer, rows.tolist(), errors)
        parts.append(part)
    return parts
