"""Imports of large tables: many short transactions, shown by one.

The rows are hidden until the last of them is in, so that jobs and other rows are accepted
meanwhile. Rows that a killed process has left hidden are deleted.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from wrenchbook.service.files.lock import take
from wrenchbook.service.ledger import rows
from wrenchbook.service.ledger.connection import Connection, sequences
from wrenchbook.service.ledger.packing import row_records
from wrenchbook.service.ledger.records import (
    ImportRunningError,
    NotedRows,
    UnknownImportError,
)

if TYPE_CHECKING:
    from wrenchbook.service.ledger.ledger import Ledger

HOLD_SECONDS = 0.03
"""Target of one transaction of an import, and so how long others wait for the ledger."""

_MIN, _MAX = 100, 4000  # rows of one transaction
_FIRST = 500
_PATIENCE_SECONDS = 120.0  # that an import waits for another one
_COLUMNS = "component, created, who, filename, format, digest, note, rig, rows"
_QUALIFIED = f"imports.id, {', '.join(f'imports.{name}' for name in _COLUMNS.split(', '))}"
_ENDED = "NOT EXISTS (SELECT 1 FROM import_parts WHERE import = imports.id AND hidden = 1)"
_ROWS = "FROM import_parts JOIN rows ON rows.seq BETWEEN first AND last WHERE import = ?"
_IS_WITHDRAWN = (
    "coalesce((SELECT withdrawn FROM edits WHERE row = rows.seq"
    " ORDER BY edits.seq DESC LIMIT 1), 0)"
)
_PARTS = "FROM import_parts JOIN imports ON imports.id = import WHERE"


@dataclass(frozen=True)
class About:
    """The origin of an import's rows, in the words of its sender."""

    who: str = ""  # the key, or the user
    filename: str = ""
    format: str = ""
    digest: str = ""  # SHA-256 of the file, hexadecimal
    note: str = ""
    rig: str = ""  # TOML of the rig whose readings the file has; empty if of the interface
    findings: str = "[]"  # JSON: objects with the hexadecimal `keys` of their rows, none if all


@dataclass(frozen=True)
class ImportRecord:
    """One import: what it was, when (seconds since the epoch), and how many rows it brought."""

    id: int
    component: str
    created: float
    who: str
    filename: str
    format: str
    digest: str
    note: str
    rig: str
    rows: int


def import_rows(
    ledger: Ledger, component: str, blocks: Iterable[NotedRows], about: About
) -> tuple[int, int, int | None]:
    """Insert the rows of a file, all or none.

    Each transaction takes some 30 ms. If the process is killed in between, no row is seen, and the
    next import or start deletes them. Returns how many rows were new and how many known, and the
    number of the import, None if nothing was new. Raises ImportRunningError if another import has
    been running for too long; nothing is loaded then.
    """
    deadline = time.monotonic() + _PATIENCE_SECONDS
    while (lock := _take_lock(ledger)) is None:  # one import of this ledger, of all processes
        if time.monotonic() > deadline:
            raise ImportRunningError(
                "another large table is being imported; nothing was loaded, send it again"
            )
    number: int | None = None
    new = count = 0
    try:
        _drop_hidden(ledger)  # of a killed process
        try:
            for block in _sized(ledger, component, blocks):
                with ledger.writing(durable=False) as db:
                    number = number or _begin(db, component, about)
                    new += _add_hidden(db, number, component, block)
                count += len(block)
            if number is None:
                return 0, 0, None
            with ledger.writing() as db:
                db.execute("UPDATE imports SET rows = ? WHERE id = ?", (new, number))
                db.execute("UPDATE import_parts SET hidden = 0 WHERE import = ?", (number,))
                if not new:
                    db.execute("DELETE FROM imports WHERE id = ?", (number,))
                db.rows += new
        except BaseException:
            _drop_hidden(ledger)
            raise
    finally:
        os.close(lock)
    return new, count - new, number if new else None


def drop_abandoned(ledger: Ledger) -> None:
    """Delete the hidden rows of imports whose process is gone; nothing while one runs."""
    with ledger.reading() as db:
        if rows.first_hidden(db, None) is None:
            return
    descriptor = _take_lock(ledger)
    if descriptor is not None:
        try:
            _drop_hidden(ledger)
        finally:
            os.close(descriptor)


