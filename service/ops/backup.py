"""A backup of a data directory that is in use: one file, consistent, verified."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from service.files.durable import sync, sync_folder
from service.ledger import Ledger, LedgerError
from service.ledger.versions import SCRIPTS
from service.ops.archive import (
    LEDGER,
    BackupError,
    Manifest,
    copies,
    opened,
    read_manifest,
    write,
)
from service.tables.coordinator_state import FOLDER as SHARED
from surrogate.packed.format import SUFFIX

TABLES = "tables"
# Attempts' folders are work in progress and logs: what is accepted and solved is in the ledger.
# Packed tables (`SUFFIX`) are made anew from it.
_LEFT_OUT = ("jobs", TABLES, SHARED)


def back_up(folder: Path, target: Path) -> Manifest:
    """Write all of a data directory that cannot be made anew into one file, while it is in use.

    Tables are copied before the ledger, so that none in the backup is newer than it, and the
    library after it, so that no row is without its component. What was written is read again and
    compared before the file gets its name.

    Parameters
    ----------
    folder : path
        The data directory.
    target : path
        Replaced if there is one, but only by a whole backup.

    Raises
    ------
    BackupError
        If there is nothing to back up, the ledger is damaged, or the file cannot be written.
    """
    folder, target = folder.absolute(), target.absolute()
    if not (folder / LEDGER).is_file():
        raise BackupError(f"{folder} is no data directory: it has no {LEDGER}")
    draft = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        with tempfile.TemporaryDirectory(prefix=".wrenchbook-", dir=target.parent) as scratch:
            files = _files(folder, Path(scratch) / LEDGER, {draft, target})
            write(draft, files, Manifest(time.time(), len(SCRIPTS)))
        manifest = verify(draft)
        draft.chmod(0o600)  # it holds all there is
        sync(draft)
        draft.replace(target)
        sync_folder(target.parent)
    except OSError as error:
        raise BackupError(f"{target} cannot be written: {error}. No backup was made") from error
    except LedgerError as error:
        raise BackupError(f"no backup was made: {error}") from error
    finally:
        draft.unlink(missing_ok=True)
    return manifest


def verify(source: Path) -> Manifest:
    """Read a backup through and compare all of it with what it says; raises BackupError."""
    with opened(source) as archive:
        manifest = read_manifest(archive, source)
        for _ in copies(archive, manifest, source, _nowhere):
            pass
    return manifest


def _nowhere(_: str) -> BinaryIO:
    return Path(os.devnull).open("wb")


def _files(folder: Path, copy: Path, own: set[Path]) -> Iterator[tuple[str, Path]]:
    """Give the files of a data directory, each when its turn comes, with the ledger's copy."""
    tables = _in(folder / TABLES, folder, own)
    yield from (found for found in tables if found[1].suffix != SUFFIX)
    ledger = Ledger(folder / LEDGER)
    try:
        ledger.copy(copy)
    finally:
        ledger.close()
    yield LEDGER, copy
    for entry in sorted(folder.iterdir()):
        if entry.name not in _LEFT_OUT and not entry.name.startswith((LEDGER, ".")):
            yield from _in(entry, folder, own)


def _in(place: Path, folder: Path, own: set[Path]) -> Iterator[tuple[str, Path]]:
    """Give the files at a place, but drafts: their names begin with a dot."""
    for path in [place] if place.is_file() else sorted(place.rglob("*")):
        name = path.relative_to(folder)
        draft = any(part.startswith(".") for part in name.parts)
        if path.is_file() and not draft and path not in own:
            yield name.as_posix(), path
