"""The builder's tables: each is built again, packed and stored when the ledger's rows change."""

from __future__ import annotations

import logging
import math
import os
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass

from wrenchbook.service.contract import CONTRACT
from wrenchbook.service.files.program import free_memory, usable_cores
from wrenchbook.service.ledger import LedgerUnavailableError
from wrenchbook.service.ledger.connection import with_remedy
from wrenchbook.service.library.component import Component
from wrenchbook.service.library.library import Library
from wrenchbook.service.settings import Settings
from wrenchbook.service.tables import store
from wrenchbook.service.tables.coordinator_state import CoordinatorState, Status
from wrenchbook.service.tables.rows import with_changes
from wrenchbook.service.tables.store import TableStore, drop_least_used
from wrenchbook.surrogate.build import Table, build
from wrenchbook.surrogate.packed.writer import pack
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.rows import Rows

log = logging.getLogger(__name__)

POLL_S = 0.02  # pause between polls of the ledger, of some microseconds each
SMALL_AT_ONCE = 2  # small builds beside a large one: all share one interpreter
SAVE_AFTER_QUIET_S = 1.0  # time without changes before an HDF5 file, written as a whole, is due
RETRY_S = 1.0  # pause before a failed step is repeated: a full disk lasts
START_S = 30.0  # s that a start waits for small tables; later ones answer 503 until they are built
_UNCONFIRMED = -1  # version of a file's rows that the ledger could not confirm


def build_table(
    component: Component,
    rows: Rows,
    version: int,
    error: SolverError | None = None,
    before: Table | None = None,
) -> Table:
    """Build a version of a component's table; its number is that of the ledger's newest change.

    The result depends on the rows and the solver's error alone: every process computes the same
    digits. Equal parts are taken from the version `before`.
    """
    return build(
        rows,
        component.load_range,
        tolerance=component.tolerance,
        linear=component.linear,
        version=version,
        before=before,
        solver_error=error if component.has_fea else None,
        locked=component.idle,
    )


def packed_bytes(table: Table, component: Component, origin: dict[str, str] | None = None) -> bytes:
    """Return the packed file of a component's table; `origin`: see `TableStore.origin`."""
    name, fingerprint = component.name, component.fingerprint
    pieces = pack(table, component=name, fingerprint=fingerprint, contract=CONTRACT, origin=origin)
    return b"".join(pieces)


@dataclass
class _Version:
    """The newest version of a component's table."""

    component: Component
    number: int
    table: Table | None = None  # None if it was not built in this process, or was dropped
    save_at: float | None = None  # when its HDF5 file is due; None once it is written
    packed: bytes = b""  # the packed file while the disk cannot store it
    used: float = 0.0  # monotonic s, as `mapped.ServedTable.used`

    def rows_in_memory(self) -> int:
        """Return the number of rows in memory; 0 as long as their HDF5 file is not written."""
        return 0 if self.table is None or self.save_at is not None else len(self.table.rows)

    def drop(self) -> None:
        """Drop the table."""
        self.table = None


