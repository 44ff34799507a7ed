"""One attempt as a task of a Dask cluster, submitted under its key until it has ended."""

import asyncio
import contextlib
import importlib
import logging
import operator
import os
import pickle
import time
from collections.abc import Callable
from concurrent.futures import CancelledError as FutureCancelled
from pathlib import Path
from typing import Any, NamedTuple

import dask.config
from dask._task_spec import Task
from distributed import Client, Future, KilledWorker, fire_and_forget
from distributed.client import ClosedClientError

from wrenchbook.service.files.durable import write_whole_bytes
from wrenchbook.service.jobs.attempt import LOCK, OUTCOME, PROGRESS, write_outcome, write_whole
from wrenchbook.service.jobs.engines import on_worker
from wrenchbook.service.jobs.engines.dask_cluster import Cluster, Place
from wrenchbook.service.jobs.engines.engine import Attempt, State
from wrenchbook.service.jobs.engines.on_worker import Payload
from wrenchbook.service.jobs.engines.worker_files import (
    BUNDLE_BYTES,
    BadPayloadError,
    digest,
    pack,
    unpack,
)

_log = logging.getLogger(__name__)

# An attempt that killed so many workers is treated as the cause and fails: KILLED_TIMES times the
# `distributed.scheduler.allowed-failures` + 1 (4) after which Dask gives a task up.
KILLED_TIMES = 5
FAULTS = 10  # exceptions of a worker's part of the engine before the attempt fails
AGAIN_SECONDS = 1.0  # before a retry after an error of this machine or of the connection
BUNDLES = 20  # components that workers keep in memory

# The scheduler unpickles tasks but need not have this program: it gets the function's name.
_MODULE = Task(None, importlib.import_module, on_worker.__name__)
_RUN_TASK = Task(None, getattr, _MODULE, on_worker.run_task.__name__)


def key_of(task: str) -> str:
    """Return the key of an attempt's Dask task. The task key has job and attempt number."""
    return f"wrenchbook-{task}"


class SentBundle(NamedTuple):
    """A component's files on the cluster: their digest, their future, how the folder was then."""

    digest: str
    future: Future
    seen: list[tuple[str, int, int]]


class Bundles:
    """Components' files as tasks: each is sent once, and workers fetch it from each other."""

    def __init__(self) -> None:
        self._bundles: dict[Path, SentBundle] = {}
        self._sending = asyncio.Lock()

    async def send(self, client: Client, folder: Path) -> SentBundle:
        """Return a component's files on the cluster, sent again if they have changed."""
        async with self._sending:
            seen = await asyncio.to_thread(_look_at, folder)
            bundle = self._bundles.pop(folder, None)
            good = bundle and bundle.future.status in ("pending", "finished")
            if bundle is None or not good or bundle.seen != seen:
                bundle = SentBundle(*await self._submit(client, folder), seen)
            self._bundles[folder] = bundle  # the one used last stands last
            for old in list(self._bundles)[:-BUNDLES]:
                del self._bundles[old]
            return bundle

    async def _submit(self, client: Client, folder: Path) -> tuple[str, Future]:
        files = await asyncio.to_thread(pack, folder)
        name = digest(files)
        with dask.config.set({"distributed.admin.large-graph-warning-threshold": BUNDLE_BYTES}):
            sent, key = pickle.dumps(files), f"wrenchbook-bundle-{name}"
            return name, client.submit(pickle.loads, sent, key=key, retries=FAULTS)


def _look_at(folder: Path) -> list[tuple[str, int, int]]:
    """Return name, size and time of the folder's files."""
    stats = ((path, path.stat()) for path in sorted(folder.rglob("*")))
    return [(str(path), stat.st_size, stat.st_mtime_ns) for path, stat in stats]


