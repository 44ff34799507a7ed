"""Rows of the ledger as tables, imports and exports take them, and rows of another setup.

A component whose files change has another fingerprint. Its earlier solves stay in the ledger; no
table has them until the files are restored, or `resolve` solves their wrenches again.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from datetime import UTC, datetime

import numpy as np

from wrenchbook.service.contract import CONTRACT
from wrenchbook.service.ledger import ImportRecord, Ledger, NotedRows, packed, unpacked
from wrenchbook.service.library.component import Component
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.meta import TableMeta
from wrenchbook.surrogate.table.rows import Floats, Rows, joined, joined_columns

CONTRACT_WORDS = " ".join(f"{word}: {meaning}." for word, meaning in CONTRACT.items())


@dataclass(frozen=True)
class ExportRows:
    """The rows of a component's present setup as table files hold them.

    Arrays as of `Rows`, NaN where not measured or not known; ``when`` each came, UTC, and ``who``
    sent it, empty for a solve.
    """

    seq: list[int]
    wrench: np.ndarray
    displacement: np.ndarray
    uncertainty: np.ndarray
    compliance: np.ndarray
    curvature: np.ndarray
    source: list[str]
    note: list[str]
    fingerprint: list[str]
    when: list[str]
    who: list[str]


def export_rows(
    stored: NotedRows, spans: Sequence[tuple[int, int, ImportRecord]] = ()
) -> ExportRows:
    """Return rows of the ledger as columns; `spans` are the imports' numbers, in order."""
    rows, firsts = stored.rows, [first for first, _, _ in spans]

    def sender(seq: int) -> str:
        at = bisect_right(firsts, seq) - 1
        return spans[at][2].who if at >= 0 and seq <= spans[at][1] else ""

    return ExportRows(
        seq=rows.seq.tolist(),
        wrench=rows.wrench,
        displacement=rows.displacement,
        uncertainty=rows.uncertainty,
        compliance=rows.compliance,
        curvature=rows.curvature,
        source=rows.source.tolist(),
        note=list(stored.note),
        fingerprint=rows.fingerprint.tolist(),
        when=[iso_time(created) for created in stored.created],
        who=[sender(seq) for seq in rows.seq.tolist()],
    )


def joined_rows(pieces: Sequence[ExportRows]) -> ExportRows:
    """Return the rows of pieces as one."""
    columns = {}
    for column in (field.name for field in fields(ExportRows)):
        parts = [getattr(piece, column) for piece in pieces]
        if isinstance(parts[0], np.ndarray):
            columns[column] = joined_columns(parts)
        else:
            columns[column] = [value for part in parts for value in part]
    return ExportRows(**columns)


def iso_time(seconds: float) -> str:
    """Return a time since the epoch as ISO 8601, UTC."""
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="seconds")


def table_meta(component: Component, version: int, error: SolverError | None = None) -> TableMeta:
    """Return the metadata of an HDF5 export: contract, range, and the solver's own error."""
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
        contract=CONTRACT_WORDS,
    )


def followed(ledger: Ledger, component: Component, rows: Rows, after: int) -> tuple[Rows, int]:
    """Return a component's rows with the ledger's changes after a seq, and up to which seq."""
    fresh = [rows]  # joined at the end: a table of a million rows comes in fifty parts
    setup = {"space": component.space, "fingerprint": component.fingerprint}
    while True:
        changes = ledger.row_changes(component.name, after, **setup)
        if changes.gone:
            kept = joined(fresh)
            fresh = [kept.take(~np.isin(kept.seq, list(changes.gone)))]
        fresh.append(changes.rows)
        after = changes.last_seq
        if changes.whole:
            return joined(fresh), after


def unsolved(component: Component, others: Iterable[bytes], known: Floats) -> Floats:
    """Return the distinct wrenches of rows of other setups that no row of the table has.

    `others` are packed wrenches of the rows of other setups, `known` (n, inputs), N and N·m, those
    of the table's rows. In the order of `others`, loads on locked freedoms zero.
    """
    inputs = len(component.space.inputs)
    distinct = dict.fromkeys(packed(component.acting(unpacked(others, inputs))))
    has = set(packed(component.acting(known)))
    return unpacked((wrench for wrench in distinct if wrench not in has), inputs)
