"""The table files of a data directory: packed tables, and the HDF5 record of their rows.

``NAME-VERSION.wbt`` is derived: a file that is missing, damaged or of another origin is written
again. ``NAME.h5`` is a second copy of the ledger's rows, from which a lost ledger is restored.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
from collections.abc import Callable, Container, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
import scipy

from wrenchbook.service.contract import CONTRACT_TEXT
from wrenchbook.service.files.durable import write_atomically
from wrenchbook.service.files.program import code_digest
from wrenchbook.service.ledger import Ledger, LedgerUnavailableError, RowEdit
from wrenchbook.service.library.component import Component
from wrenchbook.service.tables.solver_errors import SolverErrors
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.kernel.format import SUFFIX, PackedTableError
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.hdf5 import TableFileError, read_meta, read_table, write_table
from wrenchbook.surrogate.table.meta import TableMeta
from wrenchbook.surrogate.table.rows import Rows, joined

T = TypeVar("T", TableMeta, tuple[Rows, TableMeta])

log = logging.getLogger(__name__)

# MB of a numpy table, for each row: measured with 20,000 single-axis and multi-axis rows.
ROW_MB = 0.013
LARGE = 3000  # rows: the build of a larger table takes over a second
ROW_BYTES = 450  # bytes of a row in an HDF5 file, approximately
_UNKNOWN_WITHDRAWALS = (
    "the table file was written from another ledger and does not list withdrawn rows, which may be "
    "in the table again. Look through its rows, or restore the newer ledger"
)


class PackedFile(NamedTuple):
    """A packed table's file; another file of the same name has another inode."""

    version: int
    changed_ns: int
    inode: int
    path: Path


