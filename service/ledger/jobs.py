"""Jobs in SQL. Each function takes a connection inside the caller's transaction."""

import json
import secrets
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

from wrenchbook.service.actors import ANY, CALLER, NotPermittedError, acting_as
from wrenchbook.service.contract import NUMBER_LIMIT
from wrenchbook.service.ledger import rows
from wrenchbook.service.ledger.audit import note
from wrenchbook.service.ledger.connection import Connection
from wrenchbook.service.ledger.job_statistics import actor_for
from wrenchbook.service.ledger.packing import pack_vector, unpack_vector
from wrenchbook.service.ledger.records import (
    FINAL,
    Heartbeat,
    InvalidTransitionError,
    JobRecord,
    LedgerRow,
    OpenJob,
    Quota,
    QuotaError,
    StaleAttemptError,
    Status,
    UnknownJobError,
)
from wrenchbook.surrogate.table.rows import SOLVED

# Seconds for which a job waits after its solver's first, second and third death; the fourth ends
# it. The cause of deaths, such as a lack of memory, has often passed a minute or two later.
BACKOFF_SECONDS = (1.0, 10.0, 100.0)
# Random bytes of a task key: two of a million keys are equal with a probability of 1 in 500.
_TASK_BYTES = 6
# Age at which leases of owners that were killed without a job are deleted.
FORGOTTEN_SECONDS = 24 * 3600.0

# The state machine: the status after an event. A done job is reopened if its row is withdrawn.
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
    "remedy": "read log.txt in the attempt's folder. Often the memory ran out; use fewer solvers "
    "at a time or a coarser mesh, then retry the job",
}
_UNSTARTED: dict[str, Any] = {"owner": None, "started": None, "began": None}
_FRESH = {**_UNSTARTED, "lost": 0, "finished": None, "error": None, "not_before": None}

_NAMES = [field.name for field in fields(JobRecord)]
_COLUMNS = ", ".join(_NAMES)
_SET = ", ".join(f"{name} = :{name}" for name in _NAMES[_NAMES.index("status") :])


# -- accepting --------------------------------------------------------------------------------


def accept(
    db: Connection,
    component: str,
    fingerprint: str,
    wrench: Sequence[float] | bytes,
    *,
    priority: int = 0,
    reopen_cancelled: bool = True,
    asked_by: str = "",
    quota: Quota | None = None,
) -> tuple[JobRecord, bool]:
    """Return the job for this wrench (packed, or N and N·m), and whether it is new.

    There is one job for each (component, fingerprint, wrench), of any status. A waiting, running,
    done or failed one is returned unchanged (a waiting one with the higher of both priorities). A
    cancelled one waits again (unless `reopen_cancelled` is false), and so does a done one whose row
    was withdrawn or is damaged; it then belongs to the caller.

    Raises ValueError if the wrench is not six or more finite numbers, and QuotaError if the quota
    does not allow the job.
    """
    key = wrench if isinstance(wrench, bytes) else pack_vector(wrench)
    where = "WHERE component = ? AND fingerprint = ? AND wrench = ?"
    known = _select(db, where, (component, fingerprint, key))

    if not known:
        actor = actor_for(db, component, quota)
        added = db.execute(
            "INSERT INTO jobs (component, fingerprint, wrench, status, priority, attempt, lost,"
            " created, asked_by, actor) VALUES (?, ?, ?, 'waiting', ?, 0, 0, ?, ?, ?)",
            (component, fingerprint, key, priority, time.time(), asked_by, actor),
        )
        assert added.lastrowid is not None
        job = db.jobs[added.lastrowid] = get(db, added.lastrowid)
        after = {"status": job.status, "priority": priority, "asked_by": asked_by}
        note(db, "job.accept", job.id, component, after=after)
        return job, True

    job = known[0]
    if _lacks_its_row(db, job) or (job.status == "cancelled" and reopen_cancelled):
        caller = {"asked_by": asked_by, "actor": actor_for(db, component, quota)}
        job = _by_caller(db, job, "reopen", row=None, **caller, **_FRESH)
    if job.status == "waiting" and priority > job.priority:
        before = {"priority": job.priority}
        after = {"priority": priority}
        note(db, "job.priority", job.id, component, before=before, after=after)
        job = _save(db, replace(job, priority=priority))
    return job, False


