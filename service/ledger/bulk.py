"""Taking a large table in: many short transactions, shown by one."""

import logging
import os
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from wrenchbook.service.files.lock import take
from wrenchbook.service.ledger import imports, rows
from wrenchbook.service.ledger.connections import Connections
from wrenchbook.service.ledger.errors import ImportRunningError
from wrenchbook.service.ledger.imports import About, Import
from wrenchbook.service.ledger.listeners import Listeners
from wrenchbook.service.ledger.packing import PackedRow
from wrenchbook.service.ledger.records import Change
from wrenchbook.service.ledger.table_at import known_keys

_log = logging.getLogger(__name__)

HOLD_SECONDS = 0.03
"""What one transaction of an import may take, and so how long others wait for the ledger."""

_FEWEST, _MOST = 100, 4000  # rows of one transaction
_FIRST = 500
_PATIENCE_SECONDS = 120.0  # that an import waits for another one


class Imports:
    """What `Ledger` does with imports."""

    _db: Connections
    _listeners: Listeners
    path: Path

    def import_rows(
        self, component: str, blocks: Iterable[Sequence[PackedRow]], about: About
    ) -> tuple[int, int, int | None]:
        """Insert the packed rows of a file, all or none; how many were new, how many known.

        They are taken in by transactions of some 30 ms each and shown by the last one, so that
        jobs and other rows are accepted meanwhile. Of a process that is killed in between nothing
        is seen, and what it left is deleted.

        Returns
        -------
        tuple of (int, int, int or None)
            New rows, known ones, and the number of the import; None if nothing was new.

        Raises
        ------
        ImportRunningError
            If another import has been running for too long.
        LedgerUnavailableError
            If they could not be written; none is in the table then.
        """
        with self._importing():
            number: int | None = None
            new = count = 0
            try:
                for block in self._sized(blocks):
                    with self._db.writing(durable=False) as db:
                        if number is None:
                            number = imports.begin(db, component, about, time.time())
                        inserted, first, last = rows.add_hidden(db, block)
                        if inserted:
                            imports.note_part(db, number, component, (first, last), True)
                    new, count = new + inserted, count + len(block)
                if number is None:
                    return 0, 0, None
                with self._db.writing() as db:
                    imports.finish(db, number, new)
                    if not new:
                        db.execute("DELETE FROM imports WHERE id = ?", (number,))
            except BaseException:
                self._drop_hidden()
                raise
        if new:
            self._listeners.tell(Change(component, rows=new))
        return new, count - new, number if new else None

    def known_rows(self, keys: Sequence[bytes]) -> int:
        """Return how many of these rows' keys are in the ledger, or stand here before."""
        fresh: set[bytes] = set()
        known = 0
        for start in range(0, len(keys), _FIRST):
            some = keys[start : start + _FIRST]
            with self._db.reading() as db:
                there = known_keys(db, some)
            for key in some:
                known += key in there or key in fresh
                fresh.add(key)
        return known

    def imports(self, component: str, most: int = 1000) -> list[Import]:
        """Return the imports of a component, newest first."""
        with self._db.reading() as db:
            return imports.listed(db, component, most)

    def import_of(self, seq: int) -> Import | None:
        """Return the import that brought a row; None if it was solved."""
        with self._db.reading() as db:
            return imports.of_row(db, seq)

    def import_spans(self, component: str) -> list[tuple[int, int, Import]]:
        """Return which rows each import of a component brought: first, last, and the import."""
        with self._db.reading() as db:
            return imports.spans(db, component)

    def drop_abandoned(self) -> None:
        """Delete what imports have left whose process is gone; nothing if one runs."""
        with self._db.reading() as db:
            if imports.first_hidden(db, None) is None:
                return
        descriptor = take(self._lock_path())
        if descriptor is not None:
            try:
                self._drop_hidden()
            finally:
                os.close(descriptor)

    @contextmanager
    def _importing(self) -> Iterator[None]:
        """Be the only import of this ledger, of all processes."""
        deadline = time.monotonic() + _PATIENCE_SECONDS
        while (descriptor := take(self._lock_path())) is None:
            if time.monotonic() > deadline:
                raise ImportRunningError(
                    "another large table is being imported; nothing was loaded, send it again"
                )
        try:
            self._drop_hidden()  # of one that was killed
            yield
        finally:
            os.close(descriptor)

    def _drop_hidden(self) -> None:
        more = True
        while more:
            with self._db.writing(durable=False) as db:
                more = imports.drop_hidden(db, _MOST)

    def _sized(self, blocks: Iterable[Sequence[PackedRow]]) -> Iterator[list[PackedRow]]:
        """Cut blocks into what one transaction takes in the time it may."""
        size = _FIRST
        for block in blocks:
            start = 0
            while start < len(block):
                some = list(block[start : start + size])
                start += size
                began = time.monotonic()
                yield some
                took = max(time.monotonic() - began, 1e-6)
                self._db.settle()  # or others, who commit durably, wait for the disk to take it
                size = round(min(max(size * min(HOLD_SECONDS / took, 2.0), _FEWEST), _MOST))

    def _lock_path(self) -> Path:
        return self.path.with_name(f"{self.path.name}-importing")
