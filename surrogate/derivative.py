"""The derivative of an answer: the interpolant's, or the tangent of the row that answers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from .build import AnyTable
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
        Whether a row answered: that tells its own tangent, NaN if it has none.
    """
    asked = np.array(wrench, dtype=float)
    return _tangent(surrogate, asked) if by_row else surrogate.derivatives(asked[None], method)[0]


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
    rows = set(map(tuple, surrogate.rows.wrench.tolist()))
    for place, wrench in enumerate(map(tuple, asked.tolist())):
        if wrench in rows and surrogate.answer(wrench, tolerance, method).method == "row":
            found[place] = _tangent(surrogate, asked[place])
    return found


def _tangent(surrogate: AnyTable, wrench: Floats) -> Floats:
    """Return the tangent (6, 6) of the first row at a wrench (6,) that has one, else NaN."""
    same = (surrogate.rows.wrench == wrench).all(axis=1)
    tangents = surrogate.rows.compliance[same]
    known = tangents[np.isfinite(tangents).all(axis=(1, 2))]
    return known[0].copy() if len(known) else np.full((6, 6), np.nan)
