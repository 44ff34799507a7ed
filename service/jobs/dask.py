"""The engine that runs attempts on an existing Dask cluster, without a shared file system.

A worker needs this program: a bundle comes as an argument of the task, an attempt is a subprocess
in the worker's local directory, and its files are the task's result. The scheduler keeps the result
until a server has it, under the attempt's key. A solver ends with its worker; Dask then gives the
task to another worker.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import pickle
import re
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError as FutureCancelled
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import dask.config
from distributed import Client, Future, KilledWorker
from distributed.client import ClosedClientError

from wrenchbook.service.files.durable import write_atomically
from wrenchbook.service.files.program import solver_version
from wrenchbook.service.jobs import attempt as attempts
from wrenchbook.service.jobs.attempt import ALIVE, LOCK, OUTCOME, PROGRESS, Attempt
from wrenchbook.service.jobs.dask_files import (
    BUNDLE_BYTES,
    BadPayloadError,
    Payload,
    digest,
    pack,
    write_files,
)
from wrenchbook.service.jobs.dask_worker import TOPIC, probe

_log = logging.getLogger(__name__)
# These loggers report a lost connection with a traceback; the engine does in one line.
for _name in ("distributed.client", "distributed.batched"):
    logging.getLogger(_name).setLevel(logging.CRITICAL)

# A free thread finds its next task on its worker: the way through the scheduler takes as long as a
# solve of 10 ms. Scheduler and workers keep the order of priorities.
TASKS_A_THREAD = 2
CLOSE_SECONDS = 5.0  # time for the engine's thread to end, as the scheduler may not answer
CANCEL_SECONDS = 2.0  # time for the scheduler to be reachable before an attempt counts as cancelled
CONNECT_SECONDS = 10.0  # time for a connection: a third of Dask's own, as it is tried again
# Pause before the first reconnection, doubled up to the largest: a restart takes a few seconds.
MIN_PAUSE_SECONDS, MAX_PAUSE_SECONDS = 0.2, 5.0
# Interval of requests for the list of workers: a new one is used within a second.
ROSTER_SECONDS = 1.0
ROSTER_SECONDS_A_WORKER = 0.002  # addition for each worker: a reply has some kB for each
ANSWER_SECONDS = 10.0  # a scheduler that takes longer counts as unreachable
# Time for a probe of a worker before it is repeated: the call to a worker that has just registered
# may be lost, and modules that a slow worker has imported stay imported.
PROBE_SECONDS = 3.0
PROBE_INTERVAL_SECONDS = 20.0  # between probes of an unfit worker, which its user may repair
WAIT_SECONDS = 0.1  # interval of checks for a connection, and for a worker of a waiting attempt
# An attempt that killed this number of workers is treated as the cause and fails: KILLED_TIMES
# times the `distributed.scheduler.allowed-failures` + 1 (4) after which Dask gives a task up.
KILLED_TIMES = 5
MAX_RETRIES = 10  # retries by Dask of a task that raised: a solver's failure raises nothing
RETRY_SECONDS = 1.0  # pause before a retry after an error of this machine or of the connection
MAX_SENT_BUNDLES = 20  # components whose files the workers keep in memory
# Resources a worker may declare: ``--resources "wrenchbook_memory=8e9 wrenchbook_cores=4"``.
MEMORY, CORES = "wrenchbook_memory", "wrenchbook_cores"


@dataclass
class _Worker:
    """A worker of the cluster, and whether it is fit by its last probe."""

    address: str
    threads: int
    resources: dict[str, float]  # that it declares to Dask
    memory: float  # bytes, declared or its limit
    cores: float  # declared, or its threads
    unfit: str | None = "it has not been probed yet"  # why it gets no tasks
    probed: float = -float("inf")  # time of the last probe, s, monotonic

    @classmethod
    def of(cls, address: str, entry: dict[str, Any]) -> _Worker:
        """Return a worker from its entry in the scheduler's list."""
        resources, threads = entry["resources"], entry["nthreads"]
        memory = resources.get(MEMORY) or entry["memory_limit"] or float("inf")
        return cls(address, threads, resources, memory, resources.get(CORES) or threads)


