"""The careful path: what an answer rests on, how far it can be trusted, and why not further.

It is taken when the quick path finds a wrench outside an axis or in a weak simplex, and for the
detail of any answer. It never gives up while there is a row to estimate from.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import sqrt
from typing import Any

import numpy as np

from surrogate.axes import AXES, Axis
from surrogate.axistable import DEGENERATE, LARGE, LARGEST, AxisTable
from surrogate.compliance import ComplianceFit
from surrogate.composition import Composition
from surrogate.rows import LOAD_UNITS, LOADS, OUTPUT_UNITS, OUTPUTS, Floats, Rows, Tolerance

COVERED, THIN, OUTSIDE = 0, 1, 2
NAMES = ("covered", "thin", "outside")


@dataclass
class Spot:
    """Six outputs read at one point of an axis, with bars, state, reason and places of rows."""

    displacement: Floats
    bars: Floats | None
    state: int = COVERED
    reason: str = ""
    rows: tuple[int, ...] = ()


@dataclass
class Careful:
    """A composed answer with the detail of its axes; `error` is None where nothing tells it."""

    displacement: Floats
    error: Floats | None
    state: int
    reason: str
    axes: list[dict[str, Any]] = field(default_factory=list)


def read_carefully(
    composition: Composition, fit: ComplianceFit, rows: Rows, wrench: Sequence[float]
) -> Careful:
    """Compose the answer to one wrench (N, N·m) axis by axis, with states, reasons and rows."""
    loads = np.array(wrench, dtype=float)
    zero = np.array(composition.zero)
    moved, squares, lean = zero.copy(), np.zeros(6), np.zeros(3)
    spots: list[tuple[Axis, Spot]] = []
    known = True
    for axis in AXES:
        spot, base = _axis_spots(composition, fit, axis, loads)
        spots.append((axis, spot))
        outputs = list(axis.outputs)
        moved[outputs[0]] = spot.displacement[outputs[0]]
        moved[3:] += spot.displacement[3:] - base.displacement[3:]
        if spot.bars is None or base.bars is None:
            known = False
            continue
        squares[outputs[0]] += spot.bars[outputs[0]] ** 2
        squares[3:] += spot.bars[3:] ** 2 + base.bars[3:] ** 2
        table = composition.tables[AXES.index(axis)]
        if table is not None and base.rows:
            lean += table.lean
    squares[3:] += lean**2
    spread = squares.tolist()
    composition.left_out.widen(loads.tolist(), spread)
    state = max(spot.state for _, spot in spots)
    reasons = [spot.reason for _, spot in spots if spot.state == state and spot.reason]
    detail = [_detail(axis, spot, loads, rows) for axis, spot in spots]
    error = np.array([sqrt(square) for square in spread]) if known else None
    return Careful(moved, error, state, "; ".join(reasons), detail)


def over_tolerance(error: Sequence[float], tolerance: Tolerance) -> str:
    """Return why error bars (6,) are over the tolerance, or an empty text."""
    worst, name = 1.0, ""
    for output in range(6):
        allowed = tolerance.translation if output < 3 else tolerance.rotation
        if error[output] > worst * allowed:
            worst = error[output] / allowed
            unit = OUTPUT_UNITS[output]
            name = (
                f"the error bar of {OUTPUTS[output]}, {error[output]:.2g} {unit}, "
                f"is over the tolerance, {allowed:.2g} {unit}"
            )
    return name


def _axis_spots(
    composition: Composition, fit: ComplianceFit, axis: Axis, loads: Floats
) -> tuple[Spot, Spot]:
    """Return an axis' spot and the spot its rotation counts from (one moment alone, or r(0))."""
    zero = Spot(np.array(composition.zero), np.zeros(6))
    force, first, second = loads[list(axis.inputs)]
    if not (force or first or second):
        return zero, zero
    alone = None
    if not force and not (first and second):
        alone = _alone(composition, axis.inputs[1] if first else axis.inputs[2], loads)
    spot = _spot(composition, fit, axis, loads, alone)
    if not first:
        return spot, zero
    if not force and not second:
        return spot, Spot(spot.displacement, np.zeros(6))
    base = _alone(composition, axis.inputs[1], loads)
    if base is None:
        base = _guess(composition, fit, axis, np.where(np.arange(6) == axis.inputs[1], loads, 0.0))
        spot.state = OUTSIDE
        spot.reason = spot.reason or (
            f"axis {axis.name}: {_amount(axis.inputs[1], loads)} alone, from which the "
            "composition counts, lies outside the rows"
        )
    return spot, base


def _spot(
    composition: Composition,
    fit: ComplianceFit,
    axis: Axis,
    loads: Floats,
    alone: Spot | None,
) -> Spot:
    """Return an axis' own answer, that of another axis to one moment alone, or an estimate."""
    table = composition.tables[AXES.index(axis)]
    spot = _read(table, loads) if table is not None else None
    if spot is not None and (spot.state == COVERED or alone is None):
        return spot
    if alone is not None and (spot is None or alone.state < spot.state):
        return alone
    if spot is not None:
        return spot
    spot = _guess(composition, fit, axis, np.where(np.isin(np.arange(6), axis.inputs), loads, 0.0))
    spot.state = OUTSIDE
    spot.reason = _why_outside(axis, table, loads)
    return spot


