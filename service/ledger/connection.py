"""The ledger's SQLite file: opening, checking, upgrading and copying it, and its errors.

This is the only file that imports sqlite3. WAL with ``synchronous=FULL``: a transaction that has
returned survives a power failure.
"""

import errno
import logging
import os
import sqlite3
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from wrenchbook.service.files.durable import NO_ROOM, sync
from wrenchbook.service.ledger import earlier
from wrenchbook.service.ledger.packing import KEY_BYTES, Record, key_hashes
from wrenchbook.service.ledger.records import (
    JobRecord,
    LedgerDamagedError,
    LedgerFileError,
    LedgerFullError,
    LedgerUnavailableError,
)
from wrenchbook.service.ledger.schema import APPLICATION_ID, STEPS, TABLES, VERSION

_log = logging.getLogger(__name__)

# Errors of a file in use; damaged text may not be UTF-8.
USE_ERRORS = (sqlite3.Error, UnicodeDecodeError)

_REMEDIES = {
    **NO_ROOM,
    **dict.fromkeys(
        (errno.EACCES, errno.EPERM),
        "make its folder and files writable for the user of the server",
    ),
    errno.EROFS: "its disk is read-only: remount it writable (dmesg tells why the kernel changed "
    "it), or make the file writable for the user of the server",
    errno.EBUSY: "another program holds its lock: end that program (fuser FILE names it)",
    errno.EISDIR: "move the folder away, or name another data directory",
    errno.EIO: "its disk fails: read dmesg, and make a backup on another disk",
    errno.ENOLCK: "its file system has no locks left: start the lock service of the file server "
    "(NFS), or move the data directory to a local disk",
}
# Time for which a writer waits for another process: a bulk import takes seconds.
BUSY_SECONDS = 30.0
RETRY_SECONDS = 0.001  # pause between attempts: a tenth of a short transaction
# The log is moved into the file each 1000 pages (4 MB) unless a reader prevents it; a longer log,
# after a large import, is then truncated to this size.
LOG_BYTES = 16 * 1024 * 1024
RESTORING = ".restoring"  # folder of a restore within the data directory, which may be a mount


class Connection(sqlite3.Connection):
    """A connection of SQLite with the changes of its transaction, for the ledger's listeners."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.jobs: dict[int, JobRecord] = {}
        self.has_new_rows = False  # whether rows were added, withdrawn or restored
        # Damaged rows, with their component: the ledger's dictionary.
        self.damaged: dict[int, str] = {}


def can_be_read_frozen(path: Path) -> bool:
    """Return whether a ledger that cannot be opened for writing can be read without its log.

    SQLite then writes no files beside it, as needed on a full disk; so the log must be empty.
    """
    wal = path.with_name(f"{path.name}-wal")
    try:
        if not path.is_file() or (wal.exists() and wal.stat().st_size):
            return False
        connection = connect(path, frozen=True)
        try:
            return _check_schema(connection, path) == VERSION
        finally:
            connection.close()
    except (OSError, sqlite3.Error, UnicodeDecodeError, LedgerFileError):
        return False


def inode(path: Path) -> tuple[int, int]:
    """Return device and inode of a file; zeros if there is none."""
    try:
        status = path.stat()
    except OSError:
        return (0, 0)
    return status.st_dev, status.st_ino


def connect(path: Path, *, frozen: bool = False) -> Connection:
    """Open the file unchanged; with `frozen` only for reading, without files beside it."""
    connection = sqlite3.connect(
        f"{path.as_uri()}?immutable=1" if frozen else path,
        timeout=BUSY_SECONDS,
        isolation_level=None,
        check_same_thread=False,
        uri=frozen,
        factory=Connection,
    )
    try:
        # A damaged text must not prevent reading other rows.
        connection.text_factory = lambda word: word.decode("utf-8", "replace")
        connection.create_function("key_hash", 1, _key_hash, deterministic=True)
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute("PRAGMA foreign_keys = ON")
        connection.execute(f"PRAGMA journal_size_limit = {LOG_BYTES}")
    except BaseException:
        connection.close()
        raise
    return connection


def _key_hash(key: object) -> int:
    """Return the hash of a row's key in `row_keys`; 0 for a damaged key."""
    if not isinstance(key, bytes) or len(key) != KEY_BYTES:
        return 0
    return int(key_hashes(key)[0])