class TableBuilder:
    """Tables by component name, built from the ledger's rows.

    At a start it reuses packed files that a build would reproduce. One thread watches the ledger
    for rows committed, withdrawn or restored by any process of the machine and publishes `Status`;
    one large table at a time is built, and small ones beside it; another thread writes a table's
    HDF5 file after a second without changes. A fault of one component does not stop the others:
    `faults` has it, and the ledger's next change tries again.

    `state` is the data directory's, locked by this process; `memory` is in MB, and `trouble`
    returns why no job runs.
    """

    def __init__(
        self,
        files: TableStore,
        library: Library,
        state: CoordinatorState,
        memory: float = Settings.table_memory,
        trouble: Callable[[], str | None] = lambda: None,
    ) -> None:
        self._store = files
        self._ledger = files.ledger
        self._library = library
        self._state = state
        self._memory = memory
        self._trouble = trouble
        # By component name. The thread that builds a component writes its entries: one at a time,
        # by `_running`. The files' thread writes `save_at`, `packed` and `table` of a version, and
        # `_unwritten`. Others read; single operations of a dict or set are atomic.
        self._versions: dict[str, _Version] = {}
        self._faults: dict[str, str] = {}
        self._failed_at: dict[str, int] = {}
        self._unwritten: dict[str, str] = {}
        # Held while a packed file and its version are replaced, so that no earlier version of the
        # files' thread is written after it.
        self._replacing = threading.Lock()
        self._behind: set[str] = set()  # tables to build; used by the following thread alone
        # The following thread adds a name, the end of a build removes it.
        self._running: set[str] = set()
        self._ended = threading.Condition()  # notified at the end of each build
        self._stopping = threading.Event()
        self._large = ThreadPoolExecutor(1, "build-large")
        self._small = ThreadPoolExecutor(SMALL_AT_ONCE, "build-small")
        self._threads = [
            threading.Thread(target=self._follow, name="tables-follow", daemon=True),
            threading.Thread(target=self._keep_files, name="tables-files", daemon=True),
        ]

    def start(self) -> None:
        """Start to build; return once the small tables are built."""
        names = self._library.names()
        self._store.remove_stray({*names, *self._library.broken()})
        with ThreadPoolExecutor(usable_cores()) as threads:  # the others run during checksums
            list(threads.map(lambda name: self._guarded(name, self._reuse, self._faults), names))
        self._behind = {name for name in names if name not in self._versions}
        small = self._store.small(names)
        for thread in self._threads:
            thread.start()
        with self._ended:
            self._ended.wait_for(lambda: small <= {*self._versions, *self._faults}, START_S)

    def stop(self) -> None:
        """Finish the running builds, and write unwritten files."""
        self._stopping.set()
        for thread in self._threads:
            if thread.is_alive():
                thread.join()
        for executor in (self._large, self._small):
            executor.shutdown(cancel_futures=True)
        self._save(math.inf)

    def faults(self) -> dict[str, str]:
        """Return by component the reason why its table differs from the ledger."""
        return {**self._store.caveats, **self._unwritten, **self._faults}

    def _follow(self) -> None:
        """Submit the builds of tables that lag behind the ledger, until the builder is stopped."""
        version = None
        while not self._stopping.wait(POLL_S):
            pause = 0.0
            try:
                # A table that changes during its build is built again afterwards.
                for name in self._behind - self._running:
                    executor = self._small if self._store.small([name]) else self._large
                    self._submit(executor, name)
                now = self._ledger.version(), self._library.version()
                if now != version:
                    self._behind |= {name for name in self._library.names() if self._lags(name)}
                    version = now
            except LedgerUnavailableError:
                version = None  # the ledger reports the error
                pause = RETRY_S
            except Exception:
                log.exception("following the ledger failed; trying again")
                pause = RETRY_S
            try:
                failed = dict(self._failed_at)
                self._state.write(Status(self._trouble(), self.faults(), os.getpid(), failed))
            except OSError as error:
                log.warning("the builder's status cannot be written for web workers: %s", error)
            self._stopping.wait(pause)

    def _submit(self, executor: ThreadPoolExecutor, name: str) -> None:
        """Start a table's build in an executor: small tables do not wait for large ones."""
        self._running.add(name)
        try:
            executor.submit(self._run_build, name)
        except BaseException:
            self._running.discard(name)
            raise
        self._behind.discard(name)

    def _lags(self, name: str) -> bool:
        """Return whether a table's component or rows are not the present ones."""
        known = self._versions.get(name)
        if known is None or known.component is not self._library[name]:
            return True
        return known.number != self._ledger.last_seq(name)

    def _keep_files(self) -> None:
        while not self._stopping.wait(SAVE_AFTER_QUIET_S / 4):
            self._save(time.monotonic())
            drop_least_used(list(self._versions.values()), self._memory)

    def _save(self, until: float) -> None:
        for name, version in list(self._versions.items()):
            due = version.save_at  # other threads write it
            if due is not None and due <= until:
                self._guarded(name, self._write, self._unwritten)

    def _guarded(self, name: str, step: Callable[[str], None], faults: dict[str, str]) -> bool:
        """Run a step for one component; record its failure, and return whether it succeeded."""
        try:
            step(name)
            faults.pop(name, None)
            return True
        except Exception as error:
            why = with_remedy(error)
            if faults.get(name) != why:
                text = "the table of %s is not as it should be: %s"
                log.error(text, name, why, exc_info=why in (str(error), repr(error)))
            faults[name] = why
            return False

    def _run_build(self, name: str) -> None:
        """Build a component's table from the ledger's present rows."""
        goal = 0
        with suppress(Exception):  # the build meets the error too, and reports it
            goal = self._ledger.last_seq(name)
        if not self._guarded(name, self._build_newest, self._faults):
            self._failed_at[name] = goal
        with self._ended:
            self._running.discard(name)
            self._ended.notify_all()

    def _build_newest(self, name: str) -> None:
        """Build a component's table from the newest rows if it lags behind the ledger."""
        if not self._lags(name):
            return
        component = self._library[name]
        known = self._versions.get(name)
        if known is not None and known.component is not component:
            known = None  # its files were edited, so its rows may differ
        try:
            if known is None or known.number == _UNCONFIRMED:
                rows, after = self._store.load(component)
            else:
                table, after = known.table, known.number
                rows = self._store.rows(component, after) if table is None else table.rows
            rows, version = with_changes(self._ledger, component, rows, after)
        except LedgerUnavailableError:
            if known is None:  # its file answers while the ledger cannot be read
                rows, version = Rows.empty(component.space), 0
                content = self._store.read(component)
                if content is not None and content[1].fingerprint == component.fingerprint:
                    rows, version = content[0], content[1].last_seq
                self._build(component, rows, version)
                self._versions[name].number = _UNCONFIRMED
                self._versions[name].save_at = None
            raise
        if len(rows) > store.LARGE:
            free_memory()  # that of the import, before the build takes as much
        self._build(component, rows, version)
        if version == after and not self._versions[name].packed:
            self._versions[name].save_at = None  # its HDF5 file has these rows
            self._unwritten.pop(name, None)

    def _build(self, component: Component, rows: Rows, number: int) -> None:
        """Build version `number` of a table from its rows, and write its packed file."""
        started = time.monotonic()
        name = component.name
        before = self._versions.get(name)
        error = self._store.solver_error(component)
        origin = self._store.origin(component, number, error)
        table = build_table(component, rows, number, error, before and before.table)
        content = packed_bytes(table, component, origin)
        save_at = SAVE_AFTER_QUIET_S
        with self._replacing:
            try:
                self._store.write_packed(name, number, content)
                content = b""
            except OSError as failure:  # the earlier version answers; `_write` tries again
                why = with_remedy(failure)
                log.warning("the packed table of %s cannot be written: %s", name, why)
                save_at = 0.0
                self._unwritten[name] = why
                self._failed_at[name] = number
            now = time.monotonic()
            self._versions[name] = _Version(component, number, table, now + save_at, content, now)
        log.debug("%s: version %d, %.3f s", name, number, now - started)

    def _reuse(self, name: str) -> None:
        """Reuse the packed file of an earlier start if a build would reproduce it."""
        component = self._library[name]
        with suppress(LedgerUnavailableError):
            number = self._ledger.last_seq(name)
            error = self._store.solver_error(component)
            origin = self._store.origin(component, number, error)
            current = self._store.is_current(component, number, origin)
            saved = self._store.saved(component, number, origin["ledger"]) if current else None
            if saved is None:
                self._store.remove_packed(name)  # no other process must answer from it
                return
            self._store.remove_packed(name, keep=number)
            due = None if saved == number else time.monotonic() + SAVE_AFTER_QUIET_S
            self._versions[name] = _Version(component, number, save_at=due)

    def _write(self, name: str) -> None:
        """Write a table's HDF5 file, and its packed file if that is missing."""
        version = self._versions[name]
        version.save_at = time.monotonic() + RETRY_S  # in case of a failure
        table = version.table
        rows = table.rows if table else self._store.rows(version.component, version.number)
        self._store.save(version.component, rows, version.number)
        with self._replacing:
            if version.packed and self._versions[name] is version:
                self._store.write_packed(name, version.number, version.packed)
                version.packed = b""
        version.save_at = None
