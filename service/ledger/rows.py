"""SQL of the rows. Each function takes a connection inside the caller's transaction.

Rows and edits (a withdrawal, its undoing) are numbered by one sequence, so that one number tells
a follower how far it has read.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from hashlib import blake2b
from typing import Any

from wrenchbook.service.ledger import imports
from wrenchbook.service.ledger.errors import DamagedRowError, RowStatusError, UnknownRowError
from wrenchbook.service.ledger.records import (
    LedgerRow,
    NewRow,
    RowChanges,
    content_key,
    pack6,
    pack36,
    seal,
    unpack6,
    unpack36,
)
from wrenchbook.service.ledger.schema import Connection

COLUMNS = (
    "seq, component, fingerprint, source, wrench, displacement, compliance, uncertainty, "
    "job, created, origin, key, seal"
)
_CONTENT = COLUMNS.removeprefix("seq, ")
_PLACES = ", ".join("?" for _ in _CONTENT.split(","))
_INSERT = f"INSERT INTO rows ({_CONTENT}) VALUES ({_PLACES}) ON CONFLICT (key) DO NOTHING"
# Beside max(), SQLite gives that record's columns: the newest edit of a row says how it stands.
LIVE = (
    "seq NOT IN (SELECT row FROM (SELECT row, withdrawn, max(seq) FROM edits"
    " WHERE component = :component AND seq <= :until GROUP BY row) WHERE withdrawn)"
    f" AND {imports.SHOWN}"
)
_EVER = 2**63 - 1
_DIGESTED = 10_000  # rows read at once for a digest: half the time of one by one


def add(
    db: Connection, component: str, fingerprint: str, row: NewRow, job: int, now: float
) -> LedgerRow:
    """Insert the row of a job, or find the row of the same content, and return it.

    If that one was withdrawn, solving it again has confirmed it, and it is restored; if it was
    damaged, it is as it was written again.
    """
    values = _values(component, fingerprint, row, job, now)
    db.execute(_INSERT, values)
    same, damaged = sound(db.execute(f"SELECT {COLUMNS} FROM rows WHERE key = ?", (values[-2],)))
    imports.show_one(db, same[0].seq if same else damaged[0])
    if damaged:
        db.execute(
            f"UPDATE rows SET ({_CONTENT}) = ({_PLACES}) WHERE key = ?", (*values, values[-2])
        )
        same = _select(db, "WHERE key = ?", (values[-2],))
        edit(db, component, damaged[0], withdrawn=True, now=now)  # followers take it up anew
    found = same[0]
    if is_withdrawn(db, found.seq):
        edit(db, component, found.seq, withdrawn=False, now=now)
    return found


def packed(
    component: str, fingerprint: str, rows: Iterable[NewRow], now: float
) -> list[tuple[object, ...]]:
    """Return rows as `add_many` inserts them: most of the work, which needs no connection."""
    return [_values(component, fingerprint, row, None, now) for row in rows]


def add_many(db: Connection, rows: list[tuple[object, ...]]) -> int:
    """Insert those of `packed` rows that are not there yet and return how many those were.

    A row that an import has brought and not shown yet is there for nobody else: it is shown, and
    counts as one of these.
    """
    if not rows:
        return 0
    inserted = db.executemany(_INSERT, rows).rowcount
    return inserted + imports.show_many(db, [row[-2] for row in rows])


def add_hidden(db: Connection, rows: list[tuple[object, ...]]) -> tuple[int, int, int]:
    """Insert rows that nobody shall see yet; how many were new, the first and last of them."""
    first = highest(db) + 1
    inserted = db.executemany(_INSERT, rows).rowcount if rows else 0
    return inserted, first, highest(db)


def highest(db: Connection) -> int:
    """Return the highest number given to a row or an edit."""
    found = db.execute("SELECT seq FROM sqlite_sequence WHERE name = 'rows'").fetchone()
    return found[0] if found else 0


def get(db: Connection, seq: int) -> LedgerRow:
    """Return a row by its id; raises UnknownRowError, DamagedRowError."""
    found = _select(db, f"WHERE seq = ? AND {imports.SHOWN}", (seq,))
    if not found:
        raise UnknownRowError(f"there is no row {seq}")
    return found[0]


def numbered(db: Connection, seqs: Sequence[int]) -> list[LedgerRow]:
    """Return those of some rows that are there and as they were written."""
    marks = ", ".join("?" * len(seqs))
    return sound(db.execute(f"SELECT {COLUMNS} FROM rows WHERE seq IN ({marks})", seqs))[0]


def listed(
    db: Connection, component: str, fingerprint: str | None, after: int
) -> tuple[list[LedgerRow], list[int]]:
    """Return a component's rows above a seq but withdrawn ones, and the seqs of damaged ones."""
    where = f"WHERE component = :component AND seq > :after AND {LIVE}"
    if fingerprint is not None:
        where += " AND fingerprint = :fingerprint"
    values = {"component": component, "after": after, "fingerprint": fingerprint, "until": _EVER}
    return sound(db.execute(f"SELECT {COLUMNS} FROM rows {where} ORDER BY seq", values))


