"""What an answer rests on, how far it can be trusted and why not further, in words.

The numbers are those of batches.py. It is asked when the quick path finds a wrench outside an axis
or in a weak simplex, and for the detail of any answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from surrogate.answer import COVERED, NAMES, THIN
from surrogate.bars.evaluate import NOWHERE, Spots, diagnose
from surrogate.composition.axis_table import DEGENERATE, LARGE, LARGEST, AxisTable
from surrogate.composition.composition import Composition
from surrogate.table.axes import AXES, Axis
from surrogate.table.compliance import ComplianceFit
from surrogate.table.rows import LOAD_UNITS, LOADS, OUTPUTS, Floats

UNKNOWN_AT_REST = (
    "no row is at zero load and the rows of no axis surround it: what the component does without "
    "load is not known"
)


@dataclass
class Careful:
    """A composed answer with the detail of its axes; `error` is None where nothing tells it."""

    displacement: Floats
    error: Floats | None
    state: int
    reason: str
    axes: list[dict[str, Any]] = field(default_factory=list)


def read_carefully(
    composition: Composition,
    fit: ComplianceFit,
    members: Sequence[tuple[int, ...]],
    wrench: Sequence[float],
) -> Careful:
    """Compose the answer to one wrench (N, N·m) axis by axis, with states, reasons and rows.

    `members` are the numbers of the rows behind each row that the composition was made from.
    """
    loads = np.array(wrench, dtype=float)
    (moved, errors, states), spots, adrift = diagnose(composition, fit, loads[None])
    state, error = int(states[0]), errors[0]
    detail, reasons = [], []
    for index, (axis, spot) in enumerate(zip(AXES, spots, strict=True)):
        reason = _reason(composition, index, spot, loads, base_lost=bool(adrift[index, 0]))
        detail.append(_detail(axis, spot, loads, reason, _rows_behind(composition, spot, members)))
        if reason and int(spot.state[0]) == state:
            reasons.append(reason)
    if not loads.any() and not composition.rest.known:
        reasons = [UNKNOWN_AT_REST]
    known = bool(np.isfinite(error).all())
    return Careful(moved[0], error if known else None, state, "; ".join(reasons), detail)


def _reason(
    composition: Composition, index: int, spot: Spots, loads: Floats, *, base_lost: bool
) -> str:
    """Return why an axis' spot is not covered, or an empty text."""
    state, axis, table = int(spot.state[0]), AXES[index], composition.tables[index]
    if state == COVERED:
        return ""
    read, simplex = int(spot.table[0]), int(spot.simplex[0])
    source = None if read == NOWHERE else composition.tables[read]
    if state == THIN and source is not None:
        return _why_thin(source, simplex)
    if base_lost and _holds(table, loads):
        return (
            f"axis {axis.name}: {_amount(axis.inputs[1], loads)} alone, from which the "
            "composition counts, lies outside the rows"
        )
    return _why_outside(axis, table, loads)


def _holds(table: AxisTable | None, loads: Floats) -> bool:
    if table is None:
        return False
    x = loads[list(table.axis.inputs)] / np.array(table.scale)
    return bool(table.interpolant.locate(x[None])[0] >= 0)


def _why_thin(table: AxisTable, simplex: int) -> str:
    """Say why a table is thin at a simplex."""
    name, points = table.axis.name, len(table.rows.points)
    if not table.sound:
        return (
            f"axis {name}: {points} row{'s' if points > 1 else ''}, "
            f"at least {table.fewest} are needed to tell the error"
        )
    if table.weak[simplex] == DEGENERATE:
        return f"axis {name}: the rows around this wrench lie almost in one plane or line"
    assert table.weak[simplex] == LARGE
    part = table.parts()[simplex]
    most = LARGEST[table.interpolant.dimension]
    return (
        f"axis {name}: the rows around this wrench are far apart, "
        f"{part:.0%} of the load range lies between them (at most {most:.0%})"
    )


def _amount(load: int, loads: Floats, digits: int = 6) -> str:
    return f"{LOADS[load]} = {loads[load]:.{digits}g} {LOAD_UNITS[load]}"


def _why_outside(axis: Axis, table: AxisTable | None, loads: Floats) -> str:
    """Say which load leaves the rows, and what the rows span."""
    amounts = ", ".join(_amount(load, loads) for load in axis.inputs if loads[load])
    if table is None:
        return f"axis {axis.name}: no rows to answer {amounts}"
    spans = table.rows.points * np.array(table.scale)
    for column, load in enumerate(axis.inputs):
        low, high = float(spans[:, column].min()), float(spans[:, column].max())
        slack = 1e-9 * table.scale[column]
        if not low - slack <= loads[load] <= high + slack:
            if high - low <= slack:
                amount = _amount(load, loads)
                held = f"{LOADS[load]} = {low:.6g} {LOAD_UNITS[load]}"
                return f"axis {axis.name}: {amount}: all rows hold {held}"
            digits = _digits(float(loads[load]), low if loads[load] < low else high)
            span = f"{low:.{digits}g}..{high:.{digits}g} {LOAD_UNITS[load]}"
            amount = _amount(load, loads, digits)
            return f"axis {axis.name}: {amount} lies outside the rows, which span {span}"
    count = len(table.rows.points)
    return f"axis {axis.name}: {amounts} together lie outside the hull of its {count} rows"


def _digits(one: float, other: float) -> int:
    """Return the digits, at least six, by which two numbers are told apart in writing."""
    return next((n for n in range(6, 17) if f"{one:.{n}g}" != f"{other:.{n}g}"), 17)


def _rows_behind(
    composition: Composition, spot: Spots, members: Sequence[tuple[int, ...]]
) -> list[int]:
    """Return the numbers of the rows that a spot of one wrench was read from, ascending."""
    if spot.table[0] == NOWHERE:
        return []
    table = composition.tables[int(spot.table[0])]
    assert table is not None
    vertices = table.interpolant.simplices[int(spot.simplex[0])].tolist()
    places = [place for vertex in vertices for place in table.rows.members[vertex]]
    return sorted({seq for place in places for seq in members[place]})


def _detail(axis: Axis, spot: Spots, loads: Floats, reason: str, rows: list[int]) -> dict[str, Any]:
    """Return one axis' part of the answer as JSON-able values."""
    bars, outputs = spot.bars[0], axis.outputs
    known = bool(np.isfinite(bars).all())
    return {
        "axis": axis.name,
        "inputs": {LOADS[load]: float(loads[load]) for load in axis.inputs},
        "outputs": {OUTPUTS[k]: float(spot.displacement[0, k]) for k in outputs},
        "error": {OUTPUTS[k]: float(bars[k]) for k in outputs} if known else None,
        "coverage": NAMES[int(spot.state[0])],
        "reason": reason,
        "rows": rows,
    }
