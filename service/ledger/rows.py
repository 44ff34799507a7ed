"""SQL of rows. Each function takes a connection inside the caller's transaction.

A record of the table `rows` has up to `packing.MAX_COUNT` consecutive rows; `row_keys` has the key
of each row, unique. Rows and edits (a withdrawal, its restoring) are numbered by one sequence, so
that one number states the position of a reader.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence, Set
from hashlib import blake2b
from itertools import groupby
from operator import itemgetter
from typing import Any

import numpy as np

from wrenchbook.service.ledger import audit
from wrenchbook.service.ledger.connection import Connection
from wrenchbook.service.ledger.packing import (
    KEY_BYTES,
    MAX_COUNT,
    MIN_NUMBERS,
    Record,
    key_hashes,
    noted_rows,
    numbers_of,
    records_of,
    row_keys,
)
from wrenchbook.service.ledger.records import (
    DamagedRowError,
    JobRecord,
    LedgerRow,
    NotedRows,
    RowChanges,
    RowEdit,
    RowStatusError,
    TableAt,
    UnknownRowError,
    UnknownVersionError,
)
from wrenchbook.surrogate.table.rows import Rows, joined
from wrenchbook.surrogate.table.space import DEFAULT, Input, Output, Space

MAX_CHANGES = 20_000  # rows returned at once: 20 MB with slopes and curvatures
_COLUMNS = ", ".join(Record._fields)
INSERT = f"INSERT INTO rows ({_COLUMNS}) VALUES ({', '.join('?' * len(Record._fields))})"
# Rows of an unfinished import are hidden. Parts do not overlap, so that only the last part that
# begins before a row can contain it.
SHOWN = (
    "coalesce((SELECT part.last FROM import_parts part WHERE part.hidden = 1"
    " AND part.first <= rows.seq ORDER BY part.first DESC LIMIT 1), 0) < rows.seq"
)
# With max(), SQLite returns that record's columns: the newest edit of a row is the valid one.
_WITHDRAWN = (
    "SELECT row FROM (SELECT row, withdrawn, single, max(seq) FROM edits"
    " WHERE component = :component AND seq <= :until GROUP BY row) WHERE withdrawn"
)
# The records with rows of the numbers :after + 1 to :until.
_BETWEEN = (
    f"component = :component AND seq > :after - {MAX_COUNT - 1} AND seq <= :until"
    " AND seq + count - 1 > :after"
)
_EVER = 2**63 - 1
_MAX_VALUES = 500  # values of one statement; SQLite before 3.32 allows 999


def in_parts(values: Iterable[Any]) -> Iterator[tuple[str, list[Any]]]:
    """Yield the placeholders and values of `IN (...)`, some at a time."""
    listed = list(values)
    for start in range(0, len(listed), _MAX_VALUES):
        part = listed[start : start + _MAX_VALUES]
        yield ", ".join("?" * len(part)), part


# -- writing ----------------------------------------------------------------------------------


def insert(
    db: Connection,
    component: str,
    block: NotedRows,
    keys: Sequence[bytes],
    now: float,
    *,
    above: int = 0,
    job: int | None = None,
) -> tuple[int, int]:
    """Insert rows; return the numbers of new and known rows, by their keys.

    New rows get a seq above `above`. A hidden row of a running import counts as new: the import
    loses it, see `yield_to_others`.
    """
    if above:
        _skip(db, least=above)
    positions = new_positions(keys, stored(db, keys).keys())
    known = len(keys) - len(positions)
    if positions:
        block = rows_at(block, positions)
        keys = [keys[at] for at in positions]
        first = insert_numbered(db, component, block, keys, now, job)
        hashes = key_hashes(b"".join(keys)).tolist()
        insert_keys(db, sorted(zip(hashes, range(first, first + len(keys)), strict=True)))
        db.has_new_rows = True
    return len(positions), known


def insert_numbered(
    db: Connection,
    component: str,
    block: NotedRows,
    keys: Sequence[bytes],
    now: float,
    job: int | None = None,
) -> int:
    """Insert rows without entries in `row_keys` under the next numbers; return the first number."""
    first = _skip(db, len(keys)) - len(keys) + 1
    db.executemany(INSERT, records_of(component, block, keys, first, now, job))
    return first


def stored(db: Connection, keys: Sequence[bytes], *, hidden: bool = False) -> dict[bytes, int]:
    """Return the numbers of existing rows by key; with `hidden` of hidden rows."""
    seqs: list[int] = []
    for marks, part in in_parts(key_hashes(b"".join(keys)).tolist()):
        select = f"SELECT seq FROM row_keys WHERE hash IN ({marks})"
        seqs += (seq for (seq,) in db.execute(select, part))
    wanted = set(keys)
    numbers = {}
    for seq, record in containing(db, seqs, "NOT " * hidden + SHOWN):
        at = KEY_BYTES * (seq - record.seq)
        if (key := record.key[at : at + KEY_BYTES]) in wanted:
            numbers[key] = seq
    return numbers


def new_positions(keys: Sequence[bytes], known: Set[bytes]) -> Sequence[int]:
    """Return the position of the first occurrence of each key that is not known."""
    if len(set(keys)) == len(keys) and known.isdisjoint(keys):
        return range(len(keys))
    positions: dict[bytes, int] = {}
    for at, key in enumerate(keys):
        if key not in known:
            positions.setdefault(key, at)
    return list(positions.values())


def rows_at(block: NotedRows, positions: Sequence[int]) -> NotedRows:
    """Return the rows at some positions."""
    if len(positions) == len(block.rows):
        return block
    return NotedRows(block.rows.take(np.array(positions)), [block.note[at] for at in positions])


def delete(db: Connection, seq: int) -> None:
    """Delete a row, which may be damaged, from its record; the record's other rows stay."""
    for record in list(_records(db, "seq > ? AND seq <= ?", (seq - MAX_COUNT, seq))):
        at = seq - record.seq
        if at < record.count:
            row = record.part(at, at + 1)
            db.executemany("DELETE FROM row_keys WHERE hash = ? AND seq = ?", row_entries(row))
            db.execute("DELETE FROM rows WHERE seq = ?", (record.seq,))
            for first, end in ((0, at), (at + 1, record.count)):
                if first < end:
                    db.execute(INSERT, record.part(first, end))


