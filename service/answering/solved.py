"""What the row of a solve says of the wrench that was asked."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from service.ledger import LedgerRow

Floats = NDArray[np.float64]


def read_row(row: LedgerRow, wrench: Floats, scale: Floats) -> tuple[Floats, Floats]:
    """Return the displacement and the error bar of a row for the wrench it was rounded from.

    The row's tangent leads from its wrench to the asked one; the bar grows by that step. A row
    without a tangent answers as it is, and the bars of translation and of rotation grow by twice
    the step of a response in proportion to the largest load: smaller loads may move more.

    Parameters
    ----------
    row : LedgerRow
    wrench : ndarray, shape (6,), N and N·m
    scale : ndarray, shape (6,), N and N·m
        Of the load range.

    Returns
    -------
    displacement, error : ndarray, shape (6,), m and rad
    """
    solved, step = np.array(row.displacement), wrench - row.wrench
    bar = np.array(row.uncertainty or (0.0,) * 6)
    if not step.any():
        return solved, bar
    if row.compliance is not None:
        moved = np.array(row.compliance) @ step
        return solved + moved, bar + np.abs(moved)
    share = 2 * np.abs(step / scale).max() / np.abs(wrench / scale).max()
    most = np.nanmax(np.abs(solved).reshape(2, 3), axis=1)
    return solved, bar + share * np.repeat(most, 3)


def state_of(row: LedgerRow) -> tuple[Floats | None, Floats | None]:
    """Return a row's displacement (6,), m and rad, and tangent (6, 6), SI; None without one."""
    if row.compliance is None:
        return None, None
    return np.array(row.displacement, dtype=float), np.array(row.compliance, dtype=float)
