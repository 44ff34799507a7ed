"""The engine for an existing Dask cluster; no file system needs to be shared with it.

A worker needs this program: a bundle comes as an argument of the task, an attempt is a subprocess
in a folder of the worker's, and its files are the task's result. All workers of a user on a machine
share one folder, so an attempt that is submitted again after a restart of the scheduler or of a
server is found there, alive or ended. A worker holds a lock of each attempt that it supervises; the
kernel drops it when the worker dies. The next worker on the machine then supervises the solver, or
a solver is ended after a minute.
"""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import io
import logging
import os
import pickle
import re
import shutil
import tempfile
import threading
import time
import zipfile
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError as FutureCancelled
from dataclasses import asdict, dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Any

import dask.config
import distributed
from distributed import Client, Future, KilledWorker, Worker
from distributed.client import ClosedClientError

from wrenchbook.service.files import lock as flock
from wrenchbook.service.files.durable import write_whole_bytes
from wrenchbook.service.files.program import solver_version
from wrenchbook.service.jobs import attempt as attempts
from wrenchbook.service.jobs.attempt import ALIVE, LOCK, LOG, OUTCOME, PROGRESS, SPEC, Attempt
from wrenchbook.service.jobs.solver_pool import LocalEngine

_log = logging.getLogger(__name__)
# They log each lost connection with a traceback; the engine logs it in one line.
for _name in ("distributed.client", "distributed.batched"):
    logging.getLogger(_name).setLevel(logging.CRITICAL)

# A thread that is free finds its next task on its worker: the way through the scheduler takes as
# long as a solve of 10 ms. Scheduler and workers keep the order of priorities.
TASKS_A_THREAD = 2
TOPIC = "wrenchbook-progress"  # of the workers' progress events, on the scheduler
CLOSE_SECONDS = 5.0
CANCEL_SECONDS = 2.0  # for the scheduler to be reachable before an attempt counts as cancelled
CONNECT_SECONDS = 10.0  # also how long the client tries to reconnect before it is replaced
AWAY_SECONDS = (0.2, 5.0)  # before the first reconnection, and at most
ROSTER_SECONDS = 1.0  # between requests for the list of workers
ROSTER_SECONDS_A_WORKER = 0.002  # a reply holds some kB of each
ANSWER_SECONDS = 10.0  # a scheduler that takes longer does not answer
# For a look at a worker, then it is repeated: the call to a worker that has only just registered
# may be lost, and what a slow one has imported stays imported.
LOOK_SECONDS = 3.0
LOOK_AGAIN_SECONDS = 20.0  # between looks at a worker that is not fit
WAIT_SECONDS = 0.1  # between looks of an attempt for a worker that can have it
# An attempt that killed so many workers is treated as the cause and fails: KILLED_TIMES times the
# `distributed.scheduler.allowed-failures` + 1 (4) after which Dask gives a task up.
KILLED_TIMES = 5
FAULTS = 10  # exceptions of a worker's part of the engine before the attempt fails
AGAIN_SECONDS = 1.0  # before a retry after an error of this machine or of the connection
SENT_BUNDLES = 20  # components that workers keep in memory
# Resources a worker may declare: ``--resources "wrenchbook_memory=8e9 wrenchbook_cores=4"``.
MEMORY, CORES = "wrenchbook_memory", "wrenchbook_cores"

BUNDLE_BYTES = 512 * 1024 * 1024  # the limit of an uploaded bundle
OUTCOME_BYTES = 8 * 1024 * 1024  # a displacement, a compliance and a history are some kB
LOG_BYTES = 1024 * 1024  # of the end of a log
FILES_BYTES = 32 * 1024 * 1024  # a failed solve's mesh, a deck's files
NAMES = 20  # of the files that stayed behind, in the log

FOLDER_VARIABLE = "WRENCHBOOK_WORKER_FOLDER"
FREE_BYTES = 64 * 1024 * 1024  # a disk with less has no room for a solver's files
SWEEP_SECONDS = 10.0  # between sweeps
ORPHAN_SECONDS = 60.0  # a restarted scheduler and its workers are back within a minute
ATTEMPTS = 200  # ended attempts kept for a server that comes back
ATTEMPT_SECONDS = 2 * 86400.0  # and for how long: a weekend
BUNDLES = 50  # components kept on a machine
BUNDLE_SECONDS = 3600.0  # a solver has read its bundle long before
POLL_SECONDS = 0.1  # between a worker's looks at a running solver
REPORT_SECONDS = 1.0  # between two progress events of an attempt
REPEAT_SECONDS = 30.0  # before the same progress is sent again
# A kill of a solver and then its worker, or of a machine, is not the job's fault: the death of a
# solver counts if its worker outlives it so long.
OUTLIVE_SECONDS = 1.0
GRACE_SECONDS = 5.0  # between SIGTERM and SIGKILL of a solver


