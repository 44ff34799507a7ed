"""The reason and the expected time of a job's wait; callers that wait for jobs to end."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from starlette.concurrency import run_in_threadpool

from wrenchbook.service.ledger import JobRecord, Ledger, LedgerUnavailableError


@dataclass(frozen=True)
class Waiting:
    """The reason for which a job waits.

    `ahead` jobs start before it, here or in the queue of a cluster; `running` are the jobs that
    solvers work on now, on any machine; `slots` is the number of solves at once of this server.
    `solve_s` is the mean time of the newest solves of its component, s. `expected_s` is its
    expected start, s from now: the time of all jobs ahead of it shared by the slots, by the mean
    times of their components; None if a component has not been solved yet.
    """

    reason: str
    ahead: int
    running: int
    slots: int
    solve_s: float | None
    expected_s: float | None


def why_waiting(ledger: Ledger, job: JobRecord, slots: int, trouble: str | None) -> Waiting:
    """Return the reason why a job is not being solved yet.

    `slots`: number of solves at once here, 0 if other processes solve; `trouble`: the reason for
    which no job runs.
    """
    now = time.time()
    ahead = ledger.ahead(job.id, job.priority, now)
    attempts = ledger.running()
    queued = sum(run.is_queued for run in attempts)
    before = sum(part.waiting for part in ahead) + queued
    running = len(attempts) - queued
    pause = max(0.0, (job.not_before or 0.0) - now)
    means = {part.component: part.seconds for part in ahead}
    for name in {run.component for run in attempts} - means.keys():
        means[name] = ledger.solve_seconds(name)
    # Remaining time of attempts, s: 0 for one that takes longer than the mean.
    remaining: list[float | None] = []
    for run in attempts:
        mean = means[run.component]
        began = run.began or run.started or now
        elapsed = 0.0 if run.is_queued else max(0.0, now - began)
        remaining.append(None if mean is None else max(0.0, mean - elapsed))
    work = [None if part.seconds is None else part.waiting * part.seconds for part in ahead]
    expected = None
    if slots and not trouble:
        expected = _expected_start(remaining, work, slots, pause)
    if trouble:
        reason = f"jobs do not run: {trouble}"
    elif pause:
        reason = f"its solver has died {job.lost} times; it is tried again in {pause:.0f} s"
    elif not slots:
        reason = "this server runs no solvers; it waits for a `wrenchbook work` on the same data"
    elif before:
        reason = f"jobs ahead of it: {before}; running: {running} of at most {slots}"
    elif running >= slots:
        reason = f"it is the next; solvers busy: {running} of {slots}"
    else:
        reason = "it is the next and starts now"
    return Waiting(reason, before, running, slots, ledger.solve_seconds(job.component), expected)


def _expected_start(
    remaining: Sequence[float | None], work: Sequence[float | None], slots: int, pause: float
) -> float | None:
    """Return when a job is expected to start, s from now; None if a time ahead is unknown.

    `remaining` are the times of attempts, `work` those of the jobs ahead by component, s.
    """
    if not any(work) and None not in work and len(remaining) < slots:
        return pause
    known = [seconds for seconds in (*remaining, *work) if seconds is not None]
    if len(known) < len(remaining) + len(work):
        return None
    soonest = min(known[: len(remaining)], default=0.0)  # an attempt ends, and frees its slot
    return max(pause, sum(known) / slots if any(work) else soonest)


MAX_WAITERS: Final = 4096
"""Callers that may wait at once: each takes a connection and some 10 kB."""


class TooManyPollsError(RuntimeError):
    """The largest number of callers waits for jobs already; nothing was changed."""


@dataclass(eq=False)
class _Waiter:
    """A caller that waits until none of its jobs is open."""

    open_jobs: set[int]
    ended: asyncio.Event


class Polls:
    """All callers that wait for jobs of a ledger, on one event loop; `notify` follows commits."""

    def __init__(self, ledger: Ledger) -> None:
        self._ledger = ledger
        self._waiters: set[_Waiter] = set()
        self._changed = asyncio.Event()
        self.notify = self._changed.set  # poll for ended jobs after a commit; call it in the loop
        self._polling: asyncio.Task[None] | None = None
        self._stopping = False

    async def wait_all(self, job_ids: Sequence[int], seconds: float) -> list[JobRecord]:
        """Return the jobs once all have ended, or their state after ``seconds``.

        Raises TooManyPollsError if too many callers wait already, and UnknownJobError if there is
        no such job.
        """
        waiter = _Waiter(set(job_ids), asyncio.Event())
        self._waiters.add(waiter)  # before the first read: a later end wakes the caller
        try:
            jobs = await run_in_threadpool(self._read, job_ids)
            waiter.open_jobs = {job.id for job in jobs if not job.is_final}
            if not waiter.open_jobs or seconds <= 0 or self._stopping:
                return jobs
            if len(self._waiters) > MAX_WAITERS:
                raise TooManyPollsError(
                    f"{MAX_WAITERS} callers wait for jobs, the limit of this server. Ask again in "
                    "a few seconds, or follow all jobs with GET /v1/events"
                )
            if self._polling is None or self._polling.done():
                self._polling = asyncio.create_task(self._poll())
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(waiter.ended.wait(), seconds)
        finally:
            self._waiters.discard(waiter)
        return await run_in_threadpool(self._read, job_ids)

    def stop(self) -> None:
        """End all waits with the jobs' present state, as the server stops; call it in the loop."""
        self._stopping = True
        for waiter in self._waiters:
            waiter.ended.set()

    def _read(self, job_ids: Sequence[int]) -> list[JobRecord]:
        return [self._ledger.job(number) for number in job_ids]

    async def _poll(self) -> None:
        """Poll for ended jobs after each commit, as long as a caller waits."""
        while self._waiters:
            self._changed.clear()
            open_jobs = list(set[int]().union(*(waiter.open_jobs for waiter in self._waiters)))
            try:
                ended = await run_in_threadpool(self._ledger.ended, open_jobs)
            except LedgerUnavailableError:
                ended = set()  # each caller gets the error from its last read
            for waiter in list(self._waiters):
                if waiter.open_jobs <= ended:
                    waiter.ended.set()
            await self._changed.wait()
