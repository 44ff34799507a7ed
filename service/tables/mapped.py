"""Tables that another process builds and this one maps: none is built where answers are given."""

from __future__ import annotations

import logging
import sys
import threading
import time
from contextlib import suppress
from functools import partial
from pathlib import Path

from wrenchbook.service.ledger import Ledger, LedgerUnavailableError
from wrenchbook.service.library.component import Component
from wrenchbook.service.library.library import Library
from wrenchbook.service.tables.coordinator_state import CoordinatorState, Mapped, Status
from wrenchbook.service.tables.current import START_S, SWITCH_S, CurrentTables
from wrenchbook.service.tables.packed_files import (
    PackedFile,
    is_of,
    origin_of,
    setup_of,
)
from wrenchbook.service.tables.rows import count_others
from wrenchbook.service.tables.served import (
    TABLE_MEMORY,
    ServedTable,
    drop_built,
)
from wrenchbook.service.tables.solver_errors import SolverErrors
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.packed.format import PackedTableError

log = logging.getLogger(__name__)

LOOK_S = 0.02  # between looks at the folder: microseconds each
# A folder's time goes on in steps of up to 10 ms (a kernel's tick): what came within the step of
# the last look is seen by the looks of this long after a change.
SETTLED_S = 0.1


class MappedTables(CurrentTables):
    """Tables by component name, mapped from the files that the building process writes.

    It has the calls of `Tables`. One thread maps each new version and then swaps it in; without a
    building process the last versions go on answering.

    Parameters
    ----------
    ledger, library, folder
        As of `Tables`.
    state : CoordinatorState
        Of the building process.
    errors, memory
        As of `Tables`.
    """

    def __init__(
        self,
        ledger: Ledger,
        library: Library,
        folder: Path,
        state: CoordinatorState,
        errors: SolverErrors | None = None,
        memory: float = TABLE_MEMORY,
    ) -> None:
        super().__init__(ledger, library, folder, errors, memory)
        self._state = state
        self._mapped: dict[str, tuple[PackedFile, Component]] = {}
        self._refused: dict[Path, tuple[PackedFile, Component]] = {}
        self._unread: dict[str, str] = {}
        self._status, self._published = Status(), Mapped()
        self._thread = threading.Thread(target=self._follow, name="tables-follow", daemon=True)

    def start(self) -> None:
        """Start to follow; return once every table is there that the builder can build."""
        sys.setswitchinterval(min(sys.getswitchinterval(), SWITCH_S))
        self._thread.start()
        names = set(self._library.names())
        with self._grown:
            self._grown.wait_for(lambda: names <= {*self._mapped, *self.faults()}, START_S)

    def stop(self) -> None:
        """Stop following."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()
        self._state.unpublish()

    def faults(self) -> dict[str, str]:
        """Return why a component's table differs from the ledger, by its name."""
        return {**self._status.faults, **self._unread}

    def trouble(self) -> str | None:
        """Return why no job runs, as far as it is known here."""
        if not self._state.is_taken():
            return "the process that runs them has ended; it is started again"
        return self._status.trouble

    def building(self) -> list[str]:
        """Return the components that have no table yet: they answer 503 if they have rows."""
        return [name for name in self._library.names() if name not in self._tables]

    def notify(self) -> None:
        """Do nothing: the builder has seen by itself what has changed."""

    def catch_up(self, name: str, timeout: float) -> bool:
        """Wait until a table holds all rows committed when this is called, in each web worker.

        Returns False if time ran out, or if the table cannot be built: see `faults`.
        """
        goal, end = self._ledger.last_seq(name), time.monotonic() + timeout
        component = self._library[name]

        def settled() -> bool:
            # A file that does not fit a component that was just added is written anew.
            return self._holds(component, goal) or name in self._status.faults

        with self._grown:
            self._grown.wait_for(settled, timeout)
        while self._holds(component, goal):
            if self._others_hold(name, goal, setup_of(component)):
                return True
            if time.monotonic() >= end or self._stopping.wait(LOOK_S / 4):
                break
        return False

    def _others_hold(self, name: str, goal: int, setup: str) -> bool:
        """Return whether the other web workers answer from a table up to goal, of a setup."""
        found = (one.get(name, [0, ""]) for one in self._state.others())
        return all(int(version) >= goal and its == setup for version, its in found)

    def _holds(self, component: Component, goal: int) -> bool:
        """Return whether a table is of the component as it is now and has all rows up to goal."""
        table = self._tables.get(component.name)
        if table is None or table.version < goal:
            return False
        return _mark(table)[1] == setup_of(component)

    def _late(self) -> str:
        ended = "; the process that builds tables has ended and is started again"
        return "" if self._state.is_taken() else ended

    def _look(self, name: str) -> None:
        """Do nothing: the builder looks at the ledger itself."""

    def _follow(self) -> None:
        seen, changed = None, 0.0
        while not self._stopping.wait(LOOK_S):
            try:
                drop_built(self.present().values(), self._memory)
                # The library's version takes up what another process has added.
                now = self._library.version(), self._packed.stamp(), self._state.read()
                if now != seen:
                    seen, changed = now, time.monotonic()
                elif time.monotonic() - changed > SETTLED_S:
                    continue
                self._map_new(now[-1])
            except Exception:
                log.exception("looking for new tables failed; trying again")
                seen = None
                self._stopping.wait(1.0)

    def _map_new(self, status: Status) -> None:
        for name, files in self._packed.found().items():
            if name in self._library:
                component = self._library[name]
                next((file for file in files if self._map(component, file)), None)
                if not any(self._refused.get(file.path) == (file, component) for file in files):
                    self._unread.pop(name, None)
        mapped = {name: _mark(table) for name, table in self.present().items()}
        if mapped != self._published or status != self._status:  # a new builder's folder is empty
            self._state.publish(mapped)
            self._published = mapped
        with self._grown:
            self._status = status
            self._grown.notify_all()

    def _map(self, component: Component, file: PackedFile) -> bool:
        """Take a file up unless it is of anything else; return whether it is taken up."""
        name, seen = component.name, (file, component)
        if seen in (self._mapped.get(name), self._refused.get(file.path)):
            return seen == self._mapped.get(name)
        try:
            packed = PackedTable.open(file.path)
            origin = origin_of(self._ledger, component, file.version, self._errors)
            if not is_of(packed, name, origin):
                raise PackedTableError(f"{file.path} is not of version {file.version} of {name}")
            rows_of = partial(self._files.rows, component, file.version)
            table = ServedTable(packed, rows_of)
        except (PackedTableError, KeyError) as error:
            if file.path.exists():
                log.error("the table of %s stays as it is: %s", name, error)
                self._unread[name], self._refused[file.path] = str(error), seen
            return False
        with suppress(LedgerUnavailableError):
            count_others(self._ledger, component, table)
        with self._grown:
            self._unread.pop(name, None)
            self._tables[name], self._mapped[name] = table, seen
            self._grown.notify_all()
        return True


def _mark(table: ServedTable) -> list[int | str]:
    """Return a table's version, and the setup that its file was built from."""
    return [table.version, table.packed.words["provenance"]["origin"].get("setup", "")]
