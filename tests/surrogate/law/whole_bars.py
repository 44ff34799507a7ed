"""Bars with the solver's own share in them, as every answer that is told has them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tests.surrogate.law.answer import Answer, Batch
from wrenchbook.surrogate.table.rows import ROUNDING, Floats, Tolerance, acting, acting_wrench

from .derivative import derivative_at, row_tangents
from .solver_share import parts, widened, widened_many


def whole_bar(
    table: Any, wrench: Sequence[float], answer: Answer, method: str | None
) -> tuple[float, ...] | None:
    """Return the whole bars (6,), m and rad, of a table's answer to a wrench (6,), N and N·m.

    Parameters
    ----------
    method : str or None
        What was asked for.
    """
    error, bars = table.solver_error, answer.error
    wrench = acting_wrench(wrench, table.locked)
    if error is not None:
        bars = widened(error, bars, wrench, *_state(table, wrench, answer, method))
    if bars is not None:
        both = zip(bars, table.rig_error.tolist(), strict=True)
        bars = tuple(None if bar is None else bar + rig for bar, rig in both)
    if bars is None or table.bars_are_complete:
        return bars
    unknown = solved(table, wrench, None, method)
    found = tuple(None if own else bar for bar, own in zip(bars, unknown, strict=True))
    return None if all(bar is None for bar in found) else found  # pyright: ignore[reportReturnType]


def solved(
    table: Any, wrench: Sequence[float], tolerance: Tolerance | None, method: str | None
) -> list[bool]:
    """Return which outputs of an answer are those of a row or an exact fit, without interpolation.

    Where the solver's own error is not known, their error is not either.
    """
    found = [False] * 6
    for outputs, part in table.parts:
        told = part.estimate(wrench, tolerance, method).method
        bars = np.full(6, np.nan)
        if told == "row":
            place = int(
                part.by_row.index.indices(np.array([acting_wrench(wrench, table.locked)]))[0]
            )
            bars = part.row_uncertainty[part.merged.owner[place]]
        elif told == "linear" and table.linear and part.fit.complete:
            most = np.abs(part.fit.matrix) @ table.load_range.scale
            bars = np.where(part.fit.error <= ROUNDING * most, 0.0, part.fit.error)
        for output in outputs:
            found[output] = bool(bars[output] == 0.0)
    return found


def solver_parts(
    table: Any, wrench: Sequence[float], answer: Answer, method: str | None
) -> dict[str, list[float] | None]:
    """Return what `SolverError.parts` does of a table's answer; empty where nothing is known."""
    error = table.solver_error
    if error is None:
        return {}
    wrench = acting_wrench(wrench, table.locked)
    return parts(error, wrench, *_state(table, wrench, answer, method))


def whole_bars(
    table: Any,
    wrenches: Floats,
    found: Batch,
    tolerance: Tolerance | None = None,
    method: str | None = None,
) -> Floats:
    """Return the whole bars (n, 6), m and rad, of a batch's answers to wrenches (n, 6), SI.

    They are those of `whole_bar` to the last digit.
    """
    bars = _widened(table, wrenches, found, tolerance, method)
    if not table.bars_are_complete:
        bars = bars.copy()
        for place, wrench in enumerate(np.asarray(wrenches).tolist()):
            bars[place, solved(table, wrench, tolerance, method)] = np.nan
    return bars


def _widened(
    table: Any, wrenches: Floats, found: Batch, tolerance: Tolerance | None, method: str | None
) -> Floats:
    error = table.solver_error
    if error is None:
        return found.error + table.rig_error
    tangents, wrenches = None, acting(wrenches, table.locked)
    if error.stiffness is not None:
        tangents = table.derivatives(wrenches, method)
        for place, tangent in row_tangents(table, wrenches, tolerance, method):
            if np.isfinite(tangent).any():
                tangents[place] = tangent
    wide = widened_many(error, found.error, wrenches, found.displacement, tangents)
    return wide + table.rig_error


def _state(
    table: Any, wrench: Sequence[float], answer: Answer, method: str | None
) -> tuple[Floats | None, Floats | None]:
    """Return the displacement (6,) and the tangent (6, 6) that the mesh's share needs, or None.

    A row without a tangent has that of the method.
    """
    error = table.solver_error
    assert error is not None
    if error.stiffness is None or answer.displacement is None:
        return None, None
    moved = np.array(answer.displacement, dtype=float)
    tangent = derivative_at(table, wrench, method, by_row=answer.method == "row")
    if not np.isfinite(tangent).any():
        tangent = derivative_at(table, wrench, method, by_row=False)
    return moved, tangent