def begin(connection: Connection, statement: str = "BEGIN IMMEDIATE") -> None:
    """Begin a writing transaction, or execute another statement, once no other process writes.

    SQLite itself retries after up to 100 ms, by which time the next transaction of an import has
    begun.
    """
    deadline = time.monotonic() + BUSY_SECONDS
    connection.execute("PRAGMA busy_timeout = 0")
    try:
        while True:
            try:
                connection.execute(statement)
                return
            except sqlite3.OperationalError as error:
                busy = error.sqlite_errorcode & 0xFF == sqlite3.SQLITE_BUSY
                if not busy or time.monotonic() > deadline:
                    raise
            time.sleep(RETRY_SECONDS)
    finally:
        connection.execute(f"PRAGMA busy_timeout = {round(1000 * BUSY_SECONDS)}")


def unfinished_restore(path: Path) -> str:
    """Return the text on a restore that has not put the ledger `path` in place, with a remedy."""
    folder = path.parent
    if path.exists() or not (folder / RESTORING).exists():
        return ""
    return (
        f"a restore into {folder} was interrupted, or is running: {RESTORING} is there, but no "
        f"{path.name}. Repeat it with: wrenchbook restore FILE --overwrite --data {folder}; its "
        "former files, if there were any, are in .before-restore-*"
    )


def open_file(path: Path) -> Connection:
    """Open an intact ledger, or a new one, and upgrade its schema.

    Raises LedgerFileError if the file is foreign, damaged or of a newer schema, or cannot be
    written.
    """
    log = path.with_name(f"{path.name}-wal")
    try:
        path.parent.mkdir(0o700, parents=True, exist_ok=True)
        if path.is_dir():
            # SQLite would delete the log with its content.
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        lost = not path.exists() or path.stat().st_size == 0
        if lost and log.exists() and log.stat().st_size:
            # SQLite would delete the log, and with it what it holds.
            raise LedgerFileError(
                f"{log.name} is there, but {path} was moved or deleted; nothing was changed. Put "
                f"{path.name} back; if it is lost, create it from the tables with: wrenchbook "
                f"doctor --repair --data {path.parent}"
            )
        if problem := unfinished_restore(path):
            raise LedgerFileError(problem)
        with suppress(FileExistsError):
            os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600))
        # Earlier versions let everybody read it. A group that was let in stays.
        for file in (path, log, path.with_name(f"{path.name}-shm")):
            with suppress(OSError):
                if file.stat().st_mode & 0o007:
                    file.chmod(0o600)
        connection = connect(path)
        try:
            _check_schema(connection, path)
            check_integrity(connection, path)
            begin(connection, "PRAGMA journal_mode = WAL")  # SQLite itself does not wait here
            _upgrade(connection)
            _move_files_into(connection, path.parent)
        except BaseException:
            connection.close()
            raise
    except (sqlite3.OperationalError, OSError) as error:
        default = "check that its folder is writable and its disk has space"
        remedy = _REMEDIES.get(_errno_of(error), default)
        raise LedgerFileError(f"the ledger {path} cannot be opened: {error}; {remedy}") from error
    except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
        raise damaged_file(path, str(error)) from error
    sync(path.parent)
    return connection


def _check_schema(connection: Connection, path: Path) -> int:
    """Return the schema's version.

    Raises LedgerFileError if this program cannot read it.
    """
    owner, version = (
        connection.execute(f"PRAGMA {name}").fetchone()[0]
        for name in ("application_id", "user_version")
    )
    tables = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]
    if tables and owner != APPLICATION_ID:
        raise LedgerFileError(
            f"{path} is a SQLite file of another program, not a ledger; name another data "
            "directory (--data), or move the file away"
        )
    if version > VERSION:
        raise LedgerFileError(
            f"{path} was written by a newer wrenchbook (schema {version}; this program reads up to "
            f"{VERSION}); install that version or name another data directory (--data)"
        )
    if tables and version != VERSION and version not in STEPS:
        raise LedgerFileError(
            f"{path} was written before wrenchbook 0.2 (schema {version}). Start version 0.2 once "
            "on this data directory to update it, then this version"
        )
    return version


