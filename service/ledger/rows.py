"""SQL of single rows. Each function takes a connection inside the caller's transaction.

Rows and edits (a withdrawal, its undoing) are numbered by one sequence: one number says how far a
reader has read.
"""

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

from wrenchbook.service.ledger.connection import Connection
from wrenchbook.service.ledger.packing import (
    PackedRow,
    row_key,
    row_values,
    seal,
    unpack_matrix,
    unpack_vector,
)
from wrenchbook.service.ledger.records import (
    DamagedRowError,
    LedgerRow,
    NewRow,
    RowStatusError,
    UnknownRowError,
)

COLUMNS = (
    "seq, component, fingerprint, source, wrench, displacement, compliance, curvature, "
    "uncertainty, job, created, origin, key, seal"
)
_CONTENT = COLUMNS.removeprefix("seq, ")
_PLACES = ", ".join("?" for _ in _CONTENT.split(","))
INSERT = f"INSERT INTO rows ({_CONTENT}) VALUES ({_PLACES}) ON CONFLICT (key) DO NOTHING"
# Rows of an import that has not ended are hidden. Parts do not overlap, so the one that begins
# last before a row is the only one that can contain it.
SHOWN = (
    "coalesce((SELECT part.last FROM import_parts part WHERE part.hidden = 1"
    " AND part.first <= rows.seq ORDER BY part.first DESC LIMIT 1), 0) < rows.seq"
)
# With max(), SQLite gives that record's columns: the newest edit of a row is the valid one.
LIVE = (
    "seq NOT IN (SELECT row FROM (SELECT row, withdrawn, max(seq) FROM edits"
    " WHERE component = :component AND seq <= :until GROUP BY row) WHERE withdrawn)"
    f" AND {SHOWN}"
)
_MOST_VALUES = 500  # of one statement; SQLite before 3.32 takes 999


def in_parts(values: Iterable[Any], most: int = _MOST_VALUES) -> Iterator[tuple[str, list[Any]]]:
    """Yield the placeholders and values of `IN (...)`, at most `most` values a statement."""
    every = list(values)
    for start in range(0, len(every), most):
        part = every[start : start + most]
        yield ", ".join("?" * len(part)), part


def add(
    db: Connection, component: str, fingerprint: str, row: NewRow, job: int, now: float
) -> LedgerRow:
    """Insert the row of a job, or find the row of the same content, and return it.

    A withdrawn row of the same content is restored, since the solve has confirmed it; a damaged
    one is written again.
    """
    values = row_values(component, fingerprint, row, job, now)
    db.execute(INSERT, values)
    same, damaged = sound(db.execute(f"SELECT {COLUMNS} FROM rows WHERE key = ?", (values[-2],)))
    _show(db, same[0].seq if same else damaged[0])
    if damaged:
        db.execute(
            f"UPDATE rows SET ({_CONTENT}) = ({_PLACES}) WHERE key = ?", (*values, values[-2])
        )
        same = [get(db, damaged[0])]
        edit(db, component, damaged[0], withdrawn=True, now=now)  # so that readers take it again
    found = same[0]
    if is_withdrawn(db, found.seq):
        edit(db, component, found.seq, withdrawn=False, now=now)
    return found


def add_many(db: Connection, rows: list[PackedRow]) -> int:
    """Insert those of some packed rows that are not there yet and return how many those were.

    A hidden row of a running import counts as one of these, and is shown.
    """
    if not rows:
        return 0
    inserted = db.executemany(INSERT, rows).rowcount
    if first_hidden(db, None) is None:
        return inserted
    for marks, keys in in_parts(row[-2] for row in rows):
        select = f"SELECT seq FROM rows WHERE key IN ({marks}) AND NOT ({SHOWN})"
        inserted += sum(_show(db, seq) for (seq,) in db.execute(select, keys).fetchall())
    return inserted


