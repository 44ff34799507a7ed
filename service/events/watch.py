"""Turns what changes in a workspace into events, whichever process changed it.

It looks at the state and tells the differences, several times a second while somebody listens:
so jobs that another process has claimed or ended are reported like this server's own.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from starlette.concurrency import run_in_threadpool

from wrenchbook.service.events.feed import Feed, Listener
from wrenchbook.service.ledger import Change, JobRecord, LedgerError, LedgerUnavailableError
from wrenchbook.service.tables.mapped import TableBehindError
from wrenchbook.service.workspace import Workspace

_log = logging.getLogger(__name__)

LOOK_S = 0.25  # between looks: what people and simulators wait for is no faster
FIRST_LOOK_S = 10.0  # as long as a ledger may be busy; later the caller must retry
LINGER_S = 300.0  # looked on after the last listener left: it may only be connecting again
ONE_BY_ONE = 50  # changed jobs reported one by one; more are reported as a number

Notice = tuple[str, str | None, dict[str, Any]]


@dataclass
class Seen:
    """What was there at the last look: open jobs as they stood, versions of tables."""

    ledger: int | None = None
    newest_job: int = 0
    jobs: dict[int, tuple[str, int, float]] = field(default_factory=dict)
    versions: dict[str, int] = field(default_factory=dict)


class Watch:
    """Looks at a workspace for as long as its feed has listeners."""

    def __init__(self, workspace: Workspace) -> None:
        self.feed = Feed()
        self._workspace = workspace
        self._task: asyncio.Task[None] | None = None
        self._seen: Seen | None = None
        self._looked = asyncio.Event()
        self._wake = asyncio.Event()
        self._unsubscribe: Callable[[], None] = lambda: None

    def start(self, loop: asyncio.AbstractEventLoop) -> None:
        """Be woken by this process's own changes."""

        def changed(_: Change) -> None:
            if self._task is not None and not loop.is_closed():
                loop.call_soon_threadsafe(self._wake.set)

        self._unsubscribe = self._workspace.ledger.on_change(changed)

    async def stop(self) -> None:
        """Let listeners go and look no more."""
        self._unsubscribe()
        self.feed.close()
        if self._task is not None:
            self._task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._task

    async def listen(self, component: str | None, last_id: str | None) -> Listener:
        """Return a listener that receives all changes after its greeting.

        A first look comes before the greeting: what changes from then on is sent, and nothing
        that changes between the two is lost.

        Raises
        ------
        LedgerUnavailableError
            If the ledger could not be read.
        TooManyListenersError
            If all places are taken.
        """
        if self._task is None or self._task.done():
            self._looked.clear()
            self._task = asyncio.get_running_loop().create_task(self._look_on())
        try:
            await asyncio.wait_for(self._looked.wait(), FIRST_LOOK_S)
        except TimeoutError:
            raise LedgerUnavailableError(
                "the ledger could not be read for a first look; try again in a moment"
            ) from None
        versions: dict[str, int | None] = {**self._seen.versions} if self._seen else {}
        if component is not None:
            versions = {component: versions.get(component)}
        return self.feed.listen(component, last_id, {"tables": versions})

    async def _look_on(self) -> None:
        loop = asyncio.get_running_loop()
        self._seen, used = None, loop.time()
        while self.feed.listeners or loop.time() - used < LINGER_S:
            self._wake.clear()
            try:
                self._seen, notices = await run_in_threadpool(look, self._workspace, self._seen)
                for event in notices:
                    self.feed.publish(*event)
                self._looked.set()
            except LedgerError:
                await asyncio.sleep(1.0)  # the ledger itself tells of it
            except Exception:
                _log.exception("looking for events failed; trying again")
                await asyncio.sleep(1.0)
            if self.feed.listeners:
                used = loop.time()
            await asyncio.sleep(LOOK_S / 5)  # changes that come together are sent together
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._wake.wait(), LOOK_S)
        self.feed.forget()
        self._task = None


def look(workspace: Workspace, seen: Seen | None) -> tuple[Seen, list[Notice]]:
    """Return what is there now, and the events that lead there from what was seen."""
    ledger = workspace.ledger
    before = seen or Seen()
    now = Seen(ledger.version(), before.newest_job, before.jobs, table_versions(workspace))
    notices = _of_tables(workspace, before, now) if seen else []
    changed: list[JobRecord] = []
    if now.ledger != before.ledger:
        jobs = ledger.unfinished(before.newest_job if seen else None)
        newest = jobs if seen else ledger.jobs(limit=1)
        now.newest_job = max([before.newest_job, *(job.id for job in newest)])
        ended = [ledger.job(one) for one in before.jobs.keys() - {job.id for job in jobs}]
        changed = [job for job in jobs if before.jobs.get(job.id, ())[:2] != _state(job)]
        changed = [*ended, *changed] if seen else []
        now.jobs = {job.id: (*_state(job), 0.0) for job in jobs if not job.is_final}
    progressed = _progressed(workspace, before, now)
    return now, [*_of_jobs(changed), *progressed, *notices]


def table_versions(workspace: Workspace) -> dict[str, int]:
    """Return the versions of the tables that answer, by component."""
    found = {}
    for name in workspace.library.names():
        with contextlib.suppress(TableBehindError, LookupError):
            found[name] = workspace.tables.surrogate(name).version
    return found


def job_event(job: JobRecord, **more: Any) -> dict[str, Any]:
    """Return what an event says of a job."""
    return {
        "id": job.id,
        "status": job.status,
        "url": f"/v1/jobs/{job.id}",
        "component": job.component,
        "attempt": job.attempt,
        "error": job.error,
        "row": job.row,
        **more,
    }


def _state(job: JobRecord) -> tuple[str, int]:
    return job.status, job.attempt


def _of_jobs(changed: list[JobRecord]) -> list[Notice]:
    """Tell changed jobs one by one, or of a component with many how many there are."""
    of_component: dict[str, list[JobRecord]] = {}
    for job in sorted(changed, key=lambda job: job.id):
        of_component.setdefault(job.component, []).append(job)
    notices: list[Notice] = []
    for name, jobs in of_component.items():
        if len(jobs) > ONE_BY_ONE:
            body = {"component": name, "count": len(jobs), "url": f"/v1/jobs?component={name}"}
            notices.append(("jobs", name, body))
        else:
            notices += [("job", name, job_event(job)) for job in jobs]
    return notices


def _of_tables(workspace: Workspace, before: Seen, now: Seen) -> list[Notice]:
    notices: list[Notice] = []
    for name, version in now.versions.items():
        if version != before.versions.get(name):
            rows = workspace.tables.surrogate(name).row_count
            body = {"component": name, "table_version": version, "rows": rows}
            notices.append(("table", name, body))
    return notices


def _progressed(workspace: Workspace, before: Seen, now: Seen) -> list[Notice]:
    """Tell how far running jobs are where that has changed."""
    notices: list[Notice] = []
    running = [number for number, state in now.jobs.items() if state[0] == "running"]
    for number in running[:ONE_BY_ONE]:
        job = workspace.ledger.job(number)
        progress = workspace.progress(job)
        if progress is None or job.status != "running":
            continue
        fraction, last = progress.fraction, before.jobs.get(number, ("", 0, 0.0))[2]
        now.jobs[number] = (*_state(job), fraction)
        if fraction != last:
            about = {"fraction": fraction, "message": progress.message}
            notices.append(("job", job.component, job_event(job, progress=about)))
    return notices
