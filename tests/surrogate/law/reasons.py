"""Why an axis does not hold a wrench, in words."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wrenchbook.surrogate.axes.axes import INSIDE, NO_ROWS, OFF_HULL, Axes, Composed
from wrenchbook.surrogate.axes.axis_table import AxisTable
from wrenchbook.surrogate.table.axes import AXES, LoadAxis
from wrenchbook.surrogate.table.rows import ZERO_LOAD, Floats
from wrenchbook.surrogate.table.space import LOAD_UNITS, LOADS


def why_not(composition: Axes, wrench: Floats) -> str:
    """Return why the axes do not cover a wrench, shape (6,), N and N·m; empty if they do."""
    found = composition.evaluate(wrench[None])
    worst = int(found.state[0])
    if worst == INSIDE:
        return ""
    reasons = [
        why_axis(composition, index, wrench)
        for index in range(3)
        if int(found.states[0, index]) == worst
    ]
    return "; ".join(dict.fromkeys(reason for reason in reasons if reason))


class Look(NamedTuple):
    """One axis' answer, and the table and the simplex it was read from, if there are any."""

    found: Composed
    table: AxisTable | None
    simplex: int | None


def look(composition: Axes, index: int, wrench: Floats) -> Look:
    """Return the answer of one axis to its three loads of a wrench (6,), N and N·m, alone."""
    axis = AXES[index]
    loads = np.where(np.isin(np.arange(6), axis.inputs), wrench, 0.0)[None]
    found = composition.evaluate(loads)
    loaded = np.flatnonzero(np.abs(loads[0]) > ZERO_LOAD * composition.scale)
    table = composition.tables[index]
    if len(loaded) == 1 and loaded[0] >= 3:
        cuts = composition.cuts[loaded[0] - 3]
        states = [cut.read(loads[0, loaded]).state[0] for cut in cuts]
        table = cuts[int(np.argmin(states))].table if cuts else None
    if table is None or not len(loaded):
        return Look(found, table, None)
    x = loads[:, list(table.axis.inputs)] / table.scale
    return Look(found, table, int(table.read(x).simplices[0]))


def why_axis(composition: Axes, index: int, wrench: Floats) -> str:
    """Return why one axis does not cover its part of a wrench (6,), N and N·m; empty if it does."""
    axis, seen = AXES[index], look(composition, index, wrench)
    state = int(seen.found.states[0, index])
    if state in (OFF_HULL, NO_ROWS):
        return _why_outside(axis, composition.tables[index], wrench)
    if composition.evaluate(wrench[None]).states[0, index] >= OFF_HULL:
        return (
            f"axis {axis.name}: {_amount(axis.inputs[1], wrench)} alone, from which the "
            "composition counts, lies outside the rows"
        )
    return ""


def _amount(load: int, wrench: Floats) -> str:
    return f"{LOADS[load]} = {wrench[load]:.10g} {LOAD_UNITS[load]}"


def _why_outside(axis: LoadAxis, table: AxisTable | None, wrench: Floats) -> str:
    """Say which loads leave the rows, and what the rows span."""
    amounts = ", ".join(_amount(load, wrench) for load in axis.inputs if wrench[load])
    if table is None:
        return f"axis {axis.name}: no rows to answer {amounts}"
    spans, found = table.rows.points * table.scale, []
    for column, load in enumerate(axis.inputs):
        low, high = float(spans[:, column].min()), float(spans[:, column].max())
        slack, unit = ZERO_LOAD * table.scale[column], LOAD_UNITS[load]
        if low - slack <= wrench[load] <= high + slack:
            continue
        if high - low <= slack:
            only = ", ".join(LOADS[own] for own in axis.inputs)
            where = f": the rows with {only} alone all hold {LOADS[load]} = {low:.6g} {unit}"
        else:
            where = f" lies outside the rows, which span {low:.6g}..{high:.6g} {unit}"
        found.append(f"{_amount(load, wrench)}{where}")
    if found:
        return f"axis {axis.name}: {', '.join(found)}"
    count = len(table.values)
    return f"axis {axis.name}: {amounts} together lie outside the hull of its {count} rows"
