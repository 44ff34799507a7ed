"""An opened data directory: library, ledger, live tables, dispatcher."""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from starlette.concurrency import run_in_threadpool
from threadpoolctl import threadpool_limits

from service.jobs.attempt import Progress, attempt_folder, read_progress
from service.jobs.dispatcher import Dispatcher
from service.jobs.engines.registry import open_engine
from service.jobs.record_outcome import notes_of
from service.ledger import Change, Job, Ledger, LedgerUnavailableError, OpenJob
from service.library.component import Component
from service.library.library import Library
from service.ordering import QUEUE_LIMIT, Orders
from service.report.queue import Reports
from service.tables.live import TableBehindError, Tables
from surrogate.build import AnyTable
from surrogate.design.adaptive import Design, next_wrenches
from surrogate.table.rows import LoadRange, Tolerance

log = logging.getLogger(__name__)

WAIT_POLL_S = 0.25
CATCH_UP_S = 25.0  # below the patience of clients and proxies, usually 30 s


@dataclass(frozen=True)
class Settings:
    """Where a workspace lies and how many solves may run at once on this machine.

    Parameters
    ----------
    folder:
        The data directory; everything the server must not lose is in it.
    solvers:
        Solves at once; 0 leaves all solving to other processes (``wrenchbook work``).
    engine:
        Where they run, by name.
    allow_decks:
        Whether an uploaded bundle may have a deck: it names a command, which solvers then run.
    queue_limit:
        Open jobs of a component that queries may have; those of fills and solves do not count.
    """

    folder: Path
    solvers: int = 2
    engine: str = "local"
    allow_decks: bool = False
    queue_limit: int = QUEUE_LIMIT


