"""Rows between table files and the ledger: what an import inserts, what an export holds."""

from __future__ import annotations

import time
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from datetime import UTC, datetime

import numpy as np

from wrenchbook.service.contract import CONTRACT
from wrenchbook.service.formats import ParsedTable
from wrenchbook.service.ledger import Import, LedgerRow, PackedRow, packed_columns
from wrenchbook.service.library.component import Component
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.meta import TableMeta

MEASURED = "measured"
CONTRACT_WORDS = " ".join(f"{word}: {meaning}." for word, meaning in CONTRACT.items())


@dataclass(frozen=True)
class ExportRows:
    """A component's rows_for rows as table files hold them.

    Attributes
    ----------
    seq : list of int
        The ledger's number of each row.
    wrench : ndarray, shape (n, 6), N and N·m
    displacement, uncertainty : ndarray, shape (n, 6), m and rad
        NaN where not measured, not known.
    compliance : ndarray, shape (n, 6, 6), m and rad over N and N·m
        NaN where not known.
    source, note, fingerprint : list of str
    when, who : list of str
        When each came, UTC, and who sent it; who is empty for a solve.
    """

    seq: list[int]
    wrench: np.ndarray
    displacement: np.ndarray
    uncertainty: np.ndarray
    compliance: np.ndarray
    source: list[str]
    note: list[str]
    fingerprint: list[str]
    when: list[str]
    who: list[str]


def export_rows(rows: Sequence[LedgerRow], spans: Sequence[tuple[int, int, Import]]) -> ExportRows:
    """Return rows of the ledger as columns; `spans` are the imports' numbers, in order."""
    unknown, no_tangent = (np.nan,) * 6, ((np.nan,) * 6,) * 6
    firsts = [first for first, _, _ in spans]
    return ExportRows(
        seq=[row.seq for row in rows],
        wrench=np.array([row.wrench for row in rows]).reshape(-1, 6),
        displacement=np.array([row.displacement for row in rows]).reshape(-1, 6),
        uncertainty=np.array([row.uncertainty or unknown for row in rows]).reshape(-1, 6),
        compliance=np.array([row.compliance or no_tangent for row in rows]).reshape(-1, 6, 6),
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
            columns[column] = np.concatenate(parts)
        else:
            columns[column] = [value for part in parts for value in part]
    return ExportRows(**columns)


def rows_for(rows: Sequence[LedgerRow], component: Component) -> list[LedgerRow]:
    """Return those of a component's rows that are of its present setup, or measured."""
    return [row for row in rows if row.fingerprint in ("", component.fingerprint)]


def iso_time(seconds: float) -> str:
    """Return a time since the epoch as ISO 8601, UTC."""
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="seconds")


def table_meta(component: Component, version: int, error: SolverError | None = None) -> TableMeta:
    """Return what an HDF5 export says about its rows, and what their solver may be wrong by."""
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
        yield packed_columns(component.name, columns, texts, now)


def _who(seq: int, firsts: list[int], spans: Sequence[tuple[int, int, Import]]) -> str:
    at = bisect_right(firsts, seq) - 1
    return spans[at][2].who if at >= 0 and seq <= spans[at][1] else ""
