"""Imports of large tables: many short transactions, shown by one.

The rows are hidden until the last of them is in, so that jobs and other rows are accepted
meanwhile. Rows that a killed process has left hidden are deleted.
"""

import json
import os
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wrenchbook.service.files.lock import take
from wrenchbook.service.ledger import rows
from wrenchbook.service.ledger.connection import Connection, sequences
from wrenchbook.service.ledger.connections import Database
from wrenchbook.service.ledger.packing import PackedRow
from wrenchbook.service.ledger.records import Change, ImportRunningError, UnknownImportError

HOLD_SECONDS = 0.03
"""Target of one transaction of an import, and so how long others wait for the ledger."""

_FEWEST, _MOST = 100, 4000  # rows of one transaction
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
    """The origin of an import's rows, in the words of its sender.

    Attributes
    ----------
    who : str
        The key, or the user, that sent them.
    filename, format, note : str
    digest : str
        SHA-256 of the file, hexadecimal.
    rig : str
        The TOML of the rig whose readings the file has; empty if they are the interface's.
    findings : str
        JSON: a list of findings, each an object with the ``keys`` of its rows, hexadecimal, worst
        first; none if all rows are meant.
    """

    who: str = ""
    filename: str = ""
    format: str = ""
    digest: str = ""
    note: str = ""
    rig: str = ""
    findings: str = "[]"


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


class ImportTable(Database):
    """The imports of the ledger."""

    def import_rows(
        self, component: str, blocks: Iterable[Sequence[PackedRow]], about: About
    ) -> tuple[int, int, int | None]:
        """Insert the packed rows of a file, all or none.

        Each transaction takes some 30 ms. If the process is killed in between, no row is seen,
        and the next import or start deletes them.

        Returns
        -------
        tuple of (int, int, int or None)
            New rows, known ones, and the number of the import; None if nothing was new.

        Raises
        ------
        ImportRunningError
            If another import has been running for too long.
        LedgerUnavailableError
            If they could not be written; none is in the table then.
        """
        with self._importing():
            number: int | None = None
            new = count = 0
            try:
                for block in self._sized(blocks):
                    with self.writing(durable=False) as db:
                        number = number or _begin(db, component, about)
                        new += _add_hidden(db, number, component, block)
                    count += len(block)
                if number is None:
                    return 0, 0, None
                with self.writing() as db:
                    db.execute("UPDATE imports SET rows = ? WHERE id = ?", (new, number))
                    db.execute("UPDATE import_parts SET hidden = 0 WHERE import = ?", (number,))
                    if not new:
                        db.execute("DELETE FROM imports WHERE id = ?", (number,))
            except BaseException:
                self._drop_hidden()
                raise
        if new:
            self.notify(Change(component, rows=new))
        return new, count - new, number if new else None

    def imports(self, component: str, most: int = 1000) -> list[ImportRecord]:
        """Return the imports of a component that have ended, newest first."""
        select = (
            f"SELECT id, {_COLUMNS} FROM imports WHERE component = ? AND {_ENDED}"
            " ORDER BY id DESC LIMIT ?"
        )
        with self.reading() as db:
            return [ImportRecord(*record) for record in db.execute(select, (component, most))]

    def import_of(self, seq: int) -> ImportRecord | None:
        """Return the import that brought a row; None if it was solved."""
        where = "first <= ? AND last >= ? ORDER BY first DESC LIMIT 1"
        with self.reading() as db:
            found = db.execute(f"SELECT {_QUALIFIED} {_PARTS} {where}", (seq, seq)).fetchone()
        return ImportRecord(*found) if found else None

    def import_spans(self, component: str) -> list[tuple[int, int, ImportRecord]]:
        """Return which rows each import of a component brought: first, last, and the import."""
        where = "import_parts.component = ? AND hidden = 0 ORDER BY first"
        with self.reading() as db:
            found = db.execute(f"SELECT first, last, {_QUALIFIED} {_PARTS} {where}", (component,))
            return [(first, last, ImportRecord(*record)) for first, last, *record in found]

    def findings(self, component: str) -> list[dict[str, Any]]:
        """Return the findings of a component's imports that have rows in the table, newest first.

        Each is as it was stored, without ``keys``; with ``import`` and ``filename``, and of the
        rows that are not withdrawn ``rows``, their numbers (empty if all of the import are meant),
        and ``count``.
        """
        select = (
            f"SELECT id, filename, findings FROM imports WHERE component = ? AND {_ENDED}"
            " AND findings <> '[]' ORDER BY id DESC"
        )
        found = []
        with self.reading() as db:
            for number, filename, text in db.execute(select, (component,)).fetchall():
                for one in _stored(text):
                    keys = one.pop("keys")
                    live = _chosen(
                        db, component, number, keys, withdrawn=False, most=len(keys) or 1
                    )
                    if live:
                        about = {"import": number, "filename": filename}
                        seqs = live if keys else []
                        found.append({**one, **about, "rows": seqs, "count": len(seqs)})
        return found

    def edit_import(
        self, component: str, number: int, cause: str | None = None, *, withdrawn: bool
    ) -> int:
        """Withdraw or restore the rows of an import, or those that its findings of a cause name.

        Returns how many rows changed: those that are as requested already do not count.

        Raises
        ------
        UnknownImportError
            If the component has no such import, or the import no such finding.
        """
        select = f"SELECT findings FROM imports WHERE id = ? AND component = ? AND {_ENDED}"
        with self.writing() as db:
            found = db.execute(select, (number, component)).fetchone()
            if found is None:
                listed = "SELECT id FROM imports WHERE component = ? ORDER BY id DESC LIMIT 10"
                last = ", ".join(str(one) for (one,) in db.execute(listed, (component,)))
                raise UnknownImportError(
                    f"{component!r} has no import {number}; its last are {last or 'none yet'}"
                )
            lists = [one["keys"] for one in _stored(found[0]) if one.get("cause") == cause]
            if cause is not None and not lists:
                raise UnknownImportError(
                    f"import {number} of {component!r} has no finding {cause!r}"
                )
            keys = [key for one in lists for key in one] if all(lists) else []
            seqs = _chosen(db, component, number, keys, withdrawn=not withdrawn)
            rows.edit_many(db, component, seqs, withdrawn=withdrawn, now=time.time())
        if seqs:
            self.notify(Change(component, rows=len(seqs)))
        return len(seqs)

    def drop_abandoned(self) -> None:
        """Delete the hidden rows of imports whose process is gone; nothing while one runs."""
        with self.reading() as db:
            if rows.first_hidden(db, None) is None:
                return
        descriptor = self._take_lock()
        if descriptor is not None:
            try:
                self._drop_hidden()
            finally:
                os.close(descriptor)

    @contextmanager
    def _importing(self) -> Iterator[None]:
        """Be the only import of this ledger, of all processes."""
        deadline = time.monotonic() + _PATIENCE_SECONDS
        while (descriptor := self._take_lock()) is None:
            if time.monotonic() > deadline:
                raise ImportRunningError(
                    "another large table is being imported; nothing was loaded, send it again"
                )
        try:
            self._drop_hidden()  # of a killed process
            yield
        finally:
            os.close(descriptor)

    def _take_lock(self) -> int | None:
        with self.named_errors(OSError):
            return take(Path(f"{self.path}-importing"))

    def _drop_hidden(self) -> None:
        more = True
        while more:
            with self.writing(durable=False) as db:
                more = _drop_some(db)

    def _sized(self, blocks: Iterable[Sequence[PackedRow]]) -> Iterator[list[PackedRow]]:
        """Cut blocks such that a transaction takes `HOLD_SECONDS`."""
        size = _FIRST
        for block in blocks:
            start = 0
            while start < len(block):
                some = list(block[start : start + size])
                start += size
                began = time.monotonic()
                yield some
                took = max(time.monotonic() - began, 1e-6)
                self.settle()  # else the next durable commit waits until all is synced
                size = round(min(max(size * min(HOLD_SECONDS / took, 2.0), _FEWEST), _MOST))


