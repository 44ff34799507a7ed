"""The packed tables of a data directory: ``NAME-VERSION.wbt`` next to the HDF5 tables.

They are derived: a file that is missing, damaged or of anything else than its `origin_of` is
written again. The process that builds tables writes them, all processes of a server map them.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Container
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy

from wrenchbook.service.files.durable import write_whole_bytes
from wrenchbook.service.files.program import code_digest
from wrenchbook.service.ledger import Ledger, LedgerUnavailableError
from wrenchbook.service.library.component import Component
from wrenchbook.service.tables.solver_errors import SolverErrors
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.packed.format import SUFFIX, PackedTableError


class PackedFile(NamedTuple):
    """A packed table's file.

    Attributes
    ----------
    version : int
    changed : int, ns since the epoch
    number : int
        The file system's own: another file of the same name has another one.
    path : Path
    """

    version: int
    changed: int
    number: int
    path: Path


class PackedFiles:
    """The packed tables in a folder.

    Parameters
    ----------
    folder : path
        That of the HDF5 tables; made by the first write.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def write(self, name: str, version: int, content: bytes) -> PackedTable:
        """Write a version, remove the component's others, and return the table mapped.

        It need not outlive a power failure: it can be built again.

        Raises
        ------
        OSError
            If it cannot be written; the version before stays.
        PackedTableError
            If another process has removed it at once.
        """
        self._folder.mkdir(parents=True, exist_ok=True)
        path = self._folder / f"{name}-{version}{SUFFIX}"
        write_whole_bytes(path, content, durable=False)
        self.remove_others(name, version)
        return PackedTable.open(path)

    def open(self, name: str, version: int, origin: dict[str, str]) -> PackedTable | None:
        """Map a version if it is what would be built now; None if it is not."""
        try:
            found = PackedTable.open(self._folder / f"{name}-{version}{SUFFIX}")
        except (PackedTableError, OSError):
            return None
        return found if is_of(found, name, origin) and "ledger" in origin else None

    def remove(self, name: str, but: Path | None = None) -> None:
        """Remove a component's files but one; processes that have mapped one keep it."""
        for found, path in self._files():
            if found == name and path != but:
                with suppress(OSError):  # another process has removed it, or it is in use
                    path.unlink()

    def remove_others(self, name: str, version: int) -> None:
        """Remove a component's files but that of a version."""
        self.remove(name, but=self._folder / f"{name}-{version}{SUFFIX}")

    def remove_drafts(self) -> None:
        """Remove what writers that were killed have left."""
        for path in self._folder.glob(f".*{SUFFIX}.*"):
            path.unlink(missing_ok=True)

    def found(self) -> dict[str, list[PackedFile]]:
        """Return the files of each component, the highest version first."""
        found: dict[str, list[PackedFile]] = {}
        for name, path in self._files():
            with suppress(OSError):  # a newer one has taken its place
                about = path.stat()
                version = int(path.stem.rpartition("-")[2])
                file = PackedFile(version, about.st_mtime_ns, about.st_ino, path)
                found.setdefault(name, []).append(file)
        return {name: sorted(files, reverse=True) for name, files in found.items()}

    def remove_orphans(self, names: Container[str]) -> None:
        """Remove the files of components that there are not."""
        for name, path in self._files():
            if name not in names:
                path.unlink(missing_ok=True)

    def stamp(self) -> int:
        """Return a number that differs once a file has come or gone; takes microseconds."""
        try:
            return os.stat(self._folder).st_mtime_ns  # noqa: PTH116 (fifty times a second)
        except OSError:
            return 0

    def _files(self) -> list[tuple[str, Path]]:
        """Return the component and path of each file but drafts, which begin with a dot."""
        found = [(path.stem.rpartition("-"), path) for path in self._folder.glob(f"*{SUFFIX}")]
        return [
            (name, path)
            for (name, _, version), path in found
            if version.isdecimal() and name and not name.startswith(".")
        ]


def is_of(packed: PackedTable, name: str, origin: dict[str, str]) -> bool:
    """Return whether a packed table is of a component and of this `origin_of`."""
    about = packed.words.get("provenance", {})
    built = about.get("origin") or {"setup": None}
    return about.get("component") == name and built.items() <= origin.items()


def origin_of(
    ledger: Ledger, component: Component, version: int, errors: SolverErrors | None
) -> dict[str, str]:
    """Return digests of all that a version of a table is built from; a packed file keeps them.

    Without ``ledger`` if the ledger cannot be read: then no file is known to be of these rows.
    """
    error = errors.read(component.name, component.fingerprint) if errors is not None else None
    text = json.dumps(error and error.values, sort_keys=True)
    origin = {"setup": setup_of(component), "solver_error": _short(text), "program": _program()}
    with suppress(LedgerUnavailableError):
        origin["ledger"] = ledger.digest(component.name, version)
    return origin


def setup_of(component: Component) -> str:
    """Return a mark of all but rows that a component's table is built from."""
    bounds, tolerance = component.load_range, component.tolerance
    values = (
        component.fingerprint,
        component.linear,
        bounds.low.tobytes(),
        bounds.high.tobytes(),
        tolerance and (tolerance.translation, tolerance.rotation),
    )
    return _short(repr(values))


def _program() -> str:
    """Return a digest of the code that builds tables, and of what it computes with."""
    return _short("".join([np.__version__, scipy.__version__, code_digest("surrogate")]))


def _short(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]
