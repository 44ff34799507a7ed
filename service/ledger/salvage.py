"""What can still be read of a damaged ledger, written into a new one."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from wrenchbook.service.ledger import rows
from wrenchbook.service.ledger.acknowledged import Acknowledged
from wrenchbook.service.ledger.records import NewRow
from wrenchbook.service.ledger.schema import (
    USE_ERRORS,
    Connection,
    connect,
    open_file,
    raise_sequences,
    sequences,
)

TABLES = (
    *("jobs", "rows", "edits", "gatherings", "recorded", "extremes", "blocks"),
    *("imports", "import_parts"),
)
_MOST_ROWID = 10_000_000  # where nothing tells the highest number
_MOST_NUMBER = 1 << 48  # more than will ever be given out; what is damaged may say more
_HEAD_BYTES = 100  # of a file: https://www.sqlite.org/fileformat.html
_MAGIC = b"SQLite format 3\0"
_MOST_BYTES = 1 << 34  # of a ledger; a damaged head may say more
_MOST_MISSES = 50_000  # reads that fail, at 20 µs: an end to looking into what is all gone


@dataclass(frozen=True)
class Salvaged:
    """What was read.

    Attributes
    ----------
    read : dict of str to int
        How many records of each table.
    reopened : int
        Done jobs whose row is lost, which wait again.
    given : int
        The highest number that was ever given to a job.
    lost_rows : int
        At most as many acknowledged rows are in neither copy. Edits and abandoned imports have
        numbers of rows as well.
    """

    read: dict[str, int]
    reopened: int
    given: int
    lost_rows: int


@dataclass(frozen=True)
class Spare:
    """A row of a table's file, with its number in the ledger."""

    component: str
    seq: int
    row: NewRow
    created: float


def salvage(damaged: Path, target: Path, spare: Iterable[Spare], noted: Acknowledged) -> Salvaged:
    """Write a new ledger from a damaged one, which is only read, and from the tables' files.

    Rows are taken from the files first: those have digests. A done job whose row is nowhere waits
    again, and no number that was given out is given out again.

    Parameters
    ----------
    damaged : path
        A copy that nobody else uses, with its log beside it.
    target : path
        The new ledger, which is not there yet.
    spare : iterable of Spare
    noted : Acknowledged
        What the damaged one had acknowledged.
    """
    source, new = _source(damaged), open_file(target)
    try:
        highest = _highest(source, noted.read()._asdict())
        new.execute("PRAGMA foreign_keys = OFF")
        new.execute("BEGIN IMMEDIATE")
        for one in spare:
            rows.place(new, one.component, one.seq, one.row, one.created)
        read = {name: _copy(source, new, name, highest) for name in TABLES}
        reopened = _settle(new)
        there = "SELECT (SELECT count(*) FROM rows) + (SELECT count(*) FROM edits)"
        lost_rows = max(0, noted.read().rows - new.execute(there).fetchone()[0])
        new.execute("COMMIT")
        raise_sequences(new, {name: highest.get(name, 0) for name in ("jobs", "rows")})
    finally:
        source.close()
        new.close()
    return Salvaged(read, reopened, highest.get("jobs", 0), lost_rows)


def _source(damaged: Path) -> Connection:
    """Open the damaged ledger, or an empty one if its first page, the table of all, is gone."""
    _pad(damaged)
    try:
        return connect(damaged)
    except USE_ERRORS:
        return connect(damaged.with_name("nothing.sqlite"))


def _pad(damaged: Path) -> None:
    """Give a file that was cut off its length again: SQLite reads no page of a shorter one."""
    with damaged.open("r+b") as file:
        head = file.read(_HEAD_BYTES)
        pages, size = int.from_bytes(head[28:32]), int.from_bytes(head[16:18])
        size = 65536 if size == 1 else size  # as the format writes it
        whole = pages * size
        if head.startswith(_MAGIC) and damaged.stat().st_size < whole < _MOST_BYTES:
            file.truncate(whole)  # a hole: it takes no room


def _highest(source: Connection, noted: dict[str, int]) -> dict[str, int]:
    try:
        known = sequences(source)
    except USE_ERRORS:
        return noted
    known = {name: n for name, n in known.items() if isinstance(n, int) and n < _MOST_NUMBER}
    both = noted.keys() | known.keys()
    return {name: max(noted.get(name, 0), known.get(name, 0)) for name in both}


def _copy(source: Connection, new: Connection, table: str, highest: dict[str, int]) -> int:
    columns = [name for _, name, *_ in new.execute(f"PRAGMA table_info({table})")]
    try:
        there = [name for _, name, *_ in source.execute(f"PRAGMA table_info({table})")]
    except USE_ERRORS:
        there = columns
    common = [name for name in columns if name in there]
    if not common:
        return 0
    numbered = "rows" if table in ("edits", "import_parts") else table
    until = highest.get(numbered, _MOST_ROWID)
    select = f"SELECT {', '.join(common)} FROM {table} NOT INDEXED WHERE rowid BETWEEN ? AND ?"
    marks = ", ".join("?" * len(common))
    insert = f"INSERT OR IGNORE INTO {table} ({', '.join(common)}) VALUES ({marks})"
    count = 0
    for record in _readable(source, select, until):
        try:
            count += new.execute(insert, record).rowcount
        except USE_ERRORS:
            continue  # its columns are not what they were
    return count


def _readable(source: Connection, select: str, until: int) -> Iterator[tuple]:
    """Give all records that can be read, halving each range of numbers that cannot."""
    ranges, misses = [(0, until)], 0
    while ranges and misses < _MOST_MISSES:
        first, last = ranges.pop()
        try:
            found = source.execute(select, (first, last)).fetchall()
        except USE_ERRORS:
            misses += 1
            if first < last:
                middle = (first + last) // 2
                ranges += [(middle + 1, last), (first, middle)]
            continue
        yield from found


def _settle(new: Connection) -> int:
    """Let what refers to something that is gone refer to nothing; returns the jobs reopened."""
    new.execute("UPDATE rows SET job = NULL WHERE job NOT IN (SELECT id FROM jobs)")
    new.execute("DELETE FROM edits WHERE row NOT IN (SELECT seq FROM rows)")
    return new.execute(
        "UPDATE jobs SET status = 'waiting', row = NULL, started = NULL, finished = NULL"
        " WHERE row IS NOT NULL AND row NOT IN (SELECT seq FROM rows)"
    ).rowcount
