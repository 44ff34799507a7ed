"""Rows of the ledger as tables, imports and exports take them, and rows of another setup.

A component whose files change has another fingerprint. Its earlier solves stay in the ledger; no
table has them until the files are restored, or `resolve` solves their wrenches again.
"""

from __future__ import annotations

import time
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from datetime import UTC, datetime

import numpy as np

from wrenchbook.service.contract import CONTRACT
from wrenchbook.service.formats import ParsedTable
from wrenchbook.service.formats.rows import MEASURED
from wrenchbook.service.ledger import (
    ImportRecord,
    Ledger,
    LedgerRow,
    PackedRow,
    packed,
    packed_columns,
    unpacked,
)
from wrenchbook.service.library.component import Component
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.meta import TableMeta
from wrenchbook.surrogate.table.rows import Floats, Rows, curvature_column, joined, joined_columns
from wrenchbook.surrogate.table.space import Space

CONTRACT_WORDS = " ".join(f"{word}: {meaning}." for word, meaning in CONTRACT.items())


@dataclass(frozen=True)
class ExportRows:
    """The rows of a component's present setup as table files hold them.

    Attributes
    ----------
    seq : list of int
        The ledger's number of each row.
    wrench : ndarray, shape (n, inputs), N and N·m
    displacement, uncertainty : ndarray, shape (n, outputs), m and rad
        NaN where not measured, not known.
    compliance : ndarray, shape (n, outputs, inputs), m and rad over N and N·m
        NaN where not known.
    curvature : ndarray, shape (n, p) or (n, 0), SI
        As `Rows.curvature`.
    source, note, fingerprint : list of str
    when, who : list of str
        When each came, UTC, and its sender; ``who`` is empty for a solve.
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
    space: Space, rows: Sequence[LedgerRow], spans: Sequence[tuple[int, int, ImportRecord]]
) -> ExportRows:
    """Return rows of the ledger as columns; `spans` are the imports' numbers, in order."""
    n, m = len(space.inputs), len(space.outputs)
    unknown, no_tangent = (np.nan,) * m, ((np.nan,) * n,) * m
    firsts = [first for first, _, _ in spans]
    return ExportRows(
        seq=[row.seq for row in rows],
        wrench=np.array([row.wrench for row in rows]).reshape(-1, n),
        displacement=np.array([row.displacement for row in rows]).reshape(-1, m),
        uncertainty=np.array([row.uncertainty or unknown for row in rows]).reshape(-1, m),
        compliance=np.array([row.compliance or no_tangent for row in rows]).reshape(-1, m, n),
        curvature=curvature_column([row.curvature for row in rows], space),
        source=[row.source for row in rows],
        note=[row.origin for row in rows],
        fingerprint=[row.fingerprint for row in rows],
        when=[iso_time(row.created) for row in rows],
        who=[_who(row.seq, firsts, spans) for row in rows],
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


def own_rows(component: Component, rows: Iterable[LedgerRow]) -> list[LedgerRow]:
    """Return the rows of a component's present setup and measured ones.

    Solves of another setup are never mixed in.
    """
    return [row for row in rows if row.fingerprint in ("", component.fingerprint)]


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


def packed_pieces(component: Component, pieces: Iterator[ParsedTable]) -> Iterator[list[PackedRow]]:
    """Yield the rows of a file as the ledger takes them."""
    now = time.time()
    for piece in pieces:
        columns = piece.wrench, piece.displacement, piece.uncertainty, piece.compliance
        sources = [source or MEASURED for source in piece.source]
        texts = sources, piece.fingerprint, piece.note
        yield packed_columns(component.name, columns, texts, now, piece.curvature)


def _who(seq: int, firsts: list[int], spans: Sequence[tuple[int, int, ImportRecord]]) -> str:
    at = bisect_right(firsts, seq) - 1
    return spans[at][2].who if at >= 0 and seq <= spans[at][1] else ""


def without(rows: Rows, removed: Iterable[int]) -> Rows:
    """Return rows without those of some numbers."""
    return rows.take(~np.isin(rows.seq, list(removed)))


def table_rows(component: Component, rows: Iterable[LedgerRow]) -> Rows:
    """Return rows of the ledger as those of a component's table."""
    records = (
        {
            "seq": row.seq,
            "wrench": row.wrench,
            "displacement": row.displacement,
            "compliance": row.compliance,
            "curvature": row.curvature,
            "uncertainty": row.uncertainty,
            "source": row.source,
            "fingerprint": row.fingerprint,
        }
        for row in rows
    )
    return Rows.from_records(records, component.space)


def followed(ledger: Ledger, component: Component, rows: Rows, after: int) -> tuple[Rows, int]:
    """Return a component's rows with the ledger's changes after a seq, and up to which seq."""
    fresh = [rows]  # joined at the end: a table of a million rows comes in fifty parts
    while True:
        changes = ledger.row_changes(component.name, after)
        if changes.gone:
            fresh = [without(joined(fresh), changes.gone)]
        fresh.append(table_rows(component, own_rows(component, changes.rows)))
        after = changes.last_seq
        if changes.whole:
            return joined(fresh), after


def unsolved(component: Component, others: Iterable[bytes], known: Floats) -> Floats:
    """Return the distinct wrenches of rows of other setups that no row of the table has.

    Parameters
    ----------
    others : iterable of bytes
        Packed wrenches of the rows of other setups.
    known : ndarray, shape (n, inputs), N and N·m
        The wrenches of the table's rows.

    Returns
    -------
    ndarray, shape (k, inputs), N and N·m
        In their order, loads on locked freedoms zero.
    """
    inputs = len(component.space.inputs)
    distinct = dict.fromkeys(packed(component.acting(unpacked(others, inputs))))
    has = set(packed(component.acting(known)))
    return unpacked((wrench for wrench in distinct if wrench not in has), inputs)
