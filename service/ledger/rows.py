"""SQL of the rows. Each function takes a connection inside the caller's transaction.

Rows and edits (a withdrawal, its undoing) are numbered by one sequence, so that one number tells
a follower how far it has read.
"""

from collections.abc import Iterable
from hashlib import blake2b
from typing import Any

from service.ledger.errors import DamagedRowError, RowStatusError, UnknownRowError
from service.ledger.records import (
    LedgerRow,
    NewRow,
    News,
    RowEdit,
    content_key,
    pack6,
    pack36,
    seal,
    unpack6,
    unpack36,
)
from service.ledger.schema import Connection

_COLUMNS = (
    "seq, component, fingerprint, source, wrench, displacement, compliance, uncertainty, "
    "job, created, origin, key, seal"
)
_CONTENT = _COLUMNS.removeprefix("seq, ")
_PLACES = ", ".join("?" for _ in _CONTENT.split(","))
_INSERT = f"INSERT INTO rows ({_CONTENT}) VALUES ({_PLACES}) ON CONFLICT (key) DO NOTHING"
# The newest edit of a row says how it stands: beside max(), SQLite gives that record's columns.
_LIVE = (
    "seq NOT IN (SELECT row FROM (SELECT row, withdrawn, max(seq) FROM edits"
    " WHERE component = :component GROUP BY row) WHERE withdrawn)"
)


def add(
    db: Connection, component: str, fingerprint: str, row: NewRow, job: int, now: float
) -> LedgerRow:
    """Insert the row of a job, or find the row of the same content, and return it.

    If that one was withdrawn, solving it again has confirmed it, and it is restored; if it was
    damaged, it is as it was written again.
    """
    values = _values(component, fingerprint, row, job, now)
    db.execute(_INSERT, values)
    same, damaged = _sound(db.execute(f"SELECT {_COLUMNS} FROM rows WHERE key = ?", (values[-2],)))
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
    """Insert those of `packed` rows that are not there yet and return how many those were."""
    return db.executemany(_INSERT, rows).rowcount if rows else 0


def get(db: Connection, seq: int) -> LedgerRow:
    """Return a row by its id; raises UnknownRowError, DamagedRowError."""
    found = _select(db, "WHERE seq = ?", (seq,))
    if not found:
        raise UnknownRowError(f"there is no row {seq}")
    return found[0]


def listed(
    db: Connection, component: str, fingerprint: str | None, after: int
) -> tuple[list[LedgerRow], list[int]]:
    """Return a component's rows above a seq but withdrawn ones, and the seqs of damaged ones."""
    where = f"WHERE component = :component AND seq > :after AND {_LIVE}"
    if fingerprint is not None:
        where += " AND fingerprint = :fingerprint"
    values = {"component": component, "after": after, "fingerprint": fingerprint}
    return _sound(db.execute(f"SELECT {_COLUMNS} FROM rows {where} ORDER BY seq", values))


def news(db: Connection, component: str, after: int, most: int) -> tuple[News, list[int]]:
    """Return what happened to a component's rows above a seq, and the seqs of damaged ones.

    Of new rows only the first `most`; the news then end with the last of them.
    """
    values = {"component": component, "after": after, "most": most}
    touched = "SELECT row FROM edits WHERE component = :component AND seq > :after"
    gone = frozenset(seq for (seq,) in db.execute(touched, values))
    select = f"SELECT {_COLUMNS} FROM rows WHERE component = :component AND {_LIVE}"
    again = f"{select} AND seq <= :after AND seq IN ({touched}) ORDER BY seq"
    fresh = f"{select} AND seq > :after ORDER BY seq LIMIT :most"
    old, broken = _sound(db.execute(again, values))
    new, damaged = _sound(db.execute(fresh, values))
    whole = len(new) + len(damaged) < most
    until = last_seq(db, component) if whole else max(damaged + [row.seq for row in new[-1:]])
    return News(old + new, gone, until, whole), broken + damaged


def last_seq(db: Connection, component: str | None) -> int:
    """Return the number of the newest row or edit, 0 if there is none."""
    where = "" if component is None else "WHERE component = :component"
    newest = ", ".join(
        f"coalesce((SELECT max(seq) FROM {table} {where}), 0)" for table in ("rows", "edits")
    )
    return db.execute(f"SELECT max({newest})", {"component": component}).fetchone()[0]


def count(db: Connection, component: str) -> int:
    """Return how many rows a component has, withdrawn ones too."""
    found = db.execute("SELECT count(*) FROM rows WHERE component = ?", (component,))
    return found.fetchone()[0]


def digest(db: Connection, component: str, until: int) -> str:
    """Return a digest of which rows a component has, and their edits, up to and with a seq."""
    whole = blake2b(digest_size=16)
    values = (component, until)
    where = "WHERE component = ? AND seq <= ? ORDER BY seq"
    for seq, key in db.execute(f"SELECT seq, key FROM rows {where}", values):
        whole.update(b"row %d " % seq + key)
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
    found, _ = _sound(db.execute(f"SELECT {_COLUMNS} FROM rows WHERE seq = ?", (seq,)))
    return bool(found) and not is_withdrawn(db, seq)


def edit(db: Connection, component: str, seq: int, *, withdrawn: bool, now: float) -> None:
    """Withdraw or restore a component's row; raises UnknownRowError, RowStatusError."""
    same = "SELECT 1 FROM rows WHERE seq = ? AND component = ?"
    if db.execute(same, (seq, component)).fetchone() is None:
        raise UnknownRowError(f"the table of {component!r} has no row {seq}")
    if is_withdrawn(db, seq) == withdrawn:
        raise RowStatusError(f"row {seq} is {'withdrawn already' if withdrawn else 'in the table'}")
    number = skip(db, 1)
    db.execute("INSERT INTO edits VALUES (?, ?, ?, ?, ?)", (number, component, seq, withdrawn, now))


def newest_edits(db: Connection, component: str, until: int) -> list[RowEdit]:
    """Return the newest edit, up to a seq, of each of a component's rows that had one."""
    # Beside max(), SQLite gives that record's columns.
    found = db.execute(
        "SELECT rows.key, withdrawn, edits.created, max(edits.seq) FROM edits"
        " JOIN rows ON rows.seq = row WHERE edits.component = ? AND edits.seq <= ?"
        " GROUP BY row ORDER BY row",
        (component, until),
    )
    return [RowEdit(key, bool(withdrawn), created) for key, withdrawn, created, _ in found]


def replay(db: Connection, component: str, edits: Iterable[RowEdit]) -> int:
    """Repeat edits that are newer than what a row has had; return how many changed a row.

    Those of rows that are not there change nothing.
    """
    newest = "SELECT created FROM edits WHERE row = ? ORDER BY seq DESC LIMIT 1"
    same = "SELECT seq FROM rows WHERE key = ? AND component = ?"
    changed = 0
    for key, withdrawn, created in edits:
        found = db.execute(same, (key, component)).fetchone()
        if found is None or is_withdrawn(db, found[0]) == withdrawn:
            continue
        last = db.execute(newest, found).fetchone()
        if last is None or last[0] < created:
            edit(db, component, found[0], withdrawn=withdrawn, now=created)
            changed += 1
    return changed


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
    found, damaged = _sound(db.execute(f"SELECT {_COLUMNS} FROM rows {tail}", values))
    if damaged:
        raise DamagedRowError(
            f"row {damaged[0]} is damaged on the disk and used nowhere; restore the ledger from a "
            "backup, or ask for its wrench again: it is then solved anew"
        )
    return found


def _sound(records: Iterable[tuple]) -> tuple[list[LedgerRow], list[int]]:
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