class Workspace:
    """One data directory, opened.

    Several processes may open the same directory: they share jobs and rows through the ledger.
    """

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._jobs_folder = settings.folder / "jobs"
        # A full disk or a damaged file keeps nobody from asking the tables there are.
        self.ledger = Ledger(settings.folder / "ledger.sqlite", patient=True)
        if trouble := self.ledger.trouble():
            log.error("nothing is accepted until this is mended: %s", trouble)
        self.library = Library(
            settings.folder / "components",
            allow_decks=settings.allow_decks,
            on_added=self._on_added,
        )
        self.orders = Orders(self.ledger, self.library, settings.queue_limit)
        self.tables = Tables(self.ledger, self.library, settings.folder / "tables")
        self.reports = Reports(settings.folder / "reports", settings.folder / "tables")
        self._dispatcher: Dispatcher | None = None
        self._changed: set[asyncio.Event] = set()
        self._changed_lock = threading.Lock()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._unit_solves_asked: dict[str, tuple[str, int]] = {}

    def start(self, loop: asyncio.AbstractEventLoop | None = None) -> None:
        """Load the tables, recover the jobs that were running, and start solving."""
        self._loop = loop
        # Threads of small matrix products only wait for each other, the more the busier the cores.
        threadpool_limits(limits=1)
        self.ledger.on_change(self._on_change)
        self.tables.start()
        self.start_solving()

    def start_solving(self) -> None:
        """Run the jobs of the ledger, without tables: all that `wrenchbook work` needs."""
        if not self.settings.solvers:
            return
        engine = open_engine(self.settings.engine, self.settings.solvers)
        self._dispatcher = Dispatcher(self.ledger, engine, self._bundle, self._jobs_folder)
        self._dispatcher.start()

    def close(self) -> None:
        """Stop; the solves that run are ended and wait again for the next start."""
        if self._dispatcher:
            self._dispatcher.stop()
        self.reports.close()
        self.tables.stop()
        self.ledger.close()

    def surrogate(self, name: str) -> AnyTable:
        """Return the newest surrogate of a component that somebody asks for an answer.

        A linear component whose 6x6 compliance is not known has the solves that tell it queued,
        once a version of its table.
        """
        surrogate = self.tables.surrogate(name)
        if surrogate.linear and not surrogate.fit.complete:
            self._ask_compliance(name, surrogate)
        return surrogate

    def first_open_job(self, name: str) -> OpenJob | None:
        """Return the oldest job of a component that waits or runs; None if there is none."""
        try:
            found = self.ledger.open_jobs(name, self.library[name].fingerprint)
        except LedgerUnavailableError:
            return None  # an estimate needs no ledger
        return found[0] if found else None

    async def newest(self, name: str, seconds: float) -> AnyTable:
        """Return the surrogate once it holds all rows there are now, or after `seconds` as it is.

        It waits on threads of asyncio's own, few: on those that queue a loop's wrenches, forty
        such readers would hold the loop up for as long as a table is built.

        Raises
        ------
        UnknownComponentError
            If there is no such component.
        """
        self.tables.surrogate(name)  # a name that is unknown ends here
        loop = asyncio.get_running_loop()
        await loop.run_in_executor(None, self.tables.catch_up, name, seconds)
        return self.tables.surrogate(name)

    def fill(
        self,
        name: str,
        budget: int,
        tolerance: Tolerance | None,
        span: LoadRange | None = None,
        outputs: Sequence[int] = range(6),
    ) -> tuple[Design, list[Job]]:
        """Design one round of solves on all rows there are, and accept them.

        Parameters
        ----------
        tolerance : Tolerance or None, m and rad
            The component's own if None.
        span : LoadRange, optional, N and N·m
            The part of the load range that the table is wanted for; all of it by default.
        outputs : sequence of int
            The outputs that are wanted.

        Raises
        ------
        NoSetupError
            If the component has no finite-element setup.
        TableBehindError
            If the table does not hold all rows yet: a design on an older one asks, and pays,
            for what is known.
        """
        self.orders.solvable(name)
        # First what is open, then what is known: a solve that ends between the two is in both.
        # The other way round it would be in neither, and be asked for again.
        asked = self.orders.asked_wrenches(name)
        surrogate = self.tables.caught_up(name, CATCH_UP_S)
        design = next_wrenches(
            surrogate,
            budget,
            pending=asked,
            tolerance=tolerance,
            span=span,
            outputs=outputs,
        )
        jobs = self.orders.fill(name, design.wrenches)
        # A design knows no locked freedoms: what it tells apart may be one wrench, and known.
        return design, [job for job in jobs if job.status != "done"]

    async def wait(self, job_id: int, seconds: float) -> Job:
        """Return the job once it has ended, or as it is after ``seconds``."""
        return (await self.wait_all([job_id], seconds))[0]

    async def wait_all(self, job_ids: list[int], seconds: float) -> list[Job]:
        """Return the jobs once all have ended, or as they are after ``seconds``."""
        loop = asyncio.get_running_loop()
        deadline = loop.time() + seconds
        changed = asyncio.Event()
        with self._changed_lock:
            self._changed.add(changed)
        try:
            while True:
                changed.clear()
                jobs = await run_in_threadpool(lambda: [self.ledger.job(one) for one in job_ids])
                left = deadline - loop.time()
                if left <= 0 or all(job.is_final for job in jobs):
                    return jobs
                await _wait_for(changed, min(left, WAIT_POLL_S))
        finally:
            with self._changed_lock:
                self._changed.discard(changed)

    def progress(self, job: Job) -> Progress | None:
        """Return how far a running job is; None if its solver has not said anything yet."""
        return read_progress(self.attempt_folder(job))

    def notes(self, job: Job) -> list[str]:
        """Return what the solver of a done job said about its answer."""
        return notes_of(job, self.attempt_folder(job)) if job.status == "done" else []

    def attempt_folder(self, job: Job) -> Path:
        """Return the folder of a job's latest attempt."""
        return attempt_folder(self._jobs_folder, job.id, job.attempt)

    def faults(self) -> list[str]:
        """Return what keeps this workspace from doing its work; empty if nothing does."""
        trouble = self.ledger.trouble()
        if trouble:
            return [f"nothing is accepted: {trouble}"]
        trouble = self._dispatcher.trouble if self._dispatcher else None
        return [f"jobs do not run: {trouble}"] if trouble else []

    def broken(self) -> dict[str, str]:
        """Return what is wrong with single components, by name; the others answer."""
        damaged: dict[str, str] = {}
        for seq, name in self.ledger.damaged.items():
            damaged[name] = f"row {seq} is damaged on the disk and left out of the table"
        return {**damaged, **self.tables.faults(), **self.library.broken()}

    def _on_added(self, component: Component) -> None:
        try:
            self.surrogate(component.name)
        except TableBehindError:
            self.tables.notify()  # the ledger has rows of an earlier component of this name

    def _ask_compliance(self, name: str, surrogate: AnyTable) -> None:
        """Queue what tells a linear component's compliance, once a version of its table."""
        component = self.library[name]
        asked_for = component.fingerprint, surrogate.version
        if not component.has_fea or self._unit_solves_asked.get(name) == asked_for:
            return
        self._unit_solves_asked[name] = asked_for
        try:
            asked = self.orders.asked_wrenches(name)
            design = next_wrenches(surrogate, 6, pending=asked)
            self.orders.fill(name, design.wrenches, urgent=True)
        except LedgerUnavailableError:
            del self._unit_solves_asked[name]  # asked again by the next question

    def _bundle(self, name: str) -> Path:
        return self.library[name].folder

    def _on_change(self, _: Change) -> None:
        """Wake whoever waits for a job; called from the thread that committed."""
        self.tables.notify()
        loop = self._loop
        if loop is None or loop.is_closed():
            return
        with self._changed_lock:
            waiting = list(self._changed)
        for event in waiting:
            loop.call_soon_threadsafe(event.set)


async def _wait_for(event: asyncio.Event, seconds: float) -> None:
    try:
        await asyncio.wait_for(event.wait(), seconds)
    except TimeoutError:
        return