def _alone(composition: Composition, moment: int, loads: Floats) -> Spot | None:
    """Return the answer to one moment alone: from the axis it is first in, else the other."""
    only = np.where(np.arange(6) == moment, loads, 0.0)
    for place in (1, 2):
        index = next(i for i, axis in enumerate(AXES) if axis.inputs[place] == moment)
        table = composition.tables[index]
        spot = _read(table, only) if table is not None else None
        if spot is not None:
            return spot
    return None


def _read(table: AxisTable, loads: Floats) -> Spot | None:
    """Read all six outputs of a table at an axis' loads, or None outside its hull.

    The two translations that are not the axis' own have no calibrated bar: how much they vary
    over the simplex stands in for it.
    """
    outputs = list(table.axis.outputs)
    x = loads[list(table.axis.inputs)] / np.array(table.scale)
    found = table.interpolant.locate(x[None])
    if found[0] < 0:
        return None
    vertices = table.interpolant.simplices[found[0]]
    shares = table.interpolant.barycentric(found, x[None])[0]
    corners = table.rows.displacement[vertices]
    reading = table.read(found, x[None])
    displacement, bars = shares @ corners, np.ptp(corners, axis=0)
    displacement[outputs], bars[outputs] = reading.outputs[0], reading.bars[0]
    state, reason = _strength(table, int(found[0]))
    near = tuple(row for vertex in vertices for row in table.rows.members[vertex])
    return Spot(displacement, bars, state, reason, near)


def _strength(table: AxisTable, simplex: int) -> tuple[int, str]:
    """Return whether a table is thin at a simplex, and why."""
    name, points = table.axis.name, len(table.rows.points)
    if not table.sound:
        return THIN, (
            f"axis {name}: {points} row{'s' if points > 1 else ''}, "
            f"at least {table.fewest} are needed to tell the error"
        )
    if table.weak[simplex] == DEGENERATE:
        return THIN, f"axis {name}: the rows around this wrench lie almost in one plane or line"
    if table.weak[simplex] == LARGE:
        part = table.parts()[simplex]
        most = LARGEST[table.interpolant.dimension]
        return THIN, (
            f"axis {name}: the rows around this wrench are far apart, "
            f"{part:.0%} of the load range lies between them (at most {most:.0%})"
        )
    return COVERED, ""


def _guess(composition: Composition, fit: ComplianceFit, axis: Axis, loads: Floats) -> Spot:
    """Estimate from the axis' nearest row and the fitted compliance; r(0) if it has no rows."""
    table = composition.tables[AXES.index(axis)]
    start, from_loads, near = np.array(composition.zero), np.zeros(6), ()
    bars = np.zeros(6)
    if table is not None:
        inputs = list(axis.inputs)
        x = loads[inputs] / np.array(table.scale)
        nearest = int(table.interpolant.nearest(x[None])[0])
        start, near = table.rows.displacement[nearest], table.rows.members[nearest]
        from_loads[inputs] = table.interpolant.points[nearest] * np.array(table.scale)
        bars = table.rows.uncertainty[nearest].copy()
    step = loads - from_loads
    change = fit.matrix @ np.where(fit.known, step, 0.0)
    told = not (~fit.known & (np.abs(step) > 0)).any()
    # As far as the rows are from it, the estimate may be as wrong as the step is long.
    bars = bars + np.abs(fit.matrix) @ np.abs(step) + fit.bar
    return Spot(start + change, bars if told else None, OUTSIDE, "", near)


def _amount(load: int, loads: Floats) -> str:
    return f"{LOADS[load]} = {loads[load]:.6g} {LOAD_UNITS[load]}"


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
                where = f"all rows hold {LOADS[load]} = {low:.6g} {LOAD_UNITS[load]}"
            else:
                where = (
                    f"lies outside the rows, which span {low:.6g}..{high:.6g} {LOAD_UNITS[load]}"
                )
            joint = ": " if high - low <= slack else " "
            return f"axis {axis.name}: {_amount(load, loads)}{joint}{where}"
    count = len(table.rows.points)
    return f"axis {axis.name}: {amounts} together lie outside the hull of its {count} rows"


def _detail(axis: Axis, spot: Spot, loads: Floats, rows: Rows) -> dict[str, Any]:
    """Return one axis' part of the answer as JSON-able values."""
    used = rows.seq[sorted(set(spot.rows))].tolist() if spot.rows else []
    outputs = list(axis.outputs)
    return {
        "axis": axis.name,
        "inputs": {LOADS[load]: float(loads[load]) for load in axis.inputs},
        "outputs": {OUTPUTS[k]: float(spot.displacement[k]) for k in outputs},
        "error": None if spot.bars is None else {OUTPUTS[k]: float(spot.bars[k]) for k in outputs},
        "coverage": NAMES[spot.state],
        "reason": spot.reason,
        "rows": used,
    }
