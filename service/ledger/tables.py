"""Rows by component: inserting, withdrawing and restoring them, and reading tables and changes."""

import logging
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from hashlib import blake2b

from wrenchbook.service.ledger import rows
from wrenchbook.service.ledger.connection import Connection
from wrenchbook.service.ledger.connections import Database
from wrenchbook.service.ledger.packing import row_values
from wrenchbook.service.ledger.records import (
    Change,
    LedgerRow,
    NewRow,
    RowChanges,
    RowEdit,
    UnknownVersionError,
)
from wrenchbook.service.ledger.rows import COLUMNS, LIVE, SHOWN, sound

_log = logging.getLogger(__name__)

MOST_CHANGES = 20_000  # rows returned at once: 30 MB as Python objects
_EVER = 2**63 - 1
_DIGESTED = 10_000  # rows read at once for a digest: half the time of one by one


@dataclass(frozen=True)
class TableAt:
    """A component's table at a version.

    Attributes
    ----------
    version : int
        The number of the newest change in it.
    known : tuple of bool
        Whether any row has an uncertainty, tangents, a curvature, a note, a fingerprint.
    lots : iterator of lists of LedgerRow
        Its rows, at most `MOST_CHANGES` at a time.
    """

    version: int
    known: tuple[bool, ...]
    lots: Iterator[list[LedgerRow]]