class BadPayloadError(Exception):
    """A payload is damaged or too large."""


class WorkerFolderError(Exception):
    """The folder of the workers cannot be used."""


# -- on the server --------------------------------------------------------------------------


@dataclass
class _Worker:
    """A worker: what it has (declared, else its memory limit and threads) and what `look` found."""

    address: str
    threads: int
    resources: dict[str, float]
    memory: float
    cores: float
    unfit: str | None = "it has not been looked at yet"  # why it gets no tasks
    looked: float = -float("inf")
    tasks: frozenset[str] = frozenset()  # attempts on its machine


@dataclass
class _Task:
    """An attempt on its way."""

    attempt: Attempt
    state: attempts.State = "submitted"
    waits: str | None = None  # why no worker can have it
    worker: str | None = None  # that sent the last event
    killed: int = 0
    run: asyncio.Task[None] | None = None


class DaskEngine(attempts.Listeners):
    """Runs attempts as tasks of a Dask scheduler, from a thread and an event loop of its own.

    The scheduler's address is ``tcp://host:8786``, or ``tls://`` with the certificates of Dask's
    own configuration (``distributed.comm.tls``).
    """

    name = "dask"

    def __init__(self, scheduler: str) -> None:
        self._scheduler = f"the Dask scheduler at {scheduler}"
        self._away: str | None = f"{self._scheduler} has not answered yet"
        self._workers: dict[str, _Worker] = {}
        self._tasks: dict[str, _Task] = {}
        self._bundles: dict[str, tuple[list[Any], str, Future]] = {}
        self._sending = asyncio.Lock()
        self._client: Client | None = None
        self._background: set[asyncio.Task[None]] = set()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run_loop, args=(scheduler,), daemon=True)
        self._thread.start()

    @property
    def slots(self) -> int:
        """Tasks for the threads of fit workers, and those that wait for a worker."""
        waiting = sum(task.waits is not None for task in tuple(self._tasks.values()))
        return TASKS_A_THREAD * sum(worker.threads for worker in self._fit) + waiting

    @property
    def trouble(self) -> str | None:
        """What keeps attempts from being solved: no scheduler, no worker fit or large enough."""
        waits = (task.waits for task in tuple(self._tasks.values()))
        return self._unreachable or next((why for why in waits if why), None)

    def submit(self, attempt: Attempt) -> None:
        """Submit the attempt to the cluster."""
        if why := self._unreachable:
            raise attempts.EngineError(why)
        if attempt.task not in self._tasks:
            task = self._tasks[attempt.task] = _Task(attempt)
            self._soon(self._start, task)

    def attach(self, attempt: Attempt) -> None:
        """Submit the attempt under its key: a task of that key on the cluster goes on."""
        with contextlib.suppress(OSError, ValueError, TypeError, KeyError):
            if attempt.task not in self._tasks and not (attempt.folder / OUTCOME).exists():
                attempt.bundle = attempts.read_attempt(attempt.folder).bundle
                task = self._tasks[attempt.task] = _Task(attempt)
                self._soon(self._start, task)

    def poll(self, attempt: Attempt) -> attempts.State:
        """Return the attempt's state by the latest event; see `service.jobs.engines`."""
        if task := self._tasks.get(attempt.task):
            return task.state
        return "finished" if (attempt.folder / OUTCOME).exists() else "lost"

    def cancel(self, attempt: Attempt) -> None:
        """Cancel the attempt's Dask task; its worker ends the solver."""
        self._soon(lambda: self._go(self._cancel(attempt.task)))

    def forget(self, attempt: Attempt) -> None:
        """Stop following an attempt; a worker that runs it goes on."""
        if task := self._tasks.pop(attempt.task, None):
            self._soon(lambda: task.run and task.run.cancel())

    def close(self) -> None:
        """Leave the cluster; workers finish their attempts and keep them for the next server."""
        self._tasks.clear()
        self._soon(self._loop.stop)
        self._thread.join(CLOSE_SECONDS)

    @property
    def _fit(self) -> list[_Worker]:
        workers = tuple(self._workers.values())
        return [] if self._away else [worker for worker in workers if worker.unfit is None]

    @property
    def _unreachable(self) -> str | None:
        """Why no task can be submitted at present; None if one can."""
        if self._away or self._fit:
            return self._away
        reasons = sorted({worker.unfit or "" for worker in tuple(self._workers.values())})
        if not reasons:
            return f"{self._scheduler} has no workers"
        return f"no worker of {self._scheduler} can solve: {'; '.join(reasons[:3])}"

    # -- the connection, in the engine's own thread -------------------------------------------

    def _run_loop(self, scheduler: str) -> None:
        asyncio.set_event_loop(self._loop)
        following = self._loop.create_task(self._connect(scheduler))
        try:
            self._loop.run_forever()
        finally:
            # It sends what the client has not sent yet: cancellations. Dask's own may not end.
            for tasks in ({following}, asyncio.all_tasks(self._loop)):
                for task in tasks:
                    task.cancel()
                if tasks:
                    self._loop.run_until_complete(asyncio.wait(tasks, timeout=CLOSE_SECONDS / 2))
            self._loop.close()

    def _soon(self, function: Callable[..., object], *arguments: Any) -> None:
        with contextlib.suppress(RuntimeError):  # the engine is closed
            self._loop.call_soon_threadsafe(function, *arguments)

    def _go(self, coroutine: Any) -> asyncio.Task[None]:
        task = self._loop.create_task(coroutine)
        self._background.add(task)
        task.add_done_callback(self._background.discard)
        return task

    async def _connect(self, scheduler: str) -> None:
        """Connect and follow the workers for ever.

        The client reconnects by itself for CONNECT_SECONDS; then another one takes its place.
        """
        pause = AWAY_SECONDS[0]
        options: dict[str, Any] = {"timeout": CONNECT_SECONDS, "name": "wrenchbook"}
        while True:
            try:
                client = Client(scheduler, asynchronous=True, set_as_default=False, **options)
                try:
                    await client
                    pause, self._client = AWAY_SECONDS[0], client
                    await self._follow(client)
                finally:
                    self._client = None
                    with contextlib.suppress(Exception):  # its scheduler may be gone
                        closing: Any = client.close()
                        await asyncio.wait_for(closing, CLOSE_SECONDS / 2)
                why = "the connection to it was lost"
            except Exception as error:  # a bad address, another version, no certificate
                why = str(error) or repr(error)
            self._set_away(f"cannot be used: {why}")
            await asyncio.sleep(pause)
            pause = min(2 * pause, AWAY_SECONDS[1])

    async def _connected(self, ready: Callable[[], bool]) -> Client:
        while True:
            if (client := self._client) is not None and client.status == "running" and ready():
                return client
            await asyncio.sleep(WAIT_SECONDS)

    def _set_away(self, why: str) -> None:
        self._workers.clear()
        away = f"{self._scheduler} {why}"
        if away != self._away:
            _log.warning("%s; it is tried again", away)
        self._away = away

    async def _follow(self, client: Client) -> None:
        """Keep the list of workers up to date until the client closes."""
        scheduler: Any = client.scheduler
        while client.status in ("running", "connecting"):
            if client.status == "connecting":
                self._set_away("cannot be used: the connection to it was lost")
                await asyncio.sleep(AWAY_SECONDS[0])
                continue
            # A client that has reconnected has no subscriptions any more.
            client.subscribe_topic(TOPIC, self._on_progress)
            try:
                roster = await asyncio.wait_for(scheduler.identity(n_workers=-1), ANSWER_SECONDS)
            except OSError:
                self._set_away("does not answer")
                continue
            self._away = None
            self._enrol(client, roster["workers"])
            await asyncio.sleep(max(ROSTER_SECONDS, ROSTER_SECONDS_A_WORKER * len(self._workers)))

    def _enrol(self, client: Client, roster: dict[str, dict[str, Any]]) -> None:
        for address in self._workers.keys() - roster.keys():
            del self._workers[address]
        for address, seen in roster.items():
            if address not in self._workers:
                resources, threads = seen["resources"], seen["nthreads"]
                memory = resources.get(MEMORY) or seen["memory_limit"] or float("inf")
                size = memory, resources.get(CORES) or threads
                self._workers[address] = _Worker(address, threads, resources, *size)
        now = time.monotonic()
        workers = self._workers.values()
        due = [each for each in workers if each.unfit and now > each.looked + LOOK_AGAIN_SECONDS]
        for worker in due:
            worker.looked = now
        if due:
            self._go(self._look_at(client, due))

    async def _look_at(self, client: Client, workers: list[_Worker]) -> None:
        addresses = [worker.address for worker in workers]
        try:
            looks = client.run(look, workers=addresses, on_error="return")
            answers: dict[str, Any] = await asyncio.wait_for(looks, LOOK_SECONDS)
        except OSError as error:
            answers = dict.fromkeys(addresses, error)
        for worker in workers:
            answer = answers.get(worker.address)
            if isinstance(answer, dict):
                worker.tasks, why = frozenset(answer["tasks"]), answer["trouble"]
                if answer["version"] != solver_version():
                    why = f"it has wrenchbook {answer['version']}, this server has "
                    why += solver_version()
            # A worker that cannot import a function answers with the error as text.
            elif re.search("ModuleNotFoundError|ImportError|AttributeError", repr(answer)):
                why = f"it lacks this program ({answer}): install wrenchbook[cluster,server] there"
            else:
                why = f"it does not answer as it should ({answer!r})"
            self._suspend(worker, why)
            if isinstance(answer, OSError):
                worker.looked = -float("inf")

    def _suspend(self, worker: _Worker, why: str | None) -> None:
        """Send a worker no tasks until the next look at it, if there is a reason."""
        worker.unfit, worker.looked = why and f"{worker.address}: {why}", time.monotonic()
        if why:
            _log.warning("a Dask worker gets nothing to solve: %s", worker.unfit)

    # -- attempts, in the engine's own thread --------------------------------------------------

    def _start(self, task: _Task) -> None:
        task.run = self._go(self._run(task))

    async def _cancel(self, name: str) -> None:
        task = self._tasks.get(name)
        if task and task.run:
            task.run.cancel()
        if task and task.state not in ALIVE:
            return
        with contextlib.suppress(OSError):
            async with asyncio.timeout(CANCEL_SECONDS if task else None):
                client = await self._connected(lambda: True)
                future: Future = Future(f"wrenchbook-{name}", client)  # whoever submitted it
                await client.cancel([future], force=True)
        if task:
            self._set(task, await self._end_with(task, attempts.Outcome("cancelled")))

    def _on_progress(self, event: tuple[float, Any]) -> None:
        """Take a worker's progress event: a solver is at the attempt."""
        report = event[1]
        task = self._tasks.get(report["task"])
        if task is not None and task.state in ALIVE:
            task.worker = report["worker"]
            with contextlib.suppress(OSError):
                _mark_begun(task, report["seconds"])
                if report["progress"]:
                    attempts.write_whole(task.attempt.folder / PROGRESS, report["progress"])
            self._set(task, "running")

    def _set(self, task: _Task, state: attempts.State) -> None:
        if state != task.state:
            task.state = state
            self._report(task.attempt.task)

    async def _run(self, task: _Task) -> None:
        """Submit the attempt until it has ended and its folder holds the artifacts."""
        ended: attempts.State | None = None
        while ended is None:
            try:
                ended = await self._try(task)
            except (BadPayloadError, FileNotFoundError) as error:
                remedy = "add the component again"
                ended = await self._fail(task, "component_missing", error, remedy)
            except FutureCancelled:
                await asyncio.sleep(0)  # it was lost with the scheduler, or with its bundle
            except KilledWorker as error:
                task.killed += 1
                if task.killed >= KILLED_TIMES:
                    ended = await self._fail(task, "workers_died", error, _KILLED_REMEDY)
            except (OSError, ClosedClientError) as error:  # the connection, or this disk
                task.waits = f"a Dask worker is not reached: {error}"
                await asyncio.sleep(AGAIN_SECONDS)
                task.waits = None
            except Exception as error:
                _log.warning("task %s failed on the cluster: %r", task.attempt.task, error)
                ended = await self._fail(task, "cluster_error", error, _FAULT_REMEDY)
            self._set(task, ended or "submitted")

    async def _fail(self, task: _Task, kind: str, error: Exception, remedy: str) -> attempts.State:
        outcome = attempts.Outcome.failed(kind, str(error) or repr(error), remedy)
        return await self._end_with(task, outcome)

    async def _end_with(self, task: _Task, outcome: attempts.Outcome) -> attempts.State:
        """Write an outcome in the solver's stead; an attempt whose folder is gone is lost."""
        try:
            if not (task.attempt.folder / OUTCOME).exists():
                await asyncio.to_thread(attempts.write_outcome, task.attempt, outcome)
        except OSError:
            return "lost"
        return "finished"

    async def _try(self, task: _Task) -> attempts.State | None:
        """Submit the attempt once; return how it ended, or None if it is to be submitted again."""
        attempt = task.attempt
        client = await self._connected(lambda: not self._unreachable)
        workers, resources = await self._place(task)
        name, bundle = await self._send(client, attempt.bundle)
        future: Future = client.submit(
            _by_name(),
            pickle.dumps(attempt),
            name,
            bundle,
            key=f"wrenchbook-{attempt.task}",
            priority=attempt.priority,
            workers=workers,
            resources=resources or None,
            retries=FAULTS,
        )
        distributed.fire_and_forget(future)  # it goes on without this server, for the next one
        result = asyncio.ensure_future(future.result())
        try:
            while not (await asyncio.wait({result}, timeout=ROSTER_SECONDS))[0]:
                if workers and not self._away and not self._workers.keys() & workers:
                    # Dask would keep the task for these workers, whichever others come.
                    await client.cancel([future], force=True)
                    return None
            payload = result.result()
        finally:
            result.cancel()
            future.release()
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
            await asyncio.sleep(AGAIN_SECONDS)

    async def _place(self, task: _Task) -> tuple[list[str] | None, dict[str, float]]:
        """Return the workers that may have an attempt, None for all, and the resources it takes.

        Declared resources are reserved by Dask; other workers are chosen by threads and memory. An
        attempt that is on a worker's machine already goes there.
        """
        memory, cores = task.attempt.memory or 0, task.attempt.cores
        while True:
            fit = self._fit
            large = [each for each in fit if each.memory >= memory and each.cores >= cores]
            if large:
                break
            waits = (
                f"no Dask worker is large enough: a solve takes {memory / 1e9:.3g} GB and "
                f"{cores} cores, the largest workers have "
                f"{max((each.memory for each in fit), default=0) / 1e9:.3g} GB and "
                f"{max((each.cores for each in fit), default=0):g} cores"
            )
            if waits != task.waits:
                task.waits = waits
                with contextlib.suppress(OSError):
                    progress = {"fraction": 0.0, "message": f"waits: {waits}"}
                    attempts.write_whole(task.attempt.folder / PROGRESS, progress)
            await asyncio.sleep(WAIT_SECONDS)
        task.waits = None
        needs = [(CORES, cores), (MEMORY, memory)]
        declared = [each.resources for each in large]
        resources = {
            name: float(need)
            for name, need in needs
            if need and all(name in each for each in declared)
        }
        known = [each.address for each in fit if task.attempt.task in each.tasks][:1]
        everywhere = len(large) == len(self._workers)
        return known or (None if everywhere else [each.address for each in large]), resources

    async def _send(self, client: Client, folder: str) -> tuple[str, Future]:
        """Return digest and content of a component's files on the cluster, sent once a change."""

        def files() -> list[tuple[str, int, int]]:
            stats = ((path, path.stat()) for path in sorted(Path(folder).rglob("*")))
            return [(str(path), stat.st_size, stat.st_mtime_ns) for path, stat in stats]

        async with self._sending:
            seen = await asyncio.to_thread(files)
            sent = self._bundles.pop(folder, None)
            if sent is None or sent[0] != seen or sent[2].status not in ("pending", "finished"):
                content = await asyncio.to_thread(pack, Path(folder))
                name, limit = digest(content), "distributed.admin.large-graph-warning-threshold"
                with dask.config.set({limit: BUNDLE_BYTES}):
                    key = f"wrenchbook-bundle-{name}"
                    sent = seen, name, client.submit(bytes, content, key=key, retries=FAULTS)
            self._bundles[folder] = sent  # the last used stands last
            for old in list(self._bundles)[:-SENT_BUNDLES]:
                del self._bundles[old]
            return sent[1], sent[2]


