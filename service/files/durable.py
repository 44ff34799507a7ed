"""Durable and atomic writes of files and folders."""

from __future__ import annotations

import errno
import os
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Final

# Errors of a write without room, with the remedy of each.
NO_ROOM: Final = {
    errno.ENOSPC: "make room on its disk",
    errno.EDQUOT: "raise the disk quota of the server's user, or remove some of its files",
    errno.EFBIG: "raise the limit of file sizes of the server's process (ulimit -f)",
}


def sync(path: Path) -> None:
    """Return once a file's content, or a folder's names after a rename into it, are on disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_tree(folder: Path) -> None:
    """Return once every file in a folder, and every folder in it, is on disk."""
    for path in folder.rglob("*"):
        sync(path)
    sync(folder)


def write_atomically(
    path: Path, content: bytes, *, durable: bool = True, mode: int = 0o666
) -> None:
    """Write a file such that readers see its complete content, or the earlier content.

    Unless `durable` is false, the content survives a power failure once this returns.
    """
    partial = path.with_name(f".{path.name}.{os.getpid()}.{threading.get_ident()}")
    try:
        descriptor = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, mode)
        with open(descriptor, "wb") as file:  # noqa: PTH123 (a descriptor)
            file.write(content)
            if durable:
                file.flush()
                os.fsync(descriptor)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
    if durable:
        sync(path.parent)


def interrupted_writes(folder: Path) -> Iterator[Path]:
    """Yield the partial files that writes into a folder left, by processes that have ended."""
    for path in folder.glob(".*.*.*"):  # .name.process.thread
        process, thread = path.name.split(".")[-2:]
        if process.isdecimal() and thread.isdecimal() and not is_running(int(process)):
            yield path


def is_running(process: int) -> bool:
    """Return whether a process of this machine, of any user, is running."""
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):  # no process has a number above 2^31
        return False
    except PermissionError:  # another user's
        return True
    return True