class DaskTask:
    """One attempt on its way. All of it but `state` and `waits` lives in the cluster's event loop.

    Parameters
    ----------
    cluster : Cluster
    bundles : Bundles
    attempt : Attempt
        ``spec.bundle`` is the component's folder.
    on_change : callable
        Called with the task key when the state has changed.
    """

    def __init__(
        self, cluster: Cluster, bundles: Bundles, attempt: Attempt, on_change: Callable[[str], None]
    ) -> None:
        self.state: State = "submitted"
        self.waits: str | None = None
        self.attempt = attempt
        self._cluster = cluster
        self._bundles = bundles
        self._on_change = on_change
        self._worker: str | None = None  # that sent the last event
        self._killed = 0

    async def run(self) -> None:
        """Submit the attempt until it has ended and its folder holds the artifacts."""
        ended: State | None = None
        while ended is None:
            try:
                ended = await self._try()
            except (BadPayloadError, FileNotFoundError) as error:
                remedy = "add the component again"
                ended = await self.end_with(_failure("component_missing", error, remedy))
            except FutureCancelled:
                await asyncio.sleep(0)  # it was lost with the scheduler, or with its bundle
            except KilledWorker as error:
                self._killed += 1
                if self._killed >= KILLED_TIMES:
                    ended = await self.end_with(_failure("workers_died", error, _KILLED_REMEDY))
            except (OSError, ClosedClientError) as error:  # the connection, or this disk
                self.waits = f"a Dask worker is not reached: {error}"
                await asyncio.sleep(AGAIN_SECONDS)
                self.waits = None
            except Exception as error:
                _log.warning("task %s failed on the cluster: %r", self.attempt.task, error)
                ended = await self.end_with(_failure("cluster_error", error, _FAULT_REMEDY))
            self.set(ended or "submitted")

    def hear(self, event: dict[str, Any]) -> None:
        """Take a worker's progress event: a solver is at the attempt."""
        if self.state not in ("submitted", "running"):
            return
        self._worker = event["worker"]
        with contextlib.suppress(OSError):
            self._mark_begun(event["seconds"])
            if event["progress"]:
                write_whole(self.attempt.folder / PROGRESS, event["progress"])
        self.set("running")

    async def end_with(self, outcome: dict[str, Any]) -> State:
        """Write an outcome in the solver's stead; an attempt whose folder is gone is lost."""
        try:
            await asyncio.to_thread(_write_unless_there, self.attempt, outcome)
        except OSError:
            return "lost"
        return "finished"

    async def _try(self) -> State | None:
        """Submit the attempt once; return how it ended, or None if it is to be submitted again."""
        client = await self._cluster.client()
        place = await self._place()
        bundle = await self._bundles.send(client, Path(self.attempt.spec.bundle))
        future = self._submit(client, place, bundle)
        try:
            payload = await self._result(client, future, place.workers or ())
        finally:
            future.release()
        if payload is None:
            return None
        if why := payload["unfit"]:
            self._cluster.suspend(payload["worker"], why)
            return None
        self._worker = payload["worker"]
        await self._store(payload)
        return "finished" if OUTCOME in payload["files"] else "lost"

    async def _place(self) -> Place:
        """Return where the attempt may run, once there is a place: where it is already, if so."""
        needs = self.attempt.memory, self.attempt.cores
        while isinstance(place := self._cluster.place(*needs), str):
            if place != self.waits:
                self.waits = place
                with contextlib.suppress(OSError):
                    waits = {"fraction": 0.0, "message": f"waits: {place}"}
                    write_whole(self.attempt.folder / PROGRESS, waits)
            await self._cluster.changed()
        self.waits = None
        known = self._cluster.worker_with(self.attempt.task)
        return Place((known,), place.resources) if known else place

    def _submit(self, client: Client, place: Place, bundle: SentBundle) -> Future:
        attempt = self.attempt
        future: Future = client.submit(
            operator.call,
            _RUN_TASK,
            pickle.dumps(attempt),
            bundle.digest,
            bundle.future,
            key=key_of(attempt.task),
            priority=attempt.priority,
            workers=list(place.workers) if place.workers else None,
            resources=place.resources or None,
            retries=FAULTS,
        )
        fire_and_forget(future)  # it goes on without this server, for the next one
        return future

    async def _result(
        self, client: Client, future: Future, workers: tuple[str, ...]
    ) -> Payload | None:
        """Return the task's result; None if the workers it may run on are gone.

        Dask keeps such a task for these workers, whichever others come.
        """
        result = asyncio.ensure_future(future.result())
        gone = asyncio.ensure_future(self._cluster.gone(workers))
        try:
            await asyncio.wait({result, gone}, return_when=asyncio.FIRST_COMPLETED)
            if result.done():
                return result.result()
            await client.cancel([future], force=True)
            return None
        finally:
            result.cancel()
            gone.cancel()

    async def _store(self, payload: Payload) -> None:
        """Write the artifacts into the attempt's folder, the outcome last; wait for a full disk."""
        while True:
            try:
                await asyncio.to_thread(self._write, payload)
                self.waits = None
                return
            except OSError as error:
                self.waits = f"what a worker sent cannot be written: {error}"
            await asyncio.sleep(AGAIN_SECONDS)

    def _write(self, payload: Payload) -> None:
        folder, files = self.attempt.folder, dict(payload["files"])
        outcome = files.pop(OUTCOME, None)
        unpack(files, folder)
        self._mark_begun(payload["seconds"])
        if outcome is not None:
            write_whole_bytes(folder / OUTCOME, outcome)

    def _mark_begun(self, seconds: float) -> None:
        """Write the lock as a solver does that began some seconds ago."""
        lock, now = self.attempt.folder / LOCK, time.time()
        if not lock.exists():
            write_whole_bytes(lock, f"{self._worker}\n".encode(), durable=False)
            os.utime(lock, (now, now - seconds))

    def set(self, state: State) -> None:
        """Set the state and notify the engine if it has changed."""
        if state != self.state:
            self.state = state
            self._on_change(self.attempt.task)


def _write_unless_there(attempt: Attempt, outcome: dict[str, Any]) -> None:
    if not (attempt.folder / OUTCOME).exists():
        write_outcome(attempt.folder, attempt.spec, outcome)


def _failure(kind: str, error: Exception, remedy: str) -> dict[str, Any]:
    message = str(error) or repr(error)
    return {"status": "failed", "error": {"kind": kind, "message": message, "remedy": remedy}}


_KILLED_REMEDY = (
    "the workers that had it died, each time: see their logs, give them more memory or declare it "
    "(--resources wrenchbook_memory=BYTES), and retry the job"
)
_FAULT_REMEDY = "see the logs of scheduler and workers; retry the job once the cluster is well"