def _by_name() -> Callable[..., dict[str, Any]]:
    """Return `run_task`, pickled by value: a scheduler unpickles tasks and lacks this program."""

    def run(*arguments: Any) -> dict[str, Any]:
        from wrenchbook.service.jobs.dask import run_task

        return run_task(*arguments)

    return run


def _store(task: _Task, payload: dict[str, Any]) -> None:
    """Write the artifacts into the attempt's folder, the outcome last."""
    folder = task.attempt.folder
    unpack(payload["files"], folder)
    _mark_begun(task, payload["seconds"])
    if payload["outcome"] is not None:
        write_whole_bytes(folder / OUTCOME, payload["outcome"])


def _mark_begun(task: _Task, seconds: float) -> None:
    """Write the lock as a solver does that began some seconds ago."""
    lock, now = task.attempt.folder / LOCK, time.time()
    if not lock.exists():
        write_whole_bytes(lock, f"{task.worker}\n".encode(), durable=False)
        os.utime(lock, (now, now - seconds))


_KILLED_REMEDY = (
    "the workers that had it died, each time: see their logs, give them more memory or declare it "
    "(--resources wrenchbook_memory=BYTES), and retry the job"
)
_FAULT_REMEDY = "see the logs of scheduler and workers; retry the job once the cluster is well"


