"""Room on the disk and what may be written."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from service.ops.archive import LEDGER
from service.ops.findings import Finding

LITTLE_BYTES = 512 * 1024 * 1024  # a log of the ledger, a large table twice, some hundred attempts
FULL_BYTES = 1024 * 1024  # a commit's pages and an attempt's folder no longer fit


def is_full(folder: Path) -> bool:
    """Tell whether the disk has no room for another job; False where nobody can say."""
    try:
        return shutil.disk_usage(folder).free < FULL_BYTES
    except OSError:
        return False


def check_disk(folder: Path) -> list[Finding]:
    """Tell a disk that is nearly full, and files of the data directory that cannot be written."""
    found = []
    free = shutil.disk_usage(folder).free
    if free < LITTLE_BYTES:
        remedy = "make room; prune attempts' folders with serve --keep-days and --keep-count"
        found.append(Finding("fault", f"the disk has {free / 1e6:.0f} MB left", remedy))
    ledger = [folder / f"{LEDGER}{end}" for end in ("", "-wal", "-shm")]
    for path in (folder, *ledger, folder / "tables", folder / "components", folder / "jobs"):
        if path.exists() and not os.access(path, os.R_OK | os.W_OK):
            remedy = f"make it readable and writable for user {os.getuid()}, as the server runs"
            found.append(Finding("fault", f"{path} cannot be read and written", remedy))
    return found
