"""The ledger: one writing connection, short transactions, and notices of changes."""

import logging
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from functools import wraps
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar

import numpy as np

from wrenchbook.service.files.durable import sync
from wrenchbook.service.ledger import audit as audit_sql
from wrenchbook.service.ledger import imports as import_sql
from wrenchbook.service.ledger import job_statistics as statistics_sql
from wrenchbook.service.ledger import jobs as job_sql
from wrenchbook.service.ledger import repair as repair_sql
from wrenchbook.service.ledger import rows as row_sql
from wrenchbook.service.ledger.acknowledged import Acknowledged, Numbers
from wrenchbook.service.ledger.connection import (
    BUSY_SECONDS,
    USE_ERRORS,
    Connection,
    begin,
    can_be_read_frozen,
    check_integrity,
    connect,
    damaged_file,
    inode,
    is_damage,
    open_file,
    raise_sequences,
    sequences,
    unavailable,
)
from wrenchbook.service.ledger.packing import row_keys
from wrenchbook.service.ledger.records import (
    JobRecord,
    LedgerError,
    LedgerFileError,
    LedgerUnavailableError,
    NotedRows,
    ReadOnlyError,
    TableAt,
)
from wrenchbook.surrogate.table.rows import Rows

_log = logging.getLogger(__name__)
CHECKPOINT_SECONDS = 0.2  # time that a checkpoint waits for readers, and writers for the checkpoint
_LEVELS = {"done": logging.INFO, "failed": logging.WARNING, "cancelled": logging.INFO}

Listener = Callable[[], object]
P = ParamSpec("P")
R = TypeVar("R")
Method = Callable[Concatenate["Ledger", P], R]


def _reads(function: Callable[Concatenate[Connection, P], R]) -> Method[P, R]:
    """Return a function of a connection as a method that reads one committed state."""

    @wraps(function)
    def method(self: "Ledger", *arguments: P.args, **options: P.kwargs) -> R:
        with self.reading() as db:
            return function(db, *arguments, **options)

    return method


def _writes(function: Callable[Concatenate[Connection, P], R]) -> Method[P, R]:
    """Return a function of a connection as a method that is one transaction, all or nothing."""

    @wraps(function)
    def method(self: "Ledger", *arguments: P.args, **options: P.kwargs) -> R:
        with self.writing() as db:
            return function(db, *arguments, **options)

    return method


