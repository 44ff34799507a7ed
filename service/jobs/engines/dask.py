"""The engine for an existing Dask cluster; no file system needs to be shared with it."""

import asyncio
import contextlib
import logging
import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from wrenchbook.service.jobs.attempt import OUTCOME, read_spec
from wrenchbook.service.jobs.engines.dask_cluster import Cluster
from wrenchbook.service.jobs.engines.dask_task import Bundles, DaskTask, key_of
from wrenchbook.service.jobs.engines.engine import ALIVE, Attempt, EngineError, Listener, State

_log = logging.getLogger(__name__)

# A thread that is free finds its next task on its worker: the way through the scheduler takes as
# long as a solve of 10 ms. Scheduler and workers keep the order of priorities.
TASKS_A_THREAD = 2
CLOSE_SECONDS = 5.0
CANCEL_SECONDS = 2.0  # for the scheduler to be reachable before an attempt counts as cancelled


class DaskEngine:
    """Runs attempts as tasks of a Dask scheduler, from a thread and an event loop of its own.

    Parameters
    ----------
    scheduler : str
        Its address, ``tcp://host:8786``, or ``tls://`` with the certificates of Dask's own
        configuration (``distributed.comm.tls``).
    """

    name = "dask"

    def __init__(self, scheduler: str) -> None:
        self._tasks: dict[str, DaskTask] = {}
        self._runs: dict[str, asyncio.Task[None]] = {}
        self._cancelling: set[asyncio.Task[None]] = set()
        self._listeners: list[Listener] = []
        self._bundles = Bundles()
        self._loop = asyncio.new_event_loop()
        self._cluster = Cluster(scheduler, self._on_progress)
        self._thread = threading.Thread(target=self._run_loop, name="dask engine", daemon=True)
        self._thread.start()

    @property
    def slots(self) -> int:
        """Tasks for the threads of fit workers, and those that wait for a worker."""
        waiting = sum(task.waits is not None for task in tuple(self._tasks.values()))
        return TASKS_A_THREAD * sum(worker.threads for worker in self._cluster.fit) + waiting

    @property
    def trouble(self) -> str | None:
        """What keeps attempts from being solved: no scheduler, no worker fit or large enough."""
        waits = (task.waits for task in tuple(self._tasks.values()))
        return self._cluster.trouble or next((why for why in waits if why), None)

    def submit(self, attempt: Attempt) -> None:
        """Submit the attempt to the cluster; see `Engine.submit`."""
        if self._cluster.trouble:
            raise EngineError(self._cluster.trouble)
        self._begin(attempt)

    def attach(self, attempt: Attempt) -> None:
        """Submit the attempt under its key: a task of that key on the cluster goes on."""
        if (attempt.folder / OUTCOME).exists():
            return
        with contextlib.suppress(OSError, ValueError, TypeError, KeyError):
            spec = read_spec(attempt.folder)  # with the folder of the component's files
            self._begin(replace(attempt, spec=spec))

    def poll(self, attempt: Attempt) -> State:
        """Return the attempt's state by the latest event; see `Engine.poll`."""
        if task := self._tasks.get(attempt.task):
            return task.state
        return "finished" if (attempt.folder / OUTCOME).exists() else "lost"

    def cancel(self, attempt: Attempt) -> None:
        """Cancel the attempt's Dask task; its worker ends the solver."""
        self._soon(self._start_cancelling, attempt)

    def forget(self, attempt: Attempt) -> None:
        """Stop following an attempt; a worker that runs it goes on."""
        if self._tasks.pop(attempt.task, None):
            self._soon(self._stop, attempt.task)

    def listen(self, listener: Listener) -> Callable[[], None]:
        """Report changes of attempts; see `Engine.listen`."""
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener)

    def close(self) -> None:
        """Leave the cluster; workers finish their attempts and keep them for the next server."""
        self._tasks.clear()
        self._soon(self._loop.stop)
        self._thread.join(CLOSE_SECONDS)

    # -- in the engine's own thread -----------------------------------------------------------

    def _run_loop(self) -> None:
        asyncio.set_event_loop(self._loop)
        cluster = self._loop.create_task(self._cluster.run())
        try:
            self._loop.run_forever()
        finally:
            self._end({cluster})  # it sends what the client has not sent yet: cancellations
            self._end(asyncio.all_tasks(self._loop))
            self._loop.close()

    def _end(self, tasks: set[asyncio.Task[Any]]) -> None:
        for task in tasks:
            task.cancel()
        if tasks:  # Dask's own may not end
            self._loop.run_until_complete(asyncio.wait(tasks, timeout=CLOSE_SECONDS / 2))

    def _soon(self, function: Callable[..., object], *args: object) -> None:
        with contextlib.suppress(RuntimeError):  # the engine is closed
            self._loop.call_soon_threadsafe(function, *args)

    def _begin(self, attempt: Attempt) -> None:
        if attempt.task not in self._tasks:
            task = DaskTask(self._cluster, self._bundles, attempt, self._report)
            self._tasks[attempt.task] = task
            self._soon(self._start, attempt.task, task)

    def _start(self, key: str, task: DaskTask) -> None:
        run = self._runs[key] = self._loop.create_task(task.run())
        run.add_done_callback(lambda _: self._runs.pop(key, None))

    def _stop(self, key: str) -> None:
        if run := self._runs.get(key):
            run.cancel()

    def _start_cancelling(self, attempt: Attempt) -> None:
        cancelling = self._loop.create_task(self._cancel(attempt))
        self._cancelling.add(cancelling)
        cancelling.add_done_callback(self._cancelling.discard)

    async def _cancel(self, attempt: Attempt) -> None:
        self._stop(attempt.task)
        task = self._tasks.get(attempt.task)
        if task is None:
            await self._cluster.cancel(key_of(attempt.task))
        elif task.state in ALIVE:
            with contextlib.suppress(OSError):
                cancel = self._cluster.cancel(key_of(attempt.task))
                await asyncio.wait_for(cancel, CANCEL_SECONDS)
            task.set(await task.end_with({"status": "cancelled"}))

    def _on_progress(self, event: dict[str, Any]) -> None:
        if task := self._tasks.get(event["task"]):
            task.hear(event)

    def _report(self, task: str) -> None:
        for listener in tuple(self._listeners):
            listener(task)
