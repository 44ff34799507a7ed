"""Retention: removes old attempts' folders and shortens the ledger's log in the background."""

from __future__ import annotations

import logging
import os
import shutil
import threading
import time
from dataclasses import dataclass
from pathlib import Path

from wrenchbook.service.ledger import FINAL, Ledger, LedgerError
from wrenchbook.service.settings import Settings

_log = logging.getLogger(__name__)

DAY = 86_400.0
CHECK_S = 30.0  # between checks of the log, which stays below 16 MB under a day's jobs
PRUNE_S = 600.0  # between removals of old folders
LONG_LOG = 4 * 1024 * 1024  # bytes; SQLite begins to move it into the ledger at this size
PART = 2000  # folders per query of the ledger


@dataclass(frozen=True)
class Keep:
    """Which folders of ended attempts are kept; rows and jobs always are.

    A folder is removed once it is older than `days` or `count` others are newer. Attributes with
    `failed` are for failed and cancelled jobs, whose folder has the cause.
    """

    days: float = Settings.keep_days
    count: int = Settings.keep_count  # 27 kB and 7 entries each: 54 MB
    failed_days: float = Settings.keep_failed_days
    failed_count: int = Settings.keep_failed_count


def kept_by(settings: Settings) -> Keep:
    """Return the folders that a server keeps by its settings."""
    done = settings.keep_days, settings.keep_count
    return Keep(*done, settings.keep_failed_days, settings.keep_failed_count)


class Retention:
    """A thread that bounds the size of a data directory; `jobs_folder` has the attempts'."""

    def __init__(self, ledger: Ledger, jobs_folder: Path, keep: Keep) -> None:
        self._ledger, self._jobs_folder, self._keep = ledger, jobs_folder, keep
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Start the thread."""
        self._thread = threading.Thread(target=self._loop, name="retention", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop the thread; an unfinished removal goes on at the next start."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _loop(self) -> None:
        next_prune = time.monotonic()
        while not self._stopping.wait(CHECK_S):
            try:
                shorten_log(self._ledger)
                if time.monotonic() >= next_prune:
                    prune(self._ledger, self._jobs_folder, self._keep, self._stopping)
                    next_prune = time.monotonic() + PRUNE_S
            except LedgerError:
                continue  # the ledger logs it
            except Exception:
                _log.exception("retention failed; it is tried again")


def shorten_log(ledger: Ledger, longest: int = LONG_LOG) -> bool:
    """Empty the ledger's log if it is longer than `longest` bytes; return whether it was done."""
    return ledger.sizes()["log"] > longest and ledger.checkpoint()


def prune(
    ledger: Ledger, jobs_folder: Path, keep: Keep, stopping: threading.Event | None = None
) -> int:
    """Remove the folders of attempts beyond the age or number of `keep`.

    Folders of open jobs stay, and those of jobs that the ledger does not have. A job that ended in
    the future, by a clock that was set back since, counts as new. Returns the number of jobs whose
    folders were removed.
    """
    numbers = sorted((int(name) for name in _names(jobs_folder) if name.isdecimal()), reverse=True)
    kept, removed, now = {True: 0, False: 0}, 0, time.time()
    for start in range(0, len(numbers), PART):
        part = numbers[start : start + PART]
        known = ledger.attempts(part)
        for number in part:
            if stopping is not None and stopping.is_set():
                return removed
            status, attempt, ended = known.get(number, ("unknown", 0, None))
            if status not in FINAL or ended is None:
                continue
            good = status == "done"
            days, most = (keep.days, keep.count) if good else (keep.failed_days, keep.failed_count)
            if kept[good] < most and now - ended < days * DAY:
                kept[good] += 1
            else:
                removed += _remove(jobs_folder / str(number), attempt)
    if removed:
        _log.info("the folders of %d ended jobs were removed", removed)
    return removed


def _names(folder: Path) -> list[str]:
    try:
        return os.listdir(folder)  # noqa: PTH208 (a list of 10**5 names, no 10**5 paths)
    except OSError:
        return []


def _remove(folder: Path, attempt: int) -> bool:
    """Remove a job's attempts up to one; later ones, of a reopened job, stay."""
    for name in _names(folder):
        number = name.partition(".")[0]  # "2.old-..." is of an earlier ledger
        if number.isdecimal() and int(number) <= attempt:
            shutil.rmtree(folder / name, ignore_errors=True)
    try:
        folder.rmdir()
    except OSError:
        return False
    return True