class TableRows(Database):
    """The rows of the ledger.

    Attributes
    ----------
    damaged : dict of int to str
        Rows found to be damaged on the disk, with their component.
    """

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
        the rows are only counted. New rows get a seq above `above`.

        Raises
        ------
        ValueError
            If a number is not finite or a length is wrong; then nothing was inserted.
        """
        # Packed before the lock is taken: other writers wait for the insertion alone.
        now = time.time()
        packed = [row_values(component, fingerprint, row, None, now) for row in new]
        with self.writing(keep=not dry_run) as db:
            if above:
                rows.skip(db, least=above)
            inserted = rows.add_many(db, packed)
        if inserted and not dry_run:
            self.notify(Change(component, rows=inserted))
        return inserted, len(packed) - inserted

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

        Without withdrawn rows, and without damaged ones, which `damaged` then names.
        """
        where = "" if fingerprint is None else " AND fingerprint = :fingerprint"
        values = {"component": component, "after": after, "fingerprint": fingerprint}
        with self.reading() as db:
            return self._live(db, f"seq > :after{where}", {**values, "until": _EVER})[0]

    def row_changes(self, component: str, after: int, most: int = MOST_CHANGES) -> RowChanges:
        """Return the changes of a component's rows after a seq, without damaged rows.

        Of new rows only the first `most`; the changes then end with the last of them.
        """
        with self.reading() as db:
            newest = rows.last_seq(db, component)
            values = {"component": component, "after": after, "most": most, "until": newest}
            touched = (
                "SELECT row FROM edits WHERE component = :component"
                " AND seq > :after AND seq <= :until"
            )
            gone = frozenset(seq for (seq,) in db.execute(touched, values))
            old, _ = self._live(db, f"seq <= :after AND seq IN ({touched})", values)
            new, last = self._live(db, "seq > :after AND seq <= :until", values, " LIMIT :most")
        return RowChanges(old + new, gone, last or newest, whole=last is None)

    def count_new(self, component: str, fingerprint: str, after: int) -> int:
        """Return the number of a setup's and measured rows after a seq; 0.3 us a row."""
        with self.reading() as db:
            until = rows.last_seq(db, component)
            found = db.execute(
                f"SELECT count(*) FROM rows WHERE component = :component AND {LIVE}"
                " AND seq > :after AND seq <= :until AND fingerprint IN ('', :fingerprint)",
                {
                    "component": component,
                    "after": after,
                    "until": until,
                    "fingerprint": fingerprint,
                },
            )
            return found.fetchone()[0]

    @contextmanager
    def table_at(self, component: str, version: int | None = None) -> Iterator[TableAt]:
        """Give a component's table as it was at a version, now if None, as one committed state.

        Raises
        ------
        UnknownVersionError
            If the table has not come to that version yet.
        """
        with self.reading() as db:
            newest = rows.last_seq(db, component)
            if version is not None and not 0 <= version <= newest:
                raise UnknownVersionError(
                    f"the table of {component!r} has the versions 0 to {newest}, not {version}"
                )
            until = newest if version is None else version
            known = _known_blocks(db, component, until)
            yield TableAt(until, known, self._lots(db, component, until))

    def row(self, seq: int) -> LedgerRow:
        """Return a row by its seq, withdrawn or not; raises UnknownRowError, DamagedRowError."""
        with self.reading() as db:
            return rows.get(db, seq)

    def rows_of(self, seqs: Iterable[int]) -> dict[int, LedgerRow]:
        """Return those of these rows that are there and undamaged, by number."""
        with self.reading() as db:
            return rows.numbered(db, seqs)

    def known_rows(self, keys: Sequence[bytes]) -> int:
        """Return how many of these rows' keys are in the ledger, or occur earlier in `keys`."""
        found = 0
        with self.reading() as db:
            for marks, part in rows.in_parts(set(keys)):
                select = f"SELECT count(*) FROM rows WHERE key IN ({marks}) AND {SHOWN}"
                found += db.execute(select, part).fetchone()[0]
        return found + len(keys) - len(set(keys))

    def is_withdrawn(self, seq: int) -> bool:
        """Return whether a row is withdrawn."""
        with self.reading() as db:
            return rows.is_withdrawn(db, seq)

    def last_seq(self, component: str | None = None) -> int:
        """Return the number of the newest row, withdrawal or restoring (of one component)."""
        with self.reading() as db:
            return rows.last_seq(db, component)

    def count_rows(self, component: str) -> int:
        """Return how many rows a component has, withdrawn ones and those of other setups too."""
        select = f"SELECT count(*) FROM rows WHERE component = ? AND {SHOWN}"
        with self.reading() as db:
            return db.execute(select, (component,)).fetchone()[0]

    def of_other_setups(self, component: str, fingerprint: str) -> dict[bytes, int]:
        """Return how many rows of other setups have each wrench (packed), the oldest first.

        They are in no table. Measured rows, of no setup, and withdrawn ones do not count.
        """
        select = (
            "SELECT wrench, count(*) FROM rows WHERE component = :component AND fingerprint <> ''"
            f" AND fingerprint <> :fingerprint AND {LIVE} GROUP BY wrench ORDER BY min(seq)"
        )
        values = {"component": component, "fingerprint": fingerprint, "until": _EVER}
        with self.reading() as db:
            return dict(db.execute(select, values))

    def digest(self, component: str, until: int) -> str:
        """Return a digest of which rows a component has, and their edits, up to a seq."""
        whole = blake2b(digest_size=16)
        values = (component, until)
        where = "WHERE component = ? AND seq <= ? ORDER BY seq"
        with self.reading() as db:
            found = db.execute(f"SELECT seq, key FROM rows {where}", values)
            while some := found.fetchmany(_DIGESTED):
                whole.update(b"".join([b"row %d %b" % one for one in some]))
            for entry in db.execute(f"SELECT seq, row, withdrawn FROM edits {where}", values):
                whole.update(b"edit %d %d %d" % entry)
        return whole.hexdigest()

    def edits(self, component: str, until: int) -> list[RowEdit]:
        """Return the newest edit, up to a seq, of each of a component's rows that had one."""
        # With max(), SQLite gives that record's columns.
        select = (
            "SELECT rows.key, withdrawn, edits.created, max(edits.seq) FROM edits"
            " JOIN rows ON rows.seq = row WHERE edits.component = ? AND edits.seq <= ?"
            " GROUP BY row ORDER BY row"
        )
        with self.reading() as db:
            found = db.execute(select, (component, until)).fetchall()
        return [RowEdit(key, bool(withdrawn), created) for key, withdrawn, created, _ in found]

    def replay(self, component: str, edits: Iterable[RowEdit]) -> int:
        """Repeat edits that are newer than the ledger's own of the same row.

        Returns how many rows changed; an edit of a row that is not there changes nothing.
        """
        newest = "SELECT created FROM edits WHERE row = ? ORDER BY seq DESC LIMIT 1"
        same = "SELECT seq FROM rows WHERE key = ? AND component = ?"
        changed = 0
        with self.writing() as db:
            for key, withdrawn, created in edits:
                found = db.execute(same, (key, component)).fetchone()
                if found is None or rows.is_withdrawn(db, found[0]) == withdrawn:
                    continue
                last = db.execute(newest, found).fetchone()
                if last is None or last[0] < created:
                    rows.edit(db, component, found[0], withdrawn=withdrawn, now=created)
                    changed += 1
        if changed:
            self.notify(Change(component, rows=changed))
        return changed

    def _live(
        self, db: Connection, where: str, values: dict[str, object], limit: str = ""
    ) -> tuple[list[LedgerRow], int | None]:
        """Return a component's undamaged rows that are not withdrawn, by number.

        And the number of the last one, damaged ones too, if `limit` has cut them off.
        """
        live = f"WHERE component = :component AND {LIVE} AND {where} ORDER BY seq{limit}"
        records = db.execute(f"SELECT {COLUMNS} FROM rows {live}", values).fetchall()
        found, damaged = sound(records)
        component = str(values["component"])
        for seq in damaged:
            if seq not in self.damaged:
                _log.error("row %d of %s is damaged on the disk and left out", seq, component)
            self.damaged[seq] = component
        return found, records[-1][0] if limit and len(records) == values["most"] else None

    def _lots(self, db: Connection, component: str, until: int) -> Iterator[list[LedgerRow]]:
        """Yield the rows that a table had at a version, at most `MOST_CHANGES` at a time."""
        last: int | None = 0
        while last is not None:
            values = {"component": component, "until": until, "after": last, "most": MOST_CHANGES}
            found, last = self._live(db, "seq > :after AND seq <= :until", values, " LIMIT :most")
            yield found

    def _edit(self, component: str, seq: int, *, withdrawn: bool) -> None:
        with self.writing() as db:
            rows.edit(db, component, seq, withdrawn=withdrawn, now=time.time())
        self.notify(Change(component, rows=1))


def _known_blocks(db: Connection, component: str, until: int) -> tuple[bool, ...]:
    found = db.execute(
        "SELECT max(uncertainty IS NOT NULL), max(compliance IS NOT NULL),"
        " max(curvature IS NOT NULL), max(origin <> ''), max(fingerprint <> '')"
        f" FROM rows WHERE component = ? AND seq <= ? AND {SHOWN}",
        (component, until),
    ).fetchone()
    return tuple(map(bool, found))
