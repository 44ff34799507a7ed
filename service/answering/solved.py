"""Answer of the row that a solve has just given, before the table holds it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from service.ledger import LedgerRow
from service.tables.news import table_rows
from service.tables.served import ServedTable
from surrogate.exact_rows import beside

Floats = NDArray[np.float64]


def read_row(row: LedgerRow, wrench: Floats, table: ServedTable) -> tuple[Floats, Floats]:
    """Return the displacement and the error bar of a row for the wrench it was rounded from.

    They are those that the table answers with once it holds the row (`surrogate.exact_rows`).

    Parameters
    ----------
    row : LedgerRow
    wrench : ndarray, shape (6,), N and N·m
    table : ServedTable
        The component's newest.

    Returns
    -------
    displacement, error : ndarray, shape (6,), m and rad
        An error is NaN where nothing tells how far the row's wrench is from this one.
    """
    rows, scale = table_rows((row,)), table.load_range.scale
    found = beside(rows, 0, rows.wrench[0], wrench, scale, table.steepest)
    return found.displacement, found.error


def state_of(row: LedgerRow) -> tuple[Floats | None, Floats | None]:
    """Return a row's displacement (6,), m and rad, and tangent (6, 6), SI; None without one."""
    if row.compliance is None:
        return None, None
    return np.array(row.displacement, dtype=float), np.array(row.compliance, dtype=float)
