"""Waiting for jobs to end: one look at the ledger for all who wait, and no thread for any."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Sequence
from typing import Final

from starlette.concurrency import run_in_threadpool

from wrenchbook.service.ledger import Job, Ledger, LedgerUnavailableError

LOOK_S: Final = 0.25  # between looks for what other processes commit
MOST: Final = 4096
"""Who wait at once: each holds a connection and some 10 kB."""


class TooManyPollsError(RuntimeError):
    """As many wait for jobs as may; nothing was changed."""


class _Waiter:
    """One who waits until none of its jobs is open."""

    def __init__(self, open_jobs: set[int]) -> None:
        self.open_jobs = open_jobs
        self.ended = asyncio.Event()


class Polls:
    """All who wait for jobs, on one event loop.

    Parameters
    ----------
    ledger : Ledger
        Where the jobs are.
    """

    def __init__(self, ledger: Ledger) -> None:
        self._ledger = ledger
        self._waiters: set[_Waiter] = set()
        self._wanted: Counter[int] = Counter()
        self._changed: asyncio.Event | None = None
        self._looking: asyncio.Task[None] | None = None
        self._let_go = False

    async def wait_all(self, job_ids: Sequence[int], seconds: float) -> list[Job]:
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
        if not waiter.open_jobs or seconds <= 0 or self._let_go:
            return jobs
        if len(self._waiters) >= MOST:
            raise TooManyPollsError(
                f"{MOST} callers wait for jobs already. Ask again in some seconds, or follow all "
                "jobs at once with GET /v1/events"
            )
        self._enter(waiter)
        try:
            await asyncio.wait_for(waiter.ended.wait(), seconds)
        except TimeoutError:
            pass
        finally:
            self._leave(waiter)
        return await run_in_threadpool(self._read, job_ids)

    def tell(self) -> None:
        """Look soon: something was committed. For the loop."""
        if self._changed is not None:
            self._changed.set()

    def let_go(self) -> None:
        """Let all who wait have their jobs as they are: the server stops. For the loop."""
        self._let_go = True
        for waiter in self._waiters:
            waiter.ended.set()

    def _read(self, job_ids: Sequence[int]) -> list[Job]:
        return [self._ledger.job(one) for one in job_ids]

    def _enter(self, waiter: _Waiter) -> None:
        self._waiters.add(waiter)
        self._wanted.update(waiter.open_jobs)
        if self._looking is None or self._looking.done():
            self._changed = asyncio.Event()
            self._looking = asyncio.create_task(self._look())

    def _leave(self, waiter: _Waiter) -> None:
        self._waiters.discard(waiter)
        self._wanted.subtract(waiter.open_jobs)
        for job in waiter.open_jobs:
            if self._wanted[job] <= 0:
                del self._wanted[job]

    async def _look(self) -> None:
        """Look for jobs that have ended, for as long as anybody waits."""
        changed = self._changed
        assert changed is not None
        while self._waiters:
            changed.clear()
            try:
                ended = await run_in_threadpool(self._ledger.ended, list(self._wanted))
            except LedgerUnavailableError:
                ended = set()  # each who waits is told of it at the end
            for waiter in list(self._waiters):
                if waiter.open_jobs <= ended:
                    waiter.ended.set()
            try:
                await asyncio.wait_for(changed.wait(), LOOK_S)
            except TimeoutError:
                continue