def first_hidden(db: Connection, component: str | None) -> int | None:
    """Return the number of the first hidden row; None if there is none."""
    where = "" if component is None else "AND component = :component"
    select = f"SELECT min(first) FROM import_parts WHERE hidden = 1 {where}"
    return db.execute(select, {"component": component}).fetchone()[0]


def _show(db: Connection, seq: int) -> bool:
    """Take one row out of the hidden ones; return whether it was one."""
    part = db.execute(
        "SELECT first, last, import, component FROM import_parts"
        " WHERE hidden = 1 AND first <= ? AND last >= ?",
        (seq, seq),
    ).fetchone()
    if part is None:
        return False
    first, last, number, component = part
    db.execute("DELETE FROM import_parts WHERE first = ?", (first,))
    for span in ((first, seq - 1), (seq + 1, last)):
        if span[0] <= span[1]:
            values = (*span, number, component, True)
            db.execute("INSERT INTO import_parts VALUES (?, ?, ?, ?, ?)", values)
    return True


def get(db: Connection, seq: int) -> LedgerRow:
    """Return a row by its id; raises UnknownRowError, DamagedRowError."""
    select = f"SELECT {COLUMNS} FROM rows WHERE seq = ? AND {SHOWN}"
    found, damaged = sound(db.execute(select, (seq,)))
    if damaged:
        raise DamagedRowError(
            f"row {seq} is damaged on the disk and used nowhere; restore the ledger from a "
            "backup, or ask for its wrench again: it is then solved anew"
        )
    if not found:
        raise UnknownRowError(f"there is no row {seq}")
    return found[0]


def numbered(db: Connection, seqs: Iterable[int]) -> dict[int, LedgerRow]:
    """Return those of some rows that are there and undamaged, by number."""
    found = {}
    for marks, part in in_parts(seqs):
        records = db.execute(f"SELECT {COLUMNS} FROM rows WHERE seq IN ({marks})", part)
        found |= {row.seq: row for row in sound(records)[0]}
    return found


def last_seq(db: Connection, component: str | None) -> int:
    """Return the number of the newest row or edit, 0 if there is none.

    During an import of a component the numbers end before the first hidden row, so that readers
    have not passed its rows when they are shown.
    """
    where = "" if component is None else "WHERE component = :component"
    newest = ", ".join(
        f"coalesce((SELECT max(seq) FROM {table} {where}), 0)" for table in ("rows", "edits")
    )
    found = db.execute(f"SELECT max({newest})", {"component": component}).fetchone()[0]
    hidden = first_hidden(db, component)
    return found if hidden is None else min(found, hidden - 1)


def is_withdrawn(db: Connection, seq: int) -> bool:
    """Return whether a row is withdrawn."""
    newest = "SELECT withdrawn FROM edits WHERE row = ? ORDER BY seq DESC LIMIT 1"
    found = db.execute(newest, (seq,)).fetchone()
    return bool(found and found[0])


def is_usable(db: Connection, seq: int) -> bool:
    """Return whether a row is undamaged, shown and not withdrawn."""
    shown = f"SELECT {COLUMNS} FROM rows WHERE seq = ? AND {SHOWN}"
    return bool(sound(db.execute(shown, (seq,)))[0]) and not is_withdrawn(db, seq)


def rewrite(db: Connection, component: str, seq: int, row: NewRow) -> bool:
    """Write a damaged row anew from another copy, with its own number, job, time and note.

    The note is kept if the row's seal fits it. Returns False if the row is not damaged, or if
    the same row has another number already: it was solved or loaded again.
    """
    if numbered(db, [seq]):
        return False
    now = time.time()
    job, created, origin, mark = db.execute(
        "SELECT job, created, origin, seal FROM rows WHERE seq = ?", (seq,)
    ).fetchone() or (None, now, None, None)
    known = db.execute("SELECT id FROM jobs WHERE id = ?", (job,)).fetchone()
    about = known and known[0], created if isinstance(created, float) else now
    values = row_values(component, "", row, *about)
    if isinstance(origin, str):
        own = row_values(component, "", replace(row, origin=origin), *about)
        values = own if own[-1] == mark else values
    other = "SELECT 1 FROM rows WHERE key = ? AND seq <> ?"
    if db.execute(other, (values[-2], seq)).fetchone():
        return False
    db.execute(f"UPDATE rows SET ({_CONTENT}) = ({_PLACES}) WHERE seq = ?", (*values, seq))
    # Readers have passed this number; a withdrawal and its undoing make them read it again.
    withdrawn = is_withdrawn(db, seq)
    edit(db, component, seq, withdrawn=not withdrawn, now=now)
    edit(db, component, seq, withdrawn=withdrawn, now=now)
    return True


