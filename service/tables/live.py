"""The live tables: one packed table a component, rebuilt off the request path as rows arrive."""

from __future__ import annotations

import logging
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path

from wrenchbook.service.files.program import give_back, usable_cores
from wrenchbook.service.ledger import Ledger, LedgerUnavailableError
from wrenchbook.service.library.component import Component
from wrenchbook.service.library.library import Library
from wrenchbook.service.tables.builders import LARGE, Builders
from wrenchbook.service.tables.current import START_S, SWITCH_S, CurrentTables
from wrenchbook.service.tables.packed_files import origin_of
from wrenchbook.service.tables.rows import count_others, without
from wrenchbook.service.tables.served import (
    TABLE_MEMORY,
    ServedTable,
    drop_built,
    make,
    packed_bytes,
)
from wrenchbook.service.tables.solver_errors import SolverErrors
from wrenchbook.surrogate.build import AnyTable
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.packed.format import PackedTableError
from wrenchbook.surrogate.table.rows import Rows, joined

log = logging.getLogger(__name__)

POLL_S = 0.02
SAVE_AFTER_QUIET_S = 1.0
TROUBLE_S = 1.0  # before trying again what failed


class Tables(CurrentTables):
    """Tables by component name, following the ledger.

    A request takes the table there is (`surrogate`, a dictionary look-up). A start maps the packed
    files of the last one that are what it would build, and builds the others. One thread watches
    the ledger for rows committed, withdrawn or restored by this or any other process on the
    machine, `Builders` build the next version of a table in threads, write its packed file
    and swap it in, and a third writes a table's HDF5 file once it has been quiet for a second. What
    goes wrong with one component is in `faults`; the others go on. Parameters as `CurrentTables`.
    """

    def __init__(
        self,
        ledger: Ledger,
        library: Library,
        folder: Path,
        errors: SolverErrors | None = None,
        memory: float = TABLE_MEMORY,
    ) -> None:
        super().__init__(ledger, library, folder, errors, memory)
        self._seen: dict[str, int] = {}
        self._requested: dict[str, tuple[int, Component]] = {}
        self._built_for: dict[str, Component] = {}
        self._unsaved: dict[str, float] = {}
        self._faults: dict[str, str] = {}
        self._unwritten: dict[str, str] = {}
        self._unpacked: set[str] = set()
        self._failures = 0
        self._wake = threading.Event()
        self._builders = Builders(lambda name: self._guarded(name, self._bring_up, self._faults))
        self._threads = [
            threading.Thread(target=self._follow, name="tables-follow", daemon=True),
            threading.Thread(target=self._keep_files, name="tables-files", daemon=True),
        ]

    def start(self) -> None:
        """Start loading every table and following the ledger; return once the small ones answer."""
        sys.setswitchinterval(min(sys.getswitchinterval(), SWITCH_S))
        small, names = [], self._library.names()
        self._packed.remove_drafts()
        self._packed.remove_orphans({*names, *self._library.broken()})
        with ThreadPoolExecutor(usable_cores()) as threads:  # checksums let the others run
            list(threads.map(lambda name: self._guarded(name, self._take_up, self._faults), names))
        for name in names:
            rows = self._size(name)
            if rows <= LARGE:
                small.append(name)
            if name not in self._seen:
                self._builders.ask(name, rows)
        self._builders.start()
        for thread in self._threads:
            thread.start()
        with self._grown:
            self._grown.wait_for(
                lambda: all(name in self._seen or name in self._faults for name in small), START_S
            )

    def stop(self) -> None:
        """Stop following and write what is not written yet."""
        self._stopping.set()
        self._wake.set()
        self._builders.stop()
        for thread in self._threads:
            if thread.is_alive():
                thread.join()
        self._save(quiet_s=0.0)

    def faults(self) -> dict[str, str]:
        """Return why a component's table differs from the ledger, by its name."""
        return {**self._files.caveats, **self._unwritten, **self._faults}

    def building(self) -> list[str]:
        """Return the components that have no table yet since the start: they answer 503."""
        return [name for name in self._builders.busy() if name not in self._tables]

    def is_extended(self, name: str) -> bool:
        """Return whether a newer version of a table is being built."""
        return name in self._builders.busy()

    def notify(self) -> None:
        """Look at the ledger now rather than at the next poll."""
        self._wake.set()

    def catch_up(self, name: str, timeout: float) -> bool:
        """Wait until all that is committed when this is called is in the component's table.

        Returns False if time ran out, or if the table cannot be built: see `faults`.
        """
        goal, before = self._ledger.last_seq(name), self._failures
        if self._holds(name, goal):
            return True
        if name in self._faults:  # tried once more, now that a caller waits for it
            self._requested.pop(name, None)
        self._look(name, goal)

        def settled() -> bool:
            failed = name in self._faults and self._failures > before
            return self._holds(name, goal) or failed

        with self._grown:
            self._grown.wait_for(settled, timeout)
            return self._holds(name, goal)

    def _holds(self, name: str, goal: int) -> bool:
        """Return whether a table is of the component as it is now and has all rows up to goal."""
        present = self._built_for.get(name) is self._library[name]
        return self._seen.get(name, 0) >= goal and present

    def _look(self, name: str, goal: int | None = None) -> None:
        """Request a build if the ledger has changes that no build was requested for."""
        goal = self._ledger.last_seq(name) if goal is None else goal
        component = self._library[name]
        with self._grown:
            requested_goal, requested_for = self._requested.get(name, (None, None))
            if requested_goal == goal and requested_for is component:
                return
            if self._seen.get(name) == goal and self._built_for.get(name) is component:
                return
            self._requested[name] = goal, component
        known = self._tables.get(name)
        self._builders.ask(name, known.row_count if known is not None else self._size(name))

    def _follow(self) -> None:
        seen = None
        while not self._stopping.is_set():
            self._wake.wait(POLL_S)
            self._wake.clear()
            try:
                now = self._ledger.version(), self._library.version()
                if now != seen:
                    for name in self._library.names():
                        self._look(name)
                    seen = now
            except LedgerUnavailableError:
                seen = None  # the ledger reports it
                self._stopping.wait(TROUBLE_S)
            except Exception:
                log.exception("following the ledger failed; trying again")
                self._stopping.wait(TROUBLE_S)

    def _keep_files(self) -> None:
        while not self._stopping.wait(SAVE_AFTER_QUIET_S / 4):
            self._save(SAVE_AFTER_QUIET_S)
            drop_built(self.present().values(), self._memory)

    def _guarded(self, name: str, step: Callable[[str], None], faults: dict[str, str]) -> None:
        """Do something for one component, whose failure is no other's."""
        try:
            step(name)
            faults.pop(name, None)
        except Exception as error:
            why = str(error) or repr(error)
            if faults.get(name) != why:
                log.exception("the table of %s is not as it should be", name)
            with self._grown:
                faults[name] = why
                self._failures += 1
                self._requested.pop(name, None)  # the next change of the ledger tries again
                self._grown.notify_all()

    def _bring_up(self, name: str) -> None:
        """Bring one component's surrogate to what the ledger has now."""
        component = self._library[name]
        if self._built_for.get(name) is not component:
            self._seen.pop(name, None)  # its files were edited: not all rows there are its own
        seen = self._seen.get(name)
        if seen is not None and self._ledger.last_seq(name) == seen:
            return
        try:
            if seen is None:
                rows, after = self._files.load(component)
            else:
                rows, after = self._tables[name].rows, seen
            rows, version = self._followed(component, rows, after)
        except LedgerUnavailableError:
            if self._built_for.get(name) is not component:
                self._build(component, *self._unchecked(component))
            raise
        if len(rows) > LARGE:
            give_back()  # the import's, before the build takes as much again
        self._build(component, rows, version)
        if version != after:
            self._unsaved[name] = time.monotonic()
        with self._grown:
            self._faults.pop(name, None)
            self._seen[name] = version
            self._grown.notify_all()

    def _followed(self, component: Component, rows: Rows, after: int) -> tuple[Rows, int]:
        """Return rows with the ledger's changes after a seq, and up to which seq."""
        fresh = [rows]  # joined at the end: a table of a million rows comes in fifty parts
        while True:
            row_changes = self._ledger.row_changes(
                component.name, after, space=component.space, fingerprint=component.fingerprint
            )
            if row_changes.gone:
                fresh = [without(joined(fresh), row_changes.gone)]
            fresh.append(row_changes.rows)
            after = row_changes.last_seq
            if row_changes.whole:
                return joined(fresh), after

    def _unchecked(self, component: Component) -> tuple[Rows, int]:
        """Return the rows of a component's file, for as long as the ledger cannot be read."""
        found = self._files.read(component)
        if found is None or found[1].fingerprint != component.fingerprint:
            return Rows.empty(component.space), 0
        return found[0], found[1].last_seq

    def _take_up(self, name: str) -> None:
        """Map the packed file of an earlier start if it is what would be built now."""
        component = self._library[name]
        with suppress(LedgerUnavailableError):
            version = self._ledger.last_seq(name)
            origin = origin_of(self._ledger, component, version, self._errors)
            packed = self._packed.open(name, version, origin)
            ledger = origin.get("ledger", "")
            saved = packed and self._files.saved(component, version, ledger)
            if packed is None or saved is None:
                self._packed.remove(name)  # no other process may answer from it
                return
            self._packed.remove_others(name, version)
            self._put(component, packed, None)
            if saved != version:
                self._unsaved[name] = time.monotonic()
            self._seen[name] = version

    def _build(self, component: Component, rows: Rows, version: int) -> None:
        started = time.monotonic()
        name, before = component.name, self._tables.get(component.name)
        origin = origin_of(self._ledger, component, version, self._errors)
        built = make(component, rows, version, before and before.built, self._errors)
        content = packed_bytes(built, name, component.fingerprint, origin)
        try:
            packed = self._packed.write(name, version, content)
        except (OSError, PackedTableError) as error:  # answers need no file; `_write` tries again
            log.warning("the packed table of %s is in memory alone: %s", name, error)
            packed = PackedTable.from_bytes(content)
            self._unpacked.add(name)
            self._unsaved[name] = time.monotonic()
        self._put(component, packed, built)
        log.debug("%s: version %d, %.3f s", name, version, time.monotonic() - started)

    def _put(self, component: Component, packed: PackedTable, built: AnyTable | None) -> None:
        """Answer from a packed table from now on."""
        version: int = packed.words["provenance"]["version"]
        table = ServedTable(packed, partial(self._files.rows, component, version), built)
        with suppress(LedgerUnavailableError):
            count_others(self._ledger, component, table)
        with self._grown:
            self._tables[component.name] = table
            self._built_for[component.name] = component

    def _save(self, quiet_s: float) -> None:
        now = time.monotonic()
        for name, since in list(self._unsaved.items()):
            if now - since >= quiet_s:
                self._guarded(name, self._write, self._unwritten)

    def _write(self, name: str) -> None:
        self._unsaved[name] = time.monotonic() + TROUBLE_S  # when it is tried again if it fails
        table = self._tables[name]
        self._files.save(self._library[name], table.rows, table.version)
        if name in self._unpacked:
            self._packed.write(name, table.version, table.packed.content)
            self._unpacked.discard(name)
        del self._unsaved[name]
