"""The ledger's file: one writing connection, short transactions, and notices of changes."""

import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from wrenchbook.service.ledger.connection import (
    USE_ERRORS,
    Connection,
    begin,
    can_be_read_frozen,
    checkpoint,
    connect,
    copy_file,
    damaged_file,
    inode,
    is_damage,
    open_file,
    raise_sequences,
    sequences,
    sync_log,
    unavailable,
)
from wrenchbook.service.ledger.records import (
    Change,
    LedgerError,
    LedgerFileError,
    LedgerUnavailableError,
)
from wrenchbook.service.ledger.repair import SEQUENCES, Acknowledged, Numbers

_log = logging.getLogger(__name__)

Listener = Callable[[Change], None]


class Database:
    """One writing connection, as many reading ones as are in use, one to watch for changes.

    Readers never wait for the writer (WAL); writers of this process wait for each other here
    and for other processes in SQLite.

    Parameters
    ----------
    path : path
        The file; it and its folder are made if there are none.
    patient : bool
        Whether to continue without a file that cannot be used now, on a full disk for example:
        `trouble` then returns the reason, every use raises LedgerUnavailableError, and each
        `writing` tries to open it again.

    Raises
    ------
    LedgerFileError
        If the file is foreign, damaged or of a newer schema, and `patient` is false.
    """

    def __init__(self, path: str | Path, *, patient: bool = False) -> None:
        self.path = Path(path).absolute()
        self._closed = False
        self._write_lock = threading.Lock()
        self._watch_lock = threading.Lock()
        self._idle: list[Connection] = []
        self._writer: Connection | None = None
        self._watcher: Connection | None = None
        self._inode = (0, 0)
        self._refused: LedgerFileError | None = None
        self._acknowledged = Acknowledged(self.path)
        self._frozen = False  # refused for writing, but whole enough to be read as it is
        self._logged = ""  # the error logged last
        self.damaged: dict[int, str] = {}
        self._listeners: tuple[Listener, ...] = ()
        self._listeners_lock = threading.Lock()
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
            False rolls the transaction back at the end.
        durable : bool
            False leaves the sync to the next durable transaction, which covers the whole log.

        Raises
        ------
        LedgerUnavailableError
            If SQLite could not write or commit; nothing of the transaction is kept.
        """
        with self._write_lock, self.named_errors():
            writer = self._present_writer()
            if not durable:
                writer.execute("PRAGMA synchronous = NORMAL")
            try:
                begin(writer)
                yield writer
                numbers = _numbers(writer)
                writer.execute("COMMIT" if keep else "ROLLBACK")
                self._logged = ""
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
        """Sync what transactions that are not durable have written.

        Between two of them, so that a durable one of another writer does not wait for all of it.
        """
        sync_log(self.path)

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """Give a reading connection; all its statements see one and the same committed state."""
        with self.named_errors():
            self._check_open()
            frozen = self._frozen
            if not frozen:
                self._check_usable()
            try:
                connection = self._idle.pop()
            except IndexError:
                connection = connect(self.path, frozen=frozen)
            try:
                connection.execute("BEGIN")
                yield connection
            finally:
                if connection.in_transaction:
                    connection.execute("ROLLBACK")
                self._keep(connection, frozen)

    def version(self) -> int:
        """Return a number that differs after any commit of this or another process.

        Takes microseconds. Only equality of two numbers from the same Ledger means anything.
        """
        with self._watch_lock, self.named_errors():
            self._check_open()
            if self._frozen:
                return 0
            self._check_usable()
            if self._watcher is None:
                self._watcher = connect(self.path)
            return self._watcher.execute("PRAGMA data_version").fetchone()[0]

    def on_change(self, listener: Listener) -> Callable[[], None]:
        """Call `listener` after each commit of this Ledger, in the thread that committed.

        It must be quick. Returns a function that ends the subscription. Commits of other
        processes are seen by polling `version`.
        """
        with self._listeners_lock:
            self._listeners = (*self._listeners, listener)

        def remove() -> None:
            with self._listeners_lock:
                self._listeners = tuple(one for one in self._listeners if one is not listener)

        return remove

    def notify(self, change: Change) -> None:
        """Call the listeners of this process after a commit."""
        for listener in self._listeners:
            try:
                listener(change)
            except Exception:  # the commit has happened, whatever a listener makes of it
                _log.exception("a listener of the ledger failed on %s", change)

    def trouble(self) -> str | None:
        """Return why the file can be neither read nor written now; None if it can."""
        try:
            self._check_usable()
        except LedgerUnavailableError as error:
            return str(error)
        return None

    def losses(self) -> list[str]:
        """Return the acknowledged jobs and rows that are gone, as sentences."""
        return self._acknowledged.losses()

    def sizes(self) -> dict[str, int]:
        """Return the bytes of the ledger's file and of its log."""
        files = {"ledger": self.path, "log": self.path.with_name(f"{self.path.name}-wal")}
        return {word: file.stat().st_size if file.exists() else 0 for word, file in files.items()}

    def checkpoint(self) -> bool:
        """Move the log into the file and empty it; False if another connection reads just now.

        Raises
        ------
        LedgerUnavailableError
            If the file cannot be used now.
        """
        with self._write_lock, self.named_errors():
            return checkpoint(self._present_writer())

    def copy(self, target: Path) -> None:
        """Write all that is committed into a new file; raises as `checkpoint` and `copy_file`."""
        with self.named_errors():
            self._check_open()
            self._check_usable()
            connection = connect(self.path)
            try:
                copy_file(connection, target)
            finally:
                connection.close()

    def close(self) -> None:
        """Close all connections, one in use when it comes back; idempotent."""
        with self._write_lock, self._watch_lock:
            if self._closed:
                return
            self._closed = True
            for connection in (self._watcher, *self._idle, self._writer):
                if connection is not None:
                    connection.close()
            self._idle.clear()

    @contextmanager
    def named_errors(self, *more: type[Exception]) -> Iterator[None]:
        """Raise SQLite's errors, and those of the types `more`, as LedgerUnavailableError."""
        try:
            yield
        except (*USE_ERRORS, *more) as error:
            if is_damage(error):  # after one damaged page no other is trusted
                self._refuse(damaged_file(self.path, str(error)))
            found = unavailable(self.path, error)
            if str(found) != self._logged:  # once, however many requests follow
                self._logged = str(found)
                _log.error("%s", found)
            raise found from error

    def _refuse(self, error: LedgerFileError) -> None:
        self._refused = error
        self._frozen = can_be_read_frozen(self.path)

    def _open(self) -> None:
        if self._writer is not None:
            self._writer.close()
        self._writer = open_file(self.path)
        self._inode = inode(self.path)
        self._refused, self._frozen = None, False
        self._check_loss(self._writer)
        while self._idle:
            self._idle.pop().close()

    def _present_writer(self) -> Connection:
        self._check_open()
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
        # SQLite goes on writing into a file that has been deleted.
        if inode(self.path) != self._inode:
            raise LedgerUnavailableError(
                f"the ledger {self.path} was deleted or replaced under this server; nothing is "
                "accepted. Put the file back if you moved it, then restart the server"
            )

    def _keep(self, connection: Connection, frozen: bool) -> None:
        if frozen != self._frozen:  # a frozen connection does not see later commits
            connection.close()
            return
        self._idle.append(connection)
        if self._closed:
            while self._idle:
                self._idle.pop().close()

    def _check_open(self) -> None:
        if self._closed:
            raise LedgerError("the ledger is closed")

    def _check_loss(self, writer: Connection) -> None:
        """Record acknowledged jobs and rows that are gone; their numbers are never used again."""
        lost = self._acknowledged.compare(_numbers(writer))
        if lost is not None:
            raise_sequences(writer, lost._asdict())
            _log.error("the ledger has lost what it had: %s", self._acknowledged.losses()[-1:])


def _numbers(connection: Connection) -> Numbers:
    found = sequences(connection)
    return Numbers(*(found.get(name, 0) for name in SEQUENCES))
