"""The part of the Dask engine that runs on workers: looks at a machine, runs attempts.

A worker needs this program and no file system of the server's: a bundle comes as an argument of the
task, an attempt is a subprocess in a folder of its own, and its artifacts are the task's result.
All workers of a user on a machine share one folder, so an attempt that is submitted again after a
restart of the scheduler or of a server is found there, alive or ended.
"""

import os
import pickle
import shutil
import threading
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, TypedDict

from distributed import Reschedule, Status, Worker, get_worker

from wrenchbook.service.files import lock as flock
from wrenchbook.service.files.program import solver_version
from wrenchbook.service.jobs.attempt import LOCK, OUTCOME, prepare, read_progress, solver_seconds
from wrenchbook.service.jobs.engines import worker_files as folders
from wrenchbook.service.jobs.engines.engine import ALIVE, Attempt
from wrenchbook.service.jobs.engines.local import LocalEngine
from wrenchbook.service.jobs.engines.worker_files import (
    BadPayloadError,
    Files,
    WorkerFolderError,
    artifacts,
    attempt_folder,
    place,
    worker_folder,
)

TOPIC = "wrenchbook-progress"
"""The scheduler's topic of the workers' progress events."""

LOOK_SECONDS = 0.1  # between looks at a running solver
REPORT_SECONDS = 1.0  # between two progress events of an attempt
REPEAT_SECONDS = 30.0  # before the same progress is sent again
# A kill of a solver and then its worker, or of a machine, is not the job's fault: the death of a
# solver counts if its worker outlives it so long.
OUTLIVE_SECONDS = 1.0
GRACE_SECONDS = 5.0  # between SIGTERM and SIGKILL of a solver

_engines: list[LocalEngine] = []  # one at most: the solvers of this worker
_engines_lock = threading.Lock()


class Payload(TypedDict):
    """The result of a task.

    ``unfit`` is why the worker could not run the attempt. Otherwise ``files`` are the artifacts
    (without result.json if the solver died) and ``seconds`` is how long the solver ran.
    """

    worker: str
    unfit: str | None
    files: Files
    seconds: float


def look(dask_worker: Worker) -> dict[str, Any]:
    """Return version, trouble and attempts (running or ended) of this worker's machine."""
    folder = worker_folder()
    folders.start_sweeping(folder, _solvers(dask_worker.state.nthreads))
    tasks = sorted(path.name for path in (folder / "attempts").iterdir())
    return {"version": solver_version(), "tasks": tasks, "trouble": folders.trouble(folder)}


def run_task(sent: bytes, digest: str, files: Files) -> Payload:
    """Run an attempt, a pickled `Attempt`, of a component with these files to its end."""
    worker = get_worker()
    attempt: Attempt = pickle.loads(sent)
    try:
        folder = worker_folder()
        folders.start_sweeping(folder, _solvers())
        here = attempt_folder(attempt.task)
        with folders.supervised(here):
            if trouble := folders.trouble(folder):
                return _unfit(worker, trouble)
            bundle = _bundle(folder / "bundles", digest, files)
            spec = replace(attempt.spec, bundle=str(bundle))
            return _run(worker, replace(attempt, folder=here, spec=spec))
    except (OSError, WorkerFolderError, BadPayloadError) as error:
        return _unfit(worker, str(error))


def _bundle(bundles: Path, name: str, files: Files) -> Path:
    """Return the folder of a component; a machine keeps it under its digest."""
    bundle = bundles / name
    if not bundle.is_dir():
        place(files, name, bundles)
        folders.drop_old_bundles(bundles)
    os.utime(bundle)  # bundles in use are kept
    return bundle


def _run(worker: Worker, attempt: Attempt) -> Payload:
    folder, spec = attempt.folder, attempt.spec
    if not (folder / OUTCOME).exists() and not flock.is_locked(folder / LOCK):
        shutil.rmtree(folder, ignore_errors=True)  # of a solver that died with its worker
        prepare(folder, spec)
        _solvers().submit(attempt)
    finished = _supervise(worker, attempt)
    if not finished:
        time.sleep(OUTLIVE_SECONDS)
        if trouble := folders.trouble(worker_folder()):  # solvers die of a full disk
            return _unfit(worker, trouble)
    seconds = solver_seconds(folder) or 0.0
    files = artifacts(folder, spec)
    if not finished:
        shutil.rmtree(folder, ignore_errors=True)
    return {"worker": worker.address, "unfit": None, "files": files, "seconds": seconds}


def _supervise(worker: Worker, attempt: Attempt) -> bool:
    """Return once the attempt's solver has ended: whether it left an outcome.

    Raises
    ------
    Reschedule
        If the worker closes before.
    """
    changed = threading.Event()
    engine, key = _solvers(), worker.get_current_task()
    stop_listening = engine.listen(lambda task: changed.set() if task == attempt.task else None)
    reporter = _Reporter(worker, attempt)
    try:
        while (state := engine.poll(attempt)) in ALIVE:
            if state == "running":
                reporter.report()
            if worker.status in (Status.closing, Status.closed):
                raise Reschedule  # its process ends with this thread; the solver lives on
            if (known := worker.state.tasks.get(key)) and known.state == "cancelled":
                engine.cancel(attempt)
            changed.wait(LOOK_SECONDS)
            changed.clear()
    finally:
        stop_listening()
        engine.forget(attempt)
    return state == "finished"


class _Reporter:
    """Sends progress events of an attempt: one a second at most, and only changes."""

    def __init__(self, worker: Worker, attempt: Attempt) -> None:
        self._worker = worker
        self._attempt = attempt
        self._next = 0.0
        self._repeat = 0.0
        self._last: object = ()

    def report(self) -> None:
        now = time.monotonic()
        if now < self._next:
            return
        progress = read_progress(self._attempt.folder)
        if progress == self._last and now < self._repeat:
            return
        self._last, self._next, self._repeat = progress, now + REPORT_SECONDS, now + REPEAT_SECONDS
        event = {
            "task": self._attempt.task,
            "worker": self._worker.address,
            "progress": asdict(progress) if progress else None,
            "seconds": solver_seconds(self._attempt.folder) or 0.0,
        }
        self._worker.log_event(TOPIC, event)


def _solvers(threads: int = 1) -> LocalEngine:
    """Return the engine of this worker's solvers, which live from one task to the next.

    The first call, which is that of `look`, sets the number of idle solvers it keeps.
    """
    with _engines_lock:
        if not _engines:
            _engines.append(LocalEngine(threads, grace=GRACE_SECONDS))
        return _engines[0]


def _unfit(worker: Worker, why: str) -> Payload:
    return {"worker": worker.address, "unfit": why, "files": {}, "seconds": 0.0}