def accept_many(
    db: Connection,
    component: str,
    fingerprint: str,
    wrenches: Iterable[Sequence[float] | bytes],
    **options: Any,
) -> list[JobRecord]:
    """Accept jobs, all or none; one job a wrench, in their order; options as of `accept`."""
    return [accept(db, component, fingerprint, wrench, **options)[0] for wrench in wrenches]


def accept_chosen(
    db: Connection,
    component: str,
    fingerprint: str,
    choose: Callable[[list[OpenJob]], Sequence[bytes]],
    **options: Any,
) -> list[JobRecord]:
    """Accept the packed wrenches that `choose` picks after reading the open jobs.

    Choosing and accepting are one transaction, so that a limit on open jobs holds for any number of
    processes. Wrenches beyond the actor's quota are left out.
    """
    accepted: list[JobRecord] = []
    for wrench in choose(open_jobs(db, component, fingerprint)):
        try:
            job, _ = accept(db, component, fingerprint, wrench, **options)
        except QuotaError:
            break
        accepted.append(job)
    return accepted


# -- attempts ---------------------------------------------------------------------------------


def next_waiting(db: Connection, most: int) -> list[JobRecord]:
    """Return the waiting jobs that start next, at most `most`, in the order of their start.

    The highest priority goes first. Among equal ones actors take turns: next is the oldest job of
    the actor whose last start is the longest ago.
    """
    due = (
        "WHERE status = 'waiting' AND actor = ? AND coalesce(not_before, 0) <= ?"
        " ORDER BY priority DESC, id LIMIT ?"
    )
    other = "SELECT min(actor) FROM jobs WHERE status = 'waiting' AND actor {} ?"
    last = "SELECT coalesce(max(started), 0) FROM jobs WHERE actor = ?"
    queues: dict[str, list[JobRecord]] = {}  # by actor: the next job is the last in the list
    # By actor: the position of its last job in this choice, 0 without one, and the time of its last
    # earlier start. The actor with the smaller pair is next.
    turns: dict[str, tuple[int, float]] = {}
    actor = db.execute(other.format(">="), ("",)).fetchone()[0]
    while actor is not None:
        if jobs := _select(db, due, (actor, time.time(), most)):
            queues[actor] = jobs[::-1]
            turns[actor] = 0, db.execute(last, (actor,)).fetchone()[0]
        actor = db.execute(other.format(">"), (actor,)).fetchone()[0]

    picked: list[JobRecord] = []
    while queues and len(picked) < most:
        heads = {actor: jobs[-1] for actor, jobs in queues.items()}
        actor = min(heads, key=lambda name: (-heads[name].priority, turns[name], heads[name].id))
        picked.append(queues[actor].pop())
        turns[actor] = len(picked), 0.0
        if not queues[actor]:
            del queues[actor]
    return picked


def claim(db: Connection, owner: str, engine: str, most: int) -> list[JobRecord]:
    """Start the next attempts of the next waiting jobs.

    Each gets a task key; it is submitted, not running, until `send_heartbeat` reports its begin.
    The claim counts as a heartbeat of the owner.
    """
    new = {"owner": owner, "engine": engine, "started": time.time(), "began": None}
    new |= {"finished": None, "not_before": None}

    def start(job: JobRecord) -> JobRecord:
        attempt = job.attempt + 1
        # Engines may serve many data directories, whose jobs have the same numbers.
        task = f"{job.id}-{attempt}-{secrets.token_hex(_TASK_BYTES)}"
        return _transition(db, job, "claim", attempt=attempt, task=task, **new)

    claimed = list(map(start, next_waiting(db, most)))
    if claimed:
        _write_heartbeat(db, owner, engine)
    return claimed


def adopt(db: Connection, job_id: int, attempt: int, previous: str, owner: str) -> JobRecord | None:
    """Take a running attempt over from a dead owner; None if another one was faster."""
    job = get(db, job_id)
    if (job.status, job.attempt, job.owner) != ("running", attempt, previous):
        return None
    return _transition(db, job, "adopt", owner=owner)


def send_heartbeat(
    db: Connection, owner: str, engine: str, began: Mapping[tuple[int, int], float] | None = None
) -> list[JobRecord]:
    """Write a heartbeat of `owner`, and return its submitted jobs that now run.

    `began` has, by job and attempt, the time at which its solver began, in seconds since the epoch;
    attempts that have ended, or have another owner now, are ignored.
    """
    _write_heartbeat(db, owner, engine)
    begun = []
    for (job_id, attempt), start in (began or {}).items():
        job = get(db, job_id)
        if (job.status, job.attempt, job.owner) == ("running", attempt, owner):
            begun.append(_transition(db, job, "begin", began=job.began or start))
    return begun