@dataclass
class _Task:
    """The state of a submitted attempt."""

    attempt: Attempt
    state: attempts.State = "submitted"
    waits: str | None = None  # why no worker can have it
    worker: str | None = None  # the worker that sent the last event
    killed: int = 0  # times that Dask gave it up because its workers died
    run: asyncio.Task[None] | None = None


class _SentBundle(NamedTuple):
    """A component's files on the cluster."""

    files: list[tuple[str, int, int]]  # path, bytes and time of change, ns, of each when sent
    digest: str
    content: Future


class DaskEngine(attempts.Listeners):
    """Runs attempts as tasks of a Dask scheduler, in a thread with its own event loop.

    The scheduler's address is ``tcp://host:8786``, or ``tls://`` with the certificates of Dask's
    own configuration (``distributed.comm.tls``).
    """

    name = "dask"

    def __init__(self, scheduler: str) -> None:
        self._scheduler = f"the Dask scheduler at {scheduler}"
        # Why the scheduler cannot be used; None while it is connected.
        self._disconnected: str | None = f"{self._scheduler} has not answered yet"
        self._workers: dict[str, _Worker] = {}
        self._tasks: dict[str, _Task] = {}
        self._bundles: dict[str, _SentBundle] = {}
        self._sending = asyncio.Lock()
        self._client: Client | None = None
        self._background: set[asyncio.Task[None]] = set()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run_loop, args=(scheduler,), daemon=True)
        self._thread.start()

    @property
    def slots(self) -> int:
        """Number of tasks that the threads of fit workers take, and of those without a worker."""
        waiting = sum(task.waits is not None for task in tuple(self._tasks.values()))
        return TASKS_A_THREAD * sum(worker.threads for worker in self._fit_workers) + waiting

    @property
    def trouble(self) -> str | None:
        """The obstacle to solving attempts: no scheduler, or no worker fit and large enough."""
        waits = [task.waits for task in tuple(self._tasks.values()) if task.waits]
        return self._unreachable or (waits[0] if waits else None)

    def submit(self, attempt: Attempt) -> None:
        """Submit the attempt to the cluster."""
        if why := self._unreachable:
            raise attempts.EngineError(why)
        if attempt.task not in self._tasks:
            self._start(attempt)

    def attach(self, attempt: Attempt) -> None:
        """Submit the attempt under its key: a task of that key on the cluster continues."""
        with contextlib.suppress(OSError, ValueError, TypeError, KeyError):
            if attempt.task not in self._tasks and not (attempt.folder / OUTCOME).exists():
                attempt.bundle = attempts.read_attempt(attempt.folder).bundle
                self._start(attempt)

    def poll(self, attempt: Attempt) -> attempts.State:
        """Return the attempt's state by the latest event; see `service.jobs.dispatcher`."""
        if task := self._tasks.get(attempt.task):
            return task.state
        return "finished" if (attempt.folder / OUTCOME).exists() else "lost"

    def cancel(self, attempt: Attempt) -> None:
        """Cancel the attempt's Dask task; its worker ends the solver."""
        self._call_soon(lambda: self._create_task(self._cancel(attempt.task)))

    def forget(self, attempt: Attempt) -> None:
        """Stop following an attempt; a worker that runs it continues."""
        if task := self._tasks.pop(attempt.task, None):
            self._call_soon(lambda: task.run and task.run.cancel())

    def close(self) -> None:
        """Leave the cluster; workers finish their attempts and keep them for the next server."""
        self._tasks.clear()
        self._call_soon(self._loop.stop)
        self._thread.join(CLOSE_SECONDS)

    def _start(self, attempt: Attempt) -> None:
        task = self._tasks[attempt.task] = _Task(attempt)

        def run() -> None:
            task.run = self._create_task(self._run(task))

        self._call_soon(run)

    @property
    def _fit_workers(self) -> list[_Worker]:
        if self._disconnected:
            return []
        return [worker for worker in tuple(self._workers.values()) if worker.unfit is None]

    @property
    def _unreachable(self) -> str | None:
        """Why no task can be submitted at present; None if one can."""
        if self._disconnected or self._fit_workers:
            return self._disconnected
        reasons = sorted({worker.unfit or "" for worker in tuple(self._workers.values())})
        if not reasons:
            return f"{self._scheduler} has no workers"
        return f"no worker of {self._scheduler} can solve: {'; '.join(reasons[:3])}"

    # -- the connection, in the engine's own thread -------------------------------------------

    def _run_loop(self, scheduler: str) -> None:
        """Run the event loop of the engine's thread until it is stopped, then cancel its tasks."""
        asyncio.set_event_loop(self._loop)
        following = self._loop.create_task(self._connect(scheduler))
        try:
            self._loop.run_forever()
        finally:
            # `_connect` sends the client's remaining cancellations. Dask's own tasks may not end.
            for tasks in ({following}, asyncio.all_tasks(self._loop)):
                for task in tasks:
                    task.cancel()
                if tasks:
                    self._loop.run_until_complete(asyncio.wait(tasks, timeout=CLOSE_SECONDS / 2))
            self._loop.close()

    def _call_soon(self, function: Callable[..., object], *arguments: Any) -> None:
        with contextlib.suppress(RuntimeError):  # the engine is closed
            self._loop.call_soon_threadsafe(function, *arguments)

    def _create_task(self, coroutine: Any) -> asyncio.Task[None]:
        task = self._loop.create_task(coroutine)
        self._background.add(task)
        task.add_done_callback(self._background.discard)
        return task

    async def _connect(self, scheduler: str) -> None:
        """Connect and follow the workers until the engine closes."""
        pause = MIN_PAUSE_SECONDS
        options: dict[str, Any] = {"timeout": CONNECT_SECONDS, "name": "wrenchbook"}
        while True:
            try:
                client = Client(scheduler, asynchronous=True, set_as_default=False, **options)
                try:
                    await client
                    pause = MIN_PAUSE_SECONDS
                    self._client = client
                    await self._follow(client)
                finally:
                    self._client = None
                    with contextlib.suppress(Exception):  # the client's scheduler may be gone
                        closing: Any = client.close()
                        await asyncio.wait_for(closing, CLOSE_SECONDS / 2)
                why = "the connection to it was lost"
            except Exception as error:  # a bad address, another version, no certificate
                why = str(error) or repr(error)
            self._set_disconnected(f"cannot be used: {why}")
            await asyncio.sleep(pause)
            pause = min(2 * pause, MAX_PAUSE_SECONDS)

    async def _connected(self, is_ready: Callable[[], bool]) -> Client:
        """Return the client once it is connected and `is_ready` returns True."""
        while True:
            client = self._client
            if client is not None and client.status == "running" and is_ready():
                return client
            await asyncio.sleep(WAIT_SECONDS)

    def _set_disconnected(self, why: str) -> None:
        self._workers.clear()
        reason = f"{self._scheduler} {why}"
        if reason != self._disconnected:
            _log.warning("%s; it is tried again", reason)
        self._disconnected = reason

    async def _follow(self, client: Client) -> None:
        """Keep the list of workers up to date until the connection is lost.

        Dask's client would reconnect under its old name, which the scheduler may confuse with that
        of the lost connection; `_connect` makes another client.
        """
        scheduler: Any = client.scheduler
        connection = client.scheduler_comm
        client.subscribe_topic(TOPIC, self._on_progress)
        while client.status == "running" and client.scheduler_comm is connection:
            try:
                roster = await asyncio.wait_for(scheduler.identity(n_workers=-1), ANSWER_SECONDS)
            except (TimeoutError, OSError):
                self._set_disconnected("does not answer")
                continue
            self._disconnected = None
            known = self._workers
            self._workers = {
                address: known.get(address) or _Worker.of(address, entry)
                for address, entry in roster["workers"].items()
            }
            now = time.monotonic()
            unfit = [worker for worker in self._workers.values() if worker.unfit]
            due = [worker for worker in unfit if now > worker.probed + PROBE_INTERVAL_SECONDS]
            for worker in due:
                worker.probed = now
            if due:
                self._create_task(self._probe(client, due))
            await asyncio.sleep(max(ROSTER_SECONDS, ROSTER_SECONDS_A_WORKER * len(self._workers)))

    async def _probe(self, client: Client, workers: list[_Worker]) -> None:
        """Ask workers for their version and fitness, and suspend those that do not fit."""
        addresses = [worker.address for worker in workers]
        try:
            probes = client.run(probe, workers=addresses, on_error="return")
            answers: dict[str, Any] = await asyncio.wait_for(probes, PROBE_SECONDS)
        except (TimeoutError, OSError) as error:
            answers = dict.fromkeys(addresses, error)
        for worker in workers:
            answer = answers.get(worker.address)
            if isinstance(answer, dict):
                why = answer["trouble"]
                version = solver_version()
                if answer["version"] != version:
                    why = f"it has wrenchbook {answer['version']}, this server has {version}"
            # A worker that cannot import a function replies with the error as text.
            elif re.search("ModuleNotFoundError|ImportError|AttributeError", repr(answer)):
                why = f"it lacks this program ({answer}); install wrenchbook[cluster,server] there"
            elif isinstance(answer, TimeoutError):
                why = f"it gave no answer within {PROBE_SECONDS:g} s; see its log"
            else:
                why = f"its answer is invalid ({answer!r}); see its log"
            self._suspend(worker, why)
            # No answer in time, or no connection: probe again at once.
            if isinstance(answer, OSError):
                worker.probed = -float("inf")

    def _suspend(self, worker: _Worker, why: str | None) -> None:
        """Send a worker no tasks until its next probe; without a reason it is fit."""
        worker.unfit = why and f"{worker.address}: {why}"
        worker.probed = time.monotonic()
        if why:
            _log.warning("a Dask worker gets nothing to solve: %s", worker.unfit)

    # -- attempts, in the engine's own thread --------------------------------------------------

    async def _cancel(self, name: str) -> None:
        """Cancel an attempt in the scheduler, also one of an earlier server; write its outcome."""
        task = self._tasks.get(name)
        if task and task.run:
            task.run.cancel()
        if task and task.state not in ALIVE:
            return
        with contextlib.suppress(TimeoutError, OSError, ClosedClientError):
            async with asyncio.timeout(CANCEL_SECONDS if task else None):
                client = await self._connected(lambda: True)
                future: Future = Future(f"wrenchbook-{name}", client)  # the task of any client
                await client.cancel([future], force=True)
                await client.unpublish_dataset(future.key)
        if task:
            self._set_state(task, await self._write_outcome(task, attempts.Outcome("cancelled")))

    def _on_progress(self, event: tuple[float, Any]) -> None:
        """Write the progress that a worker's solver reports."""
        report = event[1]
        task = self._tasks.get(report["task"])
        if task is not None and task.state in ALIVE:
            task.worker = report["worker"]
            with contextlib.suppress(OSError):
                _mark_begun(task, report["seconds"])
                if report["progress"]:
                    attempts.write_json(task.attempt.folder / PROGRESS, report["progress"])
            self._set_state(task, "running")

    def _set_state(self, task: _Task, state: attempts.State) -> None:
        if state != task.state:
            task.state = state
            self._report(task.attempt.task)

    async def _run(self, task: _Task) -> None:
        """Submit the attempt until it has ended and its folder has the artifacts."""
        ended: attempts.State | None = None
        while ended is None:
            continues = False  # on the cluster, without this connection
            try:
                ended = await self._submit_once(task)
            except BadPayloadError as error:
                ended = await self._fail(task, "component_too_large", error, _TOO_LARGE_REMEDY)
            except FileNotFoundError as error:
                remedy = "add the component again, then retry the job"
                ended = await self._fail(task, "component_missing", error, remedy)
            except FutureCancelled:
                # The connection was lost, or the scheduler with its tasks and bundles.
                continues = True
                await asyncio.sleep(0)
            except KilledWorker as error:
                task.killed += 1
                if task.killed >= KILLED_TIMES:
                    ended = await self._fail(task, "workers_died", error, _KILLED_REMEDY)
            # No answer in time, no connection, or an error of this disk.
            except (TimeoutError, OSError, ClosedClientError) as error:
                continues = True
                task.waits = f"a Dask worker is not reached: {str(error) or 'no answer in time'}"
                await asyncio.sleep(RETRY_SECONDS)
                task.waits = None
            except Exception as error:
                _log.warning("task %s failed on the cluster: %r", task.attempt.task, error)
                ended = await self._fail(task, "cluster_error", error, _FAULT_REMEDY)
            if self._client and not continues:  # the next try must not get the same result
                with contextlib.suppress(Exception):  # the scheduler may be gone
                    async with asyncio.timeout(CANCEL_SECONDS):
                        await self._client.unpublish_dataset(f"wrenchbook-{task.attempt.task}")
            self._set_state(task, ended or "submitted")

    async def _fail(self, task: _Task, kind: str, error: Exception, remedy: str) -> attempts.State:
        """Write a failure as the attempt's outcome; return the attempt's final state."""
        outcome = attempts.Outcome.failed(kind, str(error) or repr(error), remedy)
        return await self._write_outcome(task, outcome)

    async def _write_outcome(self, task: _Task, outcome: attempts.Outcome) -> attempts.State:
        """Write an outcome unless the solver has; an attempt whose folder is gone is lost."""
        try:
            if not (task.attempt.folder / OUTCOME).exists():
                await asyncio.to_thread(attempts.write_outcome, task.attempt, outcome)
        except OSError:
            return "lost"
        return "finished"

    async def _submit_once(self, task: _Task) -> attempts.State | None:
        """Submit the attempt once; return its final state, None if it is to be submitted again."""
        attempt = task.attempt
        client = await self._connected(lambda: not self._unreachable)
        workers, resources = await self._suitable_workers(task)
        name, bundle = await self._send(client, attempt.bundle)

        def run(*arguments: Any) -> Payload:
            """Run a task; pickled by value, as a scheduler unpickles it and lacks this program."""
            from wrenchbook.service.jobs.dask_worker import run_task

            return run_task(*arguments)

        future: Future = client.submit(
            run,
            pickle.dumps(attempt),
            name,
            bundle,
            key=f"wrenchbook-{attempt.task}",
            priority=attempt.priority,
            workers=workers,
            resources=resources or None,
            retries=MAX_RETRIES,
        )
        payload = await self._payload(client, future, workers)
        if payload is None:
            return None
        if why := payload["unfit"]:
            if worker := self._workers.get(payload["worker"]):
                self._suspend(worker, why)
            return None
        task.worker = payload["worker"]
        while True:
            try:
                await asyncio.to_thread(_store, task, payload)
                task.waits = None
                return "lost" if payload["outcome"] is None else "finished"
            except OSError as error:
                task.waits = f"what a worker sent cannot be written: {error}"
            await asyncio.sleep(RETRY_SECONDS)

    async def _payload(
        self, client: Client, future: Future, workers: Sequence[str] | None
    ) -> Payload | None:
        """Return the result of a task; None if all of its `workers` have left the cluster."""
        result = asyncio.ensure_future(future.result())
        try:
            if client.status == "running":  # without the connection the future is cancelled
                # The task continues without this server, and its result stays for the next server.
                # A new scheduler waits for ever for data that were sent to a dead one.
                with contextlib.suppress(OSError):
                    async with asyncio.timeout(ANSWER_SECONDS):
                        await client.publish_dataset(future, name=future.key, override=True)
            while not (await asyncio.wait({result}, timeout=ROSTER_SECONDS))[0]:
                if workers and not self._disconnected and not self._workers.keys() & workers:
                    # Dask would reserve the task for these workers even if others come.
                    await client.cancel([future], force=True)
                    return None
            return result.result()
        finally:
            result.cancel()
            future.release()

    async def _suitable_workers(self, task: _Task) -> tuple[list[str] | None, dict[str, float]]:
        """Return the workers that may have an attempt, None for all, and the resources it takes.

        Declared resources are reserved by Dask; other workers are chosen by threads and memory.
        """
        memory = task.attempt.memory or 0
        cores = task.attempt.cores
        while True:
            fit = self._fit_workers
            large = [worker for worker in fit if worker.memory >= memory and worker.cores >= cores]
            if large:
                break
            most_memory = max((worker.memory for worker in fit), default=0)
            most_cores = max((worker.cores for worker in fit), default=0)
            waits = (
                f"a solve takes {memory / 1e9:.3g} GB and {cores} cores, but the largest Dask "
                f"workers have {most_memory / 1e9:.3g} GB and {most_cores:g} cores; start larger "
                "workers"
            )
            if waits != task.waits:
                task.waits = waits
                with contextlib.suppress(OSError):
                    progress = {"fraction": 0.0, "message": f"waits: {waits}"}
                    attempts.write_json(task.attempt.folder / PROGRESS, progress)
            await asyncio.sleep(WAIT_SECONDS)
        task.waits = None
        needs = [(CORES, cores), (MEMORY, memory)]
        resources = {
            name: float(need)
            for name, need in needs
            if need and all(name in worker.resources for worker in large)
        }
        everywhere = len(large) == len(self._workers)
        return None if everywhere else [worker.address for worker in large], resources

    async def _send(self, client: Client, folder: str) -> tuple[str, Future]:
        """Return digest and content of a component's files on the cluster; send changed ones."""
        async with self._sending:
            files = await asyncio.to_thread(_file_stats, Path(folder))
            sent = self._bundles.pop(folder, None)
            is_usable = sent is not None and sent.content.status in ("pending", "finished")
            if sent is None or sent.files != files or not is_usable:
                content = await asyncio.to_thread(pack, Path(folder), BUNDLE_BYTES)
                name = digest(content)
                limit = "distributed.admin.large-graph-warning-threshold"
                with dask.config.set({limit: BUNDLE_BYTES}):
                    key = f"wrenchbook-bundle-{name}"
                    future = client.submit(bytes, content, key=key, retries=MAX_RETRIES)
                sent = _SentBundle(files, name, future)
            self._bundles[folder] = sent  # in the order of use
            for old in list(self._bundles)[:-MAX_SENT_BUNDLES]:
                del self._bundles[old]
            return sent.digest, sent.content


