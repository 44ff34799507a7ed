"""What an engine is told of an attempt, and what it needs of a machine by its bundle's check."""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from wrenchbook.service.jobs.attempt import attempt_folder
from wrenchbook.service.jobs.engines.engine import Attempt
from wrenchbook.service.jobs.record_outcome import spec_of
from wrenchbook.service.ledger import Job
from wrenchbook.service.library.checked import estimate_of

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


def attempt_of(job: Job, jobs_folder: Path) -> Attempt:
    """Return the latest attempt of a job as its engine knows it: by its task."""
    folder = attempt_folder(jobs_folder, job.id, job.attempt)
    task = job.task or f"{job.id}-{job.attempt}"
    return Attempt(task, folder, spec_of(job), job.priority)


def completed(
    attempt: Attempt, job: Job, bundle: Path, deadline: float | None, *, estimate: bool = False
) -> Attempt:
    """Add where the component lies and what a solve of it needs, with a deadline of one's own.

    With `estimate` the solve also tells what the solver's own answers may be wrong by.
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
