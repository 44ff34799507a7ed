"""State machine of a job: one table of all transitions.

Pure functions from a job to the job after an event, without access to the ledger.
"""

import secrets
from dataclasses import replace

from wrenchbook.service.ledger.records import (
    InvalidTransitionError,
    JobRecord,
    StaleAttemptError,
    Status,
)

# Seconds a job waits after its solver's first, second and third death; the fourth ends it.
# The cause of deaths, such as a lack of memory, has often passed a minute or two later.
BACKOFF_SECONDS = (1.0, 10.0, 100.0)

TRANSITIONS: dict[tuple[Status, str], Status] = {
    ("waiting", "claim"): "running",
    ("waiting", "cancel"): "cancelled",
    ("running", "begin"): "running",
    ("running", "adopt"): "running",
    ("running", "commit"): "done",
    ("running", "fail"): "failed",
    ("running", "lose"): "waiting",
    ("running", "give up"): "failed",
    ("running", "release"): "waiting",
    ("running", "cancel"): "cancelled",
    ("failed", "retry"): "waiting",
    ("cancelled", "retry"): "waiting",
    ("cancelled", "reopen"): "waiting",
    ("done", "reopen"): "waiting",
    ("cancelled", "cancel"): "cancelled",
}

SOLVER_DIED = {
    "kind": "solver_died",
    "message": f"the solver ended without an answer {len(BACKOFF_SECONDS) + 1} times",
    "remedy": "read log.txt in the attempt's folder; often memory ran out: "
    "use fewer solvers at a time or a coarser mesh, then retry the job",
}


def claimed(job: JobRecord, owner: str, engine: str, now: float) -> JobRecord:
    """Return the job with a new attempt under `owner`, submitted to an engine."""
    attempt = job.attempt + 1
    # Engines may serve many data directories, whose jobs have the same numbers.
    task = f"{job.id}-{attempt}-{secrets.token_hex(6)}"
    fresh = {"started": now, "finished": None, "not_before": None, "began": None}
    where = {"owner": owner, "engine": engine, "task": task}
    return _moved(job, "claim", attempt=attempt, **where, **fresh)


def begun(job: JobRecord, at: float) -> JobRecord:
    """Return the running job with a solver at its attempt since `at`."""
    return _moved(job, "begin", began=at if job.began is None else job.began)


def adopted(job: JobRecord, owner: str) -> JobRecord:
    """Return the running job under another dispatcher; the attempt goes on."""
    return _moved(job, "adopt", owner=owner)


def committed(job: JobRecord, row: int, now: float, seconds: float | None = None) -> JobRecord:
    """Return the job done, with the row it gave; its solver took some seconds, if known."""
    return _moved(job, "commit", owner=None, row=row, **_end(job, now, seconds))


def failed(
    job: JobRecord, error: dict[str, str], now: float, seconds: float | None = None
) -> JobRecord:
    """Return the job failed, with the solver's reason."""
    return _moved(job, "fail", owner=None, error=error, **_end(job, now, seconds))


def lost(job: JobRecord, now: float, cause: str = "") -> JobRecord:
    """Return the job waiting for some time, or failed if its solver died too often.

    `cause` describes the latest death.
    """
    count = job.lost + 1
    if job.lost < len(BACKOFF_SECONDS):
        later = now + BACKOFF_SECONDS[job.lost]
        return _moved(job, "lose", owner=None, lost=count, not_before=later, **_UNSTARTED)
    error = dict(SOLVER_DIED)
    if cause:
        error["message"] += f"; the last time: {cause}"
    return _moved(job, "give up", owner=None, lost=count, error=error, finished=now)


def released(job: JobRecord, not_before: float | None = None) -> JobRecord:
    """Return the job waiting again after an attempt that was given back, not lost."""
    return _moved(job, "release", owner=None, not_before=not_before, **_UNSTARTED)


def cancelled(job: JobRecord, now: float) -> JobRecord:
    """Return the job cancelled."""
    finished = job.finished if job.status == "cancelled" else now
    return _moved(job, "cancel", owner=None, finished=finished)


def retried(job: JobRecord) -> JobRecord:
    """Return a failed or cancelled job waiting again, on request."""
    return _moved(job, "retry", **_FRESH)


def reopened(job: JobRecord) -> JobRecord:
    """Return a cancelled job, or one whose row is withdrawn, waiting again, on request."""
    return _moved(job, "reopen", row=None, **_FRESH)


def accepted_again(
    job: JobRecord, priority: int, reopen_cancelled: bool, lacks_row: bool, asked_by: str = ""
) -> JobRecord:
    """Return a job after its wrench was accepted once more.

    `lacks_row`: its row is withdrawn or damaged.
    """
    if lacks_row or (job.status == "cancelled" and reopen_cancelled):
        job = replace(reopened(job), asked_by=asked_by)
    if job.status == "waiting" and priority > job.priority:
        job = replace(job, priority=priority)
    return job


def check_attempt(job: JobRecord, attempt: int) -> None:
    """Raise StaleAttemptError unless `attempt` is the job's running one."""
    if job.status != "running" or job.attempt != attempt:
        raise StaleAttemptError(
            f"job {job.id} is {job.status} at attempt {job.attempt}; "
            f"a report of attempt {attempt} no longer counts"
        )


def _end(job: JobRecord, now: float, seconds: float | None) -> dict[str, object]:
    return {"finished": now, "began": job.began if seconds is None else now - seconds}


_UNSTARTED: dict[str, object] = {"started": None, "began": None}

_FRESH: dict[str, object] = {
    **_UNSTARTED,
    "lost": 0,
    "finished": None,
    "error": None,
    "not_before": None,
}


def _moved(job: JobRecord, event: str, **changes: object) -> JobRecord:
    status = TRANSITIONS.get((job.status, event))
    if status is None:
        allowed = sorted(name for before, name in TRANSITIONS if before == job.status)
        possible = f"possible now: {', '.join(allowed)}"
        if job.status == "done":
            possible = "it is final unless its row is withdrawn"
        raise InvalidTransitionError(f"job {job.id} is {job.status}: cannot {event} it; {possible}")
    return replace(job, status=status, **changes)  # pyright: ignore[reportArgumentType]
