"""Imports of large tables: many short transactions, published by one.

The rows are hidden until the last of them is written, so that jobs and other rows are accepted
meanwhile. Hidden rows of killed processes are deleted.
"""

from __future__ import annotations

import json
import os
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from wrenchbook.service.files.lock import take
from wrenchbook.service.ledger import rows
from wrenchbook.service.ledger.audit import note
from wrenchbook.service.ledger.connection import Connection, sequences
from wrenchbook.service.ledger.packing import KEY_BYTES, key_hashes, row_keys, unpacked
from wrenchbook.service.ledger.records import (
    AppendError,
    ImportRunningError,
    NotedRows,
    UnknownImportError,
)

if TYPE_CHECKING:
    from wrenchbook.service.ledger.ledger import Ledger

# Sizes of one transaction, for which others wait: processor times in a ledger of 700,000 rows.
ROWS_AT_ONCE = 50_000  # rows: 26 ms
KEYS_AT_ONCE = 20_000  # keys: 13 to 18 ms; sorted, they share pages of the index
RECORDS_DELETED = 5  # records: 42 ms; 1,000 rows each, whose keys are on as many pages of the index
APPENDED = "append"  # the format of an import to which rows are appended
_PATIENCE_SECONDS = 120.0  # time for which an import waits for another one
_COLUMNS = "component, created, who, filename, format, digest, note, rig, rows"
_NAMES = "id", *_COLUMNS.split(", ")
# Placeholders with the names of `ImportOrigin`'s fields.
_VALUES = f":{', :'.join(_COLUMNS.split(', '))}, :findings"
_INSERT = f"INSERT INTO imports ({_COLUMNS}, findings) VALUES ({_VALUES})"
_QUALIFIED = ", ".join(f"imports.{name}" for name in _NAMES)
_ENDED = "NOT EXISTS (SELECT 1 FROM import_parts WHERE import = imports.id AND hidden = 1)"
_ROWS = "FROM import_parts JOIN rows ON rows.seq BETWEEN first AND last WHERE import = ?"
_PARTS = "FROM import_parts JOIN imports ON imports.id = import WHERE"


@dataclass(frozen=True)
class ImportOrigin:
    """The origin of an import's rows, as its sender states it."""

    who: str = ""  # the key, or the user
    filename: str = ""
    format: str = ""
    digest: str = ""  # SHA-256 of the file, hexadecimal
    note: str = ""
    rig: str = ""  # TOML of the rig of the file's readings; empty for rows of the interface
    # JSON: objects with the hexadecimal `keys` of their rows, none for all rows.
    findings: str = "[]"


@dataclass(frozen=True)
class ImportRecord:
    """One import: its origin, its time (seconds since the epoch), and the number of its rows."""

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


class ImportSpan(NamedTuple):
    """Consecutive rows of an import: the first and the last seq."""

    first: int
    last: int
    record: ImportRecord


class Loaded(NamedTuple):
    """Numbers of new and known rows; the import's number, None if it has no row."""

    new: int
    known: int
    number: int | None


def import_rows(
    ledger: Ledger, component: str, blocks: Iterable[NotedRows], origin: ImportOrigin
) -> Loaded:
    """Insert the rows of a file, all or none.

    They are first hidden, in file order and without their keys; the keys follow, sorted, so that
    each page of the index is written once. If the process is killed in between, no row is visible,
    and the next import or start deletes them.

    Raises ImportRunningError if another import has been running for too long; nothing is loaded
    then.
    """
    deadline = time.monotonic() + _PATIENCE_SECONDS
    while (lock := _take_lock(ledger)) is None:  # one import of this ledger in all processes
        if time.monotonic() > deadline:
            raise ImportRunningError(
                f"another large table is still being imported after {_PATIENCE_SECONDS:.0f} s; "
                "nothing was loaded. Send this one again in a minute"
            )
    try:
        _drop_hidden(ledger)  # the hidden rows of a killed process
        try:
            with ledger.reading() as db:
                start = sequences(db).get("rows", 0)
            number, sent, parts = _insert_hidden(ledger, component, blocks, origin)
            if number is None:
                return Loaded(0, sent, None)
            _enter_keys(ledger, parts)
            new = _publish(ledger, component, number, origin, start)
            return Loaded(new, sent - new, number if new else None)
        except BaseException:
            _drop_hidden(ledger)
            raise
    finally:
        os.close(lock)


