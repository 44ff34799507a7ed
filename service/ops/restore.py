"""Restore of a data directory from a backup: complete and verified, or no change."""

from __future__ import annotations

import os
import shutil
import time
from contextlib import suppress
from pathlib import Path
from typing import IO

from wrenchbook.service.files import lock
from wrenchbook.service.files.durable import sync, sync_tree
from wrenchbook.service.keys import FILE as KEYS
from wrenchbook.service.keys import USED
from wrenchbook.service.ledger import Ledger, LedgerError
from wrenchbook.service.ledger.connection import RESTORING, with_remedy
from wrenchbook.service.ops import replica
from wrenchbook.service.ops.backup import LEDGER, BackupError, Manifest, unpack, verify
from wrenchbook.service.tables.coordinator_state import FOLDER as SHARED
from wrenchbook.service.tables.coordinator_state import LOCK

# Keys and settings are no part of a backup: those of the directory stay after any restore.
_STAYS = (RESTORING, KEYS, f"{KEYS}.lock", USED, "wrenchbook.toml")


def restore(
    source: Path | str, folder: Path, *, overwrite: bool = False, until: float = float("inf")
) -> tuple[Manifest, Path | None]:
    """Restore a backup, or the newest state of a replica's URL `until` then (s), into a directory.

    The backup is verified first, and the restored files before they replace others. Keys and
    settings of the directory stay. Only their owner can read restored files. With `overwrite` the
    directory may have more than keys and settings: these files are moved aside, into the folder
    that is returned with the manifest.

    Raises BackupError if the backup is incomplete or too new, or the directory not empty, in use or
    not writable.
    """
    folder = folder.absolute()
    if isinstance(source, Path):
        verify(source)
    draft = folder / RESTORING
    aside = None
    state = "Nothing was changed"
    is_new = not folder.exists()
    try:
        folder.mkdir(0o700, parents=True, exist_ok=True)
        _check_free(folder, overwrite=overwrite)
        manifest = _unpacked(source, until, draft)

        present = _check_free(folder, overwrite=overwrite)  # a server may have started meanwhile
        if present:
            aside = folder / f".before-restore-{time.strftime('%Y%m%dT%H%M%SZ', time.gmtime())}"
            aside.mkdir(0o700)
            state = f"The restore is not complete. The former files are in {aside}"
            # The ledger and its log first: no program uses its files without it.
            for entry in sorted(present, key=lambda entry: not entry.name.startswith(LEDGER)):
                if not entry.name.startswith(".before-restore-"):
                    entry.rename(aside / entry.name)
        else:
            state = "The restore is not complete"
        for entry in sorted(draft.iterdir(), key=lambda entry: entry.name == LEDGER):
            entry.rename(folder / entry.name)
        sync(folder)

    except LedgerError as error:
        raise BackupError(
            f"the ledger in {source} cannot be used ({error}); use another backup"
        ) from error
    except OSError as error:
        raise BackupError(f"{folder} cannot be written: {with_remedy(error)}. {state}") from error
    finally:
        shutil.rmtree(draft, ignore_errors=True)
        if is_new:
            with suppress(OSError):  # the folder has the restored files
                folder.rmdir()
    return manifest, aside


def _unpacked(source: Path | str, until: float, draft: Path) -> Manifest:
    """Unpack a backup or a replica into a new folder that only its owner can read; verify it."""

    def place(name: str) -> IO[bytes]:
        path = draft / name
        path.parent.mkdir(parents=True, exist_ok=True)
        return os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb")

    shutil.rmtree(draft, ignore_errors=True)  # remains of an interrupted restore
    draft.mkdir(0o700)
    is_replica = isinstance(source, str)
    manifest = replica.unpack(source, place, until) if is_replica else unpack(source, place)
    for path in filter(Path.is_dir, draft.rglob("*")):
        path.chmod(0o700)
    Ledger(draft / LEDGER).close()  # verifies it and updates its schema
    sync_tree(draft)
    return manifest


def in_use(folder: Path) -> bool:
    """Return whether a server or a worker uses a data directory now."""
    owners = (folder / "jobs" / "owners").glob("*.lock")
    return any(lock.is_locked(file) for file in (*owners, folder / SHARED / LOCK))


def _check_free(folder: Path, *, overwrite: bool) -> list[Path]:
    """Return the files that a restore replaces; raises BackupError if it must not."""
    present = sorted(entry for entry in folder.iterdir() if entry.name not in _STAYS)
    if in_use(folder):
        raise BackupError(f"a server or worker uses {folder}; stop it first. Nothing was changed")
    if present and not overwrite:
        raise BackupError(
            f"{folder} is not empty ({present[0].name} and {len(present) - 1} more); name another "
            "directory, or add --overwrite to move its files aside. Nothing was changed"
        )
    return present