def check_integrity(connection: Connection, path: Path) -> None:
    """Refuse a damaged file: new content in it may be lost at the next start.

    Of 300 ledgers with one to six random bytes changed, ``quick_check`` accepted 11 that had lost
    acknowledged content, this check none: it compares indices with their tables too. Keys of rows
    follow from the rows; wrong ones are written again.

    Raises LedgerDamagedError if the file is damaged.
    """
    answer = connection.execute("PRAGMA integrity_check(1)").fetchone()[0]
    if answer != "ok":
        raise damaged_file(path, answer)
    try:
        connection.execute("BEGIN")
        if _keys_fit(connection):
            return
        connection.execute("ROLLBACK")
        connection.execute("BEGIN IMMEDIATE")
        if not _keys_fit(connection):  # otherwise another process has written them meanwhile
            entered = np.array(connection.execute("SELECT seq FROM row_keys").fetchall(), np.int64)
            spans = [
                np.arange(seq, seq + count)
                for seq, count in connection.execute("SELECT seq, count FROM rows")
            ]
            gone = ~np.isin(entered, np.concatenate([np.empty(0, np.int64), *spans]))
            if gone.any():
                raise damaged_file(path, f"{int(gone.sum())} rows that have keys are not there")
            _log.error("%s: keys of rows are damaged; they are written anew from the rows", path)
            _write_keys(connection)
            connection.execute("COMMIT")
    except (TypeError, ValueError) as error:  # calculations with a text
        raise damaged_file(path, "the number, count or key of a row is not a number") from error
    finally:
        if connection.in_transaction:
            connection.execute("ROLLBACK")


def _keys_fit(connection: Connection) -> bool:
    """Return whether `row_keys` has the keys of all rows, by a comparison of sums.

    A row whose key is missing would be inserted again.
    """
    # Rows of a running import have no entries yet.
    hidden = "SELECT 1 FROM import_parts WHERE hidden = 1"
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    if version != VERSION or connection.execute(hidden).fetchone():
        return True
    # Both halves of a hash separately: sums of 64-bit numbers would overflow.
    low = 0xFFFF_FFFF
    sums = f"count(*), sum(hash >> 32), sum(hash & {low}), sum(seq)"
    entered = connection.execute(f"SELECT {sums} FROM row_keys").fetchone()
    present = [0, 0, 0, 0]
    for hashes, seqs in _entries(connection):
        halves = int((hashes >> 32).sum()), int((hashes & low).sum())
        parts = len(hashes), *halves, int(seqs.sum())
        present = [total + part for total, part in zip(present, parts, strict=True)]
    return [number or 0 for number in entered] == present


def _entries(connection: Connection) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the entries that `row_keys` should have, hashes (n,) and numbers (n,), in pieces.

    Records with more or fewer keys than rows are left out.
    """
    records = connection.execute("SELECT seq, count, key FROM rows")
    while some := records.fetchmany(1000):
        sound = [
            (seq, count, key)
            for seq, count, key in some
            if isinstance(key, bytes) and len(key) == KEY_BYTES * count
        ]
        seqs = [np.empty(0, np.int64), *(np.arange(seq, seq + count) for seq, count, _ in sound)]
        yield key_hashes(b"".join(key for *_, key in sound)), np.concatenate(seqs)


def _write_keys(connection: Connection) -> None:
    """Write the keys of damaged records again, where the seal confirms them, and `row_keys`."""
    records = map(Record._make, connection.execute(f"SELECT {', '.join(Record._fields)} FROM rows"))
    pairs = ((record, record.rekeyed()) for record in records)
    damaged = [(sound.key, sound.seq) for record, sound in pairs if sound is not record]
    connection.executemany("UPDATE rows SET key = ? WHERE seq = ?", damaged)
    connection.execute("DELETE FROM row_keys")
    none = np.empty(0, np.int64)
    hashes, seqs = map(np.concatenate, zip((none, none), *_entries(connection), strict=True))
    order = np.argsort(hashes)
    entries = zip(hashes[order].tolist(), seqs[order].tolist(), strict=True)
    connection.executemany("INSERT INTO row_keys VALUES (?, ?)", entries)


def damaged_file(path: Path, why: str) -> LedgerDamagedError:
    """Return the error of a damaged file."""
    return LedgerDamagedError(
        f"the ledger {path} is damaged ({why}). It stays unchanged, and tables answer from their "
        "files. Stop the server and put back a copy, or rebuild what can be read with: wrenchbook "
        f"doctor --repair --data {path.parent}"
    )


def with_remedy(error: Exception) -> str:
    """Return an error's text, with the remedy if the disk is the cause."""
    remedy = _REMEDIES.get(getattr(error, "errno", None) or 0)
    return f"{error}; {remedy}" if remedy else str(error) or repr(error)


