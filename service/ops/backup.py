"""Backups of a data directory in use: one zip whose last entry has the digest of every other.

A zip's index is its end, so that a truncated file is recognised at once. Changed content is
recognised by the digests, which are compared after a backup is written and again before it is
restored.
"""

from __future__ import annotations

import json
import os
import re
import secrets
import tempfile
import time
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, field
from hashlib import blake2b
from importlib.metadata import version
from pathlib import Path
from typing import IO, Any

from wrenchbook.service.files.durable import sync
from wrenchbook.service.ledger import Ledger, LedgerError, earlier
from wrenchbook.service.ledger.connection import with_remedy
from wrenchbook.service.ledger.schema import VERSION

FORMAT = "wrenchbook backup"
SCHEMA = 2  # version 1 had all files of the directory but attempts: keys and settings too
MANIFEST = "backup.json"
LEDGER = "ledger.sqlite"
PIECE = 1 << 20  # bytes in memory at once
TABLES = "tables"
_FOLDERS = ("components", "fields")
# Files in backups of release 0.3: the first start of the restored directory reads them.
_EARLIER_FILES = (earlier.CATALOGUE, earlier.DEMAND)
_EARLIER_FOLDERS = (earlier.SOLVER_ERRORS,)
# All files of a backup. Packed tables and reports are made again; keys and settings belong to the
# directory, attempts' folders to the server. Names of drafts begin with a dot.
HELD = re.compile(
    rf"{'|'.join(map(re.escape, (LEDGER, *_EARLIER_FILES)))}|{TABLES}/(?!\.)[^/]+\.h5|"
    rf"(?:{'|'.join((*_FOLDERS, *_EARLIER_FOLDERS))})(?:/(?!\.)[^/]+)+"
)
# Errors of a damaged or changed file: of the manifest's members and numbers, and of zipfile, which
# raises RuntimeError for an encrypted entry or an unknown compression.
_BAD_MANIFEST = (KeyError, ValueError, TypeError, AttributeError, OverflowError)
_UNREADABLE = (*_BAD_MANIFEST, RuntimeError, EOFError, zipfile.BadZipFile)
_DAMAGED = "the backup is damaged and nothing was changed. Use another one"


class BackupError(RuntimeError):
    """A backup that cannot be made or used; the message has the cause and the remedy."""


@dataclass(frozen=True)
class Manifest:
    """The contents of a backup; lengths and digests by the files' paths in the data directory."""

    created: float  # seconds since the epoch
    ledger_schema: int
    files: Mapping[str, tuple[int, str]] = field(default_factory=dict)
    program: str = field(default_factory=lambda: version("wrenchbook"))
    format: str = FORMAT
    schema: int = SCHEMA
    skipped: tuple[str, ...] = ()  # files of an earlier version that are not restored: keys
    state: Mapping[str, Any] = field(default_factory=dict)  # facts of a replica's manifest