def insert_keys(db: Connection, entries: Iterable[tuple[int, int]]) -> None:
    """Insert the hashes of rows' keys, with their numbers: fast in the order of the hashes."""
    db.executemany("INSERT OR IGNORE INTO row_keys VALUES (?, ?)", entries)


def row_entries(record: Record) -> Iterator[tuple[int, int]]:
    """Return the hashes of the keys of a record's rows, with their numbers."""
    sound = isinstance(record.key, bytes) and len(record.key) == KEY_BYTES * record.count
    hashes = key_hashes(record.key if sound else b"").tolist()
    return zip(hashes, range(record.seq, record.seq + record.count), strict=False)


def yield_to_others(db: Connection, component: str, after: int) -> None:
    """Delete the hidden rows that another import or solve has inserted since a seq."""
    where = f"component = ? AND seq > ? AND {SHOWN}"
    for record in list(_records(db, where, (component, after))):
        for seq in stored(db, record.keys(), hidden=True).values():
            delete(db, seq)


def delete_hidden(db: Connection, first: int, last: int, most: int) -> int:
    """Delete the last `most` records of hidden rows, and return the first number deleted."""
    where = "seq BETWEEN ? AND ? ORDER BY seq DESC LIMIT ?"
    records = list(_records(db, where, (first, last, most)))
    for record in records:
        db.executemany("DELETE FROM row_keys WHERE hash = ? AND seq = ?", row_entries(record))
        db.execute("DELETE FROM rows WHERE seq = ?", (record.seq,))
    return records[-1].seq if len(records) == most else first


def write_anew(db: Connection, record: Record) -> None:
    """Replace the record of one damaged row."""
    delete(db, record.seq)
    db.execute(INSERT, record)
    insert_keys(db, row_entries(record))