def _insert_hidden(
    ledger: Ledger, component: str, blocks: Iterable[NotedRows], origin: ImportOrigin
) -> tuple[int | None, int, list[tuple[int, bytes]]]:
    """Insert the new rows of an import, which no table shows yet.

    Returns the import's number, None if all rows were known; the number of the file's rows; the
    first seq and the keys of rows inserted at once.
    """
    number: int | None = None
    parts: list[tuple[int, bytes]] = []
    sent = 0
    now = time.time()
    values = {"component": component, "created": now, "rows": 0, **asdict(origin)}
    import_keys: set[bytes] = set()
    for block in blocks:
        keys = row_keys(component, block)
        sent += len(keys)
        with ledger.reading() as db:
            known = rows.stored(db, keys) if rows.last_seq(db, component) else {}
        positions = rows.new_positions(keys, known.keys())
        if not import_keys.isdisjoint(keys):
            positions = [at for at in positions if keys[at] not in import_keys]
        import_keys.update(keys)
        for begin in range(0, len(positions), ROWS_AT_ONCE):
            chosen = positions[begin : begin + ROWS_AT_ONCE]
            part = rows.rows_at(block, chosen)
            part_keys = [keys[at] for at in chosen]
            with ledger.writing(durable=False) as db:
                if number is None:
                    number = db.execute(_INSERT, values).lastrowid
                first = rows.insert_numbered(db, component, part, part_keys, now)
                span = first, first + len(part_keys) - 1, number, component
                db.execute("INSERT INTO import_parts VALUES (?, ?, ?, ?, 1)", span)
            parts.append((first, b"".join(part_keys)))
            ledger.sync()  # otherwise the next durable commit waits until all is synced
    return number, sent, parts


