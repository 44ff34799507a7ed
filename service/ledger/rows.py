"""SQL of rows. Each function takes a connection inside the caller's transaction.

Rows and edits (a withdrawal, its undoing) are numbered by one sequence: one number says how far a
reader has read.
"""

import logging
import math
import time
from collections.abc import Iterable, Iterator, Sequence
from hashlib import blake2b
from typing import Any

import numpy as np

from wrenchbook.service.ledger.connection import Connection
from wrenchbook.service.ledger.packing import (
    MIN_NUMBERS,
    row_key,
    row_records,
    seal,
    unpack_vector,
    unpacked,
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
from wrenchbook.surrogate.table.rows import Rows
from wrenchbook.surrogate.table.space import DEFAULT, Input, Output, Space

_log = logging.getLogger(__name__)

MAX_CHANGES = 20_000  # rows returned at once
CONTENT = (
    "component, fingerprint, source, wrench, displacement, compliance, curvature, uncertainty, "
    "job, created, origin, key, seal"
)
_COLUMNS = f"seq, {CONTENT}"
_PLACES = ", ".join("?" for _ in CONTENT.split(","))
INSERT = f"INSERT INTO rows ({CONTENT}) VALUES ({_PLACES}) ON CONFLICT (key) DO NOTHING"
# Rows of an import that has not ended are hidden. Parts do not overlap, so the one that begins
# last before a row is the only one that can contain it.
SHOWN = (
    "coalesce((SELECT part.last FROM import_parts part WHERE part.hidden = 1"
    " AND part.first <= rows.seq ORDER BY part.first DESC LIMIT 1), 0) < rows.seq"
)
# With max(), SQLite gives that record's columns: the newest edit of a row is the valid one.
_LIVE = (
    "seq NOT IN (SELECT row FROM (SELECT row, withdrawn, max(seq) FROM edits"
    " WHERE component = :component AND seq <= :until GROUP BY row) WHERE withdrawn)"
    f" AND {SHOWN}"
)
_EVER = 2**63 - 1
_DIGESTED = 10_000  # rows read at once for a digest: half the time of one by one
_MAX_VALUES = 500  # of one statement; SQLite before 3.32 takes 999


def in_parts(values: Iterable[Any]) -> Iterator[tuple[str, list[Any]]]:
    """Yield the placeholders and values of `IN (...)`, some at a time."""
    every = list(values)
    for start in range(0, len(every), _MAX_VALUES):
        part = every[start : start + _MAX_VALUES]
        yield ", ".join("?" * len(part)), part


# -- writing ----------------------------------------------------------------------------------


def insert(
    db: Connection, component: str, records: Sequence[Any], *, above: int = 0
) -> tuple[int, int]:
    """Insert packed rows; return how many were new and how many known, by their keys.

    New rows get a seq above `above`. A hidden row of a running import counts as new, and is shown.
    """
    if above:
        _skip(db, least=above)
    new = db.executemany(INSERT, records).rowcount if records else 0
    if first_hidden(db, None) is not None:
        for marks, keys in in_parts(record[-2] for record in records):
            select = f"SELECT seq FROM rows WHERE key IN ({marks}) AND NOT ({SHOWN})"
            new += sum(_show(db, seq) for (seq,) in db.execute(select, keys).fetchall())
    db.rows += new
    return new, len(records) - new


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

    A withdrawn row of the same content is restored, since the solve has confirmed it; a damaged
    row is written again. An output whose uncertainty is not known is NaN, but not all of them.
    Raises ValueError if a number is not finite or a length is wrong.
    """
    columns = {name: value for name, value in known.items() if value is not None}
    for name, value in {"displacement": displacement, **columns}.items():
        finite = np.isfinite(np.asarray(value, dtype=float))
        if not (finite.any() if name == "uncertainty" else finite.all()):
            raise ValueError(f"{name} must be finite, got {value}")
    if len(displacement) < MIN_NUMBERS:
        raise ValueError(f"displacement needs 6 numbers or more, got {len(displacement)}")
    inputs = (Input("", "", "scalar"),) * len(job.wrench)  # of the space only the counts matter
    space = Space(inputs, (Output("", ""),) * len(displacement))
    columns |= {"source": source, "fingerprint": job.fingerprint}
    more = {name: [value] for name, value in columns.items()}
    block = NotedRows(Rows.of([job.wrench], [displacement], space, **more), [origin])
    (values,) = row_records(job.component, block, now, job.id)
    db.execute(INSERT, values)
    select = f"SELECT {_COLUMNS} FROM rows WHERE key = ?"
    record = db.execute(select, (values[-2],)).fetchone()
    seq = record[0]
    _show(db, seq)
    if not _is_sound(record):
        db.execute(f"UPDATE rows SET ({CONTENT}) = ({_PLACES}) WHERE seq = ?", (*values, seq))
        if not is_withdrawn(db, seq):
            edit(db, job.component, [seq], withdrawn=True, now=now)  # so that readers read it again
    if is_withdrawn(db, seq):
        edit(db, job.component, [seq], withdrawn=False, now=now)
    db.rows += 1
    return get(db, seq)


def rewrite(db: Connection, component: str, seq: int, rows: Rows) -> bool:
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
    created = created if isinstance(created, float) else now

    def values_of(note: str) -> Any:
        return row_records(component, NotedRows(rows, [note]), created, known and known[0])[0]

    values = values_of(str(origin))
    if values[-1] != mark:
        values = values_of("table file")
    other = "SELECT 1 FROM rows WHERE key = ? AND seq <> ?"
    if db.execute(other, (values[-2], seq)).fetchone():
        return False
    db.execute(f"UPDATE rows SET ({CONTENT}) = ({_PLACES}) WHERE seq = ?", (*values, seq))
    # Readers have passed this number; a withdrawal and its undoing make them read it again.
    withdrawn = is_withdrawn(db, seq)
    edit(db, component, [seq], withdrawn=not withdrawn, now=now)
    edit(db, component, [seq], withdrawn=withdrawn, now=now)
    return True


def place(db: Connection, component: str, rows: Rows, now: float) -> None:
    """Insert rows of a table file under the numbers that they had in a ledger that is gone."""
    records = row_records(component, NotedRows(rows, ["table file"] * len(rows)), now)
    numbered_records = (
        (seq, *values) for seq, values in zip(rows.seq.tolist(), records, strict=True)
    )
    insert = f"INSERT OR IGNORE INTO rows ({_COLUMNS}) VALUES (?, {_PLACES})"
    db.executemany(insert, numbered_records)


def withdraw(db: Connection, component: str, seq: int, *, withdrawn: bool = True) -> None:
    """Take a row out of the component's table, or back into it; it stays in the ledger.

    Raises UnknownRowError if the component has no such row, RowStatusError if it is so already.
    """
    same = f"SELECT 1 FROM rows WHERE seq = ? AND component = ? AND {SHOWN}"
    if db.execute(same, (seq, component)).fetchone() is None:
        raise UnknownRowError(f"the table of {component!r} has no row {seq}")
    if is_withdrawn(db, seq) == withdrawn:
        raise RowStatusError(f"row {seq} is {'withdrawn already' if withdrawn else 'in the table'}")
    edit(db, component, [seq], withdrawn=withdrawn, now=time.time())


def restore(db: Connection, component: str, seq: int) -> None:
    """Bring a withdrawn row back into the component's table; raises as `withdraw` does."""
    withdraw(db, component, seq, withdrawn=False)


def edit(
    db: Connection, component: str, seqs: Sequence[int], *, withdrawn: bool, now: float
) -> None:
    """Withdraw or restore rows of a component, of which none is so already."""
    first = _skip(db, len(seqs)) - len(seqs) + 1
    edits = ((first + k, component, seq, withdrawn, now) for k, seq in enumerate(seqs))
    db.executemany("INSERT INTO edits VALUES (?, ?, ?, ?, ?)", edits)
    db.rows += len(seqs)


def replay(db: Connection, component: str, edits: Iterable[RowEdit]) -> int:
    """Repeat edits that are newer than the ledger's of the same row; return how many rows changed.

    An edit of a row that is not there changes nothing.
    """
    newest = "SELECT created FROM edits WHERE row = ? ORDER BY seq DESC LIMIT 1"
    same = "SELECT seq FROM rows WHERE key = ? AND component = ?"
    changed = 0
    for key, withdrawn, created in edits:
        row = db.execute(same, (key, component)).fetchone()
        if row is None or is_withdrawn(db, row[0]) == withdrawn:
            continue
        last = db.execute(newest, row).fetchone()
        if last is None or last[0] < created:
            edit(db, component, row, withdrawn=withdrawn, now=created)
            changed += 1
    return changed


def _skip(db: Connection, count: int = 0, least: int = 0) -> int:
    """Leave out `count` numbers of the sequence, and all up to `least`; return the last of them."""
    db.execute(
        "INSERT INTO sqlite_sequence SELECT 'rows', 0 WHERE NOT EXISTS"
        " (SELECT 1 FROM sqlite_sequence WHERE name = 'rows')"
    )
    db.execute(
        "UPDATE sqlite_sequence SET seq = max(seq + ?, ?) WHERE name = 'rows'", (count, least)
    )
    return db.execute("SELECT seq FROM sqlite_sequence WHERE name = 'rows'").fetchone()[0]


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

    Those of a setup's and measured rows if its fingerprint is given. Of new rows only the first
    `most`; the changes then end with the last of them.
    """
    newest = last_seq(db, component)
    values: dict[str, Any] = {"component": component, "after": after, "most": most}
    values |= {"until": newest}
    touched = (
        "SELECT row FROM edits WHERE component = :component AND seq > :after AND seq <= :until"
    )
    gone = frozenset(seq for (seq,) in db.execute(touched, values))
    old = _live(db, f"seq <= :after AND seq IN ({touched})", values)
    new = _live(db, "seq > :after AND seq <= :until", values, " LIMIT :most")
    cut = len(new) == most
    rows = _as_rows(_sound(db, old + new, fingerprint), space).rows
    return RowChanges(rows, gone, new[-1][0] if cut else newest, whole=not cut)


def table_at(
    db: Connection,
    component: str,
    version: int | None = None,
    *,
    space: Space = DEFAULT,
    fingerprint: str | None = None,
) -> TableAt:
    """Return a component's table as it was at a version, now if None; read within `db`'s state.

    Raises UnknownVersionError if the table has not come to that version yet.
    """
    newest = last_seq(db, component)
    if version is not None and not 0 <= version <= newest:
        raise UnknownVersionError(
            f"the table of {component!r} has the versions 0 to {newest}, not {version}"
        )
    until = newest if version is None else version
    known = db.execute(
        "SELECT max(uncertainty IS NOT NULL), max(compliance IS NOT NULL),"
        " max(curvature IS NOT NULL), max(origin <> ''), max(fingerprint <> '')"
        f" FROM rows WHERE component = ? AND seq <= ? AND {SHOWN}",
        (component, until),
    ).fetchone()

    def lots() -> Iterator[NotedRows]:
        values: dict[str, Any] = {"component": component, "until": until, "after": 0}
        values |= {"most": MAX_CHANGES}
        while records := _live(db, "seq > :after AND seq <= :until", values, " LIMIT :most"):
            yield _as_rows(_sound(db, records, fingerprint), space)
            values["after"] = records[-1][0]

    return TableAt(until, tuple(map(bool, known)), lots())


def get(db: Connection, seq: int) -> LedgerRow:
    """Return a row by its seq, withdrawn or not; raises UnknownRowError, DamagedRowError."""
    record = db.execute(f"SELECT {_COLUMNS} FROM rows WHERE seq = ? AND {SHOWN}", (seq,)).fetchone()
    if record is None:
        raise UnknownRowError(f"there is no row {seq}")
    if not _is_sound(record):
        raise DamagedRowError(
            f"row {seq} is damaged on the disk and used nowhere; restore the ledger from a "
            "backup, or ask for its wrench again: it is then solved anew"
        )
    return _as_row(record)


def numbered(db: Connection, seqs: Iterable[int]) -> dict[int, LedgerRow]:
    """Return those of some rows that are there and undamaged, by number."""
    rows = {}
    for marks, part in in_parts(seqs):
        records = db.execute(f"SELECT {_COLUMNS} FROM rows WHERE seq IN ({marks})", part)
        rows |= {record[0]: _as_row(record) for record in records if _is_sound(record)}
    return rows


def damaged(db: Connection) -> dict[int, str]:
    """Return the damaged rows of the ledger, with the component they name. All rows are read."""
    records = db.execute(f"SELECT {_COLUMNS} FROM rows ORDER BY seq")
    return {record[0]: str(record[1]) for record in records if not _is_sound(record)}


def is_withdrawn(db: Connection, seq: int) -> bool:
    """Return whether a row is withdrawn."""
    newest = "SELECT withdrawn FROM edits WHERE row = ? ORDER BY seq DESC LIMIT 1"
    edited = db.execute(newest, (seq,)).fetchone()
    return bool(edited and edited[0])


def is_usable(db: Connection, seq: int) -> bool:
    """Return whether a row is undamaged, shown and not withdrawn."""
    try:
        get(db, seq)
    except (UnknownRowError, DamagedRowError):
        return False
    return not is_withdrawn(db, seq)


def first_hidden(db: Connection, component: str | None) -> int | None:
    """Return the number of the first hidden row (of one component); None if there is none."""
    where = "" if component is None else "AND component = :component"
    select = f"SELECT min(first) FROM import_parts WHERE hidden = 1 {where}"
    return db.execute(select, {"component": component}).fetchone()[0]


def last_seq(db: Connection, component: str | None = None) -> int:
    """Return the number of the newest row, withdrawal or restoring (of one component), or 0.

    During an import of a component the numbers end before the first hidden row, so that readers
    have not passed its rows when they are shown.
    """
    where = "" if component is None else "WHERE component = :component"
    newest = ", ".join(
        f"coalesce((SELECT max(seq) FROM {table} {where}), 0)" for table in ("rows", "edits")
    )
    last = db.execute(f"SELECT max({newest})", {"component": component}).fetchone()[0]
    hidden = first_hidden(db, component)
    return last if hidden is None else min(last, hidden - 1)


def count_new(db: Connection, component: str, fingerprint: str, after: int) -> int:
    """Return the number of a setup's and measured rows after a seq; 0.3 us a row."""
    values = {"component": component, "after": after, "fingerprint": fingerprint}
    return db.execute(
        f"SELECT count(*) FROM rows WHERE component = :component AND {_LIVE}"
        " AND seq > :after AND seq <= :until AND fingerprint IN ('', :fingerprint)",
        {**values, "until": last_seq(db, component)},
    ).fetchone()[0]


def count_rows(db: Connection, component: str) -> int:
    """Return how many rows a component has, withdrawn ones and those of other setups too."""
    select = f"SELECT count(*) FROM rows WHERE component = ? AND {SHOWN}"
    return db.execute(select, (component,)).fetchone()[0]


def known_rows(db: Connection, keys: Iterable[bytes]) -> set[bytes]:
    """Return those of these rows' keys that are in the ledger."""
    known: set[bytes] = set()
    for marks, part in in_parts(keys):
        select = f"SELECT key FROM rows WHERE key IN ({marks}) AND {SHOWN}"
        known.update(key for (key,) in db.execute(select, part))
    return known


def of_other_setups(db: Connection, component: str, fingerprint: str) -> dict[bytes, int]:
    """Return how many rows of other setups have each wrench (packed), the oldest first.

    They are in no table. Measured rows, of no setup, and withdrawn ones do not count.
    """
    select = (
        "SELECT wrench, count(*) FROM rows WHERE component = :component AND fingerprint <> ''"
        f" AND fingerprint <> :fingerprint AND {_LIVE} GROUP BY wrench ORDER BY min(seq)"
    )
    values = {"component": component, "fingerprint": fingerprint, "until": _EVER}
    return dict(db.execute(select, values).fetchall())


def digest(db: Connection, component: str, until: int) -> str:
    """Return a digest of which rows a component has, and their edits, up to a seq."""
    total, values = blake2b(digest_size=16), (component, until)
    where = "WHERE component = ? AND seq <= ? ORDER BY seq"
    keys = db.execute(f"SELECT seq, key FROM rows {where}", values)
    while some := keys.fetchmany(_DIGESTED):
        total.update(b"".join([b"row %d %b" % record for record in some]))
    for record in db.execute(f"SELECT seq, row, withdrawn FROM edits {where}", values):
        total.update(b"edit %d %d %d" % record)
    return total.hexdigest()


def edits(db: Connection, component: str, until: int) -> list[RowEdit]:
    """Return the newest edit, up to a seq, of each of a component's rows that had one."""
    # With max(), SQLite gives that record's columns.
    select = (
        "SELECT rows.key, withdrawn, edits.created, max(edits.seq) FROM edits"
        " JOIN rows ON rows.seq = row WHERE edits.component = ? AND edits.seq <= ?"
        " GROUP BY row ORDER BY row"
    )
    records = db.execute(select, (component, until))
    return [RowEdit(key, bool(withdrawn), created) for key, withdrawn, created, _ in records]


def _live(db: Connection, where: str, values: dict[str, Any], limit: str = "") -> list[Any]:
    """Return the records of a component's rows that are not withdrawn, by number."""
    select = f"SELECT {_COLUMNS} FROM rows WHERE component = :component AND {_LIVE}"
    return db.execute(f"{select} AND {where} ORDER BY seq{limit}", values).fetchall()


def _sound(db: Connection, records: Iterable[Any], fingerprint: str | None) -> list[Any]:
    """Return the undamaged records of a setup, of all if None, and measured ones.

    Damaged ones are noted, and logged once.
    """
    sound = []
    for record in records:
        if _is_sound(record):
            if fingerprint is None or record[2] in ("", fingerprint):
                sound.append(record)
        else:
            seq, component = record[:2]
            if seq not in db.damaged:
                _log.error("row %d of %s is damaged on the disk and left out", seq, component)
            db.damaged[seq] = component
    return sound


def _is_sound(record: Any) -> bool:
    """Return whether a row is as it was written."""
    (_, component, fingerprint, source, wrench, displacement, compliance, curvature, uncertainty,
     _, _, origin, key, mark) = record  # fmt: skip
    try:
        written = row_key(component, fingerprint, source, wrench, displacement, uncertainty)
        return written == key and seal(key, compliance, origin, curvature) == mark
    except (ValueError, TypeError, AttributeError):
        return False  # of another type


def _as_row(record: Any) -> LedgerRow:
    (seq, component, fingerprint, source, wrench, displacement, compliance, curvature, uncertainty,
     job, created, origin, _, _) = record  # fmt: skip
    loads, flat = unpack_vector(wrench), unpack_vector(compliance or b"")
    return LedgerRow(
        seq,
        component,
        fingerprint,
        source,
        loads,
        unpack_vector(displacement),
        tuple(flat[k : k + len(loads)] for k in range(0, len(flat), len(loads))) or None,
        uncertainty and unpack_vector(uncertainty),
        job,
        created,
        origin,
        curvature and unpack_vector(curvature),
    )


def _as_rows(records: Sequence[Any], space: Space) -> NotedRows:
    """Return undamaged records as columns; raises ValueError if one is of another space."""
    inputs, outputs = len(space.inputs), len(space.outputs)
    for record in records:
        if (len(record[4]), len(record[5])) != (8 * inputs, 8 * outputs):
            raise ValueError(
                f"row {record[0]} has {len(record[4]) // 8} loads and {len(record[5]) // 8} "
                f"displacements; the component has {inputs} and {outputs}"
            )
    columns = list(zip(*records, strict=True)) or [()] * 14
    more = {}
    shapes = (outputs, inputs), (space.curvatures,), (outputs,)
    names = "compliance", "curvature", "uncertainty"
    for name, column, shape in zip(names, columns[6:9], shapes, strict=True):
        if any(value is not None for value in column):
            blank = np.full(shape, np.nan).tobytes()
            flat = unpacked((value or blank for value in column), math.prod(shape))
            more[name] = flat.reshape(-1, *shape)
    rows = Rows.of(
        unpacked(columns[4], inputs),
        unpacked(columns[5], outputs),
        space,
        seq=np.array(columns[0], dtype=np.int64),
        fingerprint=list(columns[2]),
        source=list(columns[3]),
        **more,
    )
    return NotedRows(rows, columns[11], columns[10])
