"""The ledger's SQLite file: its connections, its transactions, bringing it to today's schema.

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
from service.ledger.records import seal
from service.ledger.versions import APPLICATION_ID, SCRIPTS

Connection = sqlite3.Connection

BUSY_SECONDS = 30.0  # a writer waits so long for another process: a bulk import takes seconds


class Connections:
    """One writing connection, as many reading ones as are in use, one to watch for changes.

    Readers never wait for the writer (WAL); writers of this process wait for each other here
    and for other processes in SQLite.

    Parameters
    ----------
    path : path
    patient : bool
        Whether to go on without a file that cannot be used now: it is tried again by each
        `writing`, and until then every use raises LedgerUnavailableError.

    Raises
    ------
    LedgerFileError
        If the file is foreign, damaged or of a newer schema, and `patient` is false.
    """

    def __init__(self, path: Path, *, patient: bool = False) -> None:
        self._path = path
        self._closed = False
        self._write_lock = threading.Lock()
        self._watch_lock = threading.Lock()
        self._idle: list[Connection] = []
        self._writer: Connection | None = None
        self._watcher: Connection | None = None
        self._inode = (0, 0)
        self._refused: LedgerFileError | None = None
        self._frozen = False  # refused, but whole enough on the disk to be read as it lies there
        try:
            self._open()
        except LedgerFileError as error:
            if not patient:
                raise
            self._refuse(error)

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
        with self._write_lock, self._named_errors():
            self._check_open()
            writer = self._present_writer()
            writer.execute("BEGIN IMMEDIATE")
            try:
                yield writer
                writer.execute("COMMIT" if keep else "ROLLBACK")
            except BaseException:
                if writer.in_transaction:
                    writer.execute("ROLLBACK")
                raise

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """Give a reading connection; all its statements see one and the same committed state."""
        with self._named_errors():
            self._check_open()
            frozen = self._frozen
            if not frozen:
                self._check_usable()
            try:
                connection = self._idle.pop()
            except IndexError:
                connection = _connect(self._path, frozen=frozen)
            try:
                connection.execute("BEGIN")
                yield connection
            finally:
                if connection.in_transaction:
                    connection.execute("ROLLBACK")
                self._keep(connection, frozen)

    def version(self) -> int:
        """Return a number that changes with every commit of any process (microseconds)."""
        with self._watch_lock, self._named_errors():
            self._check_open()
            if self._frozen:
                return 0
            self._check_usable()
            if self._watcher is None:
                self._watcher = _connect(self._path)
            return self._watcher.execute("PRAGMA data_version").fetchone()[0]

    def trouble(self) -> str | None:
        """Return why the file can be neither read nor written now; None if it can."""
        try:
            self._check_usable()
        except LedgerUnavailableError as error:
            return str(error)
        return None

    def close(self) -> None:
        """Close all connections; one in use is closed when it comes back."""
        with self._write_lock, self._watch_lock:
            if self._closed:
                return
            self._closed = True
            for connection in (self._watcher, *self._idle, self._writer):
                if connection is not None:
                    connection.close()
            self._idle.clear()

    @contextmanager
    def _named_errors(self) -> Iterator[None]:
        try:
            yield
        except (sqlite3.Error, UnicodeDecodeError) as error:
            if _tells_damage(error):  # what is damaged in one place is trusted in no other
                self._refuse(_damaged(self._path, str(error)))
            raise LedgerUnavailableError(
                f"the ledger {self._path} could not be used: {error}. Nothing was changed; "
                "see that its disk has space and is writable, then ask again"
            ) from error

    def _refuse(self, error: LedgerFileError) -> None:
        self._refused = error
        self._frozen = _can_be_read_frozen(self._path)

    def _open(self) -> None:
        if self._writer is not None:
            self._writer.close()
        self._writer = _open(self._path)
        self._inode = _inode(self._path)
        self._refused, self._frozen = None, False
        while self._idle:
            self._idle.pop().close()

    def _present_writer(self) -> Connection:
        if self._refused is not None:
            try:
                self._open()
            except LedgerFileError as error:
                raise LedgerUnavailableError(str(error)) from error
        self._check_usable()
        assert self._writer is not None
        return self._writer

    def _check_usable(self) -> None:
        if self._refused is not None:
            raise LedgerUnavailableError(str(self._refused))
        # SQLite goes on writing into a file that nobody can open any more.
        if _inode(self._path) != self._inode:
            raise LedgerUnavailableError(
                f"the ledger {self._path} was deleted or replaced under this server; nothing is "
                "accepted. Put the file back if you moved it, then restart the server"
            )

    def _keep(self, connection: Connection, frozen: bool) -> None:
        if frozen != self._frozen:  # it does not see what is written since
            connection.close()
            return
        self._idle.append(connection)
        if self._closed:
            while self._idle:
                self._idle.pop().close()

    def _check_open(self) -> None:
        if self._closed:
            raise LedgerError("the ledger is closed")


def _can_be_read_frozen(path: Path) -> bool:
    """Return whether a ledger that cannot be opened for writing can be read as it lies there.

    SQLite then makes no files beside it, as a full disk needs, but does not see what a WAL file
    that was left behind holds either.
    """
    wal = path.with_name(f"{path.name}-wal")
    try:
        if not path.is_file() or (wal.exists() and wal.stat().st_size):
            return False
        connection = _connect(path, frozen=True)
        try:
            _check_file(connection, path)
            return _schema_version(connection) == len(SCRIPTS)
        finally:
            connection.close()
    except (OSError, sqlite3.Error, UnicodeDecodeError, LedgerFileError):
        return False


def _inode(path: Path) -> tuple[int, int]:
    try:
        found = path.stat()
    except OSError:
        return (0, 0)
    return found.st_dev, found.st_ino


def _connect(path: Path, *, frozen: bool = False) -> Connection:
    connection = sqlite3.connect(
        f"{path.as_uri()}?immutable=1" if frozen else path,
        timeout=BUSY_SECONDS,
        isolation_level=None,
        check_same_thread=False,
        uri=frozen,
    )
    try:
        # A damaged word must not keep the sound rows beside it from being read.
        connection.text_factory = lambda word: word.decode("utf-8", "replace")
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute("PRAGMA foreign_keys = ON")
    except BaseException:
        connection.close()
        raise
    return connection


def _open(path: Path) -> Connection:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        connection = _connect(path)
        try:
            _check_file(connection, path)
            _check_whole(connection, path)
            _use_wal(connection)
            _upgrade(connection)
        except BaseException:
            connection.close()
            raise
    except (sqlite3.OperationalError, OSError) as error:
        raise LedgerFileError(
            f"cannot open the ledger {path}: {error}. See that its folder is writable, "
            "its disk has space and no program keeps it locked"
        ) from error
    except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
        raise _damaged(path, str(error)) from error
    sync_folder(path.parent)
    return connection


def _check_file(connection: Connection, path: Path) -> None:
    owner = connection.execute("PRAGMA application_id").fetchone()[0]
    tables = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]
    version = _schema_version(connection)
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


def _check_whole(connection: Connection, path: Path) -> None:
    """Refuse a damaged file: what is written into one may be gone at the next start.

    Of 300 ledgers with one to six random bytes changed, ``quick_check`` let 11 pass that lost what
    they had accepted, this one none: it compares indices with their tables too. 5 µs a row.
    """
    found = connection.execute("PRAGMA integrity_check(1)").fetchone()[0]
    if found != "ok":
        raise _damaged(path, found)


def _damaged(path: Path, why: str) -> LedgerFileError:
    return LedgerFileError(
        f"cannot read {path} as a ledger: it is damaged ({why}). Nothing is written into it; "
        "tables answer from their files. Move it away with the server stopped, and put back a copy "
        "or start with an empty one: the rows of the tables' files then come back into it"
    )


def _tells_damage(error: Exception) -> bool:
    """Tell a damaged file from a disk that is full or a lock; its texts can be no UTF-8 either."""
    code = getattr(error, "sqlite_errorcode", 0) & 0xFF  # the rest says where it was noticed
    return isinstance(error, UnicodeDecodeError) or code in (
        sqlite3.SQLITE_CORRUPT,
        sqlite3.SQLITE_NOTADB,
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
    if _schema_version(connection) == len(SCRIPTS):
        return  # nothing is written, so a full disk does not keep anybody from reading
    # A table that others refer to is replaced (sqlite.org/lang_altertable.html, section 7).
    connection.execute("PRAGMA foreign_keys = OFF")
    connection.create_function("seal", 3, seal, deterministic=True)
    connection.execute("BEGIN IMMEDIATE")
    for script in SCRIPTS[_schema_version(connection) :]:
        for statement in filter(str.strip, script.split(";")):
            connection.execute(statement)
    connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
    connection.execute(f"PRAGMA user_version = {len(SCRIPTS)}")
    connection.execute("COMMIT")
    connection.execute("PRAGMA foreign_keys = ON")


def _schema_version(connection: Connection) -> int:
    return connection.execute("PRAGMA user_version").fetchone()[0]
