"""Repair: a new ledger from a damaged one, and damaged rows and lost edits from table files."""

import time
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np

from wrenchbook.service.ledger import audit, rows
from wrenchbook.service.ledger.acknowledged import Numbers
from wrenchbook.service.ledger.connection import (
    USE_ERRORS,
    Connection,
    connect,
    open_file,
    raise_sequences,
    sequences,
)
from wrenchbook.service.ledger.packing import Record, records_of, row_keys
from wrenchbook.service.ledger.records import NotedRows, RowEdit
from wrenchbook.surrogate.table.rows import Rows

# All tables with content of their own: `row_keys` follows from the rows, leases end with a server.
_TABLES = (
    "SELECT name FROM sqlite_schema WHERE type = 'table'"
    " AND name NOT IN ('row_keys', 'leases', 'sqlite_sequence') ORDER BY rowid"
)
# Whether the ledger has the row in the column `row`, of `jobs` or `edits`.
_STORED = (
    "EXISTS (SELECT 1 FROM rows WHERE rows.seq = (SELECT max(seq) FROM rows WHERE seq <= row)"
    " AND row < rows.seq + count)"
)
_MAX_ROWID = 10_000_000  # if the highest number is unknown: ten times the largest tested import
_OLDER = {"count": 1, "curvature": None}  # values of columns that records of earlier schemas lack
_MAX_NUMBER = 1 << 48  # larger numbers are damaged: a million a second would take nine years
_HEAD_BYTES = 100  # bytes of a file's header: https://www.sqlite.org/fileformat.html
_MAGIC = b"SQLite format 3\0"
_MAX_BYTES = 1 << 34  # bytes of a ledger, some 40 million rows; a damaged header may state more
_MAX_MISSES = 50_000  # failed reads, 20 µs each, before the repair gives up a table: a second


@dataclass(frozen=True)
class Salvaged:
    """Counts of a salvage."""

    read: dict[str, int]  # numbers of records, by table
    reopened: int  # done jobs whose row is lost, which wait again
    highest_job: int  # the highest number of a job that was ever used
    # Upper bound of the acknowledged rows that are in neither copy: edits and abandoned imports use
    # numbers of rows as well.
    lost_rows: int


def salvage(
    damaged: Path, target: Path, spare: Iterable[tuple[str, Rows, float]], noted: Numbers
) -> Salvaged:
    """Write a new ledger from a copy of a damaged one, and from the table files.

    Rows come from the table files first, which have digests: `spare` has the component, the rows
    and the time of each. A done job without any copy of its row waits again, and no number that was
    used, or `noted` as acknowledged, is used again. No other process uses the copy `damaged`, which
    has its log beside it; `target` must not exist.

    Raises LedgerFileError if `target` cannot be written.
    """
    _pad(damaged)
    try:
        source = connect(damaged)
    except USE_ERRORS:  # the first page, with the schema, is damaged
        source = connect(Path(":memory:"))  # no table
    new = open_file(target)
    try:
        highest = noted._asdict()
        with suppress(*USE_ERRORS):
            for name, number in sequences(source).items():
                if isinstance(number, int) and number < _MAX_NUMBER:
                    highest[name] = max(highest.get(name, 0), number)
        new.execute("PRAGMA foreign_keys = OFF")
        new.execute("BEGIN IMMEDIATE")
        for component, table_rows, written in spare:
            _insert_spare(new, component, table_rows, written)
        names = [name for (name,) in new.execute(_TABLES).fetchall()]
        read = {name: _copy(source, new, name, highest) for name in names}
        # Remove references to missing jobs and rows.
        new.execute("UPDATE rows SET job = NULL WHERE job NOT IN (SELECT id FROM jobs)")
        new.execute(f"DELETE FROM edits WHERE NOT {_STORED}")
        reopened = new.execute(
            "UPDATE jobs SET status = 'waiting', row = NULL, started = NULL, finished = NULL"
            f" WHERE row IS NOT NULL AND NOT {_STORED}"
        ).rowcount
        total = "SELECT (SELECT coalesce(sum(count), 0) FROM rows) + (SELECT count(*) FROM edits)"
        lost_rows = max(0, noted.rows - new.execute(total).fetchone()[0])
        new.execute("COMMIT")
        raise_sequences(new, {name: highest.get(name, 0) for name in ("jobs", "rows")})
    finally:
        source.close()
        new.close()
    return Salvaged(read, reopened, highest.get("jobs", 0), lost_rows)


def _pad(damaged: Path) -> None:
    """Extend a truncated file to its length: SQLite reads no page of a shorter file."""
    with damaged.open("r+b") as file:
        head = file.read(_HEAD_BYTES)
        pages, size = int.from_bytes(head[28:32]), int.from_bytes(head[16:18])
        size = 65536 if size == 1 else size  # the format's code of 65536
        full_size = pages * size
        if head.startswith(_MAGIC) and damaged.stat().st_size < full_size < _MAX_BYTES:
            file.truncate(full_size)  # a sparse file


