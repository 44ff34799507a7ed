"""An attempt that a dispatcher supervises, and what its engine needs to know of it."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from wrenchbook.service.jobs.attempt import attempt_folder, solver_began
from wrenchbook.service.jobs.engines.engine import Attempt
from wrenchbook.service.jobs.record_outcome import spec_of
from wrenchbook.service.ledger import JobRecord
from wrenchbook.service.library.component import estimate_of

# Times the estimated seconds: a load may take 4 times the iterations of a usual one, the estimate
# is right to a factor of two, and a machine may be slower or busier by as much again and more.
DEADLINE_MARGIN = 100.0
LEAST_DEADLINE = 3600.0  # s: a solve of seconds on a machine that is hardly there
# s, where no check has estimated anything: solves take hours, none is known to have taken a day.
UNKNOWN_DEADLINE = 24 * 3600.0


class Needs(NamedTuple):
    """Memory in bytes, None if unknown, and the seconds after which a solve hangs for certain."""

    memory: int | None
    deadline: float


def attempt_of(job: JobRecord, jobs_folder: Path) -> Attempt:
    """Return the latest attempt of a job as its engine knows it: by its task."""
    folder = attempt_folder(jobs_folder, job.id, job.attempt)
    task = job.task or f"{job.id}-{job.attempt}"
    return Attempt(task, folder, spec_of(job), job.priority)


def completed(
    attempt: Attempt,
    job: JobRecord,
    bundle: Path,
    deadline: float | None,
    *,
    estimate: bool = False,
) -> Attempt:
    """Add where the component lies and what a solve of it needs, with a deadline of one's own.

    With `estimate` the solve also estimates the solver's own error.
    """
    needs = needs_of(bundle)
    seconds = needs.deadline if deadline is None else deadline
    spec = replace(spec_of(job, bundle), estimate=estimate)
    return replace(attempt, spec=spec, memory=needs.memory, deadline=seconds)


def needs_of(bundle: Path) -> Needs:
    """Return what a solve of the bundle in a folder needs."""
    estimate = estimate_of(bundle)
    memory, seconds = estimate.get("memory_bytes"), estimate.get("nonlinear_seconds")
    if not isinstance(memory, int) or not isinstance(seconds, int | float):
        return Needs(None, UNKNOWN_DEADLINE)
    return Needs(memory, max(LEAST_DEADLINE, DEADLINE_MARGIN * seconds))


@dataclass
class SupervisedAttempt:
    """An attempt this dispatcher looks after.

    Attributes
    ----------
    taken : bool
        Whether an engine has taken it.
    witnessed : bool
        Whether its solver has lived in this dispatcher's time.
    adopted : bool
        Whether another dispatcher started it.
    leaving : bool
        Whether its answer is not needed any more.
    began : bool
        Whether a solver was seen at it.
    died : float or None
        When it was first seen dead, monotonic seconds.
    """

    job: JobRecord
    attempt: Attempt
    taken: bool = False
    witnessed: bool = True
    adopted: bool = False
    leaving: bool = False
    began: bool = False
    died: float | None = None

    @property
    def key(self) -> tuple[int, int]:
        """Job and attempt."""
        return self.job.id, self.job.attempt

    @property
    def folder(self) -> Path:
        """The attempt's folder."""
        return self.attempt.folder

    @property
    def is_pressing(self) -> bool:
        """Whether to poll it often: its end may come without an event, or something is due soon."""
        return self.adopted or self.leaving or self.died is not None

    @property
    def counts(self) -> bool:
        """Whether a solver that left nothing has died by itself, for all that is known."""
        return self.witnessed and (self.began or solver_began(self.folder))