# -- files that travel ------------------------------------------------------------------------


def pack(folder: Path, limit: int = BUNDLE_BYTES) -> bytes:
    """Return the zip of a folder and its subfolders, the same bytes for the same files.

    Raises FileNotFoundError without the folder, `BadPayloadError` for more than `limit` bytes.
    """
    if not folder.is_dir():
        raise FileNotFoundError(f"there is no folder {folder}")
    content, stayed = _zip(folder, limit)
    if stayed:
        raise BadPayloadError(f"{folder} holds more than {limit} bytes")
    return content


def _zip(folder: Path, limit: int, skip: tuple[str, ...] = ()) -> tuple[bytes, list[str]]:
    """Return the zip of the files that are within a limit of bytes, and those beyond it."""
    content, stayed = io.BytesIO(), []
    with zipfile.ZipFile(content, "w") as archive:
        for path in sorted(path for path in folder.rglob("*") if path.is_file()):
            name = path.relative_to(folder).as_posix()
            if name in skip or (skip and (path.name.startswith(".") or path.is_symlink())):
                continue
            size = path.stat().st_size
            if size > limit:
                stayed.append(f"{name} ({size} bytes)")
                continue
            limit -= size
            archive.writestr(zipfile.ZipInfo(name), path.read_bytes())  # without its time
    return content.getvalue(), stayed


