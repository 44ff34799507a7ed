"""The derivative of an answer: the interpolant's, or the tangent of the row that answers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike

from .build import AnyTable
from .missing_outputs import MissingOutputs
from .table.rows import Floats, Tolerance


def derivative_at(
    surrogate: AnyTable, wrench: Sequence[float], method: str | None, *, by_row: bool
) -> Floats:
    """Return du/dw (6, 6), m/N, m/(N·m), rad/N, rad/(N·m), of the answer to a wrench (6,).

    Parameters
    ----------
    method : str or None
        What was asked for.
    by_row : bool
        Whether a row, at the wrench or beside it, answered: that tells its own tangent, NaN if it
        has none.
    """
    if by_row:
        return surrogate.row_tangent(wrench).copy()
    return surrogate.derivatives(np.array((wrench,), dtype=float), method)[0]


def derivatives_at(
    surrogate: AnyTable,
    wrenches: ArrayLike,
    tolerance: Tolerance | None = None,
    method: str | None = None,
) -> Floats:
    """Return du/dw (n, 6, 6), m/N, m/(N·m), rad/N, rad/(N·m), of a batch's answers.

    Parameters are those of `Surrogate.batch`.

    Raises
    ------
    UnknownMethodError
        If the method is none of `METHODS`.
    """
    asked = np.asarray(wrenches, dtype=float).reshape(-1, 6)
    found = surrogate.derivatives(asked, method)
    for place, tangent in row_tangents(surrogate, asked, tolerance, method):
        found[place] = tangent
    return found


def row_tangents(
    surrogate: AnyTable, asked: Floats, tolerance: Tolerance | None, method: str | None
) -> Iterator[tuple[int, Floats]]:
    """Yield which of wrenches (n, 6), N and N·m, rows answer, and their tangents (6, 6), SI."""
    for place in np.flatnonzero(surrogate.near_rows(asked)).tolist():
        wrench = asked[place].tolist()
        if surrogate.answer(wrench, tolerance, method).method == "row":
            yield place, surrogate.row_tangent(wrench)


def tangent_at_zero(table: AnyTable) -> tuple[Floats, str]:
    """Return the compliance at zero load, and what tells it.

    It is the tangent of the row at zero load, else du/dw of the table's default method there. The
    fitted compliance (`AnyTable.fit`) is another one: the mean over the load range.

    Returns
    -------
    matrix : ndarray, shape (6, 6), m/N, m/(N·m), rad/N, rad/(N·m)
        NaN where unknown: for a load that no row tells, and an output that no row holds.
    origin : str
        ``row``, a method, or ``none``.
    """
    zero = np.zeros(6)
    found = table.derivatives(zero)[0]
    groups = table.groups if isinstance(table, MissingOutputs) else ((range(6), table),)
    for outputs, part in groups:
        unknown = ~part.fit.known
        unknown[list(part.locked)] = False  # no output depends on them: zero
        found[np.ix_(list(outputs), np.flatnonzero(unknown).tolist())] = np.nan
    row = table.row_tangent(zero.tolist())
    told = np.isfinite(row)
    if told.any():
        return np.where(told, row, found), "row"
    return found, table.default if np.isfinite(found).any() else "none"