class TableStore:
    """The table files in a folder, which the first write makes.

    `caveats` has open questions about a component's table, by its name, and their remedies.
    """

    def __init__(self, folder: Path, ledger: Ledger, errors: SolverErrors | None = None) -> None:
        self._folder = folder
        self.ledger = ledger
        self._errors = errors
        self.caveats: dict[str, str] = {}

    def solver_error(self, component: Component) -> SolverError | None:
        """Return the estimate of a component's solver error; None if unknown."""
        if self._errors is None:
            return None
        return self._errors.read(component.name, component.fingerprint)

    def origin(
        self, component: Component, version: int, error: SolverError | None
    ) -> dict[str, str]:
        """Return digests of all inputs of a table's version; a packed file has them.

        `error`: the component's `solver_error`. ``ledger`` is missing if the ledger cannot be read:
        then no file is known to have these rows.
        """
        program = [np.__version__, scipy.__version__, code_digest("surrogate")]
        origin = {
            "setup": setup_of(component),
            "solver_error": _short(json.dumps(error and error.values, sort_keys=True)),
            "program": _short("".join(program)),
        }
        with suppress(LedgerUnavailableError):
            origin["ledger"] = self.ledger.digest(component.name, version)
        return origin

    def is_current(self, component: Component, version: int, origin: dict[str, str]) -> bool:
        """Return whether a version's packed file is undamaged and a build would reproduce it."""
        try:
            packed = PackedTable.open(self._packed_path(component.name, version))
        except (PackedTableError, OSError):
            return False
        # A file that was built while the ledger could not be read may be of any rows.
        sure = "ledger" in origin and "ledger" in origin_of(packed)
        return sure and is_of(packed, component.name, origin)

    def write_packed(self, name: str, version: int, content: bytes) -> None:
        """Write a version and remove the component's others; after an OSError these stay.

        The file need not survive a power failure, as it can be built again.
        """
        self._folder.mkdir(parents=True, exist_ok=True)
        write_atomically(self._packed_path(name, version), content, durable=False)
        self.remove_packed(name, keep=version)

    def remove_packed(self, name: str, keep: int | None = None) -> None:
        """Remove a component's packed files except the version `keep`; mapped ones stay mapped."""
        for file in self.packed_files().get(name, []):
            if file.version != keep:
                with suppress(OSError):  # in use
                    file.path.unlink()

    def remove_stray(self, names: Container[str]) -> None:
        """Remove drafts of killed writers, and packed files of components not in `names`."""
        for path in self._folder.glob(f".*{SUFFIX}.*"):
            path.unlink(missing_ok=True)
        for name in self.packed_files():
            if name not in names:
                self.remove_packed(name)

    def packed_files(self) -> dict[str, list[PackedFile]]:
        """Return the packed files of each component, the highest version first."""
        files: dict[str, list[PackedFile]] = {}
        for path in self._folder.glob(f"*{SUFFIX}"):
            name, _, version = path.stem.rpartition("-")
            if version.isdecimal() and name and not name.startswith("."):
                with suppress(OSError):  # a newer version has replaced it
                    stat = path.stat()
                    file = PackedFile(int(version), stat.st_mtime_ns, stat.st_ino, path)
                    files.setdefault(name, []).append(file)
        return {name: sorted(versions, reverse=True) for name, versions in files.items()}

    def stamp(self) -> int:
        """Return a number that changes when a file is added or removed; takes microseconds."""
        try:
            return os.stat(self._folder).st_mtime_ns  # noqa: PTH116 (fifty times a second)
        except OSError:
            return 0

    def size(self, name: str) -> int:
        """Return the number of a component's rows by the ledger, or about, by its HDF5 file."""
        with suppress(LedgerUnavailableError):
            if count := self.ledger.count_rows(name):
                return count
        try:
            return 1 + self._path(name).stat().st_size // ROW_BYTES
        except OSError:
            return 0

    def small(self, names: Iterable[str]) -> set[str]:
        """Return the components whose tables are built within about a second."""
        return {name for name in names if self.size(name) <= LARGE}

    def written(self, name: str) -> float | None:
        """Return when a component's HDF5 file was written, s since the epoch; None without one."""
        try:
            return self._path(name).stat().st_mtime
        except OSError:
            return None

    def read(self, component: Component) -> tuple[Rows, TableMeta] | None:
        """Return the content of a component's HDF5 file; None if missing, damaged or another's."""
        return self._read_usable(component, read_table)

    def saved(self, component: Component, version: int, digest: str) -> int | None:
        """Return the seq up to which a component's HDF5 file has its rows; 0 without a usable file.

        None if the file has rows that the ledger lacks: `load` restores these. `version` and
        `digest` are those of the ledger's newest change.

        Raises LedgerUnavailableError if the ledger cannot be read.
        """
        meta = self._read_usable(component, read_meta)
        if meta is None:
            return 0
        if (meta.last_seq, meta.ledger) != (version, digest) and not self._is_of_ledger(meta):
            return None
        return meta.last_seq if meta.fingerprint == component.fingerprint else 0

    def written_version(self, component: Component) -> int | None:
        """Return the version of the rows in a component's HDF5 file; None without a usable file."""
        meta = self._read_usable(component, read_meta)
        is_present = meta is not None and meta.fingerprint == component.fingerprint
        return meta.last_seq if meta is not None and is_present else None

    def rows(self, component: Component, version: int) -> Rows:
        """Return the rows of a version, from its HDF5 file or the ledger: 0.05 s for 20,000.

        Raises LedgerUnavailableError if only the ledger has them and cannot be read.
        """
        content = self.read(component)
        if content is not None:
            rows, meta = content
            if (meta.last_seq, meta.fingerprint) == (version, component.fingerprint):
                return rows
        setup = {"space": component.space, "fingerprint": component.fingerprint}
        with self.ledger.table_at(component.name, version, **setup) as table:
            return joined([Rows.empty(component.space), *(lot.rows for lot in table.lots)])

    def load(self, component: Component) -> tuple[Rows, int]:
        """Return the rows of a component's HDF5 file and their last seq.

        Return no rows, and 0, if they differ from the ledger's rows up to there. If the ledger
        lacks rows, being a new one or an older copy, they are first restored in it, and so are
        withdrawals; `caveats` has the tables whose file lacks withdrawals.

        Raises LedgerUnavailableError if the ledger cannot be read, or the rows cannot be written to
        it.
        """
        content = self.read(component)
        if content is not None:
            rows, meta = content
            if not self._is_of_ledger(meta):
                self._restore(component.name, rows, meta)
            elif meta.fingerprint == component.fingerprint:
                return rows, meta.last_seq
            else:
                log.info("table %s is of another setup; reading the ledger", component.name)
        return Rows.empty(component.space), 0

    def save(self, component: Component, rows: Rows, last_seq: int) -> None:
        """Write a component's rows, the ledger's up to `last_seq`; after an OSError the file stays.

        If the ledger cannot be read, the file may be the last copy of the rows: it is written
        without the ledger's digest, so that the rows are restored from it.
        """
        name = component.name
        of_ledger = dict[str, Any]()
        with suppress(LedgerUnavailableError):
            edits = self.ledger.edits(name, last_seq)
            of_ledger = {
                "ledger": self.ledger.digest(name, last_seq),
                "edits": tuple((key.hex(), gone, when) for key, gone, when in edits),
            }
        meta = TableMeta(
            component=name,
            last_seq=last_seq,
            load_range=component.load_range,
            fingerprint=component.fingerprint,
            locked=component.idle,
            contract=CONTRACT_TEXT,
            **of_ledger,
        )
        self._folder.mkdir(parents=True, exist_ok=True)
        write_table(self._path(name), rows, meta)

    def _read_usable(self, component: Component, read: Callable[[Path], T]) -> T | None:
        """Return the result of `read` for a component's file; None, logged, if it is unusable."""
        try:
            content = read(self._path(component.name))
            meta = content if isinstance(content, TableMeta) else content[1]
            named = meta.component
            if named == component.name:
                return content
            # Tables without a setup have the same fingerprint, so their names distinguish them.
            why: object = f"the file is the table of {named!r}"
        except FileNotFoundError:
            return None
        except (TableFileError, OSError) as error:
            why = error
        log.warning("table %s is built from the ledger instead: %s", component.name, why)
        return None

    def _is_of_ledger(self, meta: TableMeta) -> bool:
        """Return whether a file's rows are those of the ledger up to the file's newest."""
        return bool(meta.ledger) and meta.ledger == self.ledger.digest(
            meta.component, meta.last_seq
        )

    def _restore(self, name: str, rows: Rows, meta: TableMeta) -> None:
        """Insert a file's rows, except for those of known content, and repeat its edits."""
        newest = self.ledger.last_seq(name)
        inserted, _ = self.ledger.insert_rows(name, rows, "table file", above=meta.last_seq)
        if inserted:
            text = "%s: %d rows of the table file were missing in the ledger and are there again"
            log.warning(text, name, inserted)
        if meta.edits is None:
            # Files of version 0.1 have neither edits nor a digest of their ledger: row numbers show
            # it.
            stored = self.ledger.rows_of(rows.seq.tolist())
            wrenches = zip(rows.seq.tolist(), map(tuple, rows.wrench.tolist()), strict=True)
            same = all(seq in stored and stored[seq].wrench == wrench for seq, wrench in wrenches)
            if inserted or newest < meta.last_seq or not same:
                self.caveats[name] = _UNKNOWN_WITHDRAWALS
                log.warning("%s: %s", name, _UNKNOWN_WITHDRAWALS)
            return
        edits = [RowEdit(bytes.fromhex(key), gone, when) for key, gone, when in meta.edits]
        if changed := self.ledger.replay(name, edits):
            log.warning("%s: %d rows were withdrawn or restored as in its file", name, changed)

    def _path(self, name: str) -> Path:
        return self._folder / f"{name}.h5"

    def _packed_path(self, name: str, version: int) -> Path:
        return self._folder / f"{name}-{version}{SUFFIX}"


