"""The rows half of the ledger: inserting, withdrawing, restoring, reading and following."""

import logging
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

from wrenchbook.service.ledger import edits, rows
from wrenchbook.service.ledger.connections import Connections
from wrenchbook.service.ledger.errors import UnknownVersionError
from wrenchbook.service.ledger.listeners import Listeners
from wrenchbook.service.ledger.records import Change, LedgerRow, NewRow, RowChanges, RowEdit
from wrenchbook.service.ledger.schema import Connection
from wrenchbook.service.ledger.table_at import TableAt, at_version, known_blocks

_log = logging.getLogger(__name__)

MOST_CHANGES = 20_000  # rows told at once: 30 MB as Python holds them


class TableRows:
    """What `Ledger` does with rows.

    Attributes
    ----------
    damaged : dict of int to str
        Rows found to be other on the disk than they were written, with their component.
    """

    def __init__(self, db: Connections, listeners: Listeners) -> None:
        self._db = db
        self._listeners = listeners
        self.damaged: dict[int, str] = {}

    def insert_rows(
        self,
        component: str,
        fingerprint: str,
        new: Iterable[NewRow],
        *,
        dry_run: bool = False,
        above: int = 0,
    ) -> tuple[int, int]:
        """Insert rows, all or none, and return how many were new and how many known.

        A row of the same component, fingerprint, source, wrench, displacement and uncertainty
        is known, so inserting a table twice changes nothing the second time. With `dry_run`
        only the numbers are found out. New rows get a seq above `above`.

        Raises
        ------
        ValueError
            If a number is not finite or a length is wrong; then nothing was inserted.
        """
        # Packed and sealed before the lock is taken: other writers wait for the insertion alone.
        wanted = rows.packed(component, fingerprint, new, time.time())
        with self._db.writing(keep=not dry_run) as db:
            if above:
                rows.skip(db, least=above)
            inserted = rows.add_many(db, wanted)
        if inserted and not dry_run:
            self._listeners.tell(Change(component, rows=inserted))
        return inserted, len(wanted) - inserted

    def withdraw(self, component: str, seq: int) -> None:
        """Take a row out of the component's table; it stays in the ledger.

        Raises
        ------
        UnknownRowError
            If the component has no such row.
        RowStatusError
            If it is withdrawn already.
        """
        self._edit(component, seq, withdrawn=True)

    def restore(self, component: str, seq: int) -> None:
        """Bring a withdrawn row back into the component's table; raises as `withdraw` does."""
        self._edit(component, seq, withdrawn=False)

    def rows(
        self, component: str, fingerprint: str | None = None, after: int = 0
    ) -> list[LedgerRow]:
        """Return the rows of a component with a seq above `after`, by seq.

        Withdrawn rows are left out, and so are damaged ones, which `damaged` then names.
        """
        with self._db.reading() as db:
            found, damaged = rows.listed(db, component, fingerprint, after)
        self._note(component, damaged)
        return found

    def row_changes(self, component: str, after: int, most: int = MOST_CHANGES) -> RowChanges:
        """Return what happened to a component's rows after a seq; as `rows` leaves rows out.

        New rows are told `most` at a time.
        """
        with self._db.reading() as db:
            found, damaged = rows.row_changes(db, component, after, most)
        self._note(component, damaged)
        return found

    @contextmanager
    def table_at(self, component: str, version: int | None = None) -> Iterator[TableAt]:
        """Give a component's table as it was at a version, now if None, as one committed state.

        Raises
        ------
        UnknownVersionError
            If the table has not come to that version yet.
        """
        with self._db.reading() as db:
            newest = rows.last_seq(db, component)
            if version is not None and not 0 <= version <= newest:
                raise UnknownVersionError(
                    f"the table of {component!r} has the versions 0 to {newest}, not {version}"
                )
            until = newest if version is None else version
            known = known_blocks(db, component, until)
            yield TableAt(until, known, self._lots(db, component, until))

    def _lots(self, db: Connection, component: str, until: int) -> Iterator[list[LedgerRow]]:
        for found, damaged in at_version(db, component, until, MOST_CHANGES):
            self._note(component, damaged)
            yield found

    def row(self, seq: int) -> LedgerRow:
        """Return a row by its seq, withdrawn or not; raises UnknownRowError, DamagedRowError."""
        with self._db.reading() as db:
            return rows.get(db, seq)

    def is_withdrawn(self, seq: int) -> bool:
        """Return whether a row is withdrawn."""
        with self._db.reading() as db:
            return rows.is_withdrawn(db, seq)

    def last_seq(self, component: str | None = None) -> int:
        """Return the number of the newest row, withdrawal or restoring (of one component)."""
        with self._db.reading() as db:
            return rows.last_seq(db, component)

    def count_rows(self, component: str) -> int:
        """Return how many rows a component has, withdrawn ones and those of other setups too."""
        with self._db.reading() as db:
            return rows.count(db, component)

    def of_other_setups(self, component: str, fingerprint: str) -> dict[bytes, int]:
        """Return how many rows of other setups have each wrench (packed), the oldest first.

        They are in no table. Measured rows, of no setup, and withdrawn ones are none of them.
        """
        with self._db.reading() as db:
            return rows.of_other_setups(db, component, fingerprint)

    def digest(self, component: str, until: int) -> str:
        """Return a digest of which rows a component has up to a seq, and how they stand."""
        with self._db.reading() as db:
            return rows.digest(db, component, until)

    def edits(self, component: str, until: int) -> list[RowEdit]:
        """Return how each of a component's rows that was withdrawn or restored stands at a seq."""
        with self._db.reading() as db:
            return edits.newest_edits(db, component, until)

    def replay(self, component: str, wanted: Iterable[RowEdit]) -> int:
        """Withdraw and restore rows as edits say that are newer than the ledger's own.

        Returns how many rows changed; an edit of a row that is not there changes nothing.
        """
        with self._db.writing() as db:
            changed = edits.replay(db, component, wanted)
        if changed:
            self._listeners.tell(Change(component, rows=changed))
        return changed

    def _edit(self, component: str, seq: int, *, withdrawn: bool) -> None:
        with self._db.writing() as db:
            rows.edit(db, component, seq, withdrawn=withdrawn, now=time.time())
        self._listeners.tell(Change(component, rows=1))

    def _note(self, component: str, damaged: list[int]) -> None:
        for seq in damaged:
            if seq not in self.damaged:
                _log.error("row %d of %s is damaged on the disk and left out", seq, component)
            self.damaged[seq] = component
