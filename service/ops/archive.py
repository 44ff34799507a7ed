"""The file of a backup: a zip whose last entry tells the digest of every other.

A zip's index is its end, so a file that was cut off is told at once; what was changed inside is
told by the digests, which are compared once a backup is written and again before it is restored.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from hashlib import blake2b
from importlib.metadata import version
from pathlib import Path, PurePosixPath
from typing import IO, Any

FORMAT = "wrenchbook backup"
SCHEMA = 1
MANIFEST = "backup.json"
LEDGER = "ledger.sqlite"
PIECE = 1 << 20  # bytes in memory at once


class BackupError(RuntimeError):
    """A backup that cannot be made or used; the text says why and what to do."""


@dataclass(frozen=True)
class Manifest:
    """What a backup says of itself.

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


def write(target: Path, files: Iterable[tuple[str, Path]], manifest: Manifest) -> Manifest:
    """Write files, one after the other as they are given, into a new backup.

    One that is gone when its turn comes is left out: a draft that got its name, or none.
    """
    # Stored, not squeezed: tables are digits that hardly shrink, and a backup should be quick.
    with zipfile.ZipFile(target, "x", zipfile.ZIP_STORED, allowZip64=True) as archive:
        told: dict[str, tuple[int, str]] = {}
        for name, path in files:
            with suppress(FileNotFoundError):
                told[name] = _add(archive, name, path)
        manifest = replace(manifest, files=told)
        archive.writestr(MANIFEST, json.dumps(asdict(manifest)))
    return manifest


def read_manifest(archive: zipfile.ZipFile, source: Path) -> Manifest:
    """Return what a backup says of itself.

    Raises
    ------
    BackupError
        If it is no backup, of a newer form, or names files outside of a data directory.
    """
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
    if strange := [name for name in files if not _is_inside(name)]:
        raise BackupError(f"{source} names a file outside of a data directory: {strange[0]!r}")
    return manifest


def opened(source: Path) -> zipfile.ZipFile:
    """Open a backup.

    Raises
    ------
    BackupError
        If it is not whole.
    """
    try:
        return zipfile.ZipFile(source)
    except FileNotFoundError:
        raise BackupError(f"there is no file {source}") from None
    except (zipfile.BadZipFile, OSError) as error:
        raise BackupError(
            f"{source} is not a whole backup ({error}): its writing or copying was cut off. "
            "Take another one; nothing was changed"
        ) from error


def copies(
    archive: zipfile.ZipFile, manifest: Manifest, source: Path, place: Callable[[str], IO[bytes]]
) -> Iterator[str]:
    """Copy each file to where `place` says, and give its name once its digest is as it should be.

    Raises
    ------
    BackupError
        If one is missing or not what was written.
    """
    for name, (length, digest) in manifest.files.items():
        try:
            with archive.open(name) as file, place(name) as target:
                found = _copied(file, target)
        except (KeyError, zipfile.BadZipFile, EOFError) as error:
            raise BackupError(f"{name} in {source} cannot be read ({error}); {_DAMAGED}") from error
        if found != (length, digest):
            raise BackupError(f"{name} in {source} is not what was written; {_DAMAGED}")
        yield name


_DAMAGED = "the backup is damaged and nothing was changed. Take another one"


def _add(archive: zipfile.ZipFile, name: str, path: Path) -> tuple[int, str]:
    # From one open file: a table that is replaced meanwhile is still the whole one before.
    with path.open("rb") as file, archive.open(name, "w", force_zip64=True) as target:
        return _copied(file, target)


def _copied(file: IO[bytes], target: IO[bytes]) -> tuple[int, str]:
    length, whole = 0, blake2b(digest_size=32)
    while piece := file.read(PIECE):
        target.write(piece)
        whole.update(piece)
        length += len(piece)
    return length, whole.hexdigest()


def _is_inside(name: str) -> bool:
    path = PurePosixPath(name)
    return (
        bool(path.parts) and not path.is_absolute() and ".." not in path.parts and "\\" not in name
    )
