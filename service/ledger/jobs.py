"""Jobs in SQL: functions of the caller's transaction, and what a `Ledger` reads of jobs."""

import json
import logging
import time
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from wrenchbook.service.ledger import rows, states
from wrenchbook.service.ledger.connection import Connection
from wrenchbook.service.ledger.connections import Database
from wrenchbook.service.ledger.packing import pack_vector, unpack_vector
from wrenchbook.service.ledger.records import STATUSES, JobRecord, OpenJob, Status, UnknownJobError

_log = logging.getLogger(__name__)

_COLUMNS = (
    "id, component, fingerprint, wrench, status, priority, attempt, lost, owner, "
    "created, started, finished, error, row, not_before, asked_by, engine, task, began"
)
_QUEUED = "status = 'running' AND began IS NULL AND coalesce(engine, 'local') != 'local'"
_LEVELS = {"done": logging.INFO, "failed": logging.WARNING, "cancelled": logging.INFO}
# Upper ends of the histogram of solves, s: a small plate in a warm solver, a large nonlinear one.
SOLVE_EDGES = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0, 60.0, 300.0, 1800.0, 7200.0)
MOST_KINDS = 30  # of failures; a deck's own program may make up more, which are then one
_BEGIN = "coalesce(began, started)"  # without the time in the queue of a cluster
_RECENT = 20  # solves that estimate the time of the next one


@dataclass(frozen=True)
class Statistics:
    """Numbers of all jobs.

    Attributes
    ----------
    jobs : dict of str to int
        Jobs by status.
    failures : dict of str to int
        Failed jobs by kind.
    solve_buckets : tuple of int
        Done solves in each bucket of `SOLVE_EDGES`, and those beyond the last.
    solve_seconds : float
        Total time of the solvers of all done jobs, s; see `Job.seconds`.
    oldest_waiting : float or None
        When the oldest waiting job was accepted, seconds since the epoch.
    """

    jobs: dict[str, int]
    failures: dict[str, int]
    solve_buckets: tuple[int, ...]
    solve_seconds: float
    oldest_waiting: float | None


class Ahead(NamedTuple):
    """Jobs of one component that start before another: how many wait, how long one takes, s."""

    component: str
    waiting: int
    seconds: float | None


def accept(
    db: Connection,
    same: tuple[str, str, bytes],
    priority: int,
    reopen_cancelled: bool,
    asked_by: str = "",
) -> tuple[JobRecord, bool]:
    """Return the one job of (component, fingerprint, wrench), and whether it is new."""
    job = find_same(db, *same)
    if job is not None:
        lacks_row = lacks_its_row(db, job)
        again = states.accepted_again(job, priority, reopen_cancelled, lacks_row, asked_by)
        return save(db, again), False
    added = db.execute(
        "INSERT INTO jobs (component, fingerprint, wrench, status, priority, attempt, lost,"
        " created, asked_by) VALUES (?, ?, ?, 'waiting', ?, 0, 0, ?, ?)",
        (*same, priority, time.time(), asked_by),
    )
    assert added.lastrowid is not None
    return get(db, added.lastrowid), True


def lacks_its_row(db: Connection, job: JobRecord) -> bool:
    """Return whether the row that a done job gave is withdrawn or damaged."""
    return job.row is not None and not rows.is_usable(db, job.row)


def save(db: Connection, job: JobRecord) -> JobRecord:
    """Write all fields of a job that can change."""
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


def get(db: Connection, job_id: int) -> JobRecord:
    """Return a job by its number; raises UnknownJobError."""
    found = _select(db, "WHERE id = ?", (job_id,))
    if not found:
        raise UnknownJobError(f"there is no job {job_id}; GET /v1/jobs lists all")
    return found[0]


def find_same(db: Connection, component: str, fingerprint: str, wrench: bytes) -> JobRecord | None:
    """Return the one job there can be for this wrench, whatever its status."""
    where = "WHERE component = ? AND fingerprint = ? AND wrench = ?"
    found = _select(db, where, (component, fingerprint, wrench))
    return found[0] if found else None


