"""The connections to the ledger's file and their transactions."""

import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from wrenchbook.service.ledger.acknowledged import SEQUENCES, Acknowledged, Numbers
from wrenchbook.service.ledger.errors import (
    LedgerError,
    LedgerFileError,
    LedgerFullError,
    LedgerUnavailableError,
)
from wrenchbook.service.ledger.schema import (
    USE_ERRORS,
    Connection,
    begin,
    can_be_read_frozen,
    checkpoint,
    connect,
    copy_file,
    damaged_file,
    inode,
    open_file,
    raise_sequences,
    sequences,
    sync_log,
    tells_damage,
    tells_full,
)

_log = logging.getLogger(__name__)


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
        self._acknowledged = Acknowledged(path)
        self._frozen = False  # refused, but whole enough on the disk to be read as it lies there
        try:
            self._open()
        except LedgerFileError as error:
            if not patient:
                raise
            self._refuse(error)

    @contextmanager
    def writing(self, *, keep: bool = True, durable: bool = True) -> Iterator[Connection]:
        """Give the writing connection in a transaction that is committed at the end.

        Parameters
        ----------
        keep : bool
            False tries the transaction and takes it back.
        durable : bool
            False leaves the waiting for the disk to the next transaction that is durable: its
            sync covers all that stands in the log before it.

        Raises
        ------
        LedgerUnavailableError
            If SQLite could not write or commit; nothing of the transaction is kept.
        """
        with self._write_lock, self._named_errors():
            self._check_open()
            writer = self._present_writer()
            if not durable:
                writer.execute("PRAGMA synchronous = NORMAL")
            try:
                begin(writer)
                yield writer
                numbers = _numbers(writer)
                writer.execute("COMMIT" if keep else "ROLLBACK")
                if keep and durable:
                    self._acknowledged.note(numbers)
            except BaseException:
                if writer.in_transaction:
                    writer.execute("ROLLBACK")
                raise
            finally:
                if not durable:
                    writer.execute("PRAGMA synchronous = FULL")

    def settle(self) -> None:
        """Bring onto the disk what transactions that are not durable have written.

        Between two of them, so that a durable one of somebody else does not wait for all of it.
        """
        sync_log(self._path)

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
                connection = connect(self._path, frozen=frozen)
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
                self._watcher = connect(self._path)
            return self._watcher.execute("PRAGMA data_version").fetchone()[0]

    def trouble(self) -> str | None:
        """Return why the file can be neither read nor written now; None if it can."""
        try:
            self._check_usable()
        except LedgerUnavailableError as error:
            return str(error)
        return None

    def checkpoint(self) -> bool:
        """Bring the log into the file and empty it; False if somebody reads just now.

        Raises
        ------
        LedgerUnavailableError
            If the file cannot be used now.
        """
        with self._write_lock, self._named_errors():
            self._check_open()
            return checkpoint(self._present_writer())

    def copy(self, target: Path) -> None:
        """Write all that is committed into a new file; raises as `checkpoint` and `copy_file`."""
        with self._named_errors():
            self._check_open()
            self._check_usable()
            connection = connect(self._path)
            try:
                copy_file(connection, target)
            finally:
                connection.close()

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
        except USE_ERRORS as error:
            if tells_damage(error):  # what is damaged in one place is trusted in no other
                self._refuse(damaged_file(self._path, str(error)))
            kind = LedgerFullError if tells_full(error) else LedgerUnavailableError
            raise kind(
                f"the ledger {self._path} could not be used: {error}. Nothing was changed; "
                "see that its disk has space and is writable, then ask again"
            ) from error

    def _refuse(self, error: LedgerFileError) -> None:
        self._refused = error
        self._frozen = can_be_read_frozen(self._path)

    def _open(self) -> None:
        if self._writer is not None:
            self._writer.close()
        self._writer = open_file(self._path)
        self._inode = inode(self._path)
        self._refused, self._frozen = None, False
        self._tell_loss(self._writer)
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
        if inode(self._path) != self._inode:
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

    def _tell_loss(self, writer: Connection) -> None:
        """Notice that what was acknowledged is gone, and give none of its numbers to others."""
        lost = self._acknowledged.compare(_numbers(writer))
        if lost is not None:
            raise_sequences(writer, lost._asdict())
            _log.error("the ledger has lost what it had: %s", self._acknowledged.losses()[-1:])


def _numbers(connection: Connection) -> Numbers:
    found = sequences(connection)
    return Numbers(*(found.get(name, 0) for name in SEQUENCES))
