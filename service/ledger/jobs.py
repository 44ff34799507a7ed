"""SQL of the jobs. Each function takes a connection inside the caller's transaction."""

import json
import time
from collections.abc import Iterable

from wrenchbook.service.ledger import rows, states
from wrenchbook.service.ledger.errors import UnknownJobError
from wrenchbook.service.ledger.records import STATUSES, Job, OpenJob, pack6, unpack6
from wrenchbook.service.ledger.schema import Connection

MOST_VALUES = 500  # of one statement; SQLite before 3.32 takes 999

_COLUMNS = (
    "id, component, fingerprint, wrench, status, priority, attempt, lost, owner, "
    "created, started, finished, error, row, not_before, asked_by, engine, task, began"
)


_QUEUED = "status = 'running' AND began IS NULL AND coalesce(engine, 'local') != 'local'"


def accept(
    db: Connection,
    same: tuple[str, str, bytes],
    priority: int,
    reopen_cancelled: bool,
    asked_by: str = "",
) -> tuple[Job, bool]:
    """Return the one job of (component, fingerprint, wrench), and whether it is new."""
    job = find_same(db, *same)
    if job is not None:
        lacks_row = lacks_its_row(db, job)
        again = states.asked_again(job, priority, reopen_cancelled, lacks_row, asked_by)
        return save(db, again), False
    added = db.execute(
        "INSERT INTO jobs (component, fingerprint, wrench, status, priority, attempt, lost,"
        " created, asked_by) VALUES (?, ?, ?, 'waiting', ?, 0, 0, ?, ?)",
        (*same, priority, time.time(), asked_by),
    )
    assert added.lastrowid is not None
    return get(db, added.lastrowid), True


def lacks_its_row(db: Connection, job: Job) -> bool:
    """Return whether the row that a done job gave is withdrawn or damaged."""
    return job.row is not None and not rows.is_usable(db, job.row)


def save(db: Connection, job: Job) -> Job:
    """Write all of a job that can change."""
    error = None if job.error is None else json.dumps(job.error)
    now = (job.status, job.priority, job.attempt, job.lost, job.owner)
    times, where = (job.started, job.finished), (job.engine, job.task, job.began)
    db.execute(
        "UPDATE jobs SET status = ?, priority = ?, attempt = ?, lost = ?, owner = ?,"
        " started = ?, finished = ?, error = ?, row = ?, not_before = ?, asked_by = ?,"
        " engine = ?, task = ?, began = ? WHERE id = ?",
        (*now, *times, error, job.row, job.not_before, job.asked_by, *where, job.id),
    )
    return job


def get(db: Connection, job_id: int) -> Job:
    """Return a job by its number; raises UnknownJobError."""
    found = _select(db, "WHERE id = ?", (job_id,))
    if not found:
        raise UnknownJobError(f"there is no job {job_id}; GET /v1/jobs lists all")
    return found[0]


def find_same(db: Connection, component: str, fingerprint: str, wrench: bytes) -> Job | None:
    """Return the one job there can be for this wrench, whatever its status."""
    where = "WHERE component = ? AND fingerprint = ? AND wrench = ?"
    found = _select(db, where, (component, fingerprint, wrench))
    return found[0] if found else None


def find_many(
    db: Connection, component: str, fingerprint: str, wrenches: Iterable[bytes]
) -> dict[bytes, Job]:
    """Return, by packed wrench, the jobs there are for any of these wrenches.

    Without those that gave a row which is withdrawn or damaged: they are to be asked anew.
    """
    wanted, found = list(wrenches), {}
    for start in range(0, len(wanted), MOST_VALUES):
        part = wanted[start : start + MOST_VALUES]
        marks = ", ".join("?" * len(part))
        tail = f"WHERE component = ? AND fingerprint = ? AND wrench IN ({marks})"
        same = _select(db, tail, (component, fingerprint, *part))
        found |= {pack6(job.wrench): job for job in same if not lacks_its_row(db, job)}
    return found


def opened(db: Connection, component: str, fingerprint: str) -> list[OpenJob]:
    """Return the waiting and running jobs of one setup, oldest first."""
    found = db.execute(
        "SELECT id, wrench, asked_by FROM jobs WHERE component = ? AND fingerprint = ?"
        " AND status IN ('waiting', 'running') ORDER BY id",
        (component, fingerprint),
    )
    return [OpenJob(*record) for record in found]


def next_waiting(db: Connection, now: float, most: int) -> list[Job]:
    """Return the waiting jobs that are to start next, at most so many."""
    where = (
        "WHERE status = 'waiting' AND coalesce(not_before, 0) <= ?"
        " ORDER BY priority DESC, id LIMIT ?"
    )
    return _select(db, where, (now, most))


def listed(
    db: Connection,
    component: str | None,
    status: str | None,
    limit: int,
    below: int | None = None,
) -> list[Job]:
    """Return jobs, newest first, those of a number below `below` if given."""
    conditions = {"component": component, "status": status}
    used = {name: value for name, value in conditions.items() if value is not None}
    terms = [f"{name} = ?" for name in used] + ["id < ?"] * (below is not None)
    where = f"WHERE {' AND '.join(terms)}" if terms else ""
    start = () if below is None else (below,)
    return _select(db, f"{where} ORDER BY id DESC LIMIT ?", (*used.values(), *start, limit))


def running(db: Connection) -> list[Job]:
    """Return all running jobs, oldest first."""
    return _select(db, "WHERE status = 'running' ORDER BY id", ())


def unfinished(db: Connection, after: int | None) -> list[Job]:
    """Return all jobs that wait or run, and those that ended of a number above `after`."""
    newer = "" if after is None else " OR id > ?"
    where = f"WHERE status IN ('waiting', 'running'){newer} ORDER BY id"
    return _select(db, where, () if after is None else (after,))


def ended(db: Connection, job_ids: Iterable[int]) -> set[int]:
    """Return those of some jobs that neither wait nor run."""
    wanted, found = list(job_ids), set()
    for start in range(0, len(wanted), MOST_VALUES):
        part = wanted[start : start + MOST_VALUES]
        where = f"id IN ({', '.join('?' * len(part))}) AND status NOT IN ('waiting', 'running')"
        found |= {one for (one,) in db.execute(f"SELECT id FROM jobs WHERE {where}", part)}
    return found


def counts(db: Connection, component: str | None) -> dict[str, int]:
    """Return the number of jobs of each status; those that `Job.is_queued` count as waiting."""
    where = "" if component is None else "WHERE component = ?"
    found = db.execute(
        f"SELECT CASE WHEN {_QUEUED} THEN 'waiting' ELSE status END, count(*)"
        f" FROM jobs {where} GROUP BY 1",
        () if component is None else (component,),
    )
    return dict.fromkeys(STATUSES, 0) | dict(found.fetchall())


def _select(db: Connection, tail: str, values: Iterable[object]) -> list[Job]:
    found = db.execute(f"SELECT {_COLUMNS} FROM jobs {tail}", tuple(values))
    return [_job(*record) for record in found]


def _job(*record: object) -> Job:
    fields = list(record)
    wrench, error = fields[3], fields[12]
    assert isinstance(wrench, bytes)
    fields[3] = unpack6(wrench)
    fields[12] = json.loads(error) if isinstance(error, str) else None
    return Job(*fields)  # pyright: ignore[reportArgumentType]