def row_changes(
    db: Connection, component: str, after: int, most: int
) -> tuple[RowChanges, list[int]]:
    """Return what happened to a component's rows above a seq, and the seqs of damaged ones.

    Of new rows only the first `most`; the row_changes then end with the last of them.
    """
    told = last_seq(db, component)
    values = {"component": component, "after": after, "most": most, "until": told}
    touched = (
        "SELECT row FROM edits WHERE component = :component AND seq > :after AND seq <= :until"
    )
    gone = frozenset(seq for (seq,) in db.execute(touched, values))
    select = f"SELECT {COLUMNS} FROM rows WHERE component = :component AND {LIVE}"
    again = f"{select} AND seq <= :after AND seq IN ({touched}) ORDER BY seq"
    fresh = f"{select} AND seq > :after AND seq <= :until ORDER BY seq LIMIT :most"
    old, broken = sound(db.execute(again, values))
    new, damaged = sound(db.execute(fresh, values))
    whole = len(new) + len(damaged) < most
    until = told if whole else max(damaged + [row.seq for row in new[-1:]])
    return RowChanges(old + new, gone, until, whole), broken + damaged


def last_seq(db: Connection, component: str | None) -> int:
    """Return the number of the newest row or edit, 0 if there is none.

    While an import of a component's rows is taken in, the numbers end before its first: whoever
    follows the table has not passed its rows when they are shown.
    """
    where = "" if component is None else "WHERE component = :component"
    newest = ", ".join(
        f"coalesce((SELECT max(seq) FROM {table} {where}), 0)" for table in ("rows", "edits")
    )
    found = db.execute(f"SELECT max({newest})", {"component": component}).fetchone()[0]
    hidden = imports.first_hidden(db, component)
    return found if hidden is None else min(found, hidden - 1)


def count(db: Connection, component: str) -> int:
    """Return how many rows a component has, withdrawn ones too."""
    shown = f"SELECT count(*) FROM rows WHERE component = ? AND {imports.SHOWN}"
    return db.execute(shown, (component,)).fetchone()[0]


def of_other_setups(db: Connection, component: str, fingerprint: str) -> dict[bytes, int]:
    """Return the packed wrenches of a component's rows of other setups, and how many rows each has.

    Measured rows, of no setup, and withdrawn ones are none of them.
    """
    where = (
        "WHERE component = :component AND fingerprint <> '' AND fingerprint <> :fingerprint"
        f" AND {LIVE} GROUP BY wrench ORDER BY min(seq)"
    )
    values = {"component": component, "fingerprint": fingerprint, "until": _EVER}
    return dict(db.execute(f"SELECT wrench, count(*) FROM rows {where}", values))


def digest(db: Connection, component: str, until: int) -> str:
    """Return a digest of which rows a component has, and their edits, up to and with a seq."""
    whole = blake2b(digest_size=16)
    values = (component, until)
    where = "WHERE component = ? AND seq <= ? ORDER BY seq"
    found = db.execute(f"SELECT seq, key FROM rows {where}", values)
    while some := found.fetchmany(_DIGESTED):
        whole.update(b"".join([b"row %d %b" % one for one in some]))
    for entry in db.execute(f"SELECT seq, row, withdrawn FROM edits {where}", values):
        whole.update(b"edit %d %d %d" % entry)
    return whole.hexdigest()


def is_withdrawn(db: Connection, seq: int) -> bool:
    """Return whether a row is withdrawn."""
    newest = "SELECT withdrawn FROM edits WHERE row = ? ORDER BY seq DESC LIMIT 1"
    found = db.execute(newest, (seq,)).fetchone()
    return bool(found and found[0])


def is_usable(db: Connection, seq: int) -> bool:
    """Return whether a row is as it was written and not withdrawn."""
    shown = f"SELECT {COLUMNS} FROM rows WHERE seq = ? AND {imports.SHOWN}"
    found, _ = sound(db.execute(shown, (seq,)))
    return bool(found) and not is_withdrawn(db, seq)


def is_sound(db: Connection, seq: int) -> bool:
    """Return whether there is a row of this number and it is as it was written."""
    return bool(numbered(db, [seq]))


