"""SQL of the rows. Each function takes a connection inside the caller's transaction."""

from collections.abc import Iterable, Iterator

from service.ledger.errors import UnknownRowError
from service.ledger.records import (
    LedgerRow,
    NewRow,
    content_key,
    pack6,
    pack36,
    unpack6,
    unpack36,
)
from service.ledger.schema import Connection

_COLUMNS = (
    "seq, component, fingerprint, source, wrench, displacement, compliance, uncertainty, "
    "job, created, origin"
)
_INSERT = (
    "INSERT INTO rows (component, fingerprint, source, wrench, displacement, compliance,"
    " uncertainty, job, created, origin, key) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)"
    " ON CONFLICT (key) DO NOTHING"
)


def add(
    db: Connection, component: str, fingerprint: str, row: NewRow, job: int, now: float
) -> LedgerRow:
    """Insert the row of a job, or find the row of the same content, and return it."""
    values = _values(component, fingerprint, row, job, now)
    db.execute(_INSERT, values)
    return _select(db, "WHERE key = ?", (values[-1],))[0]


def add_many(
    db: Connection, component: str, fingerprint: str, rows: Iterable[NewRow], now: float
) -> int:
    """Insert the rows that are not there yet and return how many those were."""
    values = (_values(component, fingerprint, row, None, now) for row in rows)
    return db.executemany(_INSERT, values).rowcount


def get(db: Connection, seq: int) -> LedgerRow:
    """Return a row by its id; raises UnknownRowError."""
    found = _select(db, "WHERE seq = ?", (seq,))
    if not found:
        raise UnknownRowError(f"there is no row {seq}")
    return found[0]


def listed(db: Connection, component: str, fingerprint: str | None, after: int) -> list[LedgerRow]:
    """Return the rows of a component above a seq, in order."""
    if fingerprint is None:
        where = "WHERE component = ? AND seq > ? ORDER BY seq"
        return _select(db, where, (component, after))
    where = "WHERE component = ? AND seq > ? AND fingerprint = ? ORDER BY seq"
    return _select(db, where, (component, after, fingerprint))


def last_seq(db: Connection, component: str | None) -> int:
    """Return the highest seq, 0 if there is none."""
    where = "" if component is None else "WHERE component = ?"
    values = () if component is None else (component,)
    return db.execute(f"SELECT coalesce(max(seq), 0) FROM rows {where}", values).fetchone()[0]


def start_after(db: Connection, seq: int) -> None:
    """Let the next row have a seq above this one."""
    db.execute(
        "INSERT INTO sqlite_sequence SELECT 'rows', 0 WHERE NOT EXISTS"
        " (SELECT 1 FROM sqlite_sequence WHERE name = 'rows')"
    )
    db.execute("UPDATE sqlite_sequence SET seq = max(seq, ?) WHERE name = 'rows'", (seq,))


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
    # The compliance is left out of the key: a table exported to CSV comes back without it
    # and is still the same row.
    key = content_key(
        component.encode(),
        fingerprint.encode(),
        row.source.encode(),
        wrench,
        displacement,
        uncertainty or b"",
    )
    return (
        component,
        fingerprint,
        row.source,
        wrench,
        displacement,
        compliance,
        uncertainty,
        job,
        now,
        row.origin,
        key,
    )


def _select(db: Connection, tail: str, values: tuple[object, ...]) -> list[LedgerRow]:
    found = db.execute(f"SELECT {_COLUMNS} FROM rows {tail}", values)
    return list(_read(found))


def _read(records: Iterable[tuple]) -> Iterator[LedgerRow]:
    for seq, component, fingerprint, source, wrench, displacement, c, u, *rest in records:
        compliance = None if c is None else unpack36(c)
        uncertainty = None if u is None else unpack6(u)
        yield LedgerRow(
            seq,
            component,
            fingerprint,
            source,
            unpack6(wrench),
            unpack6(displacement),
            compliance,
            uncertainty,
            *rest,
        )
