"""Locks that the kernel drops when their holder dies, whatever killed it.

A lock belongs to an open file, not to a pid: it passes to a child that inherits the file and
is gone when the last holder is, so a reused pid can never look alive.
"""

import fcntl
import os
import time
from pathlib import Path

# How long `take` tolerates the short shared lock that `is_locked` tests with.
_PATIENCE_SECONDS = 0.5


def take(path: Path, patience_s: float = _PATIENCE_SECONDS) -> int | None:
    """Lock the file (made if there is none) and return its descriptor; None if it is locked."""
    # Whoever may read a file may lock it, and so keep others from it.
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