def opened(db: Connection, component: str, fingerprint: str) -> list[OpenJob]:
    """Return the waiting and running jobs of one setup, oldest first."""
    found = db.execute(
        "SELECT id, wrench, asked_by FROM jobs WHERE component = ? AND fingerprint = ?"
        " AND status IN ('waiting', 'running') ORDER BY id",
        (component, fingerprint),
    )
    return [OpenJob(*record) for record in found]


def next_waiting(db: Connection, now: float, most: int) -> list[JobRecord]:
    """Return the waiting jobs that start next, at most `most`."""
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
) -> list[JobRecord]:
    """Return jobs, newest first, those of a number below `below` if given."""
    conditions = {"component": component, "status": status}
    used = {name: value for name, value in conditions.items() if value is not None}
    terms = [f"{name} = ?" for name in used] + ["id < ?"] * (below is not None)
    where = f"WHERE {' AND '.join(terms)}" if terms else ""
    start = () if below is None else (below,)
    return _select(db, f"{where} ORDER BY id DESC LIMIT ?", (*used.values(), *start, limit))


def log_jobs(touched: Iterable[JobRecord]) -> None:
    """Log the statuses of jobs after a commit; waiting and running ones at the level DEBUG."""
    if not _log.isEnabledFor(logging.WARNING):
        return
    for job in touched:
        level = _LEVELS.get(job.status, logging.DEBUG)
        if _log.isEnabledFor(level):
            about = {"job": job.id, "attempt": job.attempt, "component": job.component}
            _log.log(level, "job %d of %s: %s", job.id, job.component, _words(job), extra=about)


def _words(job: JobRecord) -> str:
    took = "" if job.seconds is None else f" after {job.seconds:.2f} s"
    if job.status == "done":
        return f"done{took}, row {job.row}"
    if job.error is not None:
        return f"failed{took}, {job.error.get('kind')}: {job.error.get('message')}"
    return f"{job.status}, attempt {job.attempt}" if job.attempt else job.status


class Jobs(Database):
    """The jobs of the ledger, read."""

    def job(self, job_id: int) -> JobRecord:
        """Return a job; raises UnknownJobError."""
        with self.reading() as db:
            return get(db, job_id)

    def jobs(
        self,
        component: str | None = None,
        status: Status | None = None,
        limit: int = 100,
        below: int | None = None,
    ) -> list[JobRecord]:
        """Return jobs, newest first, those of a number below `below` if given."""
        with self.reading() as db:
            return listed(db, component, status, limit, below)

    def open_jobs(self, component: str, fingerprint: str) -> list[OpenJob]:
        """Return the waiting and running jobs of one setup, oldest first."""
        with self.reading() as db:
            return opened(db, component, fingerprint)

    def jobs_for(
        self, component: str, fingerprint: str, wrenches: Iterable[bytes]
    ) -> dict[bytes, JobRecord]:
        """Return, by packed wrench, the jobs there are for any of these wrenches.

        Without those whose row is withdrawn or damaged: they can be accepted again.
        """
        found = {}
        with self.reading() as db:
            for marks, part in rows.in_parts(wrenches):
                tail = f"WHERE component = ? AND fingerprint = ? AND wrench IN ({marks})"
                same = _select(db, tail, (component, fingerprint, *part))
                found |= {
                    pack_vector(job.wrench): job for job in same if not lacks_its_row(db, job)
                }
        return found

    def running(self) -> list[JobRecord]:
        """Return all running jobs, oldest first."""
        with self.reading() as db:
            return _select(db, "WHERE status = 'running' ORDER BY id", ())

    def unfinished(self, after: int | None = None) -> list[JobRecord]:
        """Return all open jobs, and with `after` also those that ended of a number above it."""
        newer = "" if after is None else " OR id > ?"
        where = f"WHERE status IN ('waiting', 'running'){newer} ORDER BY id"
        with self.reading() as db:
            return _select(db, where, () if after is None else (after,))

    def ended(self, job_ids: Iterable[int]) -> set[int]:
        """Return those of some jobs that neither wait nor run."""
        found = self.attempts(job_ids)
        return {job for job, (status, *_) in found.items() if status not in ("waiting", "running")}

    def attempts(self, job_ids: Iterable[int]) -> dict[int, tuple[str, int, float | None]]:
        """Return status, newest attempt and time of the end of those of some jobs that exist."""
        found = {}
        with self.reading() as db:
            for marks, part in rows.in_parts(job_ids):
                select = f"SELECT id, status, attempt, finished FROM jobs WHERE id IN ({marks})"
                found |= {job: (status, n, end) for job, status, n, end in db.execute(select, part)}
        return found

    def counts(self, component: str | None = None) -> dict[str, int]:
        """Return the number of jobs of each status; those that `Job.is_queued` count as waiting."""
        with self.reading() as db:
            return _counts(db, component)

    def statistics(self) -> Statistics:
        """Return numbers of all jobs, in one committed state."""
        with self.reading() as db:
            return _statistics(db)

    def ahead(self, job_id: int, priority: int, now: float) -> list[Ahead]:
        """Return the waiting jobs that start before one, by component, with the time of a solve."""
        with self.reading() as db:
            found = db.execute(
                "SELECT component, count(*) FROM jobs WHERE status = 'waiting'"
                " AND (priority > :priority OR (priority = :priority AND id < :id))"
                " AND coalesce(not_before, 0) <= :now GROUP BY component",
                {"priority": priority, "id": job_id, "now": now},
            ).fetchall()
            return [Ahead(name, n, _mean_seconds(db, name)) for name, n in found]

    def solve_seconds(self, component: str) -> float | None:
        """Return the mean time of the newest done solves of a component, s; None without any."""
        with self.reading() as db:
            return _mean_seconds(db, component)