def add_solved(
    db: Connection,
    job: JobRecord,
    displacement: Sequence[float],
    source: str,
    origin: str,
    now: float,
    **known: Any,
) -> LedgerRow:
    """Insert the row of a job, or find the row of the same content, and return it.

    A withdrawn row of the same content is restored, since the solve has confirmed it; a damaged row
    is written again. An output with unknown uncertainty is NaN, but not all of them.

    Raises ValueError if a number is not finite or a length is wrong.
    """
    columns = {name: value for name, value in known.items() if value is not None}
    for name, value in {"displacement": displacement, **columns}.items():
        finite = np.isfinite(np.asarray(value, dtype=float))
        if not (finite.any() if name == "uncertainty" else finite.all()):
            index = tuple(np.argwhere(~finite)[0].tolist())
            wrong = f"{np.asarray(value)[index]} at {index}"
            raise ValueError(f"{name} of job {job.id} must be finite, not {wrong}")
    if len(displacement) < MIN_NUMBERS:
        needs = f"needs {MIN_NUMBERS} or more numbers, not {len(displacement)}"
        raise ValueError(f"the displacement of job {job.id} {needs}")

    # Only the numbers of inputs and outputs matter.
    inputs = (Input("", "", "scalar"),) * len(job.wrench)
    space = Space(inputs, (Output("", ""),) * len(displacement))
    columns |= {"source": source, "fingerprint": job.fingerprint}
    more = {name: [value] for name, value in columns.items()}
    block = NotedRows(Rows.of([job.wrench], [displacement], space, **more), [origin])
    keys = row_keys(job.component, block)

    insert(db, job.component, block, keys, now, job=job.id)
    (seq,) = stored(db, keys).values()
    if seq not in numbered(db, [seq]):  # the row of the same content is damaged
        (record,) = records_of(job.component, block, keys, seq, now, job.id)
        write_anew(db, record)
        if not is_withdrawn(db, seq):
            edit(db, job.component, [seq], withdrawn=True, now=now)  # makes readers read it again
    if is_withdrawn(db, seq):
        edit(db, job.component, [seq], withdrawn=False, now=now)
    db.has_new_rows = True
    return get(db, seq)


def withdraw(db: Connection, component: str, seq: int, *, withdrawn: bool = True) -> None:
    """Take a row out of the component's table, or back into it; it stays in the ledger.

    Raises UnknownRowError if the component has no such row, RowStatusError if it already is so.
    """
    if not any(record.component == component for _, record in containing(db, [seq])):
        raise UnknownRowError(
            f"the table of {component!r} has no row {seq}; list its rows with GET "
            f"/v1/components/{component}/table"
        )
    if is_withdrawn(db, seq) == withdrawn:
        state = "withdrawn" if withdrawn else "in the table"
        raise RowStatusError(f"row {seq} of {component!r} is already {state}; nothing was changed")
    edit(db, component, [seq], withdrawn=withdrawn, now=time.time(), single=True)
    note_edit(db, "row", seq, component, withdrawn=withdrawn)


def note_edit(
    db: Connection, kind: str, subject: object, component: str, *, withdrawn: bool, **more: Any
) -> None:
    """Note a withdrawal or restoring of a row or an import."""
    states = {"before": {"withdrawn": not withdrawn}, "after": {"withdrawn": withdrawn, **more}}
    audit.note(db, f"{kind}.{'withdraw' if withdrawn else 'restore'}", subject, component, **states)


def edit(
    db: Connection,
    component: str,
    seqs: Sequence[int],
    *,
    withdrawn: bool,
    now: float,
    single: bool = False,
) -> None:
    """Withdraw or restore rows of a component, none of which already is so.

    A row that was withdrawn as a `single` one stays withdrawn if its import is restored.
    """
    first = _skip(db, len(seqs)) - len(seqs) + 1
    edits = ((first + k, component, seq, withdrawn, now, single) for k, seq in enumerate(seqs))
    db.executemany("INSERT INTO edits VALUES (?, ?, ?, ?, ?, ?)", edits)
    db.has_new_rows |= bool(seqs)


