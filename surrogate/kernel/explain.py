"""The contribution of each axis to an answer of a packed table, as JSON-able values."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from .binding import PackedTable

_USED = 2  # index in a group's ``flags``: see `packed.writer`
_AXES = tuple((axis, 3 + (axis + 1) % 3, 3 + (axis + 2) % 3) for axis in range(3))


def explain(
    table: PackedTable,
    wrench: Sequence[float],
    tolerance: Sequence[float] | None = None,
    method: str | None = None,
) -> list[dict[str, Any]]:
    """Return per group of outputs and axis what its three loads contribute, and from which rows.

    Parameters are those of `PackedTable.answer`; loads are N and N·m, outputs m and rad.

    ``axis``, ``inputs``, ``outputs``, ``error``, ``coverage``, ``reason`` and ``rows``, the numbers
    of the rows used. They are the compliance's if that answers, the axes' otherwise, whose errors
    are known of complete answers alone: ``error`` is None.
    """
    explanations = []
    for number, group in enumerate(table.meta["groups"]):
        if (method or group["method"]) == "linear" and table.arrays[f"g{number}/flags"][_USED]:
            parts = _linear(table, number, wrench, tolerance)
        else:
            parts = [_axis(table, number, axis, wrench) for axis in range(3)]
        explanations += [part for part in parts if part is not None and part["outputs"]]
    return explanations


def _named(
    table: PackedTable, group: int, axis: int, values: Sequence[float]
) -> dict[str, float] | None:
    """Return an axis' outputs of a group by name; None where one is not known."""
    outputs = table.meta["groups"][group]["outputs"]
    names = [output["name"] for output in table.meta["space"]["outputs"]]
    by_name = {names[output]: values[output] for output in (axis, 3, 4, 5)}
    if any(map(math.isnan, by_name.values())):
        return None
    return {name: value for name, value in by_name.items() if name in outputs}


def _inputs(table: PackedTable, axis: int, wrench: Sequence[float]) -> dict[str, float]:
    names = [entry["name"] for entry in table.meta["space"]["inputs"]]
    return {names[load]: float(wrench[load]) for load in _AXES[axis]}


def _axis(
    table: PackedTable, group: int, axis: int, wrench: Sequence[float]
) -> dict[str, Any] | None:
    part = table.axis(group, axis, wrench)
    if part is None:
        return None
    rows: set[int] = set()
    for corner in part.corners:
        first, last = table.arrays[f"g{group}/axes/member_first"][corner : corner + 2].tolist()
        rows.update(table.arrays[f"g{group}/axes/members"][first:last].tolist())
    return {
        "axis": "xyz"[axis],
        "inputs": _inputs(table, axis, wrench),
        "outputs": _named(table, group, axis, part.outputs),
        "error": None,
        "coverage": part.coverage,
        "reason": part.reason,
        "rows": sorted(rows),
    }


def _linear(
    table: PackedTable, group: int, wrench: Sequence[float], tolerance: Sequence[float] | None
) -> list[dict[str, Any]]:
    answer = table.answer(wrench, tolerance, "linear")
    matrix = table.arrays[f"g{group}/fit/matrix"]
    error = answer.interpolation or (math.nan,) * table.outputs
    unknown = [math.nan if value is None else value for value in error]
    parts = []
    for axis, loads in enumerate(_AXES):
        moved = (matrix[:, loads] @ [wrench[load] for load in loads]).tolist()
        part = {
            "axis": "xyz"[axis],
            "inputs": _inputs(table, axis, wrench),
            "outputs": _named(table, group, axis, moved),
            "error": _named(table, group, axis, unknown),
            "coverage": answer.coverage,
            "reason": answer.reason,
            "rows": table.arrays[f"g{group}/fit/rows"].tolist(),
        }
        parts.append(part)
    return parts
