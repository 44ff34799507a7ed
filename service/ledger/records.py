"""What the ledger hands out: jobs, rows and changes, as plain immutable values."""

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import blake2b
from typing import Literal, NamedTuple

Status = Literal["waiting", "running", "done", "failed", "cancelled"]
STATUSES: tuple[Status, ...] = ("waiting", "running", "done", "failed", "cancelled")
FINAL: frozenset[Status] = frozenset({"done", "failed", "cancelled"})

Vector6 = tuple[float, ...]
Matrix6 = tuple[Vector6, ...]

_SIX = struct.Struct("<6d")
_THIRTY_SIX = struct.Struct("<36d")


@dataclass(frozen=True)
class Job:
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
        The dispatcher that looks after the running attempt.
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
    wrench: Vector6
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
        """Time from the solver's first instruction to the end, s; None for one not ended."""
        start = self.began or self.started
        return max(0.0, self.finished - start) if self.finished and start else None

    @property
    def is_queued(self) -> bool:
        """True if the queue of its engine holds it: no solver has begun. `local` has no queue."""
        return (
            self.status == "running" and self.began is None and self.engine not in (None, "local")
        )

    @property
    def is_final(self) -> bool:
        """True if nothing more happens to the job by itself."""
        return self.status in FINAL


class Beat(NamedTuple):
    """The heartbeat of an owner of attempts: its engine, how many beats, the time of the last, s.

    It lives as long as the number grows. The time is for people: clocks can be set.
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
    """A row on its way into the ledger.

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
        The setup that was solved; None stands for the one the whole call is for.
    """

    wrench: Sequence[float]
    displacement: Sequence[float]
    source: str = "measured"
    compliance: Sequence[Sequence[float]] | None = None
    uncertainty: Sequence[float] | None = None
    origin: str = ""
    fingerprint: str | None = None


@dataclass(frozen=True, slots=True)
class LedgerRow:
    """A row of the ledger; ``seq`` is its id everywhere. Units as in `NewRow`."""

    seq: int
    component: str
    fingerprint: str
    source: str
    wrench: Vector6
    displacement: Vector6
    compliance: Matrix6 | None
    uncertainty: Vector6 | None
    job: int | None
    created: float
    origin: str


class RowEdit(NamedTuple):
    """A withdrawal or restoring: the row's content key, whether it is withdrawn, and when, s."""

    key: bytes
    withdrawn: bool
    created: float


@dataclass(frozen=True)
class RowChanges:
    """What happened to a component's rows after some seq, as one committed state.

    Attributes
    ----------
    rows : list of LedgerRow
        To be taken in: new ones, and old ones that were restored.
    gone : set of int
        Seqs to be dropped before: those withdrawn, or restored and so in `rows`.
    last_seq : int
        Up to here everything is told.
    whole : bool
        Whether that is all there is; else ask again from there.
    """

    rows: list[LedgerRow]
    gone: frozenset[int]
    last_seq: int
    whole: bool = True


@dataclass(frozen=True)
class Change:
    """What one committed transaction of this process changed; listeners receive it.

    ``jobs`` are the numbers of the jobs it touched and ``rows`` counts the rows it added,
    withdrew or restored.
    """

    component: str
    jobs: tuple[int, ...] = ()
    rows: int = 0


def pack6(values: Sequence[float], name: str = "wrench", *, partial: bool = False) -> bytes:
    """Return the canonical bytes of six finite floats: little-endian float64, no minus zero.

    Parameters
    ----------
    partial : bool
        Whether some of them, not all, may be NaN: not measured.

    Raises
    ------
    ValueError
        If there are not six numbers or one is not finite.
    """
    if len(values) != 6:
        raise ValueError(f"{name} needs 6 numbers, got {len(values)}")
    # One NaN for all: equal rows must have equal bytes.
    floats = [math.nan if value != value else float(value) + 0.0 for value in values]
    known = [value for value in floats if value == value] if partial else floats
    if not known or not all(map(math.isfinite, known)):
        raise ValueError(f"{name} must be finite, got {floats}")
    return _SIX.pack(*floats)


def unpack6(packed: bytes) -> Vector6:
    """Return the six floats of `pack6`."""
    return _SIX.unpack(packed)


def pack36(matrix: Sequence[Sequence[float]]) -> bytes:
    """Return the bytes of a 6x6 matrix by rows; raises ValueError as `pack6` does."""
    if len(matrix) != 6:
        raise ValueError(f"compliance needs 6 rows, got {len(matrix)}")
    return b"".join(pack6(line, "compliance row") for line in matrix)


def unpack36(packed: bytes) -> Matrix6:
    """Return the six rows of `pack36`."""
    flat = _THIRTY_SIX.unpack(packed)
    return tuple(flat[start : start + 6] for start in range(0, 36, 6))


def content_key(*parts: bytes) -> bytes:
    """Return 16 bytes that are the same only for the same parts."""
    digest = blake2b(digest_size=16)
    for part in parts:
        digest.update(len(part).to_bytes(4, "little"))
        digest.update(part)
    return digest.digest()


def seal(key: bytes, compliance: bytes | None, origin: str) -> bytes:
    """Return 16 bytes over what a row's key leaves out."""
    return content_key(key, compliance or b"", origin.encode())
