"""The engine for an existing Dask cluster; no file system needs to be shared with it."""

import asyncio
import contextlib
import logging
import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from service.jobs.attempt import OUTCOME, read_spec
from service.jobs.engines.dask_errand import Bundles, Errand
from service.jobs.engines.dask_link import Link
from service.jobs.engines.engine import Attempt, EngineError, Heard, State

_log = logging.getLogger(__name__)

# A worker whose thread is free finds its next order there already: a solve of 10 ms would wait
# as long for the scheduler. Order is kept by priority, in the scheduler and on the worker.
ORDERS_A_THREAD = 2
CLOSE_SECONDS = 5.0


class DaskEngine:
    """Has attempts solved by the workers of a Dask scheduler.

    Everything that talks to the cluster is in a thread and an event loop of its own: what a
    dispatcher calls only leaves word there and reads what is known.

    Parameters
    ----------
    scheduler : str
        Its address, ``tcp://host:8786``, or ``tls://`` with the certificates of Dask's own
        configuration (``distributed.comm.tls``).
    """

    name = "dask"

    def __init__(self, scheduler: str) -> None:
        self._errands: dict[str, Errand] = {}
        self._ways: dict[str, asyncio.Task[None]] = {}
        self._endings: set[asyncio.Task[None]] = set()
        self._listeners: list[Heard] = []
        self._bundles = Bundles()
        self._loop = asyncio.new_event_loop()
        self._link = Link(scheduler, self._hear)
        self._thread = threading.Thread(target=self._live, name="dask engine", daemon=True)
        self._thread.start()

    @property
    def slots(self) -> int:
        """Orders that threads of workers there now can take, and those that wait for a worker."""
        waiting = sum(errand.waits is not None for errand in tuple(self._errands.values()))
        return ORDERS_A_THREAD * sum(worker.threads for worker in self._link.fit) + waiting

    @property
    def trouble(self) -> str | None:
        """What keeps attempts from being solved: no scheduler, no worker fit or large enough."""
        if self._link.trouble:
            return self._link.trouble
        waits = (errand.waits for errand in tuple(self._errands.values()))
        return next((why for why in waits if why), None)

    def submit(self, attempt: Attempt) -> None:
        """Leave word that the attempt is to be ordered; see `Engine.submit`."""
        if self._link.trouble:
            raise EngineError(self._link.trouble)
        self._begin(attempt, again=False)

    def attach(self, attempt: Attempt) -> None:
        """Find the attempt among the workers' machines, or order it again under its key."""
        if (attempt.folder / OUTCOME).exists():
            return
        with contextlib.suppress(OSError, ValueError, TypeError, KeyError):
            spec = read_spec(attempt.folder)  # it knows where the component's files are
            self._begin(replace(attempt, spec=spec), again=True)

    def poll(self, attempt: Attempt) -> State:
        """Return how the attempt stands, as far as word has come; see `Engine.poll`."""
        errand = self._errands.get(attempt.task)
        if errand is not None:
            return errand.state
        return "finished" if (attempt.folder / OUTCOME).exists() else "lost"

    def cancel(self, attempt: Attempt) -> None:
        """Have the attempt's solver ended where it runs, or its order withdrawn."""
        if errand := self._errands.get(attempt.task):
            self._soon(errand.cancel)
        else:
            self._soon(self._end_stranger, attempt.task)

    def forget(self, attempt: Attempt) -> None:
        """Let go of an attempt; a worker that is still at it goes on."""
        if self._errands.pop(attempt.task, None):
            self._soon(self._leave, attempt.task)

    def listen(self, heard: Heard) -> Callable[[], None]:
        """Tell of attempts as word of them comes; see `Engine.listen`."""
        self._listeners.append(heard)
        return lambda: self._listeners.remove(heard)

    def close(self) -> None:
        """Leave the cluster; what workers are at they finish, and keep for who asks again."""
        self._errands.clear()
        self._soon(self._loop.stop)
        self._thread.join(CLOSE_SECONDS)

    # -- in the engine's own thread -----------------------------------------------------------

    def _live(self) -> None:
        asyncio.set_event_loop(self._loop)
        self._loop.create_task(self._link.keep())
        try:
            self._loop.run_forever()
        finally:
            rest = asyncio.all_tasks(self._loop)
            for task in rest:
                task.cancel()
            ended = asyncio.wait(rest, timeout=CLOSE_SECONDS / 2)
            self._loop.run_until_complete(ended)
            self._loop.close()

    def _soon(self, function: Callable[..., object], *args: object) -> None:
        with contextlib.suppress(RuntimeError):  # the engine is closed
            self._loop.call_soon_threadsafe(function, *args)

    def _begin(self, attempt: Attempt, *, again: bool) -> None:
        if attempt.task in self._errands:
            return  # handed in twice it is one attempt
        errand = Errand(self._link, self._bundles, attempt, again=again, told=self._tell)
        self._errands[attempt.task] = errand
        self._soon(self._set_out, errand)

    def _set_out(self, errand: Errand) -> None:
        task = errand.attempt.task
        way = self._ways[task] = self._loop.create_task(errand.go())
        way.add_done_callback(lambda way: self._arrived(task, way))

    def _arrived(self, task: str, way: asyncio.Task[None]) -> None:
        if self._ways.get(task) is way:
            del self._ways[task]
        if way.cancelled() or (error := way.exception()) is None:
            return
        _log.error("task %s was given up", task, exc_info=error)
        if errand := self._errands.get(task):
            errand.state = "lost"
            self._tell(task)

    def _end_stranger(self, task: str) -> None:
        """End what another dispatcher's engine ordered, and nobody wants any more."""

        async def end() -> None:
            await self._link.client()
            await self._link.end(task, None)

        ending = self._loop.create_task(end())
        self._endings.add(ending)
        ending.add_done_callback(self._endings.discard)

    def _leave(self, task: str) -> None:
        if (way := self._ways.pop(task, None)) is not None:
            way.cancel()

    def _hear(self, word: dict[str, Any]) -> None:
        if errand := self._errands.get(word["task"]):
            errand.hear(word)

    def _tell(self, task: str) -> None:
        for heard in tuple(self._listeners):
            heard(task)