def back_up(folder: Path, target: Path) -> Manifest:
    """Write all files of a data directory that cannot be rebuilt into one file, while it is used.

    Tables are copied before the ledger, so that none in the backup is newer than it, and the
    library after it, so that no row is without its component. The backup is read again and compared
    before the file gets its name. Only a complete backup replaces an existing file.

    Raises BackupError if there is nothing to back up, the ledger is damaged, the name of a file is
    not UTF-8, or the file cannot be written.
    """
    folder, target = folder.absolute(), target.absolute()
    if not (folder / LEDGER).is_file():
        raise BackupError(
            f"{folder} has no {LEDGER}, so it is no data directory; name one with --data"
        )
    root = folder.resolve()
    real = target.resolve()
    if real.is_relative_to(root) and HELD.fullmatch(real.relative_to(root).as_posix()):
        problem = f"{target} is among the files to back up, so each backup would hold the last"
        raise BackupError(f"{problem}. Name a file outside of {folder}. No backup was made")
    if target.exists() and not target.is_file():
        raise BackupError(f"{target} is no regular file; name a file. No backup was made")

    target = real  # the file that a symbolic link names
    draft = target.with_name(f".{target.name}.{secrets.token_hex(4)}.part")
    try:
        with (
            tempfile.TemporaryDirectory(prefix=".wrenchbook-", dir=target.parent) as scratch,
            os.fdopen(os.open(draft, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600), "w+b") as content,
            # Without compression: tables are digits that hardly shrink.
            zipfile.ZipFile(content, "w", zipfile.ZIP_STORED, allowZip64=True) as archive,
        ):
            created = time.time()
            files = _files(folder, Path(scratch) / LEDGER)
            manifest = Manifest(created, VERSION, _write_entries(files, archive))
            archive.writestr(MANIFEST, json.dumps(asdict(manifest)))
        manifest = verify(draft)
        sync(draft)
        draft.replace(target)
        sync(target.parent)
    except OSError as error:
        path = Path(str(error.filename))
        if path.is_relative_to(folder) and HELD.fullmatch(path.relative_to(folder).as_posix()):
            problem = f"{path} cannot be read: {error.strerror}; let this user read it"
        else:
            problem = f"{target} cannot be written: {with_remedy(error)}"
        raise BackupError(f"{problem}. No backup was made") from error
    except LedgerError as error:
        raise BackupError(f"no backup was made: {error}") from error
    finally:
        draft.unlink(missing_ok=True)
    return manifest


def _write_entries(
    files: Iterator[tuple[str, Path]], archive: zipfile.ZipFile
) -> dict[str, tuple[int, str]]:
    """Write files into an archive; return the length and digest of each."""
    written = {}
    for name, path in files:
        # From one open file: a table that is replaced meanwhile is the complete earlier one. A
        # draft that is gone by now is left out.
        with (
            suppress(FileNotFoundError),
            path.open("rb") as file,
            archive.open(name, "w", force_zip64=True) as entry,
        ):
            written[name] = _copy_hashed(file, entry)
    return written


def verify(source: Path) -> Manifest:
    """Read a backup and compare all files with their digests; raises BackupError."""
    return unpack(source, lambda _: Path(os.devnull).open("wb"))


def unpack(source: Path, place: Callable[[str], IO[bytes]]) -> Manifest:
    """Copy each file of a backup to the file that `place` opens, and compare its digest.

    Raises BackupError if the backup is damaged, of a newer format, of another user, or has a file
    that backups never have.
    """
    with ExitStack() as stack:
        archive, status = _open(source, stack)
        # Only its owner may read a backup; another user's backup was passed on.
        if status.st_uid not in (0, os.geteuid()):
            raise BackupError(
                f"{source} belongs to user {status.st_uid}, who may have changed it. If you trust "
                "it, copy it and restore the copy; nothing was changed"
            )
        # A small file cannot fill memory or disk: entries are neither compressed nor do they
        # overlap.
        entries = archive.infolist()
        unpacked = sum(entry.file_size for entry in entries)
        if unpacked > status.st_size or any(entry.compress_type for entry in entries):
            raise BackupError(
                f"{source} has compressed or overlapping entries ({unpacked:,} bytes in a file of "
                f"{status.st_size:,}), so it was changed. Nothing was restored; use another backup"
            )
        manifest = _manifest(archive, source)
        for name, expected in manifest.files.items():
            try:
                with archive.open(name) as file, place(name) as target:
                    copied = _copy_hashed(file, target)
            except _UNREADABLE as error:
                problem = f"{name} in {source} cannot be read ({error}); {_DAMAGED}"
                raise BackupError(problem) from error
            if copied != expected:
                raise BackupError(f"{name} in {source} has a wrong digest; {_DAMAGED}")
    return manifest


def _open(source: Path, stack: ExitStack) -> tuple[zipfile.ZipFile, os.stat_result]:
    """Open a backup until `stack` ends; return it and the status of the open file.

    Raises BackupError if it is unreadable.
    """
    try:
        file = stack.enter_context(source.open("rb"))
        return stack.enter_context(zipfile.ZipFile(file)), os.fstat(file.fileno())
    except FileNotFoundError:
        raise BackupError(f"the file {source} does not exist; give the path of a backup") from None
    except OSError as error:
        raise BackupError(
            f"{source} cannot be read: {error.strerror or error}; name a backup that this user may "
            "read"
        ) from error
    except _UNREADABLE as error:
        raise BackupError(
            f"{source} is no backup ({error}); name a file that wrenchbook backup wrote. If it is "
            "such a file, its writing or copying was cut off: use another one. Nothing was changed"
        ) from error


