"""Files of the Dask engine: payloads, and the folder that a user's workers share on a machine.

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
from collections.abc import Iterator, Mapping
from hashlib import blake2b
from pathlib import Path, PurePosixPath

from wrenchbook.service.files import lock as flock
from wrenchbook.service.files.durable import write_whole_bytes
from wrenchbook.service.jobs.attempt import LOCK, LOG, OUTCOME, PROGRESS, SPEC, Spec, write_outcome
from wrenchbook.service.jobs.engines.engine import ALIVE, Attempt
from wrenchbook.service.jobs.engines.local import LocalEngine

Files = dict[str, bytes]
"""Path of each file in its folder, with forward slashes, and its bytes."""

BUNDLE_BYTES = 512 * 1024 * 1024  # the limit of an uploaded bundle
OUTCOME_BYTES = 8 * 1024 * 1024  # a displacement, a compliance and a history are some kB
LOG_BYTES = 1024 * 1024  # of the end of a log
FILES_BYTES = 32 * 1024 * 1024  # a failed solve's mesh, a deck's files
NAMES = 20  # of the files that stayed behind, in the log
_STAY = {SPEC, LOCK, PROGRESS, LOG}


class BadPayloadError(Exception):
    """A payload is damaged, too large, or has a file name that leads out of its folder."""


def pack(folder: Path, limit: int = BUNDLE_BYTES) -> Files:
    """Return the files of a folder and its subfolders.

    Raises
    ------
    OSError
        If the folder is missing or unreadable.
    BadPayloadError
        If the files have more than `limit` bytes.
    """
    if not folder.is_dir():
        raise FileNotFoundError(f"there is no folder {folder}")
    files: Files = {}
    left = limit
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        content = files[path.relative_to(folder).as_posix()] = path.read_bytes()
        left -= len(content)
        if left < 0:
            raise BadPayloadError(f"{folder} holds more than {limit} bytes")
    return files


def digest(files: Mapping[str, bytes]) -> str:
    """Return a digest of names and contents, 32 hexadecimal digits."""
    hashed = blake2b(digest_size=16)
    for name, content in sorted(files.items()):
        hashed.update(f"{len(name.encode())} {len(content)} ".encode() + name.encode())
        hashed.update(content)
    return hashed.hexdigest()


def unpack(files: Mapping[str, bytes], folder: Path) -> None:
    """Write each file into the folder, whole or not at all; other files stay.

    Raises
    ------
    BadPayloadError
        If a name leads out of the folder; nothing is written then.
    """
    for name in files:
        _check_name(name)
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole_bytes(path, content, durable=False)


def place(files: Mapping[str, bytes], name: str, folder: Path) -> Path:
    """Write files with the digest `name` into ``folder/name``, all of them or none.

    Raises
    ------
    BadPayloadError
        If the files have another digest: they were damaged in transit.
    OSError
        If they cannot be written.
    """
    found = digest(files)
    if found != name:
        raise BadPayloadError(f"the files came as {found}, not as {name}, which was sent")
    target = folder / name
    partial = folder / f".{name}.{os.getpid()}.{threading.get_ident()}"
    try:
        unpack(files, partial)
        partial.rename(target)
    except OSError:
        if not target.is_dir():  # else another worker wrote the same files
            raise
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return target


def artifacts(folder: Path, spec: Spec) -> Files:
    """Return outcome, log and other files of an ended attempt, bounded in size.

    The log names the files that are too large; an outcome that is too large becomes a failure.
    """
    if _size(folder / OUTCOME) > OUTCOME_BYTES:
        write_outcome(folder, spec, _too_large(_size(folder / OUTCOME)))
    files: Files = {}
    room, stayed = FILES_BYTES, []
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if not path.is_file() or path.name.startswith(".") or name in _STAY:
            continue
        if _size(path) > room:
            stayed.append(f"{name} ({_size(path)} bytes)")
            continue
        files[name] = path.read_bytes()
        room -= len(files[name])
    files[LOG] = _log_tail(folder / LOG, stayed)
    return files


def _log_tail(path: Path, stayed: list[str]) -> bytes:
    """Return the end of the log; notes come first because its last line is a cause of death."""
    size, end = _size(path), b""
    with contextlib.suppress(FileNotFoundError), path.open("rb") as file:
        file.seek(max(0, size - LOG_BYTES))
        end = file.read(LOG_BYTES)
    notes = [f"[{size - LOG_BYTES} bytes of this log are left out here]"] * (size > LOG_BYTES)
    if stayed:
        names = ", ".join(stayed[:NAMES]) + (", ..." if len(stayed) > NAMES else "")
        notes.append(f"[too large to be sent, left on the worker: {names}]")
    return "".join(f"{note}\n" for note in notes).encode() + end


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0


def _too_large(size: int) -> dict[str, object]:
    error = {
        "kind": "answer_too_large",
        "message": f"the solver's answer is {size} bytes; at most {OUTCOME_BYTES} are taken",
        "remedy": "have the solver give the displacement and write other results to files",
    }
    return {"status": "failed", "error": error}


def _check_name(name: str) -> None:
    path = PurePosixPath(name)
    if not name or path.is_absolute() or ".." in path.parts or "\0" in name or "\\" in name:
        raise BadPayloadError(f"the file name {name!r} leads out of its folder")


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
        If it belongs to another user: that user could replace its files.
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
        if flock.is_locked(_supervision(path)):
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
        if not flock.is_locked(attempt / LOCK):
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