def _counts(db: Connection, component: str | None) -> dict[str, int]:
    where = "" if component is None else "WHERE component = ?"
    found = db.execute(
        f"SELECT CASE WHEN {_QUEUED} THEN 'waiting' ELSE status END, count(*)"
        f" FROM jobs {where} GROUP BY 1",
        () if component is None else (component,),
    )
    return dict.fromkeys(STATUSES, 0) | dict(found.fetchall())


def _statistics(db: Connection) -> Statistics:
    kinds = db.execute(
        "SELECT coalesce(json_extract(error, '$.kind'), 'unknown'), count(*) FROM jobs"
        " WHERE status = 'failed' GROUP BY 1 ORDER BY 2 DESC"
    ).fetchall()
    failures = {str(kind)[:60]: number for kind, number in kinds[:MOST_KINDS]}
    if rest := sum(number for _, number in kinds[MOST_KINDS:]):
        failures["other"] = rest
    steps = " ".join(f"WHEN took <= {edge!r} THEN {n}" for n, edge in enumerate(SOLVE_EDGES))
    # A clock that was set back makes a solve that ended before it began: it took no time.
    solves = db.execute(
        f"SELECT CASE {steps} ELSE {len(SOLVE_EDGES)} END, count(*), sum(took) FROM"
        f" (SELECT max(finished - {_BEGIN}, 0.0) AS took FROM jobs WHERE status = 'done'"
        " AND started IS NOT NULL AND finished IS NOT NULL) GROUP BY 1"
    ).fetchall()
    buckets = [0] * (len(SOLVE_EDGES) + 1)
    for place, number, _ in solves:
        buckets[place] = number
    oldest = db.execute("SELECT min(created) FROM jobs WHERE status = 'waiting'").fetchone()[0]
    seconds = sum(took for _, _, took in solves)
    return Statistics(_counts(db, None), failures, tuple(buckets), seconds, oldest)


def _mean_seconds(db: Connection, component: str) -> float | None:
    select = (
        f"SELECT avg(took) FROM (SELECT finished - {_BEGIN} AS took FROM jobs WHERE component = ?"
        f" AND status = 'done' AND finished >= {_BEGIN} ORDER BY id DESC LIMIT ?)"
    )
    return db.execute(select, (component, _RECENT)).fetchone()[0]


def _select(db: Connection, tail: str, values: Iterable[object]) -> list[JobRecord]:
    found = db.execute(f"SELECT {_COLUMNS} FROM jobs {tail}", tuple(values))
    return [_job(*record) for record in found]


def _job(*record: object) -> JobRecord:
    fields = list(record)
    wrench, error = fields[3], fields[12]
    assert isinstance(wrench, bytes)
    fields[3] = unpack_vector(wrench)
    fields[12] = json.loads(error) if isinstance(error, str) else None
    return JobRecord(*fields)  # pyright: ignore[reportArgumentType]