def rewrite(
    db: Connection,
    component: str,
    seq: int,
    row: NewRow,
    job: int | None,
    created: float,
    origin: object,
) -> bool:
    """Write a damaged row anew from another copy, with its own number, job and time.

    Its old note is kept if its seal says that it is the one that was written. False if the same
    row stands under another number already: it was solved or loaded again.
    """
    mark = db.execute("SELECT seal FROM rows WHERE seq = ?", (seq,)).fetchone()
    if isinstance(origin, str):
        own = _values(component, "", replace(row, origin=origin), job, created)
        if mark and own[-1] == mark[0]:
            row = replace(row, origin=origin)
    values = (*_values(component, "", row, job, created), seq)
    if db.execute("SELECT 1 FROM rows WHERE key = ? AND seq <> ?", (values[-3], seq)).fetchone():
        return False
    db.execute(f"UPDATE rows SET ({_CONTENT}) = ({_PLACES}) WHERE seq = ?", values)
    return True


def place(db: Connection, component: str, seq: int, row: NewRow, now: float) -> None:
    """Insert a row under the number it had in a ledger that is gone."""
    values = (seq, *_values(component, "", row, None, now))
    db.execute(f"INSERT OR IGNORE INTO rows (seq, {_CONTENT}) VALUES (?, {_PLACES})", values)


def edit(db: Connection, component: str, seq: int, *, withdrawn: bool, now: float) -> None:
    """Withdraw or restore a component's row; raises UnknownRowError, RowStatusError."""
    same = f"SELECT 1 FROM rows WHERE seq = ? AND component = ? AND {imports.SHOWN}"
    if db.execute(same, (seq, component)).fetchone() is None:
        raise UnknownRowError(f"the table of {component!r} has no row {seq}")
    if is_withdrawn(db, seq) == withdrawn:
        raise RowStatusError(f"row {seq} is {'withdrawn already' if withdrawn else 'in the table'}")
    number = skip(db, 1)
    db.execute("INSERT INTO edits VALUES (?, ?, ?, ?, ?)", (number, component, seq, withdrawn, now))


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


def _values(
    component: str, fingerprint: str, row: NewRow, job: int | None, now: float
) -> tuple[object, ...]:
    fingerprint = fingerprint if row.fingerprint is None else row.fingerprint
    wrench = pack6(row.wrench)
    measured = job is None and row.source != "fea"
    displacement = pack6(row.displacement, "displacement", partial=measured)
    compliance = None if row.compliance is None else pack36(row.compliance)
    # An output whose uncertainty is not known is NaN, which is not 0: exact.
    uncertainty = (
        None if row.uncertainty is None else pack6(row.uncertainty, "uncertainty", partial=True)
    )
    content = (component, fingerprint, row.source, wrench, displacement)
    key = _key(*content, uncertainty)
    mark = seal(key, compliance, row.origin)
    return (*content, compliance, uncertainty, job, now, row.origin, key, mark)


def _key(
    component: str,
    fingerprint: str,
    source: str,
    wrench: bytes,
    displacement: bytes,
    uncertainty: bytes | None,
) -> bytes:
    # The compliance is left out: a table exported to CSV comes back without it and is still the
    # same row.
    words = (component.encode(), fingerprint.encode(), source.encode())
    return content_key(*words, wrench, displacement, uncertainty or b"")


def _select(db: Connection, tail: str, values: tuple[object, ...]) -> list[LedgerRow]:
    found, damaged = sound(db.execute(f"SELECT {COLUMNS} FROM rows {tail}", values))
    if damaged:
        raise DamagedRowError(
            f"row {damaged[0]} is damaged on the disk and used nowhere; restore the ledger from a "
            "backup, or ask for its wrench again: it is then solved anew"
        )
    return found


def sound(records: Iterable[tuple]) -> tuple[list[LedgerRow], list[int]]:
    """Part the rows that are as they were written from the seqs of those that are not."""
    found, damaged = [], []
    for record in records:
        try:
            found.append(_row(*record))
        except (ValueError, TypeError, AttributeError):
            damaged.append(record[0])
    return found, damaged


def _row(seq: int, *fields: Any) -> LedgerRow:
    component, fingerprint, source, wrench, displacement, compliance, uncertainty = fields[:7]
    job, created, origin, key, mark = fields[7:]
    written = _key(component, fingerprint, source, wrench, displacement, uncertainty)
    if written != key or seal(key, compliance, origin) != mark:
        raise ValueError(f"row {seq} is not as it was written")
    return LedgerRow(
        seq,
        component,
        fingerprint,
        source,
        unpack6(wrench),
        unpack6(displacement),
        None if compliance is None else unpack36(compliance),
        None if uncertainty is None else unpack6(uncertainty),
        job,
        created,
        origin,
    )
