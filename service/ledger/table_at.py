"""SQL of a table as it was at a version, and of what is known of its rows."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from wrenchbook.service.ledger import imports
from wrenchbook.service.ledger.records import LedgerRow
from wrenchbook.service.ledger.rows import COLUMNS, LIVE, sound
from wrenchbook.service.ledger.schema import Connection


@dataclass(frozen=True)
class TableAt:
    """A component's table at a version.

    Attributes
    ----------
    version : int
        The number of the newest change in it.
    known : tuple of bool
        Whether any row has an uncertainty, tangents, a note, a fingerprint.
    lots : iterator of lists of LedgerRow
        Its rows, some at a time.
    """

    version: int
    known: tuple[bool, bool, bool, bool]
    lots: Iterator[list[LedgerRow]]


def at_version(
    db: Connection, component: str, until: int, most: int
) -> Iterator[tuple[list[LedgerRow], list[int]]]:
    """Yield the rows that a component's table had at a version, some at a time, by number.

    With each lot the numbers of damaged rows, which are left out.
    """
    select = (
        f"SELECT {COLUMNS} FROM rows WHERE component = :component AND {LIVE}"
        " AND seq > :after AND seq <= :until ORDER BY seq LIMIT :most"
    )
    values = {"component": component, "until": until, "after": 0, "most": most}
    while True:
        records = db.execute(select, values).fetchall()
        if records:
            yield sound(records)
        if len(records) < most:
            return
        values["after"] = records[-1][0]


def known_blocks(db: Connection, component: str, until: int) -> tuple[bool, bool, bool, bool]:
    """Return whether any row of a table has an uncertainty, tangents, a note, a fingerprint."""
    found = db.execute(
        "SELECT max(uncertainty IS NOT NULL), max(compliance IS NOT NULL), max(origin <> ''),"
        f" max(fingerprint <> '') FROM rows WHERE component = ? AND seq <= ? AND {imports.SHOWN}",
        (component, until),
    ).fetchone()
    uncertainty, compliance, note, fingerprint = map(bool, found)
    return uncertainty, compliance, note, fingerprint


def known_keys(db: Connection, keys: Sequence[bytes]) -> set[bytes]:
    """Return those of some rows' keys that are in the ledger, for anybody to see."""
    marks = ", ".join("?" * len(keys))
    select = f"SELECT key FROM rows WHERE key IN ({marks}) AND {imports.SHOWN}"
    return {key for (key,) in db.execute(select, list(keys))}