def digest(content: bytes) -> str:
    """Return a digest of 32 hexadecimal digits."""
    return blake2b(content, digest_size=16).hexdigest()


def unpack(content: bytes, folder: Path) -> None:
    """Write the files of a zip into a folder; other files stay.

    Raises `BadPayloadError` if a name leads out of the folder; nothing is written then.
    """
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        for name in archive.namelist():
            if not name or name.startswith("/") or "\\" in name or ".." in name.split("/"):
                raise BadPayloadError(f"the file name {name!r} leads out of its folder")
        folder.mkdir(parents=True, exist_ok=True)
        archive.extractall(folder)


def place(content: bytes, name: str, folder: Path) -> Path:
    """Write the files of a zip with the digest `name` into ``folder/name``, all or none.

    Raises `BadPayloadError` if they were damaged in transit, OSError if they cannot be written.
    """
    if digest(content) != name:
        raise BadPayloadError(f"the files came as {digest(content)}, not as {name}, which was sent")
    target = folder / name
    partial = folder / f".{name}.{os.getpid()}.{threading.get_ident()}"
    try:
        unpack(content, partial)
        partial.rename(target)
    except OSError:
        if not target.is_dir():  # else another worker wrote the same files
            raise
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return target


def artifacts(attempt: Attempt) -> tuple[bytes | None, bytes]:
    """Return the outcome of an ended attempt, and the zip of log and other files, bounded in size.

    The log names the files that are too large; an outcome that is too large becomes a failure. The
    notes on a log come first because its last line is a cause of death.
    """
    outcome, log = (attempt.folder / name for name in (OUTCOME, LOG))
    if outcome.exists() and (size := outcome.stat().st_size) > OUTCOME_BYTES:
        failed = attempts.Outcome.failed(
            "answer_too_large",
            f"the solver's answer is {size} bytes; at most {OUTCOME_BYTES} are taken",
            "have the solver give the displacement and write other results to files",
        )
        attempts.write_outcome(attempt, failed)
    files, stayed = _zip(attempt.folder, FILES_BYTES, (SPEC, LOCK, PROGRESS, LOG, OUTCOME))
    text, notes = b"", ""
    with contextlib.suppress(FileNotFoundError), log.open("rb") as file:
        if (beyond := log.stat().st_size - LOG_BYTES) > 0:
            file.seek(beyond)
            notes = f"[{beyond} bytes of this log are left out here]\n"
        text = file.read(LOG_BYTES)
    if stayed:
        names = ", ".join(stayed[:NAMES]) + (", ..." if len(stayed) > NAMES else "")
        notes += f"[too large to be sent, left on the worker: {names}]\n"
    content = io.BytesIO(files)
    with zipfile.ZipFile(content, "a") as archive:
        archive.writestr(LOG, notes.encode() + text)
    return outcome.read_bytes() if outcome.exists() else None, content.getvalue()


