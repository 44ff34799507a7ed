"""The part of the Dask engine that runs on a worker: it runs an attempt in a subprocess."""

from __future__ import annotations

import contextlib
import os
import pickle
import shutil
import threading
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import distributed
from distributed import Worker

from wrenchbook.service.files.program import solver_version
from wrenchbook.service.jobs import attempt as attempts
from wrenchbook.service.jobs.attempt import ALIVE, OUTLIVE_SECONDS, Attempt
from wrenchbook.service.jobs.dask_files import BadPayloadError, Payload, artifacts, unpack
from wrenchbook.service.jobs.solver_pool import LocalEngine

TOPIC = "wrenchbook-progress"  # topic of the workers' progress events on the scheduler
FREE_BYTES = 64 * 1024 * 1024  # free space for a solver's files: with less a worker is unfit
BUNDLES = 50  # components that a worker keeps on its disk
BUNDLE_SECONDS = 3600.0  # a solver has read its bundle long before
POLL_SECONDS = 0.1  # pause between a worker's polls of a running solver: short against a solve
REPORT_SECONDS = 1.0  # pause between two progress events of an attempt: a page shows no more
# Time after which unchanged progress is sent again, for a server that has just connected.
REPEAT_SECONDS = 30.0

_engines: list[LocalEngine] = []  # the engine of this process, at most one
_engines_lock = threading.Lock()


def engine_of(worker: Worker) -> LocalEngine:
    """Return the engine of this worker's solvers, which live from one task to the next."""
    with _engines_lock:
        if not _engines:
            threads = worker.state.nthreads
            _engines.append(LocalEngine(threads, outlived_by_solvers=False))
        return _engines[0]


def probe(dask_worker: Worker) -> dict[str, Any]:
    """Return version and trouble of this worker."""
    engine_of(dask_worker)
    return {"version": solver_version(), "trouble": _no_room(dask_worker.local_directory)}


def _no_room(folder: str) -> str | None:
    """Return the reason for which the folder is too full for an attempt; None if it is not."""
    free = shutil.disk_usage(folder).free
    if free < FREE_BYTES:
        return f"{folder} is on a disk with {free >> 20} MB left; make {FREE_BYTES >> 20} free"
    return None


def run_task(sent: bytes, name: str, files: bytes) -> Payload:
    """Run an attempt, a pickled `Attempt`, to its end.

    `files` is the packed bundle of its component, `name` the digest of these bytes.
    """
    worker = distributed.get_worker()
    attempt: Attempt = pickle.loads(sent)
    unfit = _no_room(worker.local_directory)
    result = Payload(worker=worker.address, unfit=unfit, outcome=None, files={}, seconds=0.0)
    if unfit:
        return result
    folder = Path(worker.local_directory, "wrenchbook")
    bundle = folder / "bundles" / name  # a worker stores it under its digest
    attempt.folder = folder / "attempts" / attempt.task
    attempt.bundle = str(bundle)
    try:
        try:
            os.utime(bundle)  # marks a bundle as used, which keeps it
        except FileNotFoundError:
            unpack(files, name, bundle.parent)
            drop_old_bundles(bundle.parent)
        attempts.prepare(attempt)
        engine = engine_of(worker)
        engine.submit(attempt)
        if not _supervise(worker, attempt, engine):
            time.sleep(OUTLIVE_SECONDS)
            result["unfit"] = _no_room(worker.local_directory)  # solvers die on a full disk
        result["seconds"] = attempts.solver_seconds(attempt.folder) or 0.0
        result["outcome"], result["files"] = artifacts(attempt)
    except (OSError, BadPayloadError) as error:
        result["unfit"] = str(error)
    finally:
        shutil.rmtree(attempt.folder, ignore_errors=True)
    return result


def _supervise(worker: Worker, attempt: Attempt, engine: LocalEngine) -> bool:
    """Wait until the attempt's solver has ended; return whether it left an outcome.

    Sends progress events: one a second at most, and only changes.

    Raises Reschedule if the worker closes before.
    """
    changed, key = threading.Event(), worker.get_current_task()
    stop_listening = engine.listen(lambda task: changed.set() if task == attempt.task else None)
    last = None
    due = 0.0
    repeat = 0.0
    try:
        while (state := engine.poll(attempt)) in ALIVE:
            now = time.monotonic()
            if state == "running" and now >= due:
                progress = attempts.read_progress(attempt.folder)
                if progress != last or now >= repeat:
                    last = progress
                    due = now + REPORT_SECONDS
                    repeat = now + REPEAT_SECONDS
                    event = {
                        "task": attempt.task,
                        "worker": worker.address,
                        "progress": asdict(progress) if progress else None,
                        "seconds": attempts.solver_seconds(attempt.folder) or 0.0,
                    }
                    worker.log_event(TOPIC, event)
            if worker.status in (distributed.Status.closing, distributed.Status.closed):
                raise distributed.Reschedule  # the worker's process ends with this thread
            if (known := worker.state.tasks.get(key)) and known.state == "cancelled":
                engine.cancel(attempt)
            changed.wait(POLL_SECONDS)
            changed.clear()
    finally:
        stop_listening()
        engine.forget(attempt)
    return state == "finished"


def drop_old_bundles(bundles: Path) -> None:
    """Remove bundles that are neither among the last used nor were used within an hour."""
    used = dict[Path, float]()
    for path in bundles.glob("[!.]*"):
        with contextlib.suppress(FileNotFoundError):  # another worker has removed it
            used[path] = path.stat().st_mtime
    for path in sorted(used, key=lambda path: -used[path])[BUNDLES:]:
        if time.time() - used[path] > BUNDLE_SECONDS:
            shutil.rmtree(path, ignore_errors=True)
