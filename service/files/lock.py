"""File locks that the kernel releases when their holder ends, for any reason.

A lock belongs to an open file, not to a pid: it passes to a child that inherits the file and is
gone with the last holder, so that a reused pid is never taken for the holder.
"""

import fcntl
import os
import time
from pathlib import Path

_PATIENCE_SECONDS = 0.5  # for which `take` waits, as `is_locked` has a shared lock for a moment
_RETRY_SECONDS = 0.01


def take(path: Path, patience_s: float = _PATIENCE_SECONDS) -> int | None:
    """Lock the file, made if missing, and return its descriptor; None if it stays locked."""
    # No access for other users: a process that may read a file may lock it, and so block others.
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
        time.sleep(_RETRY_SECONDS)


def is_locked(path: Path) -> bool:
    """Return whether a process has the lock; a missing file is not locked."""
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
