"""An opened data directory of a web worker: library, ledger, tables, queue."""

from __future__ import annotations

import asyncio
import logging
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from wrenchbook.service.actors import CALLER, SERVER, acting_as
from wrenchbook.service.demand import DemandMaps
from wrenchbook.service.fields.deformed import DeformedSurfaces
from wrenchbook.service.fields.shape import Deformed
from wrenchbook.service.fields.store import FieldStore
from wrenchbook.service.jobs.attempt import Attempt, attempt_folder, notes_of
from wrenchbook.service.jobs.waiting import Polls
from wrenchbook.service.ledger import (
    JobRecord,
    Ledger,
    LedgerError,
    LedgerUnavailableError,
    Quota,
    noted,
)
from wrenchbook.service.ledger.connection import inode
from wrenchbook.service.library.catalogue import Catalogue
from wrenchbook.service.library.component import Component, solver_error_of
from wrenchbook.service.library.library import Library
from wrenchbook.service.ops.checks import is_full
from wrenchbook.service.ops.replica import STATUS, read_status
from wrenchbook.service.report.queue import Reports
from wrenchbook.service.settings import Settings
from wrenchbook.service.submission import Submission
from wrenchbook.service.tables.coordinator_state import FOLDER, CoordinatorState
from wrenchbook.service.tables.mapped import MappedTables, ServedTable, TableBehindError
from wrenchbook.service.tables.solver_errors import SolverErrors
from wrenchbook.service.tables.store import TableStore
from wrenchbook.surrogate.design import Design, next_wrenches
from wrenchbook.surrogate.scene.plan import Need, design_of, plan_of
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.rows import Rows, Tolerance

log = logging.getLogger(__name__)

MAX_UNBUILT = 500  # rows searched for a wrench: a loop reads them at each uncovered query
CATCH_UP_S = 25.0  # below the timeouts of clients and proxies, usually 30 s

POLL_S = 0.02  # interval of polls of the ledger: PRAGMA data_version takes microseconds
# Files follow a commit within the time of a build; later they are polled at a longer interval, as
# each poll of an idle process takes ten times as long as that of a busy one.
FOLLOWS_S = 10.0
IDLE_POLL_S = 0.1
TROUBLE_S = 1.0  # pause before a failed listener is called again: its cause, as a full disk, lasts

Stamp = Callable[[], object]


@dataclass(eq=False)
class _Entry:
    """A listener, the function of its stamp, and the stamp of its last call."""

    listener: Callable[[], object]
    stamp: Stamp
    last: object
    not_before: float = 0.0