class Ledger:
    """Jobs and rows in one SQLite file, for many threads and several processes at once.

    A method that has returned has committed to disk; one that raised has changed nothing. Its
    methods are the functions of `jobs`, `rows` and `imports`, each in a transaction of its own.
    Readers never wait for the writer (WAL); writers of this process wait for each other here and
    for other processes in SQLite.

    The file and its folder are made if missing. A `patient` ledger continues without a file that
    cannot be used now, on a full disk for example: `trouble` then returns the reason, and each
    `writing` tries to open it again. With `read_only`, which returns the remedy, each `writing`
    raises ReadOnlyError.

    Raises LedgerFileError if the file is foreign, damaged or of a newer schema, or, unless
    `patient`, cannot be used now. All methods raise LedgerUnavailableError if the file cannot be
    used.
    """

    def __init__(
        self, path: str | Path, *, patient: bool = False, read_only: Callable[[], str] | None = None
    ) -> None:
        self.path = Path(path).absolute()
        self._read_only = read_only
        self.damaged: dict[int, str] = {}
        """Rows found to be damaged on the disk, with their component."""
        self._closed = False
        self._write_lock = threading.Lock()
        self._watch_lock = threading.Lock()
        self._idle: list[Connection] = []
        self._writer: Connection | None = None
        self._watcher: Connection | None = None
        self._inode = (0, 0)
        self._refused: LedgerFileError | None = None
        self._acknowledged = Acknowledged(self.path)
        self._frozen = False  # refused for writing, but still readable
        self._logged = ""  # the last logged error
        self._listeners: tuple[Listener, ...] = ()
        self._listeners_lock = threading.Lock()
        try:
            self._open()
        except LedgerFileError as error:
            if not patient:
                raise
            self._refuse(error)

    accept = _writes(job_sql.accept)
    accept_many = _writes(job_sql.accept_many)
    accept_chosen = _writes(job_sql.accept_chosen)
    adopt = _writes(job_sql.adopt)
    send_heartbeat = _writes(job_sql.send_heartbeat)
    commit = _writes(job_sql.commit)
    fail = _writes(job_sql.fail)
    lose = _writes(job_sql.lose)
    release = _writes(job_sql.release)
    renew = _writes(job_sql.renew)
    end_lease = _writes(job_sql.end_lease)
    cancel = _writes(job_sql.cancel)
    cancel_many = _writes(job_sql.cancel_many)
    retry = _writes(job_sql.retry)
    job = _reads(job_sql.get)
    jobs = _reads(job_sql.listed)
    open_jobs = _reads(job_sql.open_jobs)
    jobs_for = _reads(job_sql.jobs_for)
    running = _reads(job_sql.running)
    unfinished = _reads(job_sql.unfinished)
    ended = _reads(job_sql.ended)
    attempts = _reads(job_sql.attempts)
    attempts_of = _reads(job_sql.attempts_of)
    leases = _reads(job_sql.leases)
    counts = _reads(statistics_sql.counts)
    statistics = _reads(statistics_sql.statistics)
    ahead = _reads(statistics_sql.ahead)
    solve_seconds = _reads(statistics_sql.solve_seconds)

    withdraw = _writes(row_sql.withdraw)
    rewrite = _writes(repair_sql.rewrite)
    replay = _writes(repair_sql.replay)
    row = _reads(row_sql.get)
    rows_of = _reads(row_sql.numbered)
    row_changes = _reads(row_sql.row_changes)
    damaged_rows = _reads(row_sql.damaged)
    is_withdrawn = _reads(row_sql.is_withdrawn)
    last_seq = _reads(row_sql.last_seq)
    count_new = _reads(row_sql.count_new)
    count_rows = _reads(row_sql.count_rows)
    known_rows = _reads(row_sql.stored)
    withdrawn_keys = _reads(row_sql.withdrawn_keys)
    of_other_setups = _reads(row_sql.of_other_setups)
    digest = _reads(row_sql.digest)
    edits = _reads(row_sql.edits)

    import_rows = import_sql.import_rows
    drop_abandoned = import_sql.drop_abandoned
    append_rows = _writes(import_sql.append_rows)
    edit_import = _writes(import_sql.edit_import)
    restore_confirmed = _writes(import_sql.restore_confirmed)
    imports = _reads(import_sql.imports)
    same_file = _reads(import_sql.same_file)
    stored_numbers = _reads(import_sql.stored_numbers)
    import_of = _reads(import_sql.import_of)
    import_spans = _reads(import_sql.import_spans)
    withdrawn_counts = _reads(import_sql.withdrawn_counts)
    findings = _reads(import_sql.findings)
    audit = _reads(audit_sql.entries)

    def claim_many(self, owner: str, engine: str, most: int) -> list[JobRecord]:
        """Start the next attempts of the next waiting jobs; write nothing if none waits."""
        with self.reading() as db:
            if not job_sql.next_waiting(db, 1):
                return []
        with self.writing() as db:
            return job_sql.claim(db, owner, engine, most)

    def insert_rows(
        self, component: str, rows: Rows, note: str | Sequence[str] = "", *, above: int = 0
    ) -> tuple[int, int]:
        """Insert rows, all or none, and return the numbers of new and known rows.

        A row of the same component, fingerprint, source, wrench, displacement and uncertainty is
        known. New rows get a seq above `above`.

        Raises ValueError if a solve lacks an output or a tangent is infinite.
        """
        unsolved = rows.is_solved & np.isnan(rows.displacement).any(axis=1)
        if unsolved.any():
            at = int(unsolved.argmax())
            displacement = rows.displacement[at].tolist()
            problem = f"row {at + 1} of {len(rows)} is a solve of the displacement {displacement}"
            raise ValueError(f"{problem}, but all outputs must be finite; solve it again")
        block = NotedRows(rows, [note] * len(rows) if isinstance(note, str) else note)
        # Before the lock is taken: other writers wait for the insertion only.
        keys = row_keys(component, block)
        with self.writing() as db:
            new, known = row_sql.insert(db, component, block, keys, time.time(), above=above)
            if new:
                last = sequences(db)["rows"]
                after = {"rows": new}
                audit_sql.note(db, "row.insert", last, component, after=after)
            return new, known

    @contextmanager
    def table_at(
        self, component: str, version: int | None = None, **setup: Any
    ) -> Iterator[TableAt]:
        """Yield `rows.table_at`, whose lots are read within the `with`, as one committed state."""
        with self.reading() as db:
            yield row_sql.table_at(db, component, version, **setup)

    @contextmanager
    def writing(self, *, durable: bool = True) -> Iterator[Connection]:
        """Yield the writing connection in a transaction that is committed at the end.

        Listeners are called after the commit. Without `durable`, the sync is left to the next
        durable transaction, which covers the complete log.
        """
        if self._read_only is not None:
            raise ReadOnlyError(self._read_only())
        with self._write_lock, self.named_errors():
            writer = self._present_writer()
            if not durable:
                writer.execute("PRAGMA synchronous = NORMAL")
            try:
                writer.jobs = {}
                writer.has_new_rows = False
                begin(writer)
                yield writer
                numbers = _numbers(writer)
                writer.execute("COMMIT")
                jobs, has_new_rows = writer.jobs, writer.has_new_rows
                self._logged = ""
                if durable:
                    self._acknowledged.note(numbers)
            except BaseException:
                if writer.in_transaction:
                    writer.execute("ROLLBACK")
                raise
            finally:
                if not durable:
                    writer.execute("PRAGMA synchronous = FULL")
        _log_jobs(jobs.values())
        for listener in self._listeners if jobs or has_new_rows else ():
            try:
                listener()
            except Exception:  # the commit has happened, whether or not a listener fails
                _log.exception("a listener of the ledger failed")

    def sync(self) -> None:
        """Sync the content of transactions that are not durable, without a lock on the ledger.

        Called between two of them, it keeps a durable transaction of another writer from waiting
        for all of it.
        """
        with suppress(OSError):  # no log, or a disk that fails: the next durable commit fails
            sync(self.path.with_name(f"{self.path.name}-wal"))

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """Yield a reading connection; all its statements read the same committed state."""
        with self.named_errors():
            self._check_open()
            frozen = self._frozen
            if not frozen:
                self._check_usable()
            try:
                connection = self._idle.pop()
            except IndexError:
                connection = connect(self.path, frozen=frozen)
                connection.damaged = self.damaged
            try:
                connection.execute("BEGIN")
                yield connection
            finally:
                if connection.in_transaction:
                    connection.execute("ROLLBACK")
                if frozen == self._frozen:
                    self._idle.append(connection)
                else:  # a frozen connection does not see later commits
                    connection.close()
                while self._closed and self._idle:
                    self._idle.pop().close()

    def version(self) -> int:
        """Return a number that differs after any commit of this or another process.

        Takes microseconds. Only the equality of two numbers from the same Ledger has a meaning.
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
        """Call `listener` after each commit of jobs or rows, in the thread that committed.

        It must be quick. Returns a function that ends the subscription. Commits of other processes
        are found by polling `version`.
        """
        with self._listeners_lock:
            self._listeners = (*self._listeners, listener)

        def remove() -> None:
            with self._listeners_lock:
                self._listeners = tuple(other for other in self._listeners if other is not listener)

        return remove

    def trouble(self) -> str | None:
        """Return the reason why the file can be neither read nor written now; None if it can."""
        try:
            self._check_usable()
        except LedgerUnavailableError as error:
            return str(error)
        return None

    def losses(self) -> list[str]:
        """Return the lost acknowledged jobs and rows, as sentences."""
        return [loss.sentence() for loss in self._acknowledged.losses()]

    def sizes(self) -> dict[str, int]:
        """Return the bytes of the ledger's file and of its log."""
        files = {"ledger": self.path, "log": self.path.with_name(f"{self.path.name}-wal")}
        return {name: file.stat().st_size if file.exists() else 0 for name, file in files.items()}

    def checkpoint(self) -> bool:
        """Move the log into the file and empty it; return False if another connection uses it."""
        with self._write_lock, self.named_errors():
            writer = self._present_writer()
            writer.execute(f"PRAGMA busy_timeout = {round(1000 * CHECKPOINT_SECONDS)}")
            try:
                busy, _, _ = writer.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
            finally:
                writer.execute(f"PRAGMA busy_timeout = {round(1000 * BUSY_SECONDS)}")
            return not busy

    def copy(self, target: Path, *, checked: bool = True) -> tuple[int, int, int]:
        """Write all committed content into a new file, by one read of SQLite's online backup.

        In one step: in parts it would restart with each commit of another process. Returns the
        numbers of its rows, of the highest row and of its jobs. A copy that is not `checked` is not
        durable either.

        Raises LedgerFileError if the copy is damaged.
        """
        with self.named_errors():
            self._check_open()
            self._check_usable()
            target.unlink(missing_ok=True)
            with closing(connect(self.path)) as source, closing(connect(target)) as copy:
                if not checked:
                    copy.execute("PRAGMA synchronous = OFF")
                source.backup(copy)
                if checked:
                    check_integrity(copy, target)
                # One file; it gets WAL again once opened.
                copy.execute("PRAGMA journal_mode = DELETE")
                return copy.execute(
                    "SELECT coalesce(sum(count), 0), coalesce(max(seq + count - 1), 0),"
                    " (SELECT count(*) FROM jobs) FROM rows"
                ).fetchone()

    def take_over(self, source: Path) -> None:
        """Replace all content by that of another ledger's file, in one transaction."""
        with self._write_lock, self.named_errors(), closing(connect(source)) as new:
            new.backup(self._present_writer())
        self.checkpoint()  # while another connection reads, the next call shortens the log

    def close(self) -> None:
        """Close all connections, those in use when they are returned; idempotent."""
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
            refusal = unavailable(self.path, error)
            if str(refusal) != self._logged:  # once for any number of requests
                self._logged = str(refusal)
                _log.error("%s", refusal)
            raise refusal from error

    def _refuse(self, error: LedgerFileError) -> None:
        self._refused = error
        self._frozen = can_be_read_frozen(self.path)

    def _open(self) -> None:
        """Open the file, and skip the numbers of commits that it has lost."""
        if self._writer is not None:
            self._writer.close()
        self._writer = open_file(self.path)
        self._writer.damaged = self.damaged
        self._inode = inode(self.path)
        self._refused = None
        self._frozen = False
        noted = self._acknowledged.read()  # before the ledger, which others may be writing
        lost = self._acknowledged.compare(noted, _numbers(self._writer))
        if lost is not None:  # noted; these numbers are never used again
            raise_sequences(self._writer, lost._asdict())
            _log.error("the ledger has lost what it had: %s", self.losses()[-1:])
        while self._idle:
            self._idle.pop().close()

    def _present_writer(self) -> Connection:
        """Return the writer, after another attempt to open a file that could not be used.

        Raises LedgerUnavailableError if the file still cannot be used.
        """
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
        # SQLite continues to write into a deleted file.
        if inode(self.path) != self._inode:
            raise LedgerUnavailableError(
                f"the ledger {self.path} was deleted or replaced while the server runs, so nothing "
                "is accepted. Put the file back if you moved it, then restart the server"
            )

    def _check_open(self) -> None:
        if self._closed:
            raise LedgerError(f"the ledger {self.path} is closed; try again once the server runs")


def _numbers(connection: Connection) -> Numbers:
    used = sequences(connection)
    return Numbers(used.get("jobs", 0), used.get("rows", 0))


def _log_jobs(jobs: Iterable[JobRecord]) -> None:
    """Log the statuses of jobs after a commit; waiting and running ones at the level DEBUG."""
    for job in jobs:
        level = _LEVELS.get(job.status, logging.DEBUG)
        if _log.isEnabledFor(level):
            took = "" if job.seconds is None else f" after {job.seconds:.2f} s"
            if job.status == "done":
                text = f"done{took}, row {job.row}"
            elif job.error is not None:
                text = f"failed{took}, {job.error.get('kind')}: {job.error.get('message')}"
            else:
                text = f"{job.status}, attempt {job.attempt}" if job.attempt else job.status
            details = {"job": job.id, "attempt": job.attempt, "component": job.component}
            _log.log(level, "job %d of %s: %s", job.id, job.component, text, extra=details)