def _skip(db: Connection, count: int = 0, least: int = 0) -> int:
    """Leave out `count` numbers of the sequence, and all up to `least`; return the last of them."""
    db.execute(
        "INSERT INTO sqlite_sequence SELECT 'rows', 0 WHERE NOT EXISTS"
        " (SELECT 1 FROM sqlite_sequence WHERE name = 'rows')"
    )
    # SQLite's AUTOINCREMENT counts records; the last record may have several rows.
    last = "coalesce((SELECT seq + count - 1 FROM rows ORDER BY seq DESC LIMIT 1), 0)"
    db.execute(
        f"UPDATE sqlite_sequence SET seq = max(max(seq, {last}) + ?, ?) WHERE name = 'rows'",
        (count, least),
    )
    return db.execute("SELECT seq FROM sqlite_sequence WHERE name = 'rows'").fetchone()[0]


# -- reading ----------------------------------------------------------------------------------


def row_changes(
    db: Connection,
    component: str,
    after: int,
    most: int = MAX_CHANGES,
    *,
    space: Space = DEFAULT,
    fingerprint: str | None = None,
) -> RowChanges:
    """Return the changes of a component's rows after a seq, without damaged rows.

    `fingerprint`: the setup whose rows and measured rows are returned. Only the first `most` new
    rows are returned; the changes then end with the last of them.
    """
    newest = last_seq(db, component)
    touched = "SELECT row FROM edits WHERE component = ? AND seq > ? AND seq <= ?"
    edited = frozenset(seq for (seq,) in db.execute(touched, (component, after, newest)))
    gone = withdrawn(db, component, newest)
    restored = [seq for seq in edited if seq <= after and seq not in gone]
    records = list(dict.fromkeys(record for _, record in containing(db, restored)))
    records = [record for record in records if record.component == component]
    wanted = np.isin(numbers_of(records), restored)
    old = noted_rows(records, wanted, space, fingerprint, db.damaged)

    new, last = _read(db, component, after, newest, gone, most, space, fingerprint)
    rows = joined((old.rows, new.rows))
    return RowChanges(rows, edited, newest if last is None else last, complete=last is None)


def table_at(
    db: Connection,
    component: str,
    version: int | None = None,
    *,
    space: Space = DEFAULT,
    fingerprint: str | None = None,
) -> TableAt:
    """Return a component's table at a version, now if None; read it within `db`'s state.

    Raises UnknownVersionError if the table has not reached that version yet.
    """
    newest = last_seq(db, component)
    if version is not None and not 0 <= version <= newest:
        raise UnknownVersionError(
            f"the table of {component!r} has no version {version}; use 0 to {newest}"
        )
    until = newest if version is None else version
    known = db.execute(
        "SELECT max(uncertainty IS NOT NULL), max(compliance IS NOT NULL),"
        " max(curvature IS NOT NULL), max(origin <> ''), max(fingerprint <> '')"
        f" FROM rows WHERE component = ? AND seq <= ? AND {SHOWN}",
        (component, until),
    ).fetchone()

    def lots() -> Iterator[NotedRows]:
        gone = withdrawn(db, component, until)
        after = 0
        while after is not None:
            values = after, until, gone, MAX_CHANGES
            block, after = _read(db, component, *values, space, fingerprint)
            yield block

    return TableAt(until, tuple(map(bool, known)), lots())


def get(db: Connection, seq: int) -> LedgerRow:
    """Return a row by its seq, withdrawn or not.

    Raises UnknownRowError if there is none, DamagedRowError if it is damaged.
    """
    rows = numbered(db, [seq])
    if rows:
        return rows[seq]
    if not list(containing(db, [seq])):
        raise UnknownRowError(f"there is no row {seq}; list all with GET /v1/components/NAME/table")
    raise DamagedRowError(
        f"row {seq} is damaged on the disk and is not used; restore the ledger from a backup, or "
        "ask for its wrench again to have it solved anew"
    )


def numbered(db: Connection, seqs: Iterable[int]) -> dict[int, LedgerRow]:
    """Return the existing undamaged ones of some rows, by number."""
    rows: dict[int, LedgerRow] = {}
    for record, pairs in groupby(containing(db, seqs), key=itemgetter(1)):
        sound = record.sound()
        rows |= {seq: record.row(seq) for seq, _ in pairs if sound[seq - record.seq]}
    return rows