def is_damage(error: Exception) -> bool:
    """Return whether an error is that of a damaged file; damaged text may not be UTF-8."""
    code = getattr(error, "sqlite_errorcode", 0) & 0xFF  # the other bits are details
    return isinstance(error, UnicodeDecodeError) or code in (
        sqlite3.SQLITE_CORRUPT,
        sqlite3.SQLITE_NOTADB,
    )


def _errno_of(error: Exception) -> int:
    """Return the number of a disk's error; for SQLite's errors the one with the same remedy."""
    code = getattr(error, "sqlite_errorcode", 0)
    if code == sqlite3.SQLITE_IOERR_WRITE:
        return errno.ENOSPC
    numbers = {
        sqlite3.SQLITE_FULL: errno.ENOSPC,
        sqlite3.SQLITE_READONLY: errno.EROFS,
        sqlite3.SQLITE_IOERR: errno.EIO,
        sqlite3.SQLITE_BUSY: errno.EBUSY,
        sqlite3.SQLITE_CANTOPEN: errno.EACCES,
    }
    # The low byte is the error; the other bits are details (sqlite.org/rescode.html).
    return numbers.get(code & 0xFF, getattr(error, "errno", None) or 0)


def unavailable(path: Path, error: Exception) -> LedgerUnavailableError:
    """Return the ledger's error for an error of SQLite or the disk, with cause and remedy."""
    number = _errno_of(error)
    remedy = _REMEDIES.get(number, "check that its disk has space and is writable")
    kind = LedgerFullError if number in NO_ROOM else LedgerUnavailableError
    return kind(
        f"the ledger {path} could not be used: {error}. Nothing was changed; {remedy}, "
        "then ask again"
    )


def _upgrade(connection: Connection) -> None:
    """Bring the tables to the present schema, without a write if they have it already."""

    def version() -> int:
        return connection.execute("PRAGMA user_version").fetchone()[0]

    if version() == VERSION:
        return  # without a write, so that a ledger on a full disk can be read
    connection.execute("BEGIN IMMEDIATE")
    while (before := version()) != VERSION:  # another process may have upgraded it meanwhile
        after, script = STEPS[before] if before else (VERSION, TABLES)
        for statement in filter(str.strip, script.split(";\n")):  # a trigger has ";" within a line
            connection.execute(statement)
        connection.execute(f"PRAGMA user_version = {after}")
    connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
    connection.execute("COMMIT")


def _move_files_into(connection: Connection, folder: Path) -> None:
    """Store the state that release 0.3 had in files of the folder; existing entries stay."""
    entries, read = earlier.read_files(folder)
    if not read:
        return
    connection.execute("BEGIN IMMEDIATE")
    for table, values in entries:
        marks = ", ".join("?" * len(values))
        connection.execute(f"INSERT OR IGNORE INTO {table} VALUES ({marks})", values)
    connection.execute("COMMIT")
    earlier.remove_files(folder, read)


def sequences(connection: Connection) -> dict[str, int]:
    """Return the highest numbers used, by table."""
    return dict(connection.execute("SELECT name, seq FROM sqlite_sequence").fetchall())


def raise_sequences(connection: Connection, numbers: dict[str, int]) -> None:
    """Raise the sequences so that no number is used again."""
    connection.execute("BEGIN IMMEDIATE")
    used = sequences(connection)
    for name, number in numbers.items():
        connection.execute("DELETE FROM sqlite_sequence WHERE name = ?", (name,))
        highest = max(number, used.get(name, 0))
        connection.execute("INSERT INTO sqlite_sequence VALUES (?, ?)", (name, highest))
    connection.execute("COMMIT")