def is_of(packed: PackedTable, name: str, origin: dict[str, str]) -> bool:
    """Return whether a packed table belongs to a component and an origin."""
    built = origin_of(packed) or {"setup": None}
    component = packed.meta.get("provenance", {}).get("component")
    return component == name and built.items() <= origin.items()


def origin_of(packed: PackedTable) -> dict[str, str]:
    """Return the origin in a packed table; {} of a file without one."""
    return packed.meta.get("provenance", {}).get("origin") or {}


def setup_of(component: Component) -> str:
    """Return a digest of all inputs of a component's table other than rows."""
    bounds, tolerance = component.load_range, component.tolerance
    values = (
        component.fingerprint,
        component.linear,
        bounds.low.tobytes(),
        bounds.high.tobytes(),
        tolerance and (tolerance.translation, tolerance.rotation),
    )
    return _short(repr(values))


def _short(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


class InMemory(Protocol):
    """Rows and a numpy table that may be dropped, as they can be read or built again."""

    used: float

    def rows_in_memory(self) -> int:
        """Return the number of rows in memory that `drop` frees."""
        ...

    def drop(self) -> None:
        """Drop rows and numpy table."""


def drop_least_used(tables: Iterable[InMemory], limit_mb: float) -> None:
    """Drop the least recently used tables beyond a limit; the last used table always stays."""
    total = 0.0
    for table in sorted(tables, key=lambda table: -table.used):
        size = ROW_MB * table.rows_in_memory()
        if size and total and total + size > limit_mb:
            table.drop()
        else:
            total += size