# -- on a worker ------------------------------------------------------------------------------

_solvers: dict[Path, LocalEngine] = {}  # of this worker, one at most, by the workers' folder
_solvers_lock = threading.Lock()


def look(dask_worker: Worker) -> dict[str, Any]:
    """Return version, trouble and attempts (running or ended) of this worker's machine."""
    folder = worker_folder()
    solvers_in(folder, dask_worker.state.nthreads)
    tasks = sorted(path.name for path in (folder / "attempts").iterdir())
    return {"version": solver_version(), "tasks": tasks, "trouble": _no_room(folder)}


def run_task(sent: bytes, name: str, files: bytes) -> dict[str, Any]:
    """Run an attempt, a pickled `Attempt`, of a component with these files to its end.

    In the result ``unfit`` is why the worker could not run it. Otherwise ``outcome`` is the content
    of result.json, None if the solver died, ``files`` the zip of the others, ``seconds`` is how
    long the solver ran.
    """
    worker = distributed.get_worker()
    attempt: Attempt = pickle.loads(sent)
    result: dict[str, Any] = {"worker": worker.address, "unfit": None}
    try:
        folder = worker_folder()
        if not re.fullmatch(r"[\w-][\w.-]{0,119}", attempt.task):
            raise WorkerFolderError(f"{attempt.task!r} is no task key: it names no folder")
        attempt.folder = folder / "attempts" / attempt.task
        with supervised(attempt.folder):
            if why := _no_room(folder):
                raise WorkerFolderError(why)
            bundle = folder / "bundles" / name  # a machine keeps it under its digest
            if not bundle.is_dir():
                place(files, name, bundle.parent)
                drop_old_bundles(bundle.parent)
            os.utime(bundle)  # bundles in use are kept
            attempt.bundle = str(bundle)
            return result | _run_here(worker, attempt, solvers_in(folder))
    except (OSError, WorkerFolderError, BadPayloadError) as error:
        return result | {"unfit": str(error)}


