"""The derivative of an answer: the interpolant's, or the tangent of the row that answers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from wrenchbook.surrogate.table.rows import Floats, Tolerance


def derivative_at(
    surrogate: Any, wrench: Sequence[float], method: str | None, *, by_row: bool
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
    surrogate: Any,
    wrenches: ArrayLike,
    tolerance: Tolerance | None = None,
    method: str | None = None,
) -> Floats:
    """Return du/dw (n, 6, 6), m/N, m/(N·m), rad/N, rad/(N·m), of a batch's answers.

    Parameters are those of `Law.batch`.

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
    surrogate: Any, asked: Floats, tolerance: Tolerance | None, method: str | None
) -> Iterator[tuple[int, Floats]]:
    """Yield which of wrenches (n, 6), N and N·m, rows answer, and their tangents (6, 6), SI."""
    for place in np.flatnonzero(surrogate.near_rows(asked)).tolist():
        wrench = asked[place].tolist()
        if surrogate.answer(wrench, tolerance, method).method == "row":
            yield place, surrogate.row_tangent(wrench)
