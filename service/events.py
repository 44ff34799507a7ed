"""Server-sent events: changes of jobs and tables by any process.

`Events` compares the state with that of its last poll while it has listeners, and `Feed` stores the
events for a while and gives them to its listeners. Both are used on one event loop.
"""

from __future__ import annotations

import asyncio
import contextlib
import contextvars
import logging
import secrets
from collections import deque
from dataclasses import dataclass, field
from itertools import islice
from typing import Any, NamedTuple

import orjson
from starlette.concurrency import run_in_threadpool

from wrenchbook.service.actors import ANONYMOUS, CALLER, LOCAL
from wrenchbook.service.jobs.attempt import read_progress
from wrenchbook.service.ledger import JobRecord, LedgerBusyError, LedgerError
from wrenchbook.service.tables.mapped import TableBehindError
from wrenchbook.service.workspace import Workspace

_log = logging.getLogger(__name__)

MAX_EVENTS = 2_000  # stored events, for listeners that are slow or reconnect: 0.6 MB
MAX_LISTENERS = 64  # listeners, each with a connection
MAX_OF_ACTOR = 32  # of one key or user: half, so that no single one locks out the others

POLL_S = 0.25  # s between polls of progress and tables, which no commit announces
# s for which a ledger may be busy; later the caller must retry.
FIRST_POLL_S = LedgerBusyError.retry_s
LINGER_S = 300.0  # s of polls after the last listener has left: it may be reconnecting
ONE_BY_ONE = 50  # changed jobs with an event each; a larger number is reported as a count

Notice = tuple[str, str | None, dict[str, Any]]  # kind, component (None for all), data


class TooManyListenersError(Exception):
    """The server already has `MAX_LISTENERS` listeners."""


class ListenerQuotaError(Exception):
    """The caller's key or user already has `MAX_OF_ACTOR` listeners."""

    retry_s = 20.0  # after which the server drops a listener that reads nothing


class Listener:
    """A connection that reads the events of a component, or of all that its caller may use."""

    def __init__(self, feed: Feed, component: str | None, number: int, greeting: bytes) -> None:
        self._component = component
        self._caller = CALLER.get()
        self.actor = self._caller.actor
        self.number = number  # number of the last event that was read
        self.ended = False
        self._feed = feed
        self._greeting = greeting
        self._ready = asyncio.Event()
        self._ready.set()
        self.wake = self._ready.set  # let `read` return: there is an event

    def hears(self, component: str | None) -> bool:
        """Return whether the listener reads the events of a component; None: of all components."""
        of_listener = self._component in (None, component)
        return component is None or (of_listener and self._caller.may_use(component))

    def end(self) -> None:
        """End the listener; it reads no further event."""
        self.ended = True
        self._greeting = b""
        self.wake()

    async def read(self, seconds: float) -> bytes:
        """Return all available lines, waiting for the first; nothing after `seconds`."""
        try:
            await asyncio.wait_for(self._ready.wait(), seconds)
        except TimeoutError:
            return b""
        self._ready.clear()
        greeting = self._greeting
        self._greeting = b""
        return greeting if self.ended else greeting + self._feed.unread(self)


class _Event(NamedTuple):
    number: int
    component: str | None
    wire: bytes


