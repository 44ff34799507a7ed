"""HDF5 tables: a faster way to read the ledger's rows, and a second copy of them."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from wrenchbook.service.contract import CONTRACT
from wrenchbook.service.ledger import Ledger, LedgerUnavailableError, RowEdit
from wrenchbook.service.library.component import Component
from wrenchbook.surrogate.table.hdf5 import TableFileError, read_meta, read_table, write_table
from wrenchbook.surrogate.table.meta import TableMeta
from wrenchbook.surrogate.table.rows import Rows, joined

T = TypeVar("T")

log = logging.getLogger(__name__)

ROW_BYTES = 450  # of a row in a file, about
_UNKNOWN_WITHDRAWALS = (
    "the ledger is not the one that its table file was written from, and the file does not list "
    "withdrawn rows: those may be in the table again. Look through its rows, or restore the newer "
    "ledger"
)


class TableFiles:
    """The HDF5 files of a data directory, one ``<name>.h5`` a component.

    Parameters
    ----------
    folder : path
        Made if there is none.
    ledger : Ledger
        The record of rows; a file that differs from it is written again.
    """

    def __init__(self, folder: Path, ledger: Ledger) -> None:
        self._folder = folder
        self._ledger = ledger
        self.caveats: dict[str, str] = {}
        """What is not known of a component's table, by its name, and what to do about it."""

    def size(self, name: str) -> int:
        """Return about how many rows a component's file holds; 0 if there is none."""
        try:
            return 1 + self._path(name).stat().st_size // ROW_BYTES
        except OSError:
            return 0

    def written(self, name: str) -> float | None:
        """Return when a component's file was written, seconds since the epoch; None without."""
        try:
            return self._path(name).stat().st_mtime
        except OSError:
            return None

    def read(self, component: Component) -> tuple[Rows, TableMeta] | None:
        """Return what a component's file holds; None if it is missing, damaged or another's."""
        return self._sound(component, read_table)

    def saved(self, component: Component, version: int, digest: str) -> int | None:
        """Return up to which seq a component's file has its rows; 0 without a usable file.

        None if it has rows that the ledger lacks: `load` puts these back.

        Parameters
        ----------
        version, digest
            The ledger's newest change of the component, and its digest up to there.

        Raises
        ------
        LedgerUnavailableError
            If the ledger cannot be read.
        """
        found = self._sound(component, lambda path: (None, read_meta(path)))
        if found is None:
            return 0
        meta = found[1]
        newest = (meta.last_seq, meta.ledger) == (version, digest)
        if not newest and not self._is_of_ledger(meta):
            return None
        return meta.last_seq if meta.fingerprint == component.fingerprint else 0

    def rows(self, component: Component, version: int) -> Rows:
        """Return the rows of a version of a component's table, from its file or the ledger.

        Raises
        ------
        LedgerUnavailableError
            If only the ledger has them and cannot be read.
        """
        found = self.read(component)
        if found is not None:
            rows, meta = found
            if (meta.last_seq, meta.fingerprint) == (version, component.fingerprint):
                return rows
        setup = {"space": component.space, "fingerprint": component.fingerprint}
        with self._ledger.table_at(component.name, version, **setup) as table:
            return joined([Rows.empty(component.space), *(lot.rows for lot in table.lots)])

    def _sound(
        self, component: Component, read: Callable[[Path], tuple[T, TableMeta]]
    ) -> tuple[T, TableMeta] | None:
        """Return what is read of a component's file; None with a warning if it is of no use."""
        instead = "table %s is built from the ledger instead: %s"
        try:
            found = read(self._path(component.name))
        except FileNotFoundError:
            return None
        except (TableFileError, OSError) as error:
            log.warning(instead, component.name, error)
            return None
        named = found[1].component
        if named != component.name:  # tables without a setup share one fingerprint
            log.warning(instead, component.name, f"the file is the table of {named!r}")
            return None
        return found

    def _is_of_ledger(self, meta: TableMeta) -> bool:
        """Return whether a file's rows are those of the ledger up to the file's newest."""
        return bool(meta.ledger) and meta.ledger == self._ledger.digest(
            meta.component, meta.last_seq
        )

    def load(self, component: Component) -> tuple[Rows, int]:
        """Return the rows of a component's file and the seq they go up to.

        No rows, and 0, if they are not exactly what the ledger has up to there. Rows that the
        ledger has lost, being a new one or an older copy, are restored in it first, and so are
        withdrawals; `caveats` names the tables whose file does not have those.

        Raises
        ------
        LedgerUnavailableError
            If the ledger cannot be read, or cannot take the rows it has lost.
        """
        found = self.read(component)
        if found is None:
            return Rows.empty(component.space), 0
        rows, meta = found
        if self._is_of_ledger(meta):
            if meta.fingerprint == component.fingerprint:
                return rows, meta.last_seq
            log.info("table %s is of another setup; reading the ledger", component.name)
        else:
            self._put_back(component.name, rows, meta)
        return Rows.empty(component.space), 0

    def save(self, component: Component, rows: Rows, last_seq: int) -> None:
        """Write a component's rows, which are the ledger's up to `last_seq`.

        Raises
        ------
        OSError
            If the file cannot be written; the one before stays.
        """
        self._folder.mkdir(parents=True, exist_ok=True)
        meta = TableMeta(
            component=component.name,
            last_seq=last_seq,
            load_range=component.load_range,
            fingerprint=component.fingerprint,
            locked=component.idle,
            contract=" ".join(f"{word}: {meaning}." for word, meaning in CONTRACT.items()),
            **self._ledger_words(component.name, last_seq),
        )
        write_table(self._path(component.name), rows, meta)

    def _ledger_words(self, name: str, last_seq: int) -> dict[str, Any]:
        try:
            edits = self._ledger.edits(name, last_seq)
            return {
                "ledger": self._ledger.digest(name, last_seq),
                "edits": tuple((key.hex(), gone, when) for key, gone, when in edits),
            }
        except LedgerUnavailableError:
            return {}  # the file may be the last copy of the rows: they are restored from it

    def _put_back(self, name: str, rows: Rows, meta: TableMeta) -> None:
        """Insert a file's rows and repeat its edits; the ledger knows what it has by content."""
        newest = self._ledger.last_seq(name)
        inserted, _ = self._ledger.insert_rows(name, rows, "table file", above=meta.last_seq)
        if inserted:
            log.warning(
                "%s: %d rows of the table file were missing in the ledger and are there again",
                name,
                inserted,
            )
        if meta.edits is None:
            # Files of 0.1 have neither edits nor a digest of their ledger.
            if not inserted and newest >= meta.last_seq and self._numbers_are_of_ledger(rows):
                return
            self.caveats[name] = _UNKNOWN_WITHDRAWALS
            log.warning("%s: %s", name, _UNKNOWN_WITHDRAWALS)
            return
        edits = [RowEdit(bytes.fromhex(key), gone, when) for key, gone, when in meta.edits]
        if changed := self._ledger.replay(name, edits):
            log.warning("%s: %d rows were withdrawn or restored as in its file", name, changed)

    def _numbers_are_of_ledger(self, rows: Rows) -> bool:
        """Return whether the ledger has the rows of a file under the same numbers."""
        found = self._ledger.rows_of(rows.seq.tolist())
        wrenches = map(tuple, rows.wrench.tolist())
        return all(
            seq in found and found[seq].wrench == wrench
            for seq, wrench in zip(rows.seq.tolist(), wrenches, strict=True)
        )

    def _path(self, name: str) -> Path:
        return self._folder / f"{name}.h5"
