"""SQL of imports: who loaded which rows, and which rows are there but not to be seen yet.

A large table is taken in by many short transactions, so that nobody waits long for the ledger; its
rows are hidden until the last of them is in, and one small transaction then shows all of them. What
a killed process has left hidden is deleted: it was never told to anybody.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from wrenchbook.service.ledger.schema import Connection

# Parts do not overlap, so the one that begins last before a row is the only one that can hold it.
SHOWN = (
    "coalesce((SELECT part.last FROM import_parts part WHERE part.hidden = 1"
    " AND part.first <= rows.seq ORDER BY part.first DESC LIMIT 1), 0) < rows.seq"
)
_COLUMNS = "id, component, created, who, filename, format, digest, note, rows"
_MOST_KEYS = 500  # in one statement


@dataclass(frozen=True)
class About:
    """Where the rows of an import come from, in the words of who sent them.

    Attributes
    ----------
    who : str
        The key, or the user, that sent them.
    filename, format, note : str
    digest : str
        SHA-256 of the file, hexadecimal.
    """

    who: str = ""
    filename: str = ""
    format: str = ""
    digest: str = ""
    note: str = ""


@dataclass(frozen=True)
class Import:
    """One import: what it was, when (seconds since the epoch), and how many rows it brought."""

    id: int
    component: str
    created: float
    who: str
    filename: str
    format: str
    digest: str
    note: str
    rows: int


def begin(db: Connection, component: str, about: About, now: float) -> int:
    """Note that an import begins; returns its number."""
    values = (component, now, about.who, about.filename, about.format, about.digest, about.note)
    marks = ", ".join("?" * 7)
    columns = _COLUMNS.removeprefix("id, ")
    return _new_id(db.execute(f"INSERT INTO imports ({columns}) VALUES ({marks}, 0)", values))


def note_part(db: Connection, number: int, component: str, span: tuple[int, int], hidden: bool):
    """Note that an import has brought the rows of these numbers."""
    grown = db.execute(
        "UPDATE import_parts SET last = ? WHERE import = ? AND last = ? AND hidden = ?",
        (span[1], number, span[0] - 1, hidden),
    )
    if not grown.rowcount:
        values = (*span, number, component, hidden)
        db.execute("INSERT INTO import_parts VALUES (?, ?, ?, ?, ?)", values)


def finish(db: Connection, number: int, rows: int) -> None:
    """Show the rows of an import."""
    db.execute("UPDATE imports SET rows = ? WHERE id = ?", (rows, number))
    db.execute("UPDATE import_parts SET hidden = 0 WHERE import = ?", (number,))


def first_hidden(db: Connection, component: str | None) -> int | None:
    """Return the number of the first row that is not to be seen yet; None if there is none."""
    where = "" if component is None else "AND component = ?"
    values = () if component is None else (component,)
    return db.execute(
        f"SELECT min(first) FROM import_parts WHERE hidden = 1 {where}", values
    ).fetchone()[0]


def show_one(db: Connection, seq: int) -> bool:
    """Take one row out of the hidden ones: somebody else has brought the same."""
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


def show_many(db: Connection, keys: Sequence[object]) -> int:
    """Take rows with these keys out of the hidden ones; returns how many there were."""
    if first_hidden(db, None) is None:
        return 0
    shown = 0
    for start in range(0, len(keys), _MOST_KEYS):
        some = list(keys[start : start + _MOST_KEYS])
        marks = ", ".join("?" * len(some))
        select = f"SELECT seq FROM rows WHERE key IN ({marks}) AND NOT ({SHOWN})"
        shown += sum(show_one(db, seq) for (seq,) in db.execute(select, some).fetchall())
    return shown


def drop_hidden(db: Connection, most: int) -> bool:
    """Delete some of the hidden rows, the last first; tell whether there are more.

    Their numbers are given to nobody else.
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
    start = max(first, last - most + 1)
    db.execute("DELETE FROM rows WHERE seq BETWEEN ? AND ?", (start, last))
    if start == first:
        db.execute("DELETE FROM import_parts WHERE first = ?", (first,))
    else:
        db.execute("UPDATE import_parts SET last = ? WHERE first = ?", (start - 1, first))
    return True


def listed(db: Connection, component: str, most: int) -> list[Import]:
    """Return the imports of a component, newest first."""
    select = (
        f"SELECT {_COLUMNS} FROM imports WHERE component = ? AND NOT EXISTS"
        " (SELECT 1 FROM import_parts WHERE import = imports.id AND hidden = 1)"
        " ORDER BY id DESC LIMIT ?"
    )
    return [Import(*record) for record in db.execute(select, (component, most))]


def spans(db: Connection, component: str) -> list[tuple[int, int, Import]]:
    """Return which rows each import of a component brought, by their numbers."""
    columns = ", ".join(f"imports.{name.strip()}" for name in _COLUMNS.split(","))
    found = db.execute(
        f"SELECT first, last, {columns} FROM import_parts JOIN imports ON imports.id = import"
        " WHERE import_parts.component = ? AND hidden = 0 ORDER BY first",
        (component,),
    )
    return [(first, last, Import(*record)) for first, last, *record in found]


def of_row(db: Connection, seq: int) -> Import | None:
    """Return the import that brought a row; None if it was solved."""
    columns = ", ".join(f"imports.{name.strip()}" for name in _COLUMNS.split(","))
    found = db.execute(
        f"SELECT {columns} FROM import_parts JOIN imports ON imports.id = import"
        " WHERE first <= ? AND last >= ? ORDER BY first DESC LIMIT 1",
        (seq, seq),
    ).fetchone()
    return Import(*found) if found else None


def _new_id(cursor: object) -> int:
    number = getattr(cursor, "lastrowid", None)
    assert isinstance(number, int)
    return number