def stored_numbers(db: Connection, component: str, inputs: int, outputs: int) -> np.ndarray:
    """Return wrench, displacement and uncertainty of all rows, (n, inputs + 2 outputs), SI."""
    unknown = np.full(outputs, np.nan).tobytes()
    select = (
        "SELECT wrench, displacement, uncertainty FROM rows WHERE component = ?"
        " AND length(wrench) = ? AND length(displacement) = ?"
    )
    content = b"".join(
        wrench + displacement + (uncertainty or unknown)
        for wrench, displacement, uncertainty in db.execute(
            select, (component, 8 * inputs, 8 * outputs)
        )
    )
    return np.frombuffer(content, dtype="<f8").reshape(-1, inputs + 2 * outputs)


def imports(db: Connection, component: str, most: int = 1000) -> list[ImportRecord]:
    """Return the imports of a component that have ended, newest first."""
    select = (
        f"SELECT id, {_COLUMNS} FROM imports WHERE component = ? AND {_ENDED}"
        " ORDER BY id DESC LIMIT ?"
    )
    return [ImportRecord(*record) for record in db.execute(select, (component, most))]


def import_of(db: Connection, seq: int) -> ImportRecord | None:
    """Return the import that brought a row; None if it was solved."""
    where = "first <= ? AND last >= ? ORDER BY first DESC LIMIT 1"
    record = db.execute(f"SELECT {_QUALIFIED} {_PARTS} {where}", (seq, seq)).fetchone()
    return ImportRecord(*record) if record else None


def import_spans(db: Connection, component: str) -> list[tuple[int, int, ImportRecord]]:
    """Return which rows each import of a component brought: first, last, and the import."""
    where = "import_parts.component = ? AND hidden = 0 ORDER BY first"
    records = db.execute(f"SELECT first, last, {_QUALIFIED} {_PARTS} {where}", (component,))
    return [(first, last, ImportRecord(*record)) for first, last, *record in records]


def findings(db: Connection, component: str) -> list[dict[str, Any]]:
    """Return the findings of a component's imports that have rows in the table, newest first.

    Each is as it was stored, without ``keys``; with ``import`` and ``filename``, and of the
    rows that are not withdrawn ``rows``, their numbers (empty if all of the import are meant),
    and ``count``.
    """
    select = (
        f"SELECT id, filename, findings FROM imports WHERE component = ? AND {_ENDED}"
        " AND findings <> '[]' ORDER BY id DESC"
    )
    live = []
    for number, filename, text in db.execute(select, (component,)).fetchall():
        for finding in _stored(text):
            keys = finding.pop("keys")
            most = len(keys) or 1
            seqs = _chosen(db, component, number, keys, withdrawn=False, most=most)
            if seqs:
                seqs = seqs if keys else []
                details = {"import": number, "filename": filename, "rows": seqs}
                live.append({**finding, **details, "count": len(seqs)})
    return live


def edit_import(
    db: Connection, component: str, number: int, cause: str | None = None, *, withdrawn: bool
) -> int:
    """Withdraw or restore the rows of an import, or those that its findings of a cause name.

    Returns how many rows changed: those that are as requested already do not count. Raises
    UnknownImportError if the component has no such import, or the import no such finding.
    """
    select = f"SELECT findings FROM imports WHERE id = ? AND component = ? AND {_ENDED}"
    record = db.execute(select, (number, component)).fetchone()
    if record is None:
        listed = "SELECT id FROM imports WHERE component = ? ORDER BY id DESC LIMIT 10"
        last = ", ".join(str(known) for (known,) in db.execute(listed, (component,)))
        raise UnknownImportError(
            f"{component!r} has no import {number}; its last are {last or 'none yet'}"
        )
    lists = [finding["keys"] for finding in _stored(record[0]) if finding.get("cause") == cause]
    if cause is not None and not lists:
        raise UnknownImportError(f"import {number} of {component!r} has no finding {cause!r}")
    keys = [key for some in lists for key in some] if all(lists) else []
    seqs = _chosen(db, component, number, keys, withdrawn=not withdrawn)
    rows.edit(db, component, seqs, withdrawn=withdrawn, now=time.time())
    return len(seqs)