def reason_of(error: Exception) -> str:
    """Return the reason why a manifest cannot be read, without Python's own words."""
    if isinstance(error, KeyError):
        return f"the member {error} is missing"
    if isinstance(error, ValueError) and not isinstance(error, UnicodeDecodeError):
        return f"a value is invalid: {error}"
    return "a value is of another type or size"


def _manifest(archive: zipfile.ZipFile, source: Path) -> Manifest:
    """Return the manifest of the archive `source`; raises BackupError if it cannot be used."""
    try:
        fields: dict[str, Any] = json.loads(archive.read(MANIFEST))
        kind = fields["format"]
        schema = int(fields["schema"])
    except _UNREADABLE as error:
        problem = f"it has no {MANIFEST}"
        if MANIFEST in archive.namelist():
            problem = f"in its {MANIFEST} {reason_of(error)}"
        raise BackupError(f"{source} is a zip, but no backup: {problem}; name another") from error
    if kind != FORMAT:
        raise BackupError(
            f"{source} has the format {str(kind)[:60]!r}, not {FORMAT!r}; name another"
        )
    if schema > SCHEMA:
        raise BackupError(
            f"{source} was written by a newer wrenchbook ({fields.get('program')}, form {schema}; "
            f"this one reads up to {SCHEMA}). Install that version to restore it"
        )

    try:
        files = {str(name): (int(n), str(digest)) for name, (n, digest) in fields["files"].items()}
        created, ledger_schema = float(fields["created"]), int(fields["ledger_schema"])
        program = str(fields["program"])
    except _BAD_MANIFEST as error:
        problem = f"in its {MANIFEST} {reason_of(error)}"
        raise BackupError(f"{source} is damaged: {problem}; use another backup") from error

    restored = {name: content for name, content in files.items() if HELD.fullmatch(name)}
    skipped = tuple(files.keys() - restored.keys())
    outside = [name for name in skipped if name.startswith("/") or ".." in name.split("/")]
    if outside or (skipped and schema > 1):
        raise BackupError(
            f"{source} holds {(outside or skipped)[0]!r}, which no backup contains, so it was "
            "changed. Nothing was restored; use another backup"
        )
    if LEDGER not in restored:
        raise BackupError(f"{source} has no {LEDGER}, so it is no backup; name another file")
    return Manifest(
        created, ledger_schema, restored, program, schema=schema, skipped=tuple(sorted(skipped))
    )


def _copy_hashed(file: IO[bytes], target: IO[bytes]) -> tuple[int, str]:
    """Copy a file; return its length and digest."""
    length = 0
    digest = blake2b(digest_size=32)
    while piece := file.read(PIECE):
        target.write(piece)
        digest.update(piece)
        length += len(piece)
    return length, digest.hexdigest()


def _files(folder: Path, copy: Path) -> Iterator[tuple[str, Path]]:
    """Yield the files of a backup, and a copy of the ledger made at its turn."""

    def files_in(name: str) -> Iterator[tuple[str, Path]]:
        paths = sorted((folder / name).rglob("*"))
        for path in paths:
            path_name = path.relative_to(folder).as_posix()
            if path.is_file() and HELD.fullmatch(path_name):
                shown = os.fsencode(path_name).decode(errors="backslashreplace")
                if shown != path_name:
                    problem = f"the name of {shown} is not UTF-8, so no zip can have it; rename it"
                    raise BackupError(f"{problem}. No backup was made")
                yield path_name, path

    yield from files_in(TABLES)
    ledger = Ledger(folder / LEDGER)
    try:
        ledger.copy(copy)
    finally:
        ledger.close()
    yield LEDGER, copy
    for name in _FOLDERS:
        yield from files_in(name)
