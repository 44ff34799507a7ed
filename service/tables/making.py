"""From rows to the table that answers, and to its packed bytes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from wrenchbook.service.contract import CONTRACT
from wrenchbook.service.library.component import Component
from wrenchbook.service.tables.served import ServedTable
from wrenchbook.service.tables.solver_errors import SolverErrors
from wrenchbook.surrogate.build import AnyTable, build
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.packed.writer import pack
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.rows import Rows


def make(
    component: Component,
    rows: Rows,
    version: int,
    before: AnyTable | None = None,
    errors: SolverErrors | None = None,
) -> AnyTable:
    """Build the surrogate; its version is the number of the ledger's newest change in it.

    It is the same function of the rows alone, whatever was before: whoever has the same rows, a
    simulator that has downloaded them or this server after a restart, has the same digits. What
    has not changed since the version before is not made again. What `errors` knows of the solver
    stands beside it.
    """
    own = errors if component.has_fea else None
    return build(
        rows,
        component.load_range,
        tolerance=component.tolerance,
        linear=component.linear,
        version=version,
        before=before,
        solver_error=own and own.read(component.name, component.fingerprint),
        locked=component.idle,
    )


def row_table(
    component: Component, row: Rows, error: SolverError | None, near: ServedTable
) -> ServedTable:
    """Return a table of one row, which answers its wrench until the component's table holds it.

    Parameters
    ----------
    row : Rows
        Of one row.
    error : SolverError or None
        What the solver of the row may be wrong by.
    near : ServedTable
        The component's newest: a row without a tangent takes the steepest slopes of its rows.
    """
    built = build(
        row,
        component.load_range,
        tolerance=component.tolerance,
        linear=False,  # the row answers, and no compliance through it
        version=max(near.version, int(row.seq[0])),
        solver_error=error,
        locked=component.idle,
    )
    for _, group in built.groups:
        group.exact.steepest = np.fmax(group.exact.steepest, near.steepest)
    return in_memory(built, packed_bytes(built, component.name, component.fingerprint))


def packed_bytes(
    table: AnyTable, name: str, fingerprint: str, origin: Mapping[str, str] | None = None
) -> bytes:
    """Return the packed file of a component's table; `origin` is that of `packed_files`."""
    pieces = pack(table, component=name, fingerprint=fingerprint, contract=CONTRACT, origin=origin)
    return b"".join(pieces)


def in_memory(table: AnyTable, content: bytes) -> ServedTable:
    """Return a table that answers from its packed bytes, without a file."""
    return ServedTable(PackedTable.from_bytes(content), built=table)


def empty_table(component: Component, errors: SolverErrors | None = None) -> ServedTable:
    """Return the table of a component without rows."""
    table = make(component, Rows.empty(), 0, errors=errors)
    return in_memory(table, packed_bytes(table, component.name, component.fingerprint))
