"""Backups of a data directory in use: one zip whose last entry has the digest of every other.

A zip's index is its end, so a truncated file is found at once. Changed content is found by the
digests, which are compared once a backup is written and again before it is restored.
"""

from __future__ import annotations

import json
import os
import tempfile
import time
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from hashlib import blake2b
from importlib.metadata import version
from pathlib import Path, PurePosixPath
from typing import IO, Any

from wrenchbook.service.files.durable import sync, sync_folder
from wrenchbook.service.ledger import Ledger, LedgerError
from wrenchbook.service.ledger.versions import SCRIPTS
from wrenchbook.service.tables.coordinator_state import FOLDER as SHARED
from wrenchbook.surrogate.packed.format import SUFFIX

FORMAT = "wrenchbook backup"
SCHEMA = 1
MANIFEST = "backup.json"
LEDGER = "ledger.sqlite"
PIECE = 1 << 20  # bytes in memory at once
TABLES = "tables"
# Attempts' folders are work in progress and logs: accepted jobs and rows are in the ledger.
# Packed tables (`SUFFIX`) are built again from it.
_LEFT_OUT = ("jobs", TABLES, SHARED)
_DAMAGED = "the backup is damaged and nothing was changed. Take another one"


class BackupError(RuntimeError):
    """A backup that cannot be made or used; the text says why and what to do."""


@dataclass(frozen=True)
class Manifest:
    """The contents of a backup.

    Attributes
    ----------
    created : float
        Seconds since the epoch.
    ledger_schema : int
    files : dict of str to [int, str]
        Length and digest of each file, by its path in the data directory.
    """

    created: float
    ledger_schema: int
    files: Mapping[str, tuple[int, str]] = field(default_factory=dict)
    program: str = field(default_factory=lambda: version("wrenchbook"))
    format: str = FORMAT
    schema: int = SCHEMA


def back_up(folder: Path, target: Path) -> Manifest:
    """Write everything of a data directory that cannot be rebuilt into one file, while it is used.

    Tables are copied before the ledger, so that none in the backup is newer than it, and the
    library after it, so that no row is without its component. The backup is read again and
    compared before the file gets its name.

    Parameters
    ----------
    folder : path
        The data directory.
    target : path
        An existing file is replaced, but only by a complete backup.

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
            _write(draft, _files(folder, Path(scratch) / LEDGER, {draft, target}))
        manifest = verify(draft)
        draft.chmod(0o600)  # it holds everything
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
    """Read a backup and compare all files with their digests; raises BackupError."""
    return unpack(source, lambda _: Path(os.devnull).open("wb"))


def unpack(source: Path, place: Callable[[str], IO[bytes]]) -> Manifest:
    """Copy each file of a backup to the file that `place` opens, and compare its digest.

    Raises
    ------
    BackupError
        If the backup is damaged, of a newer format, or names files outside of a data directory.
    """
    try:
        archive = zipfile.ZipFile(source)
    except FileNotFoundError:
        raise BackupError(f"there is no file {source}") from None
    except (zipfile.BadZipFile, OSError) as error:
        raise BackupError(
            f"{source} is not a whole backup ({error}): its writing or copying was cut off. "
            "Take another one; nothing was changed"
        ) from error
    with archive:
        manifest = _manifest(archive, source)
        for name, expected in manifest.files.items():
            try:
                with archive.open(name) as file, place(name) as target:
                    found = _copied(file, target)
            except (KeyError, zipfile.BadZipFile, EOFError) as error:
                what = f"{name} in {source} cannot be read ({error}); {_DAMAGED}"
                raise BackupError(what) from error
            if found != expected:
                raise BackupError(f"{name} in {source} is not what was written; {_DAMAGED}")
    return manifest


def _manifest(archive: zipfile.ZipFile, source: Path) -> Manifest:
    try:
        fields: dict[str, Any] = json.loads(archive.read(MANIFEST))
        kind, schema = fields["format"], int(fields["schema"])
    except (KeyError, ValueError, TypeError, zipfile.BadZipFile) as error:
        raise BackupError(f"{source} is a zip, but no backup of wrenchbook ({error!r})") from error
    if kind != FORMAT or schema > SCHEMA:
        raise BackupError(
            f"{source} was written by a newer wrenchbook ({fields.get('program')}, form {schema}; "
            f"this one reads up to {SCHEMA}). Install that version to restore it"
        )
    try:
        files = {str(name): (int(n), str(digest)) for name, (n, digest) in fields["files"].items()}
        manifest = Manifest(fields["created"], int(fields["ledger_schema"]), files)
    except (KeyError, ValueError, TypeError, AttributeError) as error:
        raise BackupError(f"{source} does not say what is in it ({error!r})") from error
    if outside := [name for name in files if not _is_inside(name)]:
        raise BackupError(f"{source} names a file outside of a data directory: {outside[0]!r}")
    return manifest


def _is_inside(name: str) -> bool:
    path = PurePosixPath(name)
    relative = bool(path.parts) and not path.is_absolute()
    return relative and ".." not in path.parts and "\\" not in name


def _write(target: Path, files: Iterable[tuple[str, Path]]) -> None:
    """Write files in their order into a new backup; a draft that is gone by then is left out."""
    # Without compression: tables are digits that hardly shrink.
    with zipfile.ZipFile(target, "x", zipfile.ZIP_STORED, allowZip64=True) as archive:
        manifest, written = Manifest(time.time(), len(SCRIPTS)), {}
        for name, path in files:
            # From one open file: a table that is replaced meanwhile is the whole previous one.
            with (
                suppress(FileNotFoundError),
                path.open("rb") as file,
                archive.open(name, "w", force_zip64=True) as entry,
            ):
                written[name] = _copied(file, entry)
        archive.writestr(MANIFEST, json.dumps(asdict(replace(manifest, files=written))))


def _copied(file: IO[bytes], target: IO[bytes]) -> tuple[int, str]:
    """Copy a file; return its length and digest."""
    length, whole = 0, blake2b(digest_size=32)
    while piece := file.read(PIECE):
        target.write(piece)
        whole.update(piece)
        length += len(piece)
    return length, whole.hexdigest()


def _files(folder: Path, copy: Path, own: set[Path]) -> Iterator[tuple[str, Path]]:
    """Yield the files of a data directory, and a copy of the ledger made at its turn."""
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
    """Yield the files at a place except drafts, whose names begin with a dot."""
    for path in [place] if place.is_file() else sorted(place.rglob("*")):
        name = path.relative_to(folder)
        draft = any(part.startswith(".") for part in name.parts)
        if path.is_file() and not draft and path not in own:
            yield name.as_posix(), path
