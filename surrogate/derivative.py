"""The compliance at zero load."""

from __future__ import annotations

import numpy as np

from .build import AnyTable
from .kernel.packing import packed_of
from .table.rows import Floats


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
    found, row = packed_of(table).derivatives(zero[None])[0], np.full((6, 6), np.nan)
    for outputs, part in table.groups:
        row[list(outputs)] = part.exact.tangent(zero.tolist())[list(outputs)]
        unknown = ~part.fit.known
        unknown[list(part.locked)] = False  # no output depends on them: zero
        found[np.ix_(list(outputs), np.flatnonzero(unknown).tolist())] = np.nan
    told = np.isfinite(row)
    if told.any():
        return np.where(told, row, found), "row"
    return found, table.default if np.isfinite(found).any() else "none"
