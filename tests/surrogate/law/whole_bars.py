"""Bars with the solver's own share in them, as every answer that is told has them.

The mesh's share needs the displacement and, where a part softens much, the tangent there (see
`solver_error`); only tables whose rows say so pay for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from surrogate.table.rows import Floats, Tolerance, acting, acting_one
from tests.surrogate.law.answer import Answer, Batch

from .derivative import derivative_at, derivatives_at, row_tangents


def whole_bar(
    table: Any, wrench: Sequence[float], answer: Answer, method: str | None
) -> tuple[float, ...] | None:
    """Return the whole bars (6,), m and rad, of a table's answer to a wrench (6,), N and N·m.

    Parameters
    ----------
    method : str or None
        What was asked for.
    """
    error = table.solver_error
    if error is None or answer.error is None:
        return answer.error
    wrench = acting_one(wrench, table.locked)
    return error.widened(answer.error, wrench, *_state(table, wrench, answer, method))


def solver_parts(
    table: Any, wrench: Sequence[float], answer: Answer, method: str | None
) -> dict[str, list[float] | None]:
    """Return what `SolverError.parts` does of a table's answer; empty where nothing is known."""
    error = table.solver_error
    if error is None:
        return {}
    wrench = acting_one(wrench, table.locked)
    return error.parts(wrench, *_state(table, wrench, answer, method))


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
    error = table.solver_error
    if error is None:
        return found.error
    tangents, wrenches = None, acting(wrenches, table.locked)
    if error.asks_tangent:
        tangents = derivatives_at(table, wrenches, tolerance, method)
    elif (
        error.stiffness is not None
        and (beyond := table.load_range.exceeded(wrenches).any(axis=1)).any()
    ):
        tangents = np.full((len(wrenches), 6, 6), np.nan)
        places = np.flatnonzero(beyond)
        for place, tangent in row_tangents(table, wrenches[places], tolerance, method):
            tangents[places[place]] = tangent
    return error.widened_many(found.error, wrenches, found.displacement, tangents)


def _state(
    table: Any, wrench: Sequence[float], answer: Answer, method: str | None
) -> tuple[Floats | None, Floats | None]:
    """Return the displacement (6,) and the tangent (6, 6) that the mesh's share needs, or None.

    What a row says beyond the range tells its own share: the growth of others is none of its.
    """
    error, by_row = table.solver_error, answer.method == "row"
    assert error is not None
    if error.stiffness is None or answer.displacement is None:
        return None, None
    if not (error.asks_tangent or (by_row and table.load_range.exceeded([wrench]).any())):
        return None, None
    moved = np.array(answer.displacement, dtype=float)
    return moved, derivative_at(table, wrench, method, by_row=by_row)