def damaged(db: Connection) -> dict[int, str]:
    """Return the damaged rows of the ledger, with the component that they name. Reads all rows."""
    return {
        record.seq + at: str(record.component)
        for record in _records(db, "1 ORDER BY seq", ())
        for at, sound in enumerate(record.sound())
        if not sound
    }


def is_withdrawn(db: Connection, seq: int) -> bool:
    """Return whether a row is withdrawn."""
    newest = "SELECT withdrawn FROM edits WHERE row = ? ORDER BY seq DESC LIMIT 1"
    edited = db.execute(newest, (seq,)).fetchone()
    return bool(edited and edited[0])


def first_hidden(db: Connection, component: str | None) -> int | None:
    """Return the number of the first hidden row (of one component); None if there is none."""
    where = "" if component is None else "AND component = :component"
    select = f"SELECT min(first) FROM import_parts WHERE hidden = 1 {where}"
    return db.execute(select, {"component": component}).fetchone()[0]


def last_seq(db: Connection, component: str | None = None) -> int:
    """Return the number of the newest row, withdrawal or restoring (of one component), or 0.

    During an import of a component, return the newest before the first hidden row: readers have
    then not passed the import's rows when these are published, and every version is one that the
    table had.
    """
    where = "seq < :end" if component is None else "component = :component AND seq < :end"
    newest = ", ".join(
        f"coalesce((SELECT {last} FROM {table} WHERE {where} ORDER BY seq DESC LIMIT 1), 0)"
        for table, last in (("rows", "seq + count - 1"), ("edits", "seq"))
    )
    end = first_hidden(db, component)
    values = {"component": component, "end": _EVER if end is None else end}
    return db.execute(f"SELECT max({newest})", values).fetchone()[0]


def count_new(db: Connection, component: str, fingerprint: str, after: int) -> int:
    """Return the number of a setup's and measured rows after a seq."""
    values = {"component": component, "after": after, "fingerprint": fingerprint}
    of_setup = "fingerprint IN ('', :fingerprint)"
    there = (
        "SELECT coalesce(sum(min(seq + count - 1, :until) - max(seq - 1, :after)), 0) FROM rows"
        f" WHERE {_BETWEEN} AND {SHOWN} AND {of_setup}"
    )
    gone = (
        f"SELECT count(*) FROM ({_WITHDRAWN} AND row > :after) JOIN rows"
        f" ON rows.seq = (SELECT max(seq) FROM rows WHERE seq <= row) WHERE {of_setup}"
    )
    values |= {"until": last_seq(db, component)}
    return db.execute(f"SELECT ({there}) - ({gone})", values).fetchone()[0]


def count_rows(db: Connection, component: str) -> int:
    """Return the number of a component's rows, with withdrawn ones and those of other setups."""
    select = f"SELECT coalesce(sum(count), 0) FROM rows WHERE component = ? AND {SHOWN}"
    return db.execute(select, (component,)).fetchone()[0]


def withdrawn_keys(db: Connection, component: str, keys: Iterable[bytes]) -> list[bytes]:
    """Return the given keys whose rows are withdrawn, but not one by one.

    Without any such row no key is read.
    """
    gone = withdrawn(db, component, with_single=False)
    known = stored(db, list(keys)) if gone else {}
    return [key for key, seq in known.items() if seq in gone]


def of_other_setups(db: Connection, component: str, fingerprint: str) -> dict[bytes, int]:
    """Return the number of rows of other setups at each wrench (packed), the oldest first.

    They are in no table. Measured rows, which have no setup, and withdrawn ones do not count.
    """
    where = f"component = ? AND fingerprint <> '' AND fingerprint <> ? AND {SHOWN} ORDER BY seq"
    gone = withdrawn(db, component)
    counts: dict[bytes, int] = {}
    for record in _records(db, where, (component, fingerprint)):
        width = len(record.wrench) // record.count
        for at in range(record.count):
            if record.seq + at not in gone:
                wrench = record.wrench[width * at : width * (at + 1)]
                counts[wrench] = counts.get(wrench, 0) + 1
    return counts


