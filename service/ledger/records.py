"""Values that the ledger returns (jobs, rows, changes) and the errors that it raises."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

Status = Literal["waiting", "running", "done", "failed", "cancelled"]
STATUSES: tuple[Status, ...] = ("waiting", "running", "done", "failed", "cancelled")
FINAL: frozenset[Status] = frozenset({"done", "failed", "cancelled"})

Vector = tuple[float, ...]
Matrix = tuple[Vector, ...]


@dataclass(frozen=True)
class JobRecord:
    """A queued solve of one wrench on one component.

    Attributes
    ----------
    id : int
        Number of the job, increasing with the order of acceptance.
    component, fingerprint : str
        What is solved, and the state of the component the job was accepted for.
    wrench : tuple of 6 floats
        Force in N, then moment in N·m.
    status : str
        ``waiting``, ``running``, ``done``, ``failed`` or ``cancelled``.
    priority : int
        Waiting jobs of a higher priority start first; of equal ones the oldest.
    attempt : int
        Attempts started so far; the number of the current one while running.
    lost : int
        Attempts whose solver died since the job was accepted, reopened or retried.
    owner : str or None
        The dispatcher of the running attempt.
    created, started, finished : float or None
        Seconds since the epoch; ``started`` is that of the latest attempt.
    error : dict or None
        ``{"kind", "message", "remedy"}`` of a failed job.
    row : int or None
        ``seq`` of the row a done job gave.
    not_before : float or None
        Seconds since the epoch before which a waiting job is not started: its solver has died.
    asked_by : str
        Which call the job comes from, such as ``query`` or ``fill``.
    engine, task : str or None
        Which engine has the latest attempt, and the key it has it under.
    began : float or None
        Seconds since the epoch: when a solver was first seen at the running attempt. Until then
        it is submitted, no more.
    """

    id: int
    component: str
    fingerprint: str
    wrench: Vector
    status: Status
    priority: int
    attempt: int
    lost: int
    owner: str | None
    created: float
    started: float | None
    finished: float | None
    error: dict[str, str] | None
    row: int | None
    not_before: float | None = None
    asked_by: str = ""
    engine: str | None = None
    task: str | None = None
    began: float | None = None

    @property
    def seconds(self) -> float | None:
        """Time from the solver's first instruction to the end, s; None before the end."""
        start = self.began or self.started
        return max(0.0, self.finished - start) if self.finished and start else None

    @property
    def is_queued(self) -> bool:
        """True if it is in the queue of its engine: no solver has begun. `local` has no queue."""
        return (
            self.status == "running" and self.began is None and self.engine not in (None, "local")
        )

    @property
    def is_final(self) -> bool:
        """True if nothing more happens to the job by itself."""
        return self.status in FINAL


class Beat(NamedTuple):
    """The heartbeat of an owner of attempts: its engine, how many beats, the time of the last, s.

    An owner lives as long as the number grows. The time is for display: clocks can be set.
    """

    engine: str
    beat: int
    at: float


class OpenJob(NamedTuple):
    """A job that waits or runs, in short: its number, its wrench as `pack6` writes it, its call."""

    id: int
    wrench: bytes
    asked_by: str


@dataclass(frozen=True)
class NewRow:
    """A row to be inserted.

    Attributes
    ----------
    wrench, displacement : sequence of 6 floats
        N and N·m; m and rad (rotation vector). An output that was not measured is NaN; a solve's
        never is.
    source : str
        Where it comes from: ``"measured"``, ``"fea"`` ...
    compliance : 6 sequences of 6 floats, or None
        Tangent d(displacement)/d(wrench) at the wrench.
    uncertainty : sequence of 6 floats, or None
        95 % half-width of the displacement, m and rad; NaN where unknown, but not all six.
    origin : str
        Free note, such as the file name and line.
    fingerprint : str or None
        The setup that was solved; None: the one of the call.
    curvature : sequence of 56 floats, or None
        Third derivatives of the complementary energy by the loads, as `Rows.curvature` has them.
    """

    wrench: Sequence[float]
    displacement: Sequence[float]
    source: str = "measured"
    compliance: Sequence[Sequence[float]] | None = None
    uncertainty: Sequence[float] | None = None
    origin: str = ""
    fingerprint: str | None = None
    curvature: Sequence[float] | None = None


@dataclass(frozen=True, slots=True)
class LedgerRow:
    """A row of the ledger; ``seq`` is its id everywhere. Units as in `NewRow`."""

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


class RowEdit(NamedTuple):
    """A withdrawal or restoring: the row's content key, whether it is withdrawn, and when, s."""

    key: bytes
    withdrawn: bool
    created: float


@dataclass(frozen=True)
class RowChanges:
    """Changes of a component's rows after some seq, as one committed state.

    Attributes
    ----------
    rows : list of LedgerRow
        Rows to add: new ones, and old ones that were restored.
    gone : set of int
        Seqs to remove before: those withdrawn, or restored and so in `rows`.
    last_seq : int
        Up to here the changes are complete.
    whole : bool
        Whether these are all changes; else read on from `last_seq`.
    """

    rows: list[LedgerRow]
    gone: frozenset[int]
    last_seq: int
    whole: bool = True


@dataclass(frozen=True)
class Change:
    """The changes of one committed transaction of this process, for listeners.

    ``jobs`` are the numbers of the jobs it touched and ``rows`` counts the rows it added,
    withdrew or restored.
    """

    component: str
    jobs: tuple[int, ...] = ()
    rows: int = 0


class LedgerError(Exception):
    """Base of all errors of the ledger."""


class LedgerFileError(LedgerError):
    """The file is not a ledger this program can read: foreign, damaged or newer."""


class LedgerDamagedError(LedgerFileError):
    """The file is a ledger, or was one, and its bytes are not those that were written."""


class LedgerUnavailableError(LedgerError):
    """The ledger could not be read or written now (disk full, locked); nothing was changed."""


class LedgerFullError(LedgerUnavailableError):
    """The disk is full; nothing was changed."""


class UnknownJobError(LedgerError, LookupError):
    """There is no job with this number."""


class UnknownRowError(LedgerError, LookupError):
    """There is no row with this seq."""


class UnknownImportError(LedgerError, LookupError):
    """The component has no import of this number, or the import no such finding."""


class InvalidTransitionError(LedgerError):
    """The job's status does not allow this; see the table in ``service.ledger.states``."""


class StaleAttemptError(InvalidTransitionError):
    """The report is of an attempt that is not the job's running one; drop it."""


class DamagedRowError(LedgerError):
    """The row on the disk is damaged; it is used nowhere."""


class RowStatusError(LedgerError):
    """The row is withdrawn already, or is not."""


class BlockKeyError(LedgerError):
    """The key of a block of wrenches does not show whether the block was recorded."""


class ImportRunningError(LedgerError):
    """Another import has the ledger for too long; nothing was loaded."""


class UnknownVersionError(LedgerError, LookupError):
    """The table has no such version, or none yet."""
