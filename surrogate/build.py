"""From the rows of one version of a table to what answers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .missing_outputs import MissingOutputs
from .solver_error import SolverError, bars_are_whole
from .surrogate import Surrogate
from .table.axes import OffAxis
from .table.rows import Floats, LoadRange, Rows, Tolerance, without_locked

AnyTable = Surrogate | MissingOutputs


def build(
    rows: Rows,
    load_range: LoadRange,
    *,
    tolerance: Tolerance | None = None,
    linear: bool = False,
    off_axis: OffAxis = "correct",
    version: int = 0,
    before: AnyTable | None = None,
    solver_error: SolverError | None = None,
    locked: Sequence[int] = (),
) -> AnyTable:
    """Build what answers from valid rows of one fingerprint.

    Parameters
    ----------
    rows : Rows
        One surrogate answers if all of them hold all outputs, else one for each set of outputs
        that the same rows hold.
    tolerance : Tolerance or None, m and rad
    linear : bool
        Whether the component is linear, so that its 6x6 compliance is the whole truth.
    off_axis : {"correct", "ignore", "exclude"}
        What becomes of rows that are clean for no axis.
    before : Surrogate or MissingOutputs, optional
        Another version: axes with the same points are taken from it, to the last bit the same.
    solver_error : SolverError, optional
        What the solver of those rows may be wrong by; in no error bar of the table itself.
    locked : sequence of int
        Places, in `LOADS`, of the loads on locked freedoms: answers leave these loads out.
    """
    kind: type[Any] = MissingOutputs if rows.partial else Surrogate
    table: AnyTable = kind(
        rows,
        load_range,
        tolerance=tolerance,
        linear=linear,
        off_axis=off_axis,
        version=version,
        before=before if isinstance(before, kind) else None,
        locked=locked,
    )
    table.solver_error = None if solver_error is None else solver_error.grown(rows, load_range)
    table.bars_are_whole = bars_are_whole(rows, solver_error)
    return table


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