class Feed:
    """The newest events of one server, numbered.

    An id is the feed's random mark and a number, so that an id of an earlier feed is recognised.
    """

    def __init__(self) -> None:
        self._mark = secrets.token_hex(4)
        self._number = 0
        self._events: deque[_Event] = deque(maxlen=MAX_EVENTS)
        self._listeners: set[Listener] = set()
        self.closed = False

    @property
    def listeners(self) -> int:
        """The number of listeners."""
        return len(self._listeners)

    def publish(self, kind: str, component: str | None, body: dict[str, Any]) -> None:
        """Store an event, and wake its listeners."""
        self._number += 1
        self._events.append(_Event(self._number, component, _wire(kind, body, self._newest())))
        for listener in self._listeners:
            if listener.hears(component):
                listener.wake()

    def listen(self, component: str | None, last_id: str | None, hello: dict[str, Any]) -> Listener:
        """Add a listener, which reads the events after `last_id` and then new ones.

        Raises TooManyListenersError if there are `MAX_LISTENERS` already, and ListenerQuotaError if
        `MAX_OF_ACTOR` of the caller's key or user are.
        """
        if len(self._listeners) >= MAX_LISTENERS:
            raise TooManyListenersError(
                f"{MAX_LISTENERS} listeners are connected, the limit of this server; close one, or "
                "poll GET /v1/jobs and GET /v1/components. Nothing was changed."
            )
        actor = CALLER.get().actor
        count = sum(listener.actor == actor for listener in self._listeners)
        if count >= MAX_OF_ACTOR and actor not in (ANONYMOUS, LOCAL):
            raise ListenerQuotaError(
                f"{count} listeners of {actor!r} are connected, the limit of a key or user; close "
                "one, or poll GET /v1/jobs and GET /v1/components. Nothing was changed."
            )
        mark, _, number = (last_id or self._newest()).partition(".")
        last = int(number) if mark == self._mark and number.isdecimal() else -1
        is_stored = self._number - len(self._events) <= last <= self._number
        all_read = not is_stored or last == self._number
        greeting = b"retry: 2000\n" + _wire("hello", hello, self._newest() if all_read else None)
        if not is_stored:
            reason = "the events since your last one are no longer stored; read jobs and tables"
            greeting += _wire("missed", {"reason": reason}, self._newest())
        listener = Listener(self, component, last if is_stored else self._number, greeting)
        self._listeners.add(listener)
        if self.closed:
            listener.end()
        return listener

    def unread(self, listener: Listener) -> bytes:
        """Return the lines of a listener's further events.

        End a listener that is too far behind.
        """
        count = self._number - listener.number
        listener.number = self._number
        if count > len(self._events):
            self._listeners.discard(listener)
            listener.end()
            reason = (
                f"the listener is more than {len(self._events)} events behind; connect again with "
                "the id of the last one you have read"
            )
            return _wire("dropped", {"reason": reason}, None)
        events = islice(self._events, len(self._events) - count, None)
        return b"".join(event.wire for event in events if listener.hears(event.component))

    def leave(self, listener: Listener) -> None:
        """Remove a listener."""
        self._listeners.discard(listener)

    def forget(self) -> None:
        """Take another mark after a time without listeners, whose events are unknown."""
        self._mark = secrets.token_hex(4)
        self._events.clear()

    def close(self) -> None:
        """End all listeners, as the server stops."""
        self.closed = True
        for listener in self._listeners:
            listener.end()

    def _newest(self) -> str:
        return f"{self._mark}.{self._number}"


def _wire(kind: str, body: dict[str, Any], number: str | None) -> bytes:
    """Return an event's lines; its JSON is one line, so that no data looks like a field."""
    lines = [b"event: " + kind.encode(), b"data: " + orjson.dumps(body)]
    if number is not None:
        lines.insert(0, b"id: " + number.encode())
    return b"\n".join(lines) + b"\n\n"


@dataclass
class Snapshot:
    """The state at a poll: open jobs (status, attempt, progress) and versions of tables."""

    ledger: int | None = None
    newest_job: int = 0
    jobs: dict[int, tuple[str, int, float]] = field(default_factory=dict)
    versions: dict[str, int] = field(default_factory=dict)


class Events:
    """Polls a workspace as long as its feed has listeners."""

    def __init__(self, workspace: Workspace) -> None:
        self.feed = Feed()
        self._workspace = workspace
        self._task: asyncio.Task[None] | None = None
        self._last: Snapshot | None = None
        self._polled = asyncio.Event()
        self._wake = asyncio.Event()
        self.wake = self._wake.set  # poll soon, as something was committed; call it in the loop

    async def stop(self) -> None:
        """End the listeners and stop polling."""
        self.feed.close()
        if self._task is not None:
            self._task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._task

    async def listen(self, component: str | None, last_id: str | None) -> Listener:
        """Return a listener that receives all changes after its greeting.

        A first poll precedes the greeting, so that no change between the two is lost.

        Raises LedgerBusyError if the ledger cannot be read, and the errors of `Feed.listen`.
        """
        if self._task is None or self._task.done():
            self._polled.clear()
            everything = contextvars.Context()  # not that of the first listener's caller
            self._task = asyncio.get_running_loop().create_task(self._poll(), context=everything)
        try:
            await asyncio.wait_for(self._polled.wait(), FIRST_POLL_S)
        except TimeoutError:
            raise LedgerBusyError(
                f"the ledger gave no answer within {FIRST_POLL_S:g} s, so no events can be sent; "
                f"connect again in {FIRST_POLL_S:g} s. If that lasts, run on the server's machine: "
                f"wrenchbook doctor --data {self._workspace.ledger.path.parent}"
            ) from None
        versions: dict[str, int | None] = {**self._last.versions} if self._last else {}
        if component is not None:
            versions = {component: versions.get(component)}
        versions = {name: versions[name] for name in filter(CALLER.get().may_use, versions)}
        return self.feed.listen(component, last_id, {"tables": versions})

    async def _poll(self) -> None:
        """Publish changes while somebody listens, and `LINGER_S` longer."""
        loop = asyncio.get_running_loop()
        self._last = None
        used = loop.time()
        while self.feed.listeners or loop.time() - used < LINGER_S:
            self._wake.clear()
            try:
                self._last, notices = await run_in_threadpool(poll, self._workspace, self._last)
                for notice in notices:
                    self.feed.publish(*notice)
                self._polled.set()
            except LedgerError:
                await asyncio.sleep(1.0)  # the ledger itself reports the error
            except Exception:
                _log.exception("polling for events failed; trying again")
                await asyncio.sleep(1.0)
            if self.feed.listeners:
                used = loop.time()
            await asyncio.sleep(POLL_S / 5)  # simultaneous changes are sent together
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._wake.wait(), POLL_S)
        self.feed.forget()
        self._task = None


