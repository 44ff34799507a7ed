"""Values that the ledger returns (jobs, rows, changes) and the errors that it raises."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

from wrenchbook.surrogate.table.rows import Rows

Status = Literal["waiting", "running", "done", "failed", "cancelled"]
STATUSES: tuple[Status, ...] = ("waiting", "running", "done", "failed", "cancelled")
FINAL: frozenset[Status] = frozenset({"done", "failed", "cancelled"})

Vector = tuple[float, ...]
Matrix = tuple[Vector, ...]


@dataclass(frozen=True)
class JobRecord:
    """A queued solve of one wrench on one component; times are seconds since the epoch."""

    id: int  # grows with the order of acceptance
    component: str
    fingerprint: str  # fingerprint of the setup for which the job was accepted
    wrench: Vector  # N, N·m
    status: Status
    priority: int  # waiting jobs of a higher priority start first, of equal priority the oldest
    attempt: int  # attempts started; the number of the current one while running
    lost: int  # attempts whose solver died since the job was accepted, reopened or retried
    owner: str | None  # the dispatcher of the running attempt
    created: float
    started: float | None  # start of the latest attempt
    finished: float | None
    error: dict[str, str] | None  # kind, message and remedy of a failed job
    row: int | None  # `seq` of the row of a done job
    not_before: float | None = None  # earliest start of a waiting job whose solver died
    asked_by: str = ""  # the call that requested it, such as `query` or `fill`
    engine: str | None = None  # the engine of the latest attempt
    task: str | None = None  # the engine's key of the attempt
    began: float | None = None  # when a solver reported its begin; until then it is submitted
    # The actor that requested it; empty if it was accepted before the ledger had actors.
    actor: str = ""

    @property
    def seconds(self) -> float | None:
        """Time from the solver's first instruction to the end, s; None before the end."""
        start = self.began or self.started
        return max(0.0, self.finished - start) if self.finished and start else None

    @property
    def is_queued(self) -> bool:
        """Whether the job is in its engine's queue: no solver has begun. `local` has no queue."""
        return (
            self.status == "running" and self.began is None and self.engine not in (None, "local")
        )

    @property
    def is_final(self) -> bool:
        """Whether the job does not change any more by itself."""
        return self.status in FINAL


class Quota(NamedTuple):
    """The limits of an actor: open jobs, and solver seconds of a day; None for no limit."""

    open_jobs: int | None = None
    solver_seconds: float | None = None


class Heartbeat(NamedTuple):
    """The heartbeat of an owner of attempts: its engine, their number, the time of the last, s.

    An owner lives as long as the number grows. The time is for display only, as clocks can be set.
    """

    engine: str
    number: int
    at: float


class OpenJob(NamedTuple):
    """A waiting or running job in short form: its number, its packed wrench, its call."""

    id: int
    wrench: bytes
    asked_by: str


@dataclass(frozen=True, slots=True)
class LedgerRow:
    """A single row of any space with its provenance; SI, None where unknown."""

    seq: int
    component: str
    fingerprint: str
    source: str
    wrench: Vector
    displacement: Vector
    compliance: Matrix | None
    uncertainty: Vector | None
    job: int | None
    created: float
    origin: str
    curvature: Vector | None = None


class NotedRows(NamedTuple):
    """Rows with each row's note and, for stored rows, the time of storing, seconds since the epoch.

    The numbers (`seq`) of rows that are to be stored are ignored.
    """

    rows: Rows
    note: Sequence[str]
    created: Sequence[float] = ()


class RowEdit(NamedTuple):
    """A withdrawal or restoring: the row's content key, whether it is withdrawn, and when, s."""

    key: bytes
    withdrawn: bool
    created: float


@dataclass(frozen=True)
class RowChanges:
    """Changes of a component's rows after some seq, as one committed state."""

    rows: Rows  # rows to add: new ones, and restored old ones
    # Rows to remove before: all edited ones; those that are restored are in `rows`.
    edited: frozenset[int]
    last_seq: int  # number up to which the changes are complete
    complete: bool = True  # whether these are all changes; otherwise continue from `last_seq`


@dataclass(frozen=True)
class TableAt:
    """A component's table at a version, the number of the newest change in it."""

    version: int
    # Whether any row has an uncertainty, tangents, a curvature, a note, a setup.
    known: tuple[bool, ...]
    lots: Iterator[NotedRows]


class LedgerError(RuntimeError):
    """Base of all errors of the ledger."""


class LedgerFileError(LedgerError):
    """The file is not a ledger that this program can read: foreign, damaged or newer."""


class LedgerDamagedError(LedgerFileError):
    """The file is or was a ledger, but its bytes have changed."""


class LedgerUnavailableError(LedgerError):
    """The ledger could not be read or written now (disk full, locked); nothing was changed."""


class LedgerBusyError(LedgerUnavailableError):
    """The ledger did not answer in time."""

    retry_s = 10.0


class ReadOnlyError(LedgerUnavailableError):
    """The ledger is a replica's copy; the message names the server that accepts writes."""


class LedgerFullError(LedgerUnavailableError):
    """The disk is full; nothing was changed."""


class UnknownJobError(LedgerError, LookupError):
    """There is no job with this number."""


class UnknownRowError(LedgerError, LookupError):
    """There is no row with this seq."""


class UnknownImportError(LedgerError, LookupError):
    """The component has no import of this number, or the import has no such finding."""


class InvalidTransitionError(LedgerError):
    """The job's status does not allow this event; see `TRANSITIONS`."""


class QuotaError(LedgerError):
    """The actor has reached its limit of open jobs or solver seconds; nothing was changed."""

    def __init__(self, message: str, retry_s: float) -> None:
        super().__init__(message)
        self.retry_s = retry_s


class StaleAttemptError(InvalidTransitionError):
    """The report belongs to an attempt that is not the job's running one; drop it."""


class DamagedRowError(LedgerError):
    """The row on the disk is damaged, and is not used."""


class RowStatusError(LedgerError):
    """The row already is withdrawn, or is not."""


class BlockKeyError(LedgerError):
    """The key of a block of wrenches does not show whether the block was recorded."""


class AppendError(LedgerError):
    """Rows cannot be appended to this import."""


class ImportRunningError(LedgerError):
    """Another import has used the ledger for too long; nothing was loaded."""


class UnknownVersionError(LedgerError, LookupError):
    """The table has no such version, or none yet."""
