"""Rows of the ledger in the forms of tables, imports and exports, and rows of another setup.

A component whose files change has another fingerprint. Its earlier solves stay in the ledger; no
table has them until the files are restored, or `resolve` solves their wrenches again.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from datetime import UTC, datetime

import numpy as np

from wrenchbook.service.contract import CONTRACT_TEXT
from wrenchbook.service.ledger import (
    ImportSpan,
    Ledger,
    NotedRows,
    import_numbers,
    packed,
    unpacked,
)
from wrenchbook.service.library.component import Component
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.meta import TableMeta
from wrenchbook.surrogate.table.rows import Floats, Rows, joined


class ExportRows:
    """Rows of the ledger for table files: their columns, and texts of each row.

    ``when`` is the time of each row's arrival, UTC, and ``who`` its sender, from the imports'
    numbers, `spans`, in order; empty for a solve.
    """

    def __init__(self, stored: NotedRows, spans: Sequence[ImportSpan] = ()) -> None:
        rows = stored.rows
        self.wrench = rows.wrench
        self.displacement = rows.displacement
        self.uncertainty = rows.uncertainty
        self.compliance = rows.compliance
        self.curvature = rows.curvature
        self.source = rows.source
        self.fingerprint = rows.fingerprint
        self.note = stored.note
        self.seq = rows.seq.tolist()
        self.when = [iso_time(created) for created in stored.created]
        senders = {span.record.id: span.record.who for span in spans}
        self.who = [senders.get(of, "") for of in import_numbers(spans, rows.seq).tolist()]


def iso_time(seconds: float, timespec: str = "seconds") -> str:
    """Return a time since the epoch as ISO 8601, UTC."""
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec=timespec)


def table_meta(component: Component, version: int, error: SolverError | None = None) -> TableMeta:
    """Return the metadata of an HDF5 export: contract, range, and the solver's error."""
    return TableMeta(
        component=component.name,
        last_seq=version,
        load_range=component.load_range,
        fingerprint=component.fingerprint,
        title=component.title,
        tolerance=component.tolerance,
        linear=component.linear,
        solver_error=error and error.values,
        locked=component.idle,
        contract=CONTRACT_TEXT,
    )


def with_changes(ledger: Ledger, component: Component, rows: Rows, after: int) -> tuple[Rows, int]:
    """Return a component's rows with the ledger's changes after a seq, and the last seq."""
    fresh = [rows]  # joined at the end: a table of a million rows comes in fifty parts
    setup = {"space": component.space, "fingerprint": component.fingerprint}
    while True:
        changes = ledger.row_changes(component.name, after, **setup)
        if changes.edited:
            earlier = joined(fresh)
            fresh = [earlier.take(~np.isin(earlier.seq, list(changes.edited)))]
        fresh.append(changes.rows)
        after = changes.last_seq
        if changes.complete:
            return joined(fresh), after


def unsolved(component: Component, others: Iterable[bytes], known: Floats) -> Floats:
    """Return the distinct wrenches of rows of other setups that no row of the table has.

    `others` are packed wrenches of the rows of other setups, `known` (n, inputs), N and N·m, those
    of the table's rows. The result is in the order of `others`, with zero loads on locked freedoms.
    """
    inputs = len(component.space.inputs)
    distinct = dict.fromkeys(packed(component.acting(unpacked(others, inputs))))
    has = set(packed(component.acting(known)))
    return unpacked((wrench for wrench in distinct if wrench not in has), inputs)