def _begin(db: Connection, component: str, about: About) -> int:
    values = (component, time.time())
    values += (about.who, about.filename, about.format, about.digest, about.note, about.rig)
    insert = f"INSERT INTO imports ({_COLUMNS}, findings) VALUES (?, ?, ?, ?, ?, ?, ?, ?, 0, ?)"
    values += (about.findings,)
    number = db.execute(insert, values).lastrowid
    assert number is not None
    return number


def _stored(text: str) -> list[dict[str, Any]]:
    """Return the findings of an import; none if their text is damaged."""
    try:
        return [{"keys": [], **one} for one in json.loads(text)]
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
    found: dict[bytes, int] = {}
    wanted = dict.fromkeys(map(bytes.fromhex, keys))
    for marks, part in rows.in_parts(wanted):
        select = f"SELECT key, seq FROM rows WHERE key IN ({marks}) AND component = ? {state}"
        found |= dict(db.execute(select, (*part, component)).fetchall())
    return [found[key] for key in wanted if key in found]


def _add_hidden(db: Connection, number: int, component: str, block: list[PackedRow]) -> int:
    """Insert hidden rows of an import; return how many were new."""
    before = sequences(db).get("rows", 0)
    inserted = db.executemany(rows.INSERT, block).rowcount if block else 0
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


def _drop_some(db: Connection) -> bool:
    """Delete at most `_MOST` hidden rows, the last first; return whether there are more.

    Their numbers are not used again.
    """
    part = db.execute(
        "SELECT first, last FROM import_parts WHERE hidden = 1 ORDER BY first DESC LIMIT 1"
    ).fetchone()
    if part is None:
        db.execute(
            "DELETE FROM imports WHERE rows = 0 AND id NOT IN (SELECT import FROM import_parts)"
        )
        return False
    first, last = part
    start = max(first, last - _MOST + 1)
    db.execute("DELETE FROM rows WHERE seq BETWEEN ? AND ?", (start, last))
    if start == first:
        db.execute("DELETE FROM import_parts WHERE first = ?", (first,))
    else:
        db.execute("UPDATE import_parts SET last = ? WHERE first = ?", (start - 1, first))
    return True