def _copy(source: Connection, new: Connection, table: str, highest: dict[str, int]) -> int:
    """Copy the readable records of a table, and return their number.

    A range of numbers with an unreadable record is halved until the record is alone. `highest` has
    the highest used number of each table, where the search ends.
    """
    columns = [name for _, name, *_ in new.execute(f"PRAGMA table_info({table})")]
    try:
        readable = [name for _, name, *_ in source.execute(f"PRAGMA table_info({table})")]
    except USE_ERRORS:
        readable = columns
    common = [name for name in columns if name in readable]
    if not common:
        return 0
    numbered = "rows" if table in ("edits", "import_parts") else table
    end = highest.get(numbered) or _MAX_ROWID
    select = f"SELECT {', '.join(common)} FROM {table} NOT INDEXED WHERE rowid BETWEEN ? AND ?"
    values = ", ".join("?" * len(common))
    insert = f"INSERT OR IGNORE INTO {table} ({', '.join(common)}) VALUES ({values})"
    count = 0
    misses = 0
    ranges = [(0, end)]
    while ranges and misses < _MAX_MISSES:
        first, last = ranges.pop()
        try:
            records = source.execute(select, (first, last)).fetchall()
        except USE_ERRORS:
            misses += 1
            if first < last:
                middle = (first + last) // 2
                ranges += [(middle + 1, last), (first, middle)]
            continue
        for record in records:
            with suppress(*USE_ERRORS, TypeError, ValueError):  # a record with damaged values
                if table == "rows":
                    columns_of = dict(zip(common, record, strict=True))
                    count += _restore_record(new, Record(**_OLDER | columns_of))
                else:
                    count += new.execute(insert, record).rowcount
    return count


def _insert_spare(db: Connection, component: str, table_rows: Rows, now: float) -> None:
    """Insert rows of a table file under their numbers in a lost ledger."""
    if not len(table_rows):
        return
    gaps = np.flatnonzero(np.diff(table_rows.seq) != 1) + 1
    for run in np.split(np.arange(len(table_rows)), gaps):
        block = NotedRows(table_rows.take(run), ["table file"] * len(run))
        first = int(table_rows.seq[run[0]])
        keys = row_keys(component, block)
        for record in records_of(component, block, keys, first, now):
            _restore_record(db, record)


def _restore_record(db: Connection, record: Record) -> int:
    """Insert the rows of a record whose keys and numbers a new ledger lacks; return the count."""
    last = record.seq + record.count - 1
    used = {seq for seq, _ in rows.containing(db, range(record.seq, last + 1))}
    known = rows.stored(db, record.keys())
    keys = record.keys()
    count = 0
    free = [
        record.seq + at not in used and key not in known
        for at, key in enumerate(keys[: record.count])
    ]
    for is_free, group in groupby(range(len(free)), free.__getitem__):
        if is_free:
            positions = list(group)
            part = record
            if len(positions) < record.count:
                part = record.part(positions[0], positions[-1] + 1)
            db.execute(rows.INSERT, part)
            rows.insert_keys(db, rows.row_entries(part))
            count += part.count
    return count


def rewrite(db: Connection, component: str, seq: int, copy: Rows) -> bool:
    """Write a damaged row again from `copy`, one row, with its own number, job, time and note.

    The note stays if it fits the row's seal. Returns False if the row is not damaged, or if the
    same row already has another number because it was solved or loaded again.
    """
    if rows.numbered(db, [seq]):
        return False
    now = time.time()
    job = None
    created = now
    note = "table file"
    for _, damaged in rows.containing(db, [seq]):  # at most one record
        job = damaged.job
        if isinstance(damaged.created, float):  # not so if its bytes have changed
            created = damaged.created
        if damaged.is_sealed():
            note = damaged.origin
    known = db.execute("SELECT id FROM jobs WHERE id = ?", (job,)).fetchone()
    block = NotedRows(copy, [note])
    keys = row_keys(component, block)
    if rows.stored(db, keys).get(keys[0], seq) != seq:
        return False
    (record,) = records_of(component, block, keys, seq, created, known and known[0])
    rows.write_anew(db, record)
    # Readers have passed this number; a withdrawal and its restoring make them read it again.
    withdrawn = rows.is_withdrawn(db, seq)
    single = withdrawn and seq not in rows.withdrawn(db, component, with_single=False)
    rows.edit(db, component, [seq], withdrawn=not withdrawn, now=now)
    rows.edit(db, component, [seq], withdrawn=withdrawn, now=now, single=single)
    audit.note(db, "row.rewrite", seq, component)
    return True


def replay(db: Connection, component: str, edits: Iterable[RowEdit]) -> int:
    """Repeat edits that are newer than the ledger's of the same row; return their number.

    An edit of a missing row changes nothing.
    """
    newest = "SELECT created FROM edits WHERE row = ? ORDER BY seq DESC LIMIT 1"
    changed = 0
    for key, withdrawn, created in edits:
        for seq in rows.stored(db, [key]).values():
            last = db.execute(newest, (seq,)).fetchone()
            if rows.is_withdrawn(db, seq) != withdrawn and (last is None or last[0] < created):
                rows.edit(db, component, [seq], withdrawn=withdrawn, now=created)
                rows.note_edit(db, "row", seq, component, withdrawn=withdrawn)
                changed += 1
    return changed