def _run_here(worker: Worker, attempt: Attempt, engine: LocalEngine) -> dict[str, Any]:
    folder = attempt.folder
    if not (folder / OUTCOME).exists() and not flock.is_locked(folder / LOCK):
        shutil.rmtree(folder, ignore_errors=True)  # of a solver that died with its worker
        attempts.prepare(attempt)
        engine.submit(attempt)
    finished = _supervise(worker, attempt, engine)
    if not finished:
        time.sleep(OUTLIVE_SECONDS)
        if why := _no_room(worker_folder()):  # solvers die of a full disk
            raise WorkerFolderError(why)
    seconds = attempts.solver_seconds(folder) or 0.0
    outcome, files = artifacts(attempt)
    if not finished:
        shutil.rmtree(folder, ignore_errors=True)
    return {"outcome": outcome, "files": files, "seconds": seconds}


def _supervise(worker: Worker, attempt: Attempt, engine: LocalEngine) -> bool:
    """Return once the attempt's solver has ended: whether it left an outcome.

    Sends progress events: one a second at most, and only changes. Raises Reschedule if the worker
    closes before.
    """
    changed = threading.Event()
    key = worker.get_current_task()
    stop_listening = engine.listen(lambda task: changed.set() if task == attempt.task else None)
    last, due, repeat = None, 0.0, 0.0
    try:
        while (state := engine.poll(attempt)) in ALIVE:
            now = time.monotonic()
            if state == "running" and now >= due:
                progress = attempts.read_progress(attempt.folder)
                if progress != last or now >= repeat:
                    last, due, repeat = progress, now + REPORT_SECONDS, now + REPEAT_SECONDS
                    event = {
                        "task": attempt.task,
                        "worker": worker.address,
                        "progress": asdict(progress) if progress else None,
                        "seconds": attempts.solver_seconds(attempt.folder) or 0.0,
                    }
                    worker.log_event(TOPIC, event)
            if worker.status in (distributed.Status.closing, distributed.Status.closed):
                raise distributed.Reschedule  # its process ends with this thread
            if (known := worker.state.tasks.get(key)) and known.state == "cancelled":
                engine.cancel(attempt)
            changed.wait(POLL_SECONDS)
            changed.clear()
    finally:
        stop_listening()
        engine.forget(attempt)
    return state == "finished"


