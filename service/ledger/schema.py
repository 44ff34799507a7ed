"""The ledger's SQLite file: its schema, its connections, its transactions.

The one file that imports sqlite3. WAL with ``synchronous=FULL``: when a transaction has
returned, it survives a power cut.
"""

import sqlite3
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from service.files.durable import sync_folder
from service.ledger.errors import LedgerError, LedgerFileError, LedgerUnavailableError

Connection = sqlite3.Connection

APPLICATION_ID = 0x77726E63  # "wrnc": tells a ledger from other programs' SQLite files
BUSY_SECONDS = 30.0

# One script a schema version; a file of version n has the first n of them.
SCRIPTS = (
    """
    CREATE TABLE jobs (
        id INTEGER PRIMARY KEY AUTOINCREMENT,
        component TEXT NOT NULL,
        fingerprint TEXT NOT NULL,
        wrench BLOB NOT NULL CHECK (length(wrench) = 48),
        status TEXT NOT NULL
            CHECK (status IN ('waiting', 'running', 'done', 'failed', 'cancelled')),
        priority INTEGER NOT NULL,
        attempt INTEGER NOT NULL,
        lost INTEGER NOT NULL,
        owner TEXT CHECK ((owner IS NOT NULL) = (status = 'running')),
        created REAL NOT NULL,
        started REAL,
        finished REAL,
        error TEXT CHECK ((error IS NOT NULL) = (status = 'failed')),
        row INTEGER UNIQUE REFERENCES rows (seq)
            CHECK ((row IS NOT NULL) = (status = 'done')),
        UNIQUE (component, fingerprint, wrench)
    );
    CREATE INDEX jobs_in_order ON jobs (status, priority DESC, id);
    CREATE INDEX jobs_of_component ON jobs (component, status);
    CREATE TABLE rows (
        seq INTEGER PRIMARY KEY AUTOINCREMENT,
        component TEXT NOT NULL,
        fingerprint TEXT NOT NULL,
        source TEXT NOT NULL,
        wrench BLOB NOT NULL CHECK (length(wrench) = 48),
        displacement BLOB NOT NULL CHECK (length(displacement) = 48),
        compliance BLOB CHECK (length(compliance) = 288),
        uncertainty BLOB CHECK (length(uncertainty) = 48),
        job INTEGER UNIQUE REFERENCES jobs (id),
        created REAL NOT NULL,
        origin TEXT NOT NULL,
        key BLOB NOT NULL UNIQUE
    );
    CREATE INDEX rows_of_component ON rows (component, seq);
    """,
    "ALTER TABLE jobs ADD COLUMN asked_by TEXT NOT NULL DEFAULT ''",
)


class Connections:
    """One writing connection, as many reading ones as are in use, one to watch for changes.

    Readers never wait for the writer (WAL); writers of this process wait for each other here
    and for other processes in SQLite.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._closed = False
        self._write_lock = threading.Lock()
        self._watch_lock = threading.Lock()
        self._idle: list[Connection] = []
        self._writer = _open(path)
        self._watcher = _connect(path)

    @contextmanager
    def writing(self, *, keep: bool = True) -> Iterator[Connection]:
        """Give the writing connection in a transaction that is committed at the end.

        Parameters
        ----------
        keep : bool
            False tries the transaction and takes it back.

        Raises
        ------
        LedgerUnavailableError
            If SQLite could not write or commit; nothing of the transaction is kept.
        """
        with self._write_lock, _named_errors(self._path):
            self._check_open()
            self._writer.execute("BEGIN IMMEDIATE")
            try:
                yield self._writer
                self._writer.execute("COMMIT" if keep else "ROLLBACK")
            except BaseException:
                if self._writer.in_transaction:
                    self._writer.execute("ROLLBACK")
                raise

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """Give a reading connection; each statement sees the latest committed state."""
        with _named_errors(self._path):
            self._check_open()
            try:
                connection = self._idle.pop()
            except IndexError:
                connection = _connect(self._path)
            try:
                yield connection
            finally:
                self._keep(connection)

    def version(self) -> int:
        """Return a number that changes with every commit of any process (microseconds)."""
        with self._watch_lock, _named_errors(self._path):
            self._check_open()
            return self._watcher.execute("PRAGMA data_version").fetchone()[0]

    def close(self) -> None:
        """Close all connections; one in use is closed when it comes back."""
        with self._write_lock, self._watch_lock:
            if self._closed:
                return
            self._closed = True
            for connection in (self._watcher, *self._idle, self._writer):
                connection.close()
            self._idle.clear()

    def _keep(self, connection: Connection) -> None:
        self._idle.append(connection)
        if self._closed:
            while self._idle:
                self._idle.pop().close()

    def _check_open(self) -> None:
        if self._closed:
            raise LedgerError("the ledger is closed")


@contextmanager
def _named_errors(path: Path) -> Iterator[None]:
    try:
        yield
    except sqlite3.Error as error:
        raise LedgerUnavailableError(
            f"the ledger {path} could not be used: {error}. Nothing was changed; "
            "see that its disk has space and is writable, then ask again"
        ) from error


def _connect(path: Path) -> Connection:
    connection = sqlite3.connect(
        path, timeout=BUSY_SECONDS, isolation_level=None, check_same_thread=False
    )
    try:
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute("PRAGMA foreign_keys = ON")
    except BaseException:
        connection.close()
        raise
    return connection


def _open(path: Path) -> Connection:
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        connection = _connect(path)
        try:
            _check_file(connection, path)
            _use_wal(connection)
            _upgrade(connection)
        except BaseException:
            connection.close()
            raise
    except sqlite3.OperationalError as error:
        raise LedgerFileError(
            f"cannot open the ledger {path}: {error}. See that its folder is writable, "
            "its disk has space and no program keeps it locked"
        ) from error
    except sqlite3.DatabaseError as error:
        raise LedgerFileError(
            f"cannot read {path} as a ledger: {error}. Move it away to start an empty one, "
            "or put back a copy"
        ) from error
    sync_folder(path.parent)
    return connection


def _check_file(connection: Connection, path: Path) -> None:
    owner = connection.execute("PRAGMA application_id").fetchone()[0]
    tables = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    if tables and owner != APPLICATION_ID:
        raise LedgerFileError(
            f"{path} is a SQLite file of another program, not a ledger; "
            "name another data directory, or move the file away"
        )
    if version > len(SCRIPTS):
        raise LedgerFileError(
            f"{path} was written by a newer wrenchbook (schema {version}, this program knows "
            f"up to {len(SCRIPTS)}); install that version or name another data directory"
        )


def _use_wal(connection: Connection) -> None:
    # SQLite does not wait by itself when two processes switch the journal at the same time.
    deadline = time.monotonic() + BUSY_SECONDS
    while True:
        try:
            connection.execute("PRAGMA journal_mode = WAL")
            return
        except sqlite3.OperationalError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.01)


def _upgrade(connection: Connection) -> None:
    connection.execute("BEGIN IMMEDIATE")
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    for script in SCRIPTS[version:]:
        for statement in filter(str.strip, script.split(";")):
            connection.execute(statement)
    connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
    connection.execute(f"PRAGMA user_version = {len(SCRIPTS)}")
    connection.execute("COMMIT")
