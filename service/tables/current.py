"""The newest table of each component, whichever process builds it."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from pathlib import Path

from wrenchbook.service.ledger import Ledger, LedgerUnavailableError
from wrenchbook.service.library.library import Library
from wrenchbook.service.tables.files import TableFiles
from wrenchbook.service.tables.packed_files import PackedFiles
from wrenchbook.service.tables.served import (
    TABLE_MEMORY,
    ServedTable,
    TableBehindError,
    empty_table,
)
from wrenchbook.service.tables.solver_errors import SolverErrors

START_S = 30.0  # how long a start waits for small tables; what takes longer answers 503 till then
# How long a thread that computes may keep the interpreter from one that answers: about what an
# answer takes; Python's own 5 ms are felt by each call during a build.
SWITCH_S = 0.0005


class CurrentTables(ABC):
    """The newest tables by component name: what `Tables` and `MappedTables` share.

    Parameters
    ----------
    ledger, library:
        Where rows come from and which components there are.
    folder:
        Folder of the HDF5 tables, one ``<name>.h5`` each.
    errors:
        Estimates of the solver's own error.
    memory:
        MB of rows and numpy tables that stay in memory.
    """

    def __init__(
        self,
        ledger: Ledger,
        library: Library,
        folder: Path,
        errors: SolverErrors | None = None,
        memory: float = TABLE_MEMORY,
    ) -> None:
        self._errors, self._memory = errors, memory
        self._ledger, self._library = ledger, library
        self._files, self._packed = TableFiles(folder, ledger), PackedFiles(folder)
        self._tables: dict[str, ServedTable] = {}
        self._grown = threading.Condition()
        self._stopping = threading.Event()

    @abstractmethod
    def faults(self) -> dict[str, str]:
        """Return why a component's table differs from the ledger, by its name."""

    @abstractmethod
    def catch_up(self, name: str, timeout: float) -> bool:
        """Wait until a table holds all rows committed when this is called.

        Returns False if time ran out, or if the table cannot be built: see `faults`.
        """

    @abstractmethod
    def _look(self, name: str) -> None:
        """Have the table of a component without one built, if this process builds tables."""

    def surrogate(self, name: str) -> ServedTable:
        """Return the newest table of a component.

        Raises
        ------
        UnknownComponentError
            If the library has no such component.
        TableBehindError
            If it has rows and has not been built since the start.
        """
        found = self._tables.get(name)
        return found if found is not None else self._first(name)

    def present(self) -> dict[str, ServedTable]:
        """Return the tables that answer now, by component."""
        return self._tables.copy()

    def is_extended(self, name: str) -> bool:
        """Return whether a newer version of a table is known to be built."""
        return False

    def written(self, name: str) -> float | None:
        """Return when a component's file was written, seconds since the epoch; None without."""
        return self._files.written(name)

    def caught_up(self, name: str, timeout: float) -> ServedTable:
        """Return a table that holds all rows committed when this is called.

        Raises
        ------
        TableBehindError
            If it is not there after `timeout` seconds.
        """
        if self.catch_up(name, timeout):
            return self.surrogate(name)
        raise TableBehindError.late(name, self.faults().get(name), timeout, self._late())

    def _late(self) -> str:
        """Return what else is known of a table that is late."""
        return ""

    def _first(self, name: str) -> ServedTable:
        """Return the empty table of a component without rows that was added after the start."""
        component = self._library[name]
        if self._size(name):
            self._look(name)
            raise TableBehindError.unbuilt(name, self.faults().get(name))
        with self._grown:
            found = self._tables.setdefault(name, empty_table(component, self._errors))
        self._look(name)
        return found

    def _size(self, name: str) -> int:
        """Return about how many rows a table will have."""
        try:
            return self._ledger.count_rows(name) or self._files.size(name)
        except LedgerUnavailableError:
            return self._files.size(name)