def _enter_keys(ledger: Ledger, parts: Sequence[tuple[int, bytes]]) -> None:
    """Insert the keys of hidden rows, in the order of their hashes."""
    hashes = key_hashes(b"".join(named for _, named in parts))
    seqs = np.concatenate([first + np.arange(len(named) // KEY_BYTES) for first, named in parts])
    order = np.argsort(hashes)
    for begin in range(0, len(order), KEYS_AT_ONCE):
        chosen = order[begin : begin + KEYS_AT_ONCE]
        with ledger.writing(durable=False) as db:
            rows.insert_keys(db, zip(hashes[chosen].tolist(), seqs[chosen].tolist(), strict=True))
        ledger.sync()


def _publish(ledger: Ledger, component: str, number: int, origin: ImportOrigin, start: int) -> int:
    """Publish the rows that no other process has inserted since seq `start`; return the count."""
    with ledger.writing() as db:
        rows.yield_to_others(db, component, start)
        (new,) = db.execute(f"SELECT coalesce(sum(count), 0) {_ROWS}", (number,)).fetchone()
        db.execute("UPDATE imports SET rows = ? WHERE id = ?", (new, number))
        db.execute("UPDATE import_parts SET hidden = 0 WHERE import = ?", (number,))
        if new:
            _note(db, "import.load", number, component, new, origin)
        else:
            db.execute("DELETE FROM import_parts WHERE import = ?", (number,))
            db.execute("DELETE FROM imports WHERE id = ?", (number,))
        db.has_new_rows |= bool(new)
    return new


def append_rows(
    db: Connection, component: str, blocks: Iterable[NotedRows], origin: ImportOrigin
) -> Loaded:
    """Append rows to the import of this sender, component and file name; the first call makes it.

    A block that is sent again changes nothing.

    Raises AppendError if the import has readings of another rig, or all of its rows are withdrawn.
    """
    origin = replace(origin, format=APPENDED)
    names = "component = ? AND format = ? AND filename = ? AND who = ?"
    which = component, origin.format, origin.filename, origin.who
    select = f"SELECT id, rig, created FROM imports WHERE {names} ORDER BY id DESC LIMIT 1"
    # Rows of one time are one session of the measurement.
    number, rig, now = db.execute(select, which).fetchone() or (None, origin.rig, time.time())
    values = {"component": component, "created": now, "rows": 0, **asdict(origin)}
    if rig != origin.rig:
        raise AppendError(
            f"import {number} of {component!r}, {origin.filename!r}, has readings of another rig, "
            "frame or point; send the same ones, or append under another name: append=NAME"
        )
    if number and not _select_rows(db, component, number, (), withdrawn=False, most=1):
        raise AppendError(
            f"import {number}, {origin.filename!r}, is withdrawn. Restore it with: wrenchbook "
            f"withdraw {component} {number} --restore; or append under another name: append=NAME"
        )
    total = known = 0
    for block in blocks:
        new, old = rows.insert(db, component, block, row_keys(component, block), now)
        total, known = total + new, known + old
        if not new:
            continue
        number = number or db.execute(_INSERT, values).lastrowid
        db.execute("UPDATE imports SET rows = rows + ? WHERE id = ?", (new, number))
        last = sequences(db)["rows"]
        first = last - new + 1
        longer = "UPDATE import_parts SET last = ? WHERE import = ? AND last = ?"
        if not db.execute(longer, (last, number, first - 1)).rowcount:
            part = first, last, number, component
            db.execute("INSERT INTO import_parts VALUES (?, ?, ?, ?, 0)", part)
    if total:
        _note(db, "import.append", number, component, total, origin)
    return Loaded(total, known, number)


def drop_abandoned(ledger: Ledger) -> None:
    """Delete the hidden rows of imports whose process has ended, unless an import is running."""
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
    select = (
        "SELECT wrench, displacement, uncertainty, count FROM rows WHERE component = ?"
        " AND length(wrench) = 8 * ? * count AND length(displacement) = 8 * ? * count"
    )
    records = db.execute(select, (component, inputs, outputs)).fetchall()
    unknown = np.full(outputs, np.nan).tobytes()
    columns = (
        unpacked((wrench for wrench, *_ in records), inputs),
        unpacked((displacement for _, displacement, *_ in records), outputs),
        unpacked((uncertainty or unknown * count for *_, uncertainty, count in records), outputs),
    )
    return np.hstack(columns)


def imports(db: Connection, component: str, most: int = 1000) -> list[ImportRecord]:
    """Return the finished imports of a component, newest first."""
    where = f"component = ? AND {_ENDED} ORDER BY id DESC LIMIT ?"
    records = db.execute(f"SELECT {_QUALIFIED} FROM imports WHERE {where}", (component, most))
    return [_record(values) for values in records]


def same_file(db: Connection, component: str, digest: str) -> ImportRecord | None:
    """Return the newest import of this SHA-256 with a row in use, among the newest 1,000."""
    same = [record for record in imports(db, component) if record.digest == digest]
    for record in same:
        if _select_rows(db, component, record.id, (), withdrawn=False, most=1):
            return record
    return None


def import_of(db: Connection, seq: int) -> ImportRecord | None:
    """Return the import of a row; None for a solved row."""
    where = "first <= ? AND last >= ? ORDER BY first DESC LIMIT 1"
    record = db.execute(f"SELECT {_QUALIFIED} {_PARTS} {where}", (seq, seq)).fetchone()
    return _record(record) if record else None


def import_spans(db: Connection, component: str) -> list[ImportSpan]:
    """Return the rows of each import of a component, in their order."""
    where = "import_parts.component = ? AND hidden = 0 ORDER BY first"
    records = db.execute(f"SELECT first, last, {_QUALIFIED} {_PARTS} {where}", (component,))
    return [ImportSpan(first, last, _record(values)) for first, last, *values in records]


def withdrawn_counts(db: Connection, component: str) -> Counter[int]:
    """Return the number of withdrawn rows of each import of a component, by its number."""
    return _counts_by_import(db, component, rows.withdrawn(db, component))


def _counts_by_import(db: Connection, component: str, seqs: Iterable[int]) -> Counter[int]:
    """Return the number of the given rows in each import; solved rows are in none."""
    numbers = import_numbers(import_spans(db, component), np.array([*seqs], np.int64))
    return Counter(numbers[numbers > 0].tolist())


def import_numbers(spans: Sequence[ImportSpan], seqs: np.ndarray) -> np.ndarray:
    """Return the number of each row's import, (n,), by `import_spans`; 0 for rows without one."""
    bounds = [(span.first, span.last, span.record.id) for span in spans]
    first, last, number = np.array(bounds or [(0, 0, 0)]).T
    at = np.searchsorted(first, seqs, side="right") - 1
    return np.where((at >= 0) & (seqs <= last[at]), number[at], 0)


def restore_confirmed(db: Connection, component: str, keys: Sequence[bytes]) -> int:
    """Restore the withdrawn rows with these keys, which a later import has confirmed.

    Return their number. As after a solve, a row that comes again counts again, except for a row
    that was withdrawn by itself.
    """
    known = rows.stored(db, rows.withdrawn_keys(db, component, keys))
    seqs = sorted(known.values())
    rows.edit(db, component, seqs, withdrawn=False, now=time.time())
    for number, count in _counts_by_import(db, component, seqs).items():
        rows.note_edit(db, "import", number, component, withdrawn=False, rows=count)
    return len(seqs)


def findings(db: Connection, component: str) -> list[dict[str, Any]]:
    """Return the findings of a component's imports that have rows in the table, newest first.

    Each is as stored, without ``keys``, and with ``import``, ``filename``, ``rows``, the numbers of
    its rows that are not withdrawn (empty if the whole import is meant), and ``count``.
    """
    select = (
        f"SELECT id, filename, findings FROM imports WHERE component = ? AND {_ENDED}"
        " AND findings <> '[]' ORDER BY id DESC"
    )
    live = []
    for number, filename, text in db.execute(select, (component,)).fetchall():
        for finding in _read_findings(text):
            keys = finding.pop("keys")
            most = len(keys) or 1
            seqs = _select_rows(db, component, number, keys, withdrawn=False, most=most)
            if seqs:
                seqs = seqs if keys else []
                details = {"import": number, "filename": filename, "rows": seqs}
                live.append({**finding, **details, "count": len(seqs)})
    return live


def edit_import(
    db: Connection, component: str, number: int, cause: str | None = None, *, withdrawn: bool
) -> int:
    """Withdraw or restore the rows of an import, or those that its findings of a cause name.

    Returns the number of changed rows. Rows that already are as requested do not count, and rows
    that were withdrawn one by one are not restored.

    Raises UnknownImportError if the component has no such import, or the import no such finding.
    """
    select = f"SELECT findings FROM imports WHERE id = ? AND component = ? AND {_ENDED}"
    record = db.execute(select, (number, component)).fetchone()
    if record is None:
        running = "SELECT 1 FROM imports WHERE id = ? AND component = ?"
        if db.execute(running, (number, component)).fetchone():
            still = f"import {number} of {component!r} is still running; repeat this when it has "
            raise UnknownImportError(f"{still}ended")
        listed = f"SELECT id FROM imports WHERE component = ? AND {_ENDED}"
        ids = db.execute(f"{listed} ORDER BY id DESC LIMIT 10", (component,))
        newest = ", ".join(str(known) for (known,) in ids)
        remedy = f"its newest imports are {newest}" if newest else "import a file first"
        raise UnknownImportError(f"{component!r} has no import {number}; {remedy}")
    lists = [
        finding["keys"] for finding in _read_findings(record[0]) if finding.get("cause") == cause
    ]
    if cause is not None and not lists:
        causes = ", ".join(str(finding.get("cause")) for finding in _read_findings(record[0]))
        known = f"finding {cause!r}; its findings are {causes}" if causes else "findings"
        raise UnknownImportError(f"import {number} of {component!r} has no {known}")
    keys = [key for part in lists for key in part] if all(lists) else []
    seqs = _select_rows(db, component, number, keys, withdrawn=not withdrawn)
    rows.edit(db, component, seqs, withdrawn=withdrawn, now=time.time())
    if seqs:
        more = {"withdrawn": withdrawn, "rows": len(seqs), "finding": cause}
        rows.note_edit(db, "import", number, component, **more)
    return len(seqs)


def _record(values: Iterable[Any]) -> ImportRecord:
    return ImportRecord(**dict(zip(_NAMES, values, strict=True)))


def _note(
    db: Connection, action: str, number: int | None, component: str, new: int, origin: ImportOrigin
) -> None:
    after = {"rows": new, "filename": origin.filename, "sha256": origin.digest}
    note(db, action, number, component, after=after)


def _take_lock(ledger: Ledger) -> int | None:
    with ledger.named_errors(OSError):
        return take(Path(f"{ledger.path}-importing"))


def _read_findings(text: str) -> list[dict[str, Any]]:
    """Return the findings of an import; none if their text is damaged."""
    try:
        return [{"keys": [], **finding} for finding in json.loads(text)]
    except (ValueError, TypeError):
        return []


def _select_rows(
    db: Connection,
    component: str,
    number: int,
    keys: Sequence[str],
    *,
    withdrawn: bool,
    most: int | None = None,
) -> list[int]:
    """Return the rows with these keys, in their order, or all of an import without keys.

    Only withdrawn ones, except for those withdrawn one by one, or only others, and at most `most`.
    """
    gone = rows.withdrawn(db, component, with_single=not withdrawn)
    if keys:
        wanted = list(dict.fromkeys(map(bytes.fromhex, keys)))
        stored = rows.stored(db, wanted)
        seqs = iter([stored[key] for key in wanted if key in stored])
    else:
        records = db.execute(f"SELECT rows.seq, count {_ROWS}", (number,))
        seqs = (seq for first, count in records for seq in range(first, first + count))
    return list(islice((seq for seq in seqs if (seq in gone) == withdrawn), most))


def _drop_hidden(ledger: Ledger) -> None:
    """Delete hidden rows, the last first, and imports without rows; numbers are not used again."""
    while True:
        with ledger.writing(durable=False) as db:
            last_part = "FROM import_parts WHERE hidden = 1 ORDER BY first DESC LIMIT 1"
            part = db.execute(f"SELECT first, last {last_part}").fetchone()
            if part is None:
                without_parts = "id NOT IN (SELECT import FROM import_parts)"
                db.execute(f"DELETE FROM imports WHERE rows = 0 AND {without_parts}")
                return
            first, last = part
            start = rows.delete_hidden(db, first, last, RECORDS_DELETED)
            if start == first:
                db.execute("DELETE FROM import_parts WHERE first = ?", (first,))
            else:
                db.execute("UPDATE import_parts SET last = ? WHERE first = ?", (start - 1, first))
