"""The folder that the Dask workers of one user share on one machine: attempts and bundles.

A worker holds a lock of each attempt that it supervises; the kernel drops it when the worker dies.
The next worker on the machine then supervises the solver, or a solver is ended after a minute.
"""

import contextlib
import fcntl
import logging
import os
import re
import shutil
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from wrenchbook.service.files import lock as flock
from wrenchbook.service.jobs.attempt import LOCK, Spec
from wrenchbook.service.jobs.engines.engine import ALIVE, Attempt
from wrenchbook.service.jobs.engines.local import LocalEngine

_log = logging.getLogger(__name__)

FOLDER_VARIABLE = "WRENCHBOOK_WORKER_FOLDER"
FREE_BYTES = 64 * 1024 * 1024  # a disk with less has no room for a solver's files
SWEEP_SECONDS = 10.0  # between sweeps
ORPHAN_SECONDS = 60.0  # a restarted scheduler and its workers are back within a minute
ATTEMPTS = 200  # ended attempts kept for a server that comes back
ATTEMPT_SECONDS = 2 * 86400.0  # and for how long: a weekend
BUNDLES = 50  # components kept on a machine
BUNDLE_SECONDS = 3600.0  # a solver has read its bundle long before

_sweepers: dict[Path, threading.Thread] = {}
_sweepers_lock = threading.Lock()


class WorkerFolderError(Exception):
    """The folder of the workers cannot be used."""


def worker_folder() -> Path:
    """Return the folder; it is created if it is missing.

    Raises
    ------
    WorkerFolderError
        If it belongs to another user, who could replace its files.
    """
    default = Path(tempfile.gettempdir()) / f"wrenchbook-{os.getuid()}"
    folder = Path(os.environ.get(FOLDER_VARIABLE) or default)
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if folder.stat().st_uid != os.getuid():
        raise WorkerFolderError(f"{folder} belongs to another user; set {FOLDER_VARIABLE}")
    for name in ("bundles", "attempts", "supervised"):
        (folder / name).mkdir(exist_ok=True)
    return folder


def attempt_folder(task: str) -> Path:
    """Return the folder of an attempt; raises WorkerFolderError if its key names none."""
    if not re.fullmatch(r"[\w.-]{1,120}", task) or task.startswith("."):
        raise WorkerFolderError(f"{task!r} is no task key: it names no folder")
    return worker_folder() / "attempts" / task


def trouble(folder: Path) -> str | None:
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
    found = [path for path in bundles.iterdir() if not path.name.startswith(".")]
    for path, age in _oldest(found, keep=BUNDLES):
        if age > BUNDLE_SECONDS:
            shutil.rmtree(path, ignore_errors=True)


def start_sweeping(folder: Path, engine: LocalEngine) -> None:
    """Start a thread that sweeps the folder, unless this process has one."""
    with _sweepers_lock:
        if folder not in _sweepers:
            sweeper = threading.Thread(target=_sweep_on, args=(folder, engine), daemon=True)
            _sweepers[folder] = sweeper
            sweeper.start()


def _sweep_on(folder: Path, engine: LocalEngine) -> None:
    orphans: dict[str, float] = {}
    while True:
        time.sleep(SWEEP_SECONDS)
        try:
            orphans = sweep(folder, engine, orphans)
        except OSError as error:
            _log.warning("%s was not swept: %s", folder, error)


def sweep(folder: Path, engine: LocalEngine, orphans: dict[str, float]) -> dict[str, float]:
    """End solvers that no worker has supervised for a minute; remove old attempts.

    Parameters
    ----------
    folder : Path
        The workers' folder.
    engine : LocalEngine
        Ends the solvers.
    orphans : dict
        Result of the sweep before: by task key, when a solver was first seen without a worker,
        in seconds of `time.monotonic`.

    Returns
    -------
    dict
        The orphans that there are now.
    """
    now = time.monotonic()
    found: dict[str, float] = {}
    ended: list[Path] = []
    for path in (folder / "attempts").iterdir():
        if flock.is_held(_supervision(path)):
            continue
        attempt = bare(path.name, path)
        if engine.poll(attempt) not in ALIVE:
            ended.append(path)
            engine.forget(attempt)
            continue
        found[path.name] = orphans.get(path.name, now)
        if now - found[path.name] >= ORPHAN_SECONDS:
            engine.cancel(attempt)
    for index, (path, age) in enumerate(_oldest(ended)):
        if index < len(ended) - ATTEMPTS or age > ATTEMPT_SECONDS:
            _remove(path)
    return found


def bare(task: str, folder: Path) -> Attempt:
    """Return an attempt of which only the key and the folder are known."""
    return Attempt(task, folder, Spec(0, 0, "", "", "", ()))


def _remove(attempt: Path) -> None:
    lock = flock.take(_supervision(attempt))
    if lock is None:
        return
    try:
        if not flock.is_held(attempt / LOCK):
            shutil.rmtree(attempt, ignore_errors=True)
            _supervision(attempt).unlink(missing_ok=True)
    finally:
        os.close(lock)


def _supervision(attempt: Path) -> Path:
    return attempt.parent.with_name("supervised") / attempt.name


def _oldest(paths: list[Path], keep: int = 0) -> list[tuple[Path, float]]:
    """Return all but the `keep` newest paths, the oldest first, with their ages in seconds."""
    aged: list[tuple[float, Path]] = []
    for path in paths:
        with contextlib.suppress(OSError):
            aged.append((path.stat().st_mtime, path))
    aged.sort()
    return [(path, time.time() - at) for at, path in aged[: len(aged) - keep]]
