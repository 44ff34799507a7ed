"""A folder for the temporary files of a process, removed after its end.

A killed process removes nothing, but its lock is free then, and the next process removes its
folder.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Final

from wrenchbook.service.files.lock import is_locked

PREFIX: Final = "wrenchbook-web-"


def take_scratch() -> Path:
    """Return a new folder that `tempfile` uses from now on, locked until this process ends.

    Folders of ended processes are removed. The lock is on the folder itself: services that remove
    old files (systemd-tmpfiles) leave such folders alone.
    """
    parent = Path(tempfile.gettempdir())
    for folder in parent.glob(f"{PREFIX}*"):
        with suppress(OSError):  # another user's folder, or removed meanwhile
            if not is_locked(folder):
                shutil.rmtree(folder, ignore_errors=True)
    draft = Path(tempfile.mkdtemp(prefix=f".{PREFIX}"))
    fcntl.flock(os.open(draft, os.O_RDONLY), fcntl.LOCK_EX)
    folder = draft.rename(parent / draft.name[1:])  # locked before another process can see it
    tempfile.tempdir = str(folder)
    return folder
