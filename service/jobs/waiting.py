"""Why a job waits and how long it may; callers that wait for jobs to end."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from starlette.concurrency import run_in_threadpool

from wrenchbook.service.ledger import JobRecord, Ledger, LedgerUnavailableError


@dataclass(frozen=True)
class Waiting:
    """Why a job waits.

    Attributes
    ----------
    reason : str
    ahead : int
        Jobs that start before it: they wait here, or in the queue of a cluster.
    running : int
        Jobs that a solver works on now, wherever.
    slots : int
        Solves at once of this server.
    solve_s : float or None
        What the newest solves of its component took on average, s; None if there is none.
    expected_s : float or None
        When it is expected to start, s from now: all that is ahead of it shared by the slots, at
        what solves of those components took. None where a component has not been solved yet.
    """

    reason: str
    ahead: int
    running: int
    slots: int
    solve_s: float | None
    expected_s: float | None


def why_waiting(ledger: Ledger, job: JobRecord, slots: int, trouble: str | None) -> Waiting:
    """Return why a waiting job waits.

    Parameters
    ----------
    ledger : Ledger
    job : Job
    slots : int
        Solves at once here; 0 if other processes solve.
    trouble : str or None
        What keeps all jobs from running.
    """
    now = time.time()
    ahead, taken = ledger.ahead(job.id, job.priority, now), ledger.running()
    queued = sum(one.is_queued for one in taken)
    before = sum(one.waiting for one in ahead) + queued
    running = len(taken) - queued
    pause = max(0.0, (job.not_before or 0.0) - now)
    means = {one.component: one.seconds for one in ahead}
    for name in {one.component for one in taken} - means.keys():
        means[name] = ledger.solve_seconds(name)
    # Remaining time of those that run: 0 for one that takes longer than the mean.
    left = [
        max(0.0, mean - max(0.0, now - (now if one.is_queued else one.began or one.started or now)))
        if (mean := means[one.component]) is not None
        else None
        for one in taken
    ]
    work = [one.waiting * one.seconds if one.seconds is not None else None for one in ahead]
    expected = None if not slots or trouble else _start(slots, left, work, pause)
    reason = _reason(job, before, running, slots, trouble, pause)
    own = ledger.solve_seconds(job.component)
    return Waiting(reason, before, running, slots, own, expected)


def _start(
    slots: int, left: list[float | None], work: list[float | None], pause: float
) -> float | None:
    """Return when a slot is free for it, s from now, as far as the times are known."""
    if not any(work) and None not in work and len(left) < slots:
        return pause
    known = [time for time in (*left, *work) if time is not None]
    if len(known) < len(left) + len(work):
        return None
    soonest = min((time for time in left if time is not None), default=0.0)
    return max(pause, sum(known) / slots if any(work) else soonest)


def _reason(
    job: JobRecord, before: int, running: int, slots: int, trouble: str | None, pause: float
) -> str:
    if trouble:
        return f"jobs do not run: {trouble}"
    if pause:
        return f"its solver has died {job.lost} times; it is tried again in {pause:.0f} s"
    if not slots:
        return "this server runs no solvers; it waits for a `wrenchbook work` on the same data"
    if before:
        return f"{before} jobs are ahead of it and {running} run, {slots} at a time"
    if running >= slots:
        return f"it is the next; all {slots} solvers are busy"
    return "it is the next and starts now"


LOOK_S: Final = 0.25  # between looks for what other processes commit
MOST: Final = 4096
"""Callers that wait at once: each takes a connection and some 10 kB."""


class TooManyPollsError(RuntimeError):
    """As many wait for jobs as may; nothing was changed."""


class _Waiter:
    """A caller that waits until none of its jobs is open."""

    def __init__(self, open_jobs: set[int]) -> None:
        self.open_jobs = open_jobs
        self.ended = asyncio.Event()


class Polls:
    """All callers that wait for jobs, on one event loop.

    Parameters
    ----------
    ledger : Ledger
        Where the jobs are.
    """

    def __init__(self, ledger: Ledger) -> None:
        self._ledger = ledger
        self._waiters: set[_Waiter] = set()
        self._changed: asyncio.Event | None = None
        self._looking: asyncio.Task[None] | None = None
        self._stopping = False

    async def wait_all(self, job_ids: Sequence[int], seconds: float) -> list[JobRecord]:
        """Return the jobs once all have ended, or as they are after ``seconds``.

        Raises
        ------
        TooManyPollsError
            If as many wait already as may.
        UnknownJobError
            If there is no such job.
        """
        jobs = await run_in_threadpool(self._read, job_ids)
        waiter = _Waiter({job.id for job in jobs if not job.is_final})
        if not waiter.open_jobs or seconds <= 0 or self._stopping:
            return jobs
        if len(self._waiters) >= MOST:
            raise TooManyPollsError(
                f"{MOST} callers wait for jobs already. Ask again in some seconds, or follow all "
                "jobs at once with GET /v1/events"
            )
        self._waiters.add(waiter)
        if self._looking is None or self._looking.done():
            self._changed = asyncio.Event()
            self._looking = asyncio.create_task(self._look())
        try:
            await asyncio.wait_for(waiter.ended.wait(), seconds)
        except TimeoutError:
            pass
        finally:
            self._waiters.discard(waiter)
        return await run_in_threadpool(self._read, job_ids)

    def notify(self) -> None:
        """Look soon: something was committed. For the loop."""
        if self._changed is not None:
            self._changed.set()

    def stop(self) -> None:
        """Return from all waits with the jobs as they are: the server stops. For the loop."""
        self._stopping = True
        for waiter in self._waiters:
            waiter.ended.set()

    def _read(self, job_ids: Sequence[int]) -> list[JobRecord]:
        return [self._ledger.job(one) for one in job_ids]

    async def _look(self) -> None:
        """Look for jobs that have ended, for as long as a caller waits."""
        changed = self._changed
        assert changed is not None
        while self._waiters:
            changed.clear()
            open_jobs = list(set[int]().union(*(one.open_jobs for one in self._waiters)))
            try:
                ended = await run_in_threadpool(self._ledger.ended, open_jobs)
            except LedgerUnavailableError:
                ended = set()  # each caller gets the error from its last read
            for waiter in list(self._waiters):
                if waiter.open_jobs <= ended:
                    waiter.ended.set()
            try:
                await asyncio.wait_for(changed.wait(), LOOK_S)
            except TimeoutError:
                continue