def place(db: Connection, component: str, seq: int, row: NewRow, now: float) -> None:
    """Insert a row under the number it had in a ledger that is gone."""
    values = (seq, *row_values(component, "", row, None, now))
    db.execute(f"INSERT OR IGNORE INTO rows (seq, {_CONTENT}) VALUES (?, {_PLACES})", values)


def edit(db: Connection, component: str, seq: int, *, withdrawn: bool, now: float) -> None:
    """Withdraw or restore a component's row; raises UnknownRowError, RowStatusError."""
    same = f"SELECT 1 FROM rows WHERE seq = ? AND component = ? AND {SHOWN}"
    if db.execute(same, (seq, component)).fetchone() is None:
        raise UnknownRowError(f"the table of {component!r} has no row {seq}")
    if is_withdrawn(db, seq) == withdrawn:
        raise RowStatusError(f"row {seq} is {'withdrawn already' if withdrawn else 'in the table'}")
    number = skip(db, 1)
    db.execute("INSERT INTO edits VALUES (?, ?, ?, ?, ?)", (number, component, seq, withdrawn, now))


def edit_many(
    db: Connection, component: str, seqs: Sequence[int], *, withdrawn: bool, now: float
) -> None:
    """Withdraw or restore rows of a component, of which none is so already."""
    first = skip(db, len(seqs)) - len(seqs) + 1
    edits = ((first + k, component, seq, withdrawn, now) for k, seq in enumerate(seqs))
    db.executemany("INSERT INTO edits VALUES (?, ?, ?, ?, ?)", edits)


def skip(db: Connection, count: int = 0, least: int = 0) -> int:
    """Leave out `count` numbers of the sequence, and all up to `least`; return the last of them."""
    db.execute(
        "INSERT INTO sqlite_sequence SELECT 'rows', 0 WHERE NOT EXISTS"
        " (SELECT 1 FROM sqlite_sequence WHERE name = 'rows')"
    )
    db.execute(
        "UPDATE sqlite_sequence SET seq = max(seq + ?, ?) WHERE name = 'rows'", (count, least)
    )
    return db.execute("SELECT seq FROM sqlite_sequence WHERE name = 'rows'").fetchone()[0]


def sound(records: Iterable[Sequence[Any]]) -> tuple[list[LedgerRow], list[int]]:
    """Return the undamaged rows of some records, and the numbers of the damaged ones."""
    found, damaged = [], []
    for record in records:
        try:
            found.append(_row(*record))
        except (ValueError, TypeError, AttributeError):
            damaged.append(record[0])
    return found, damaged


def _row(seq: int, *fields: Any) -> LedgerRow:
    component, fingerprint, source, wrench, displacement = fields[:5]
    compliance, curvature, uncertainty, job, created, origin, key, mark = fields[5:]
    written = row_key(component, fingerprint, source, wrench, displacement, uncertainty)
    if written != key or seal(key, compliance, origin, curvature) != mark:
        raise ValueError(f"row {seq} is not as it was written")
    moved = unpack_vector(displacement)
    return LedgerRow(
        seq,
        component,
        fingerprint,
        source,
        unpack_vector(wrench),
        moved,
        None if compliance is None else unpack_matrix(compliance, len(moved)),
        None if uncertainty is None else unpack_vector(uncertainty),
        job,
        created,
        origin,
        None if curvature is None else unpack_vector(curvature),
    )