def poll(workspace: Workspace, last: Snapshot | None) -> tuple[Snapshot, list[Notice]]:
    """Return the present state, and the events between the last state and it."""
    ledger = workspace.ledger
    before = last or Snapshot()
    now = Snapshot(ledger.version(), before.newest_job, before.jobs)
    tables: list[Notice] = []
    for name in workspace.library.names():
        with contextlib.suppress(TableBehindError, LookupError):
            table = workspace.tables.surrogate(name)
            now.versions[name] = table.version
            if last and table.version != before.versions.get(name):
                body = {"table_version": table.version, "rows": table.row_count}
                tables.append(("table", name, {"component": name, **body}))
    changed: list[JobRecord] = []
    if now.ledger != before.ledger:
        # At first the newest job is read before the open ones: a job that is accepted between the
        # two and ends before the next poll is newer, so that its end is an event.
        newest = [] if last else ledger.jobs(limit=1)
        jobs = ledger.unfinished(before.newest_job if last else None)
        newest = jobs if last else newest
        now.newest_job = max([before.newest_job, *(job.id for job in newest)])
        if last:
            ended = before.jobs.keys() - {job.id for job in jobs}
            changed = [ledger.job(number) for number in ended]
            changed += [
                job for job in jobs if before.jobs.get(job.id, ())[:2] != (job.status, job.attempt)
            ]
        now.jobs = {job.id: (job.status, job.attempt, 0.0) for job in jobs if not job.is_final}
    return now, [*_job_notices(changed), *_progress_notices(workspace, before, now), *tables]


def _job_event(job: JobRecord, **more: Any) -> Notice:
    body = {
        "id": job.id,
        "status": job.status,
        "url": f"/v1/jobs/{job.id}",
        "component": job.component,
        "attempt": job.attempt,
        "error": job.error,
        "row": job.row,
        **more,
    }
    return "job", job.component, body


def _job_notices(changed: list[JobRecord]) -> list[Notice]:
    """Return an event for each changed job, or for each component with many the number."""
    of_component: dict[str, list[JobRecord]] = {}
    for job in sorted(changed, key=lambda job: job.id):
        of_component.setdefault(job.component, []).append(job)
    notices: list[Notice] = []
    for name, jobs in of_component.items():
        if len(jobs) > ONE_BY_ONE:
            body = {"component": name, "count": len(jobs), "url": f"/v1/jobs?component={name}"}
            notices.append(("jobs", name, body))
        else:
            notices += map(_job_event, jobs)
    return notices


def _progress_notices(workspace: Workspace, before: Snapshot, now: Snapshot) -> list[Notice]:
    """Return events of running jobs whose progress has changed."""
    notices: list[Notice] = []
    running = [number for number, state in now.jobs.items() if state[0] == "running"]
    for number in running[:ONE_BY_ONE]:
        job = workspace.ledger.job(number)
        progress = read_progress(workspace.attempt_folder(job))
        if progress is None or job.status != "running":
            continue
        last = before.jobs.get(number, ("", 0, 0.0))[2]
        now.jobs[number] = job.status, job.attempt, progress.fraction
        if progress.fraction != last:
            body = {"fraction": progress.fraction, "message": progress.message}
            notices.append(_job_event(job, progress=body))
    return notices
