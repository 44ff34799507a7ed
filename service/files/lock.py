"""Locks that the kernel releases when their holder ends, for any reason.

A lock belongs to an open file, not to a pid: it passes to a child that inherits the file and is
gone with the last holder, so that a reused pid is never taken for the holder.
"""

import fcntl
import os
import time
from pathlib import Path

_PATIENCE_SECONDS = 0.5  # for which `take` waits for the short shared lock of `is_locked`


def take(path: Path, patience_s: float = _PATIENCE_SECONDS) -> int | None:
    """Lock the file (made if missing) and return its descriptor; None if it is locked."""
    # Every process that may read a file may lock it, and so block others.
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    deadline = time.monotonic() + patience_s
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return descriptor
        except BlockingIOError:
            if time.monotonic() > deadline:
                os.close(descriptor)
                return None
        time.sleep(0.01)


def is_locked(path: Path) -> bool:
    """Return whether a process has the lock; a file that is missing is not locked."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except (FileNotFoundError, NotADirectoryError):
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(descriptor)
    return False