def digest(db: Connection, component: str, until: int) -> str:
    """Return a digest of a component's rows and their edits, up to a seq."""
    total = blake2b(digest_size=16)
    values = (component, until)
    where = "WHERE component = ? AND seq <= ? ORDER BY seq"
    for first, keys in db.execute(f"SELECT seq, key FROM rows {where}", values):
        last = min(len(keys) // KEY_BYTES, until - first + 1)
        total.update(
            b"".join(
                b"row %d %b" % (first + at, keys[KEY_BYTES * at : KEY_BYTES * (at + 1)])
                for at in range(last)
            )
        )
    for record in db.execute(f"SELECT seq, row, withdrawn FROM edits {where}", values):
        total.update(b"edit %d %d %d" % record)
    return total.hexdigest()


def edits(db: Connection, component: str, until: int) -> list[RowEdit]:
    """Return the newest edit, up to the seq `until`, of each edited row of a component."""
    # With max(), SQLite returns that record's columns.
    select = (
        "SELECT row, withdrawn, created, max(seq) FROM edits"
        " WHERE component = ? AND seq <= ? GROUP BY row"
    )
    newest = {row: edit for row, *edit, _ in db.execute(select, (component, until))}
    return [
        RowEdit(record.keys()[row - record.seq], bool(newest[row][0]), newest[row][1])
        for row, record in containing(db, newest)
    ]


def _records(db: Connection, where: str, values: Any) -> Iterator[Record]:
    for columns in db.execute(f"SELECT {_COLUMNS} FROM rows WHERE {where}", values):
        record = Record(*columns)
        if not isinstance(record.count, int) or not 1 <= record.count <= MAX_COUNT:
            record = record._replace(count=1)  # a damaged record: its numbers do not fit either
        yield record


def containing(
    db: Connection, seqs: Iterable[int], condition: str = SHOWN
) -> Iterator[tuple[int, Record]]:
    """Yield the given rows that meet the condition, in order, each with the record that has it."""
    record = None
    where = f"seq > ? AND seq <= ? AND {condition} ORDER BY seq DESC LIMIT 1"
    for seq in sorted(seqs):
        if record is None or seq >= record.seq + record.count:
            record = next(_records(db, where, (seq - MAX_COUNT, seq)), None)
        if record is not None and seq < record.seq + record.count:
            yield seq, record


def withdrawn(
    db: Connection, component: str, until: int = _EVER, *, with_single: bool = True
) -> set[int]:
    """Return the rows of a component that are withdrawn at a seq, now by default.

    `with_single`: also those that were withdrawn one by one.
    """
    select = _WITHDRAWN if with_single else f"{_WITHDRAWN} AND NOT single"
    return {row for (row,) in db.execute(select, {"component": component, "until": until})}


def _read(
    db: Connection,
    component: str,
    after: int,
    until: int,
    gone: set[int],
    most: int,
    space: Space,
    fingerprint: str | None,
) -> tuple[NotedRows, int | None]:
    """Return the first `most` rows with numbers from `after` + 1 to `until`, and where to continue.

    The rows `gone`, damaged ones and those of another setup (see `noted_rows`) are left out. The
    second value is the number of the last row read, None if there are no further ones.
    """
    values = {"component": component, "after": after, "until": until}
    records = []
    count = 0
    for record in _records(db, f"{_BETWEEN} AND {SHOWN} ORDER BY seq", values):
        records.append(record)
        span = range(max(record.seq, after + 1), min(record.seq + record.count - 1, until) + 1)
        count += len(span) - (sum(seq in gone for seq in span) if gone else 0)
        if count >= most:
            break
    seqs = numbers_of(records)
    live = (seqs > after) & (seqs <= until)
    live &= ~np.isin(seqs, list(gone))
    positions = np.flatnonzero(live)
    live[positions[most:]] = False
    last = int(seqs[positions[most - 1]]) if len(positions) >= most else None
    return noted_rows(records, live, space, fingerprint, db.damaged), last