def commit(
    db: Connection,
    job_id: int,
    attempt: int,
    displacement: Sequence[float],
    *,
    source: str = SOLVED,
    origin: str = "",
    seconds: float | None = None,
    **known: Any,
) -> LedgerRow:
    """Write the row of a job and the job's end, exactly once.

    A job that is already done keeps its row, which is returned. Its solver took `seconds`, if
    known; other columns of `Rows` are `known` if not None.

    Raises StaleAttemptError if the attempt is not the running one, ValueError if a number is not
    finite or a length is wrong.
    """
    job = get(db, job_id)
    if job.row is not None:
        return rows.get(db, job.row)
    _check_attempt(job, attempt)
    now = time.time()
    row = rows.add_solved(db, job, displacement, source, origin, now, **known)
    note(db, "row.solve", row.seq, job.component, after={"job": job_id}, actor=job.actor)
    _transition(db, job, "commit", owner=None, row=row.seq, **_end(job, now, seconds))
    return row


def fail(
    db: Connection, job_id: int, attempt: int, error: dict[str, str], seconds: float | None = None
) -> JobRecord:
    """End a running attempt as failed; `error` has kind, message and remedy."""
    job = _check_attempt(get(db, job_id), attempt)
    note(db, "job.fail", job_id, job.component, after={"kind": error["kind"]}, actor=job.actor)
    return _transition(db, job, "fail", owner=None, error=error, **_end(job, time.time(), seconds))


def lose(db: Connection, job_id: int, attempt: int, cause: str = "") -> JobRecord:
    """Record that an attempt's solver died: the job waits, longer each time, and then fails.

    `cause` describes the death.
    """
    job = _check_attempt(get(db, job_id), attempt)
    now = time.time()
    if job.lost < len(BACKOFF_SECONDS):
        later = now + BACKOFF_SECONDS[job.lost]
        return _transition(db, job, "lose", lost=job.lost + 1, **_UNSTARTED, not_before=later)
    error = dict(SOLVER_DIED)
    if cause:
        error["message"] += f"; the last time: {cause}"
    note(db, "job.fail", job_id, job.component, after={"kind": error["kind"]}, actor=job.actor)
    return _transition(db, job, "give up", owner=None, lost=job.lost + 1, error=error, finished=now)


def release(db: Connection, job_id: int, attempt: int, *, delay: float = 0.0) -> JobRecord:
    """Let the job of an attempt that the dispatcher ends wait again; the attempt is not lost.

    The next attempt starts after `delay` seconds.
    """
    job = _check_attempt(get(db, job_id), attempt)
    later = time.time() + delay if delay else None
    return _transition(db, job, "release", not_before=later, **_UNSTARTED)


def renew(db: Connection, job_id: int, attempt: int, fingerprint: str) -> JobRecord:
    """Let a claimed job of an earlier setup wait again, for the setup with this fingerprint.

    If the new setup already has a job of this wrench, that job is accepted and this one cancelled.
    """
    job = _check_attempt(get(db, job_id), attempt)
    key = job.component, fingerprint, pack_vector(job.wrench)
    if _select(db, "WHERE component = ? AND fingerprint = ? AND wrench = ?", key):
        with acting_as(job.actor):
            accept(db, *key, priority=job.priority, asked_by=job.asked_by)
        return _transition(db, job, "cancel", owner=None, finished=time.time())
    db.execute("UPDATE jobs SET fingerprint = ? WHERE id = ?", (fingerprint, job_id))
    return _transition(db, get(db, job_id), "release", **_UNSTARTED)


def end_lease(db: Connection, owner: str) -> None:
    """Delete the lease of an owner that has ended; its attempts can then be adopted."""
    db.execute("DELETE FROM leases WHERE owner = ?", (owner,))
    db.execute(
        "DELETE FROM leases WHERE at < ?"
        " AND owner NOT IN (SELECT owner FROM jobs WHERE owner IS NOT NULL)",
        (time.time() - FORGOTTEN_SECONDS,),
    )


# -- on request -------------------------------------------------------------------------------