def _take_lock(ledger: Ledger) -> int | None:
    with ledger.named_errors(OSError):
        return take(Path(f"{ledger.path}-importing"))


def _sized(
    ledger: Ledger, component: str, blocks: Iterable[NotedRows]
) -> Iterator[list[tuple[Any, ...]]]:
    """Pack blocks, and cut them such that a transaction takes `HOLD_SECONDS`."""
    size, now = _FIRST, time.time()
    for block in blocks:
        records, start = row_records(component, block, now), 0
        while start < len(records):
            some = records[start : start + size]
            start += size
            began = time.monotonic()
            yield some
            took = max(time.monotonic() - began, 1e-6)
            ledger.sync()  # else the next durable commit waits until all is synced
            size = round(min(max(size * min(HOLD_SECONDS / took, 2.0), _MIN), _MAX))


def _begin(db: Connection, component: str, about: About) -> int:
    *texts, findings_text = astuple(about)
    insert = f"INSERT INTO imports ({_COLUMNS}, findings) VALUES (?, ?, ?, ?, ?, ?, ?, ?, 0, ?)"
    number = db.execute(insert, (component, time.time(), *texts, findings_text)).lastrowid
    assert number is not None
    return number


def _stored(text: str) -> list[dict[str, Any]]:
    """Return the findings of an import; none if their text is damaged."""
    try:
        return [{"keys": [], **finding} for finding in json.loads(text)]
    except (ValueError, TypeError):
        return []


def _chosen(
    db: Connection,
    component: str,
    number: int,
    keys: Sequence[str],
    *,
    withdrawn: bool,
    most: int = -1,
) -> list[int]:
    """Return the rows with some keys, in their order, or all of an import, that are withdrawn."""
    state = f"AND {_IS_WITHDRAWN} = {int(withdrawn)}"
    if not keys:
        select = f"SELECT rows.seq {_ROWS} {state} LIMIT ?"
        return [seq for (seq,) in db.execute(select, (number, most))]
    seqs: dict[bytes, int] = {}
    wanted = dict.fromkeys(map(bytes.fromhex, keys))
    for marks, part in rows.in_parts(wanted):
        select = f"SELECT key, seq FROM rows WHERE key IN ({marks}) AND component = ? {state}"
        seqs |= dict(db.execute(select, (*part, component)).fetchall())
    return [seqs[key] for key in wanted if key in seqs]


def _add_hidden(db: Connection, number: int, component: str, records: Sequence[Any]) -> int:
    """Insert hidden rows of an import; return how many were new."""
    before = sequences(db).get("rows", 0)
    inserted = db.executemany(rows.INSERT, records).rowcount if records else 0
    last = sequences(db).get("rows", 0)
    if inserted:
        grown = db.execute(
            "UPDATE import_parts SET last = ? WHERE import = ? AND last = ? AND hidden = 1",
            (last, number, before),
        )
        if not grown.rowcount:
            part = (before + 1, last, number, component)
            db.execute("INSERT INTO import_parts VALUES (?, ?, ?, ?, 1)", part)
    return inserted


def _drop_hidden(ledger: Ledger) -> None:
    """Delete hidden rows, the last first, and imports without rows; numbers are not used again."""
    while True:
        with ledger.writing(durable=False) as db:
            part = db.execute(
                "SELECT first, last FROM import_parts WHERE hidden = 1 ORDER BY first DESC LIMIT 1"
            ).fetchone()
            if part is None:
                db.execute(
                    "DELETE FROM imports WHERE rows = 0"
                    " AND id NOT IN (SELECT import FROM import_parts)"
                )
                return
            first, last = part
            start = max(first, last - _MAX + 1)
            db.execute("DELETE FROM rows WHERE seq BETWEEN ? AND ?", (start, last))
            if start == first:
                db.execute("DELETE FROM import_parts WHERE first = ?", (first,))
            else:
                db.execute("UPDATE import_parts SET last = ? WHERE first = ?", (start - 1, first))
