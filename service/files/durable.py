"""Making changes to a folder last."""

from __future__ import annotations

import os
from pathlib import Path


def sync_folder(folder: Path) -> None:
    """Return once the folder's entries, a file just renamed into it say, are on disk."""
    sync(folder)


def sync(path: Path) -> None:
    """Return once what a file holds, or the names in a folder, are on disk."""
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
