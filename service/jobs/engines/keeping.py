"""What the workers on one machine keep for each other: attempts, bundles, and who minds what.

An attempt is minded by the worker that holds its hand: a lock beside the attempts, dropped by the
kernel when the worker dies. A solver that nobody minds any more is ended after a while, in which a
worker that was started anew may take it up; attempts and bundles that nobody asks for are dropped.
"""

import contextlib
import fcntl
import logging
import os
import shutil
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from service.files import lock as flock
from service.jobs.attempt import LOCK, Spec
from service.jobs.engines.engine import ALIVE, Attempt
from service.jobs.engines.local import LocalEngine

_log = logging.getLogger(__name__)

SWEEP_SECONDS = 10.0  # between looks for what nobody minds
ORPHAN_SECONDS = 60.0  # a restarted scheduler and its workers are back within a minute
ATTEMPTS = 200  # ended attempts kept for a server that comes back
ATTEMPT_SECONDS = 2 * 86400.0  # and for how long: a weekend
BUNDLES = 50  # components a machine keeps at a time
BUNDLE_SECONDS = 3600.0  # a solver has read its bundle long before

_sweepers: dict[Path, threading.Thread] = {}
_sweepers_lock = threading.Lock()


@contextlib.contextmanager
def minded(attempt: Path) -> Iterator[None]:
    """Hold the attempt's hand; waits while another worker of this machine, or thread, does."""
    hand = _hand(attempt)
    hand.parent.mkdir(exist_ok=True)
    descriptor = os.open(hand, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def attempts_of(folder: Path) -> list[str]:
    """Return the task keys of the attempts on this machine, running or ended."""
    return sorted(path.name for path in (folder / "attempts").iterdir())


def drop_old_bundles(shelf: Path) -> None:
    """Keep the bundles used last, and those of the last hour."""
    found = [path for path in shelf.iterdir() if not path.name.startswith(".")]
    for path, age in _oldest_beyond(found, BUNDLES):
        if age > BUNDLE_SECONDS:
            shutil.rmtree(path, ignore_errors=True)


def start(folder: Path, engine: LocalEngine) -> None:
    """See to it that a thread of this worker looks after the folder."""
    with _sweepers_lock:
        if folder not in _sweepers:
            sweeper = threading.Thread(target=_sweep_on, args=(folder, engine), daemon=True)
            _sweepers[folder] = sweeper
            sweeper.start()


def _sweep_on(folder: Path, engine: LocalEngine) -> None:
    seen: dict[str, float] = {}
    pause = threading.Event()
    while not pause.wait(SWEEP_SECONDS):
        try:
            seen = sweep(folder, engine, seen)
        except OSError as error:
            _log.warning("what nobody minds in %s was not looked for: %s", folder, error)


def sweep(folder: Path, engine: LocalEngine, seen: dict[str, float]) -> dict[str, float]:
    """End solvers nobody has minded for a while; drop attempts nobody has asked for.

    Parameters
    ----------
    folder : Path
        The workers' folder.
    engine : LocalEngine
        Ends the solvers.
    seen : dict
        When, by `time.monotonic`, each solver that nobody minds was seen first.

    Returns
    -------
    dict
        The same of those that are there now.
    """
    now = time.monotonic()
    orphans: dict[str, float] = {}
    ended: list[Path] = []
    for path in (folder / "attempts").iterdir():
        if flock.is_held(_hand(path)):
            continue
        attempt = Attempt(path.name, path, Spec(0, 0, "", "", "", ()))
        if engine.poll(attempt) not in ALIVE:
            ended.append(path)
            engine.forget(attempt)
            continue
        orphans[path.name] = seen.get(path.name, now)
        if now - orphans[path.name] >= ORPHAN_SECONDS:
            engine.cancel(attempt)
    for index, (path, age) in enumerate(_oldest_beyond(ended, 0)):
        if index < len(ended) - ATTEMPTS or age > ATTEMPT_SECONDS:
            _drop(path)
    return orphans


def _drop(attempt: Path) -> None:
    held = flock.take(_hand(attempt))
    if held is None:
        return
    try:
        if not flock.is_held(attempt / LOCK):
            shutil.rmtree(attempt, ignore_errors=True)
            _hand(attempt).unlink(missing_ok=True)
    finally:
        os.close(held)


def _hand(attempt: Path) -> Path:
    return attempt.parent.with_name("hands") / attempt.name


def _oldest_beyond(paths: list[Path], keep: int) -> list[tuple[Path, float]]:
    """Return all but the `keep` newest, the oldest first, each with its age in seconds."""
    aged: list[tuple[float, Path]] = []
    for path in paths:
        with contextlib.suppress(OSError):
            aged.append((path.stat().st_mtime, path))
    aged.sort()
    return [(path, time.time() - at) for at, path in aged[: len(aged) - keep]]
