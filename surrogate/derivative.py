"""The compliance at zero load."""

from __future__ import annotations

import numpy as np

from .build import AnyTable
from .surrogate import Surrogate
from .table.rows import Floats, without_locked


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
    found, row = np.full((6, 6), np.nan), np.full((6, 6), np.nan)
    for outputs, group in table.groups:
        own = list(outputs)
        row[own] = group.exact.tangent([0.0] * 6)[own]
        found[own] = _slopes_at_zero(group)[own]
    known = np.isfinite(row)
    if known.any():
        return np.where(known, row, found), "row"
    return found, table.default if np.isfinite(found).any() else "none"


def _slopes_at_zero(group: Surrogate) -> Floats:
    """Return du/dw (6, 6), SI, of a group's default method; NaN by loads that no row tells."""
    if not len(group.used):
        return np.full((6, 6), np.nan)
    zero, name = np.zeros((1, 6)), group.default
    if name == "linear":
        found = group.fit.matrix[None]
    elif group.by_kriging and group.kriging is not None:
        found = group.kriging.derivatives(zero)
    else:
        found = group.composition.derivatives(zero, "tangent" if name == "kriging" else name)
    found = without_locked(found, group.locked)[0]
    unknown = ~group.fit.known
    unknown[list(group.locked)] = False  # no output depends on them: zero
    return np.where(unknown, np.nan, found)
