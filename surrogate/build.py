"""From the rows of one version of a table to what answers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from .missing_outputs import MissingOutputs
from .solver_error import SolverError, bars_are_whole
from .surrogate import Surrogate
from .table.axes import OffAxis
from .table.rows import LoadRange, Rows, Tolerance

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