def _file_stats(folder: Path) -> list[tuple[str, int, int]]:
    """Return path, bytes and time of change, ns, of a folder's files, by path."""
    stats = ((path, path.stat()) for path in sorted(folder.rglob("*")))
    return [(str(path), stat.st_size, stat.st_mtime_ns) for path, stat in stats]


def _store(task: _Task, payload: Payload) -> None:
    """Write the artifacts into the attempt's folder, the outcome last."""
    folder = task.attempt.folder
    write_files(payload["files"], folder)
    _mark_begun(task, payload["seconds"])
    if payload["outcome"] is not None:
        write_atomically(folder / OUTCOME, payload["outcome"])


def _mark_begun(task: _Task, seconds: float) -> None:
    """Write the lock file of a solver that began `seconds` ago, unless it exists."""
    lock = task.attempt.folder / LOCK
    now = time.time()
    if not lock.exists():
        write_atomically(lock, f"{task.worker}\n".encode(), durable=False)
        os.utime(lock, (now, now - seconds))


_KILLED_REMEDY = (
    "all workers that ran it died. See their logs, give them more memory or declare it "
    "(--resources wrenchbook_memory=BYTES), and retry the job"
)
_TOO_LARGE_REMEDY = "remove files that its component.toml does not name, then retry the job"
_FAULT_REMEDY = "see the logs of scheduler and workers; retry the job once the cluster works"
