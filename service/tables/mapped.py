"""Tables that another process builds and this one maps: none is built where answers are given."""

from __future__ import annotations

import logging
import sys
import threading
import time
from pathlib import Path

from service.ledger import Ledger, LedgerUnavailableError
from service.library.component import Component
from service.library.library import Library
from service.tables.behind import TableBehindError
from service.tables.files import TableFiles
from service.tables.image import ImageError, read_image
from service.tables.live import START_S, SWITCH_S
from service.tables.making import ask_once, make
from service.tables.shelf import Shelf, Shelved, Told, setup_of
from surrogate.build import AnyTable
from surrogate.table.rows import Rows

log = logging.getLogger(__name__)

LOOK_S = 0.02  # between looks at the shelf: microseconds each
# A folder's time goes on in steps of up to 10 ms (a kernel's tick): what came within the step of
# the last look is seen by the looks of this long after a change.
SETTLED_S = 0.1


class MappedTables:
    """Surrogates by component name, as the builder puts them on a shelf.

    To who asks it is what `Tables` is. A version that is there is mapped by one thread and then
    swapped in; without a builder the last ones go on answering.

    Parameters
    ----------
    ledger, library, folder
        As of `Tables`.
    shelf : Shelf
    """

    def __init__(self, ledger: Ledger, library: Library, folder: Path, shelf: Shelf) -> None:
        self._ledger, self._library, self._shelf = ledger, library, shelf
        self._files = TableFiles(folder, ledger)
        self._surrogates: dict[str, AnyTable] = {}
        self._held: dict[str, Shelved] = {}
        self._setups: dict[str, tuple[Component, str]] = {}
        self._unread: dict[str, str] = {}
        self._told = Told()
        self._grown = threading.Condition()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._follow, name="tables-follow", daemon=True)

    def start(self) -> None:
        """Start to follow; return once every table is there that the builder can build."""
        sys.setswitchinterval(min(sys.getswitchinterval(), SWITCH_S))
        self._thread.start()
        names = self._library.names()
        with self._grown:
            self._grown.wait_for(
                lambda: all(name in self._held or name in self.faults() for name in names), START_S
            )

    def stop(self) -> None:
        """Stop following."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()

    def surrogate(self, name: str) -> AnyTable:
        """Return the newest surrogate of a component.

        Raises
        ------
        UnknownComponentError
            If the library has no such component.
        TableBehindError
            If it has rows, and no process has built it yet.
        """
        found = self._surrogates.get(name)
        return found if found is not None else self._first(name)

    def faults(self) -> dict[str, str]:
        """Return why a component's table is not what the ledger says, by its name."""
        return {**self._told.faults, **self._unread}

    def trouble(self) -> str | None:
        """Return why no job runs, as far as it is known here."""
        if not self._shelf.is_tended():
            return "the process that runs them has ended; it is started again"
        return self._told.trouble

    def present(self) -> dict[str, AnyTable]:
        """Return the surrogates that answer now, by component."""
        return self._surrogates.copy()

    def written(self, name: str) -> float | None:
        """Return when a component's file was written, seconds since the epoch; None without."""
        return self._files.written(name)

    def building(self) -> list[str]:
        """Return the components that have no surrogate yet: they answer 503 if they have rows."""
        return [name for name in self._library.names() if name not in self._surrogates]

    def notify(self) -> None:
        """Do nothing: the builder has seen by itself what has changed."""

    def catch_up(self, name: str, timeout: float) -> bool:
        """Wait until a surrogate holds all rows committed when this is called.

        Returns False if time ran out, or if the table cannot be built: see `faults`.
        """
        goal = self._ledger.last_seq(name)
        component = self._library[name]

        def settled() -> bool:
            return self._holds(component, goal) or name in self.faults()

        with self._grown:
            self._grown.wait_for(settled, timeout)
            return self._holds(component, goal)

    def caught_up(self, name: str, timeout: float) -> AnyTable:
        """Return a surrogate that holds all rows committed when this is called.

        Raises
        ------
        TableBehindError
            If it is not there after `timeout` seconds.
        """
        if self.catch_up(name, timeout):
            return self.surrogate(name)
        ended = "; the process that builds tables has ended and is started again"
        more = "" if self._shelf.is_tended() else ended
        raise TableBehindError.late(name, self.faults().get(name), timeout, more)

    def _holds(self, component: Component, goal: int) -> bool:
        """Tell whether a surrogate is of the component as it is now and has all rows up to goal."""
        held = self._held.get(component.name)
        if held is None or held.version < goal:
            return False
        known = self._setups.get(component.name)
        if known is None or known[0] is not component:
            known = self._setups[component.name] = component, setup_of(component)
        return held.setup == known[1]

    def _first(self, name: str) -> AnyTable:
        """Make the empty surrogate of a component without rows that was added a moment ago."""
        component = self._library[name]
        try:
            rows = self._ledger.count_rows(name)
        except LedgerUnavailableError:
            rows = self._files.size(name)
        if rows:
            raise TableBehindError.unbuilt(name, self.faults().get(name))
        empty = make(component, Rows.empty(), 0)
        with self._grown:
            return self._surrogates.setdefault(name, empty)

    def _follow(self) -> None:
        seen, changed = -1, 0.0
        while not self._stopping.wait(LOOK_S):
            try:
                self._library.version()  # takes up what another process has added
                now = self._shelf.stamp()
                if now != seen:
                    seen, changed = now, time.monotonic()
                elif time.monotonic() - changed > SETTLED_S:
                    continue
                self._look()
            except Exception:
                log.exception("looking for new tables failed; trying again")
                seen = -1
                self._stopping.wait(1.0)

    def _look(self) -> None:
        told = self._shelf.told()
        for name, shelved in self._shelf.newest().items():
            held = self._held.get(name)
            if held is None or held.path != shelved.path:
                self._map(name, shelved)
        with self._grown:
            self._told = told
            self._grown.notify_all()

    def _map(self, name: str, shelved: Shelved) -> None:
        """Take a version up; one that goes away meanwhile makes room for a newer one."""
        try:
            surrogate = read_image(shelved.path)
        except FileNotFoundError:
            return
        except (ImageError, OSError) as error:
            if self._unread.get(name) != str(error):
                log.error("the table of %s stays as it is: %s", name, error)
            self._unread[name] = str(error)
            return
        ask_once(surrogate)
        with self._grown:
            self._unread.pop(name, None)
            self._surrogates[name], self._held[name] = surrogate, shelved
            self._grown.notify_all()