def cancel(db: Connection, job_id: int) -> JobRecord:
    """Cancel a waiting or running job; its dispatcher then stops the solver.

    Raises NotPermittedError for a job of another actor, unless the caller has the scope admin.
    """
    job = get(db, job_id)
    caller = CALLER.get()
    if not caller.admin and job.actor != caller.actor:
        raise NotPermittedError(
            f"job {job_id} belongs to {job.actor or 'an unknown actor'}, but {caller.actor} may "
            "cancel only its own jobs. For others use a key for admin"
        )
    if job.status == "cancelled":
        return job
    return _by_caller(db, job, "cancel", owner=None, finished=time.time())


def cancel_many(db: Connection, component: str | None, status: Status) -> int:
    """Cancel all jobs of a status (of one component), and return their number.

    The caller may cancel its own jobs, or with the scope admin all jobs of its components.

    Raises InvalidTransitionError if jobs of that status cannot be cancelled; then none is.
    """
    actor = None if CALLER.get().admin else CALLER.get().actor
    jobs = listed(db, component, status, limit=-1, actor=actor)  # no limit in SQLite
    return len([cancel(db, job.id) for job in jobs])


def retry(db: Connection, job_id: int, quota: Quota | None = None) -> JobRecord:
    """Let a failed or cancelled job wait again, as the caller's.

    Raises QuotaError if the quota does not allow it.
    """
    job = get(db, job_id)
    return _by_caller(db, job, "retry", actor=actor_for(db, job.component, quota), **_FRESH)


# -- reading ----------------------------------------------------------------------------------


def get(db: Connection, job_id: int) -> JobRecord:
    """Return a job by its number.

    Raises UnknownJobError if there is none.
    """
    jobs = _select(db, "WHERE id = ?", (job_id,))
    if not jobs:
        raise UnknownJobError(f"there is no job {job_id}; list all with GET /v1/jobs")
    return jobs[0]


def listed(
    db: Connection,
    component: str | None = None,
    status: Status | None = None,
    limit: int = 100,
    below: int | None = None,
    actor: str | None = None,
) -> list[JobRecord]:
    """Return jobs, newest first, with numbers below `below` if given.

    Jobs of components that the caller may not use are left out.
    """
    terms = {"component = ?": component, "status = ?": status, "id < ?": below, "actor = ?": actor}
    used = {term: value for term, value in terms.items() if value is not None}
    values = [*used.values()]
    if (patterns := CALLER.get().components) != ANY:
        used[f"({' OR '.join(['component GLOB ?'] * len(patterns))})"] = None
        values += patterns
    where = f"WHERE {' AND '.join(used)}" if used else ""
    return _select(db, f"{where} ORDER BY id DESC LIMIT ?", (*values, limit))


def open_jobs(db: Connection, component: str, fingerprint: str) -> list[OpenJob]:
    """Return the waiting and running jobs of one setup, oldest first."""
    records = db.execute(
        "SELECT id, wrench, asked_by FROM jobs WHERE component = ? AND fingerprint = ?"
        " AND status IN ('waiting', 'running') ORDER BY id",
        (component, fingerprint),
    )
    return [OpenJob(*record) for record in records]


def jobs_for(
    db: Connection, component: str, fingerprint: str, wrenches: Iterable[bytes]
) -> dict[bytes, JobRecord]:
    """Return the existing jobs for any of these packed wrenches, by wrench.

    Jobs whose row is withdrawn or damaged are left out, as they can be accepted again.
    """
    jobs: dict[bytes, JobRecord] = {}
    for marks, part in rows.in_parts(wrenches):
        tail = f"WHERE component = ? AND fingerprint = ? AND wrench IN ({marks})"
        same = _select(db, tail, (component, fingerprint, *part))
        jobs |= {pack_vector(job.wrench): job for job in same if not _lacks_its_row(db, job)}
    return jobs


def running(db: Connection) -> list[JobRecord]:
    """Return all running jobs, oldest first."""
    return _select(db, "WHERE status = 'running' ORDER BY id", ())


def unfinished(db: Connection, after: int | None = None) -> list[JobRecord]:
    """Return all open jobs, and with `after` also ended ones with a number above it."""
    newer = "" if after is None else " OR id > ?"
    where = f"WHERE status IN ('waiting', 'running'){newer} ORDER BY id"
    return _select(db, where, () if after is None else (after,))