class Watcher:
    """The only thread of a process that notices changes by other processes.

    It calls listeners after commits of any process, at once after those of its own ledger.

    It also watches files of the data directory that are no part of the ledger: see `on_change`.
    """

    def __init__(self, ledger: Ledger) -> None:
        self._ledger = ledger
        self._entries: tuple[_Entry, ...] = ()
        self._lock = threading.Lock()
        self._wake, self._stopping = threading.Event(), threading.Event()
        self._end_notices: Callable[[], None] = lambda: None
        self._thread = threading.Thread(target=self._run, name="watcher", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._end_notices = self._ledger.on_change(self._wake.set)
        self._thread.start()

    def stop(self) -> None:
        """End the thread; no listener is called from then on."""
        self._end_notices()
        self._stopping.set()
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join()

    def on_change(
        self, listener: Callable[[], object], stamp: Stamp | None = None
    ) -> Callable[[], None]:
        """Call `listener` after each commit, or whenever the result of `stamp` has changed.

        It is called in the watcher's thread and must be quick; a listener that fails is called
        again. Returns a function that ends the subscription.
        """
        stamp = stamp or self.version
        entry = _Entry(listener, stamp, stamp())
        with self._lock:
            self._entries = (*self._entries, entry)

        def remove() -> None:
            with self._lock:
                self._entries = tuple(other for other in self._entries if other is not entry)

        return remove

    def version(self) -> int | None:
        """Return a number that differs after each commit; None while the ledger is unreadable."""
        try:
            return self._ledger.version()
        except LedgerError:
            return None

    def _run(self) -> None:
        """Call each listener whose stamp has changed, until the watcher is stopped."""
        version: object = None
        follows_until = next_files = 0.0
        while not self._stopping.is_set():
            self._wake.wait(POLL_S)
            self._wake.clear()
            now = time.monotonic()
            try:
                stamps: dict[Stamp, object] = {self.version: self.version()}
            except Exception:
                log.exception("the ledger's version could not be read; trying again")
                self._stopping.wait(TROUBLE_S)
                continue
            if stamps[self.version] != version:
                version, follows_until = stamps[self.version], now + FOLLOWS_S
            reads_files = now < follows_until or now >= next_files
            if reads_files:
                next_files = now + IDLE_POLL_S
            for entry in self._entries:
                is_due = reads_files or entry.stamp == self.version
                if now < entry.not_before or not is_due or self._stopping.is_set():
                    continue
                try:
                    if entry.stamp not in stamps:
                        stamps[entry.stamp] = entry.stamp()
                    if stamps[entry.stamp] != entry.last:
                        entry.last = stamps[entry.stamp]
                        entry.listener()
                except Exception:
                    log.exception("a listener for changes failed; it is called again")
                    entry.last = object()
                    entry.not_before = time.monotonic() + TROUBLE_S


class Workspace:
    """One data directory, opened.

    Several processes may open the same directory: they share jobs and rows through the ledger.
    """

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._jobs_folder = settings.data / "jobs"
        # On a full disk or with a damaged file the existing tables still answer.
        self.copies: dict[str, Any] = {}  # the status of replica and backups
        read_only = self.refusal if settings.read_only else None
        self.ledger = Ledger(settings.data / "ledger.sqlite", patient=True, read_only=read_only)
        if trouble := self.ledger.trouble():
            log.error("nothing is accepted until this is repaired: %s", trouble)
        self.watcher = Watcher(self.ledger)
        self.library = Library(
            settings.data / "components",
            allow_decks=settings.allow_decks,
            on_added=self._on_added,
            on_checked=self._on_checked,
            # Before rows of the copy can be answered without the solver's error.
            on_copy=lambda old, name: self.errors.copy(old.name, old.fingerprint, name),
            noted=lambda name: noted(self.ledger, "component.add", name, component=name),
        )
        self.catalogue = Catalogue(self.ledger)
        self.demand_maps = DemandMaps(self.ledger)
        self.quota = Quota(settings.actor_jobs, settings.actor_seconds)
        self.submission = Submission(self.ledger, self.library, settings.queue_limit, self.quota)
        self.errors = SolverErrors(self.ledger)
        self.tables = MappedTables(
            TableStore(settings.data / "tables", self.ledger, self.errors),
            self.library,
            CoordinatorState(settings.data / FOLDER),
            settings.table_memory,
            settings.method,
        )
        self.fields = FieldStore(settings.data / "fields")
        self.shapes = DeformedSurfaces(self.fields)
        self.reports = Reports(settings.data / "reports", settings.data / "tables")
        self.polls = Polls(self.ledger)
        self.comparison_lock = asyncio.Lock()  # each comparison builds a table
        self._compliance_requested: dict[str, tuple[str, int]] = {}

    def start(self) -> None:
        """Map the tables, and watch for changes by other processes."""
        # Threads of small matrix products only wait for each other, longer on busier cores.
        threadpool_limits(limits=1)
        with suppress(LedgerUnavailableError):
            self.ledger.drop_abandoned()  # remains of a server that was killed during an import
        self.watcher.on_change(self.tables.wake, self.tables.stamp)
        self.watcher.on_change(self._read_copies, partial(inode, self.settings.data / STATUS))
        self._read_copies()
        self.watcher.start()
        self.tables.start()
        if not self.settings.read_only:
            self.demand_maps.start()

    def close(self) -> None:
        """Stop watching, mapping and counting, and close the ledger."""
        self.watcher.stop()
        self.reports.close()
        self.shapes.close()
        self.tables.stop()
        if not self.settings.read_only:
            self.demand_maps.stop()
        self.ledger.close()

    def surrogate(self, name: str) -> ServedTable:
        """Return the newest table of a component for a query.

        For a linear component whose 6x6 compliance is unknown the missing solves are queued, once
        for each version of its table.
        """
        table = self.tables.surrogate(name)
        if table.needs_compliance:
            self._ask_compliance(name, table)
        return table

    def solver_error(self, component: Component, table: ServedTable) -> SolverError | None:
        """Return the solver error of a component and its table, for a row that was added just now.

        The estimate is stored before the row; the table's version with both may still be building.
        """
        return table.solver_error or self.errors.read(component.name, component.fingerprint)

    def unbuilt(self, component: Component, table: ServedTable) -> tuple[int, Rows]:
        """Return how many rows the next version adds, and the first `MAX_UNBUILT` of them.

        No rows if the ledger cannot be read: an answer needs no ledger.
        """
        name = component.name
        setup = {"space": component.space, "fingerprint": component.fingerprint}
        with suppress(LedgerUnavailableError):
            changes = self.ledger.row_changes(name, table.version, MAX_UNBUILT, **setup)
            if changes.complete:
                return len(changes.rows), changes.rows
            return self.ledger.count_new(name, component.fingerprint, table.version), changes.rows
        return 0, Rows.empty(component.space)

    async def newest(self, name: str, seconds: float) -> ServedTable:
        """Return the table once it has all present rows, or after `seconds` its present version.

        Raises UnknownComponentError if there is no such component, and TableBehindError if it has
        rows and was not built since the start.
        """
        await self.caught_up(name, seconds)
        return self.surrogate(name)

    async def caught_up(self, name: str, seconds: float) -> bool:
        """Return whether a table has all present rows, after at most `seconds`.

        No thread is held while it waits, so that no number of callers delays another request.
        """
        deadline = time.monotonic() + seconds
        loop = asyncio.get_running_loop()
        progress = await loop.run_in_executor(None, self.tables.progress, name)
        # No event: the versions of other web workers are in files.
        while (caught_up := await loop.run_in_executor(None, progress)) is None:
            if time.monotonic() >= deadline:
                break
            await asyncio.sleep(POLL_S)
        return caught_up is True

    def deformed(
        self, component: Component, table: ServedTable, wrench: NDArray[np.float64]
    ) -> Deformed:
        """Return a component's deformed surface under a wrench (6,), N and N·m, from files.

        Raises NoFieldsError if no row has a surface, and TooFarError for a wrench far beyond the
        load range.
        """
        solver = self.solver_error(component, table)
        reply = table.packed.answer(wrench.tolist())
        error_parts = {} if table.solver_error is None else {"mesh": reply.discretisation}
        if table.solver_error is not None and "linearity" in table.solver_error.values:
            error_parts["linearity"] = reply.linearity
        shape = self.shapes.answer(
            component, table.rows, wrench, table.hyperparameters, solver, error_parts
        )
        is_unknown = reply.coverage == "outside" and None in (reply.error or (None,))
        if is_unknown and shape.source == "rows" and shape.error is not None:
            return shape.without_bars(reply.reason)
        return shape

    def fill(
        self,
        name: str,
        budget: int,
        tolerance: Tolerance | None,
        need: Need | None = None,
        *,
        for_joint: bool = False,
    ) -> tuple[Design, list[JobRecord]]:
        """Design one round of solves on all present rows, and accept them.

        With `need`, a scene's requirements on the table, the fill follows the scene's plan;
        `for_joint` as of `next_wrenches`.

        Raises NoSetupError if the component cannot be solved, and TableBehindError if the table
        lacks rows: a design on an older version would repeat known solves.
        """
        self.submission.solvable(name)
        # First open jobs, then known rows: a solve that ends between the two is in both. In the
        # opposite order it would be in neither, and be solved twice.
        pending = self.submission.pending_wrenches(name)
        surrogate = self.tables.caught_up(name, CATCH_UP_S).surrogate()
        if need is None:
            span = self.library[name].acting_range
            options = {"tolerance": tolerance, "span": span, "for_joint": for_joint}
            design = next_wrenches(surrogate, budget, pending=pending, **options)
        else:
            design = design_of(surrogate, plan_of(surrogate, need), budget, pending)
        wrenches = design.wrenches
        if not len(wrenches) and design.stage != "met":  # an open solve is all it needs
            wrenches = self.submission.open_wrenches(name)
        jobs = self.submission.fill(name, wrenches)
        # A design separates by 1e-9 of the range, a queue by 1e-6: some may be known.
        return design, [job for job in jobs if job.status != "done"]

    def notes(self, job: JobRecord) -> list[str]:
        """Return the solver's notes on the answer of a done job."""
        return [] if job.status != "done" else notes_of(Attempt.of(job, self.attempt_folder(job)))

    def attempt_folder(self, job: JobRecord) -> Path:
        """Return the folder of a job's latest attempt."""
        return attempt_folder(self._jobs_folder, job.id, job.attempt)

    def faults(self) -> list[str]:
        """Return the problems that keep this workspace from working; empty if there are none."""
        trouble = self.ledger.trouble()
        if trouble:
            return [f"nothing is accepted: {trouble}"]
        if is_full(self.settings.data):
            return ["nothing is accepted, because the disk is full; make room"]
        if is_full(Path(tempfile.gettempdir())):
            return ["files are refused, because the disk of TMPDIR is full; make room there"]
        trouble = self.tables.trouble()
        return [f"jobs do not run: {trouble}"] if trouble else []

    def broken(self) -> dict[str, str]:
        """Return the problems of single components, by name; the others answer."""
        damaged: dict[str, str] = {}
        if losses := self.ledger.losses():
            damaged["(ledger)"] = f"{'; '.join(losses)}. Note it with: wrenchbook doctor --repair "
            damaged["(ledger)"] += f"--data {self.settings.data}"
        for seq, name in self.ledger.damaged.copy().items():  # others add to it
            damaged[name] = f"row {seq} is damaged on the disk and left out of the table"
        broken = {**damaged, **self.tables.faults()}
        may_use = CALLER.get().may_use
        return {k: v for k, v in broken.items() if may_use(k)} | self.library.broken()

    def age(self) -> float | None:
        """Return the largest age of a read-only server's state, s; None for other servers."""
        checked = self.copies.get("followed", {}).get("checked")
        return checked and max(0.0, time.time() - checked)

    def refusal(self, path: str = "") -> str:
        """Return the refusal of a write to a path, with the server that accepts the write."""
        send = f"Send it to {self.copies.get('followed', {}).get('server', 'the main server')}"
        if path.startswith("/v1/keys"):  # keys of the main server are not valid here
            send = f"Change its keys on its machine: wrenchbook keys --data {self.settings.data}"
        why = "This server answers from a replica and accepts no writes; nothing was changed"
        return f"{why}. {send}"

    def _read_copies(self) -> None:
        self.copies = read_status(self.settings.data)

    def _on_checked(self, component: Component) -> None:
        """Store the estimate of an upload's check before another process can build its table."""
        estimate = solver_error_of(component.folder, component.fingerprint)
        known = self.errors.read(component.name, component.fingerprint)
        # A later solve of an earlier component of this name and setup may have refined it.
        if estimate is not None and (known is None or not known.can_grow):
            self.errors.record(component.name, component.fingerprint, estimate)

    def _on_added(self, component: Component) -> None:
        with suppress(TableBehindError):  # the ledger has rows of an earlier component of this name
            self.surrogate(component.name)

    def _ask_compliance(self, name: str, table: ServedTable) -> None:
        """Queue the solves of a linear component's compliance, once for a version of its table."""
        component = self.library[name]
        setup = component.fingerprint, table.version
        if (
            self.settings.read_only
            or not component.has_fea
            or self._compliance_requested.get(name) == setup
        ):
            return
        self._compliance_requested[name] = setup
        try:
            pending = self.submission.pending_wrenches(name)
            design = next_wrenches(table.surrogate(), 6, pending=pending)
            # The caller may have read access only, and has not requested them.
            with acting_as(SERVER):
                self.submission.fill(name, design.wrenches, urgent=True)
        except LedgerUnavailableError:
            del self._compliance_requested[name]  # the next query tries again