def worker_folder() -> Path:
    """Return the folder of the workers; it is created if it is missing.

    Raises `WorkerFolderError` if it belongs to another user: that user could replace its files.
    """
    default = Path(tempfile.gettempdir()) / f"wrenchbook-{os.getuid()}"
    folder = Path(os.environ.get(FOLDER_VARIABLE) or default)
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if folder.stat().st_uid != os.getuid():
        raise WorkerFolderError(f"{folder} belongs to another user; set {FOLDER_VARIABLE}")
    for name in ("bundles", "attempts", "supervised"):
        (folder / name).mkdir(exist_ok=True)
    return folder


def solvers_in(folder: Path, threads: int = 1) -> LocalEngine:
    """Return the engine of this worker's solvers, which live from one task to the next.

    The first call, which is that of `look`, sets the number of idle solvers it keeps, and starts a
    thread that sweeps the folder.
    """

    def sweep_on() -> None:
        orphans: dict[str, float] = {}
        while True:
            time.sleep(SWEEP_SECONDS)
            try:
                orphans = sweep(folder, engine, orphans)
            except OSError as error:
                _log.warning("%s was not swept: %s", folder, error)

    with _solvers_lock:
        if folder not in _solvers:
            engine = _solvers[folder] = LocalEngine(threads, grace=GRACE_SECONDS)
            threading.Thread(target=sweep_on, daemon=True).start()
        return _solvers[folder]


def _no_room(folder: Path) -> str | None:
    """Return why the folder has no room for an attempt; None if it has."""
    free = shutil.disk_usage(folder).free
    if free < FREE_BYTES:
        return f"{folder} is on a disk with {free >> 20} MB left; {FREE_BYTES >> 20} are needed"
    return None


@contextlib.contextmanager
def supervised(attempt: Path) -> Iterator[None]:
    """Hold the attempt's supervision lock; waits while another worker or thread holds it."""
    descriptor = os.open(_supervision(attempt), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def drop_old_bundles(bundles: Path) -> None:
    """Remove bundles that are neither among the last used nor used within an hour."""
    visible = [path for path in bundles.iterdir() if not path.name.startswith(".")]
    for path, age in _aged(visible)[:-BUNDLES]:
        if age > BUNDLE_SECONDS:
            shutil.rmtree(path, ignore_errors=True)


def sweep(folder: Path, engine: LocalEngine, orphans: dict[str, float]) -> dict[str, float]:
    """End solvers that no worker has supervised for a minute; remove old attempts.

    `orphans` is the result of the sweep before: by task key, when a solver was first seen without
    a worker, in seconds of `time.monotonic`.
    """
    now = time.monotonic()
    unsupervised: dict[str, float] = {}
    ended: list[Path] = []
    for path in (folder / "attempts").iterdir():
        if flock.is_locked(_supervision(path)):
            continue
        attempt = Attempt(0, 0, "", "", "", (), folder=path, task=path.name)
        if engine.poll(attempt) not in ALIVE:
            ended.append(path)
            engine.forget(attempt)
            continue
        since = unsupervised[path.name] = orphans.get(path.name, now)
        if now - since >= ORPHAN_SECONDS:
            engine.cancel(attempt)
    for index, (path, age) in enumerate(_aged(ended)):
        if index >= len(ended) - ATTEMPTS and age <= ATTEMPT_SECONDS:
            continue
        if (lock := flock.take(_supervision(path))) is not None:
            if not flock.is_locked(path / LOCK):
                shutil.rmtree(path, ignore_errors=True)
                _supervision(path).unlink(missing_ok=True)
            os.close(lock)
    return unsupervised


def _supervision(attempt: Path) -> Path:
    return attempt.parent.with_name("supervised") / attempt.name


def _aged(paths: list[Path]) -> list[tuple[Path, float]]:
    """Return the paths that are still there, the oldest first, with their ages in seconds."""
    aged: list[tuple[float, Path]] = []
    for path in paths:
        with contextlib.suppress(OSError):
            aged.append((path.stat().st_mtime, path))
    return [(path, time.time() - at) for at, path in sorted(aged)]