def attempts(db: Connection, job_ids: Iterable[int]) -> dict[int, tuple[Status, int, float | None]]:
    """Return status, newest attempt and end (s since the epoch) of those jobs that exist."""
    states: dict[int, tuple[Status, int, float | None]] = {}
    for marks, part in rows.in_parts(number for number in job_ids if number < NUMBER_LIMIT):
        select = f"SELECT id, status, attempt, finished FROM jobs WHERE id IN ({marks})"
        states |= {job: tuple(state) for job, *state in db.execute(select, part)}
    return states


def ended(db: Connection, job_ids: Iterable[int]) -> set[int]:
    """Return which of some jobs neither wait nor run."""
    return {job for job, (status, *_) in attempts(db, job_ids).items() if status in FINAL}


def attempts_of(db: Connection, owner: str) -> set[tuple[int, int]]:
    """Return job and attempt of all attempts of `owner`; cheaper than `running`."""
    return set(db.execute("SELECT id, attempt FROM jobs WHERE owner = ?", (owner,)))


def leases(db: Connection) -> dict[str, Heartbeat]:
    """Return the heartbeat of each owner."""
    records = db.execute("SELECT owner, engine, beat, at FROM leases")
    return {owner: Heartbeat(*rest) for owner, *rest in records}


# -- shared -----------------------------------------------------------------------------------


def _transition(db: Connection, job: JobRecord, event: str, **changes: Any) -> JobRecord:
    """Write and return a job after an event.

    Raises InvalidTransitionError if its status does not allow the event.
    """
    status = TRANSITIONS.get((job.status, event))
    if status is None:
        calls = [name for name in ("cancel", "retry") if (job.status, name) in TRANSITIONS]
        possible = f"possible now: {', '.join(calls)}"
        if job.status == "done":
            row = f"DELETE /v1/components/{job.component}/table/{job.row}"
            possible = f"withdraw its row to solve again: {row}"
        raise InvalidTransitionError(f"cannot {event} job {job.id}: it is {job.status}; {possible}")
    return _save(db, replace(job, status=status, **changes))


def _by_caller(db: Connection, job: JobRecord, event: str, **changes: Any) -> JobRecord:
    """Write a job after an event of the caller, with its entry in the audit."""
    changed = _transition(db, job, event, **changes)
    before, after = ({"status": part.status, "actor": part.actor} for part in (job, changed))
    note(db, f"job.{event}", job.id, job.component, before=before, after=after)
    return changed


def _save(db: Connection, job: JobRecord) -> JobRecord:
    error = None if job.error is None else json.dumps(job.error)
    db.execute(f"UPDATE jobs SET {_SET} WHERE id = :id", {**vars(job), "error": error})
    db.jobs[job.id] = job
    return job


def _check_attempt(job: JobRecord, attempt: int) -> JobRecord:
    """Return the job of an attempt.

    Raises StaleAttemptError unless `attempt` is its running one.
    """
    if job.status != "running" or job.attempt != attempt:
        raise StaleAttemptError(
            f"job {job.id} is {job.status} at attempt {job.attempt}, so the report of attempt "
            f"{attempt} is ignored"
        )
    return job


def _end(job: JobRecord, now: float, seconds: float | None) -> dict[str, Any]:
    """Return the columns of a job that ends now, whose solver took `seconds` if known."""
    return {"finished": now, "began": job.began if seconds is None else now - seconds}


def _lacks_its_row(db: Connection, job: JobRecord) -> bool:
    """Return whether the row of a done job is withdrawn or damaged."""
    if job.row is None:
        return False
    return not rows.numbered(db, [job.row]) or rows.is_withdrawn(db, job.row)


def _write_heartbeat(db: Connection, owner: str, engine: str) -> None:
    db.execute(
        "INSERT INTO leases (owner, engine, beat, at) VALUES (?, ?, 1, ?)"
        " ON CONFLICT (owner) DO UPDATE SET engine = excluded.engine, beat = beat + 1,"
        " at = excluded.at",
        (owner, engine, time.time()),
    )


def _select(db: Connection, tail: str, values: Iterable[object]) -> list[JobRecord]:
    """Return the jobs of a SELECT's WHERE, ORDER BY and LIMIT."""
    jobs: list[JobRecord] = []
    for record in db.execute(f"SELECT {_COLUMNS} FROM jobs {tail}", tuple(values)):
        columns: dict[str, Any] = dict(zip(_NAMES, record, strict=True))
        columns["wrench"] = unpack_vector(columns["wrench"])
        error = columns["error"]
        columns["error"] = json.loads(error) if isinstance(error, str) else None
        jobs.append(JobRecord(**columns))
    return jobs
