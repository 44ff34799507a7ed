"""Numbers of jobs in SQL, and quotas on them. Each function takes a connection in a transaction."""

import time
from dataclasses import dataclass
from typing import NamedTuple

from wrenchbook.service.actors import CALLER, LOCAL, SERVER
from wrenchbook.service.ledger.connection import Connection
from wrenchbook.service.ledger.records import STATUSES, Quota, QuotaError

_QUEUED = "status = 'running' AND began IS NULL AND coalesce(engine, 'local') != 'local'"
# Upper ends of the histogram of solves, s: a small plate in a warm solver to a large nonlinear
# part.
SOLVE_EDGES = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0, 60.0, 300.0, 1800.0, 7200.0)
MAX_KINDS = 30  # kinds of failures; a deck's own program may add more, which count as "other"
_BEGIN = "coalesce(began, started)"  # the time in the queue of a cluster does not count
_RECENT = 20  # newest solves that estimate the time of the next
UNKNOWN_SECONDS = 60.0  # time of a solve for Retry-After before any job of the component has ended
DAY_SECONDS = 24 * 3600.0  # the period of a quota of solver seconds


@dataclass(frozen=True)
class Statistics:
    """Numbers of all jobs."""

    jobs: dict[str, int]  # by status
    failures: dict[str, int]  # by kind
    solve_buckets: tuple[int, ...]  # done solves up to each of `SOLVE_EDGES`, and those beyond
    solve_seconds: float  # total time of the solvers of all done jobs
    oldest_waiting: float | None  # when it was accepted, seconds since the epoch


class Ahead(NamedTuple):
    """Jobs of one component that start before another: their number, and s per solve."""

    component: str
    waiting: int
    seconds: float | None


def counts(db: Connection, component: str | None = None) -> dict[str, int]:
    """Return the number of jobs of each status; jobs in an engine's queue count as waiting."""
    where = "" if component is None else "WHERE component = :component"
    select = f"SELECT CASE WHEN {_QUEUED} THEN 'waiting' ELSE status END, count(*) FROM jobs"
    records = db.execute(f"{select} {where} GROUP BY 1", {"component": component})
    return dict.fromkeys(STATUSES, 0) | dict(records.fetchall())


def statistics(db: Connection) -> Statistics:
    """Return numbers of all jobs, in one committed state."""
    kinds = db.execute(
        "SELECT coalesce(json_extract(error, '$.kind'), 'unknown'), count(*) FROM jobs"
        " WHERE status = 'failed' GROUP BY 1 ORDER BY 2 DESC"
    ).fetchall()
    failures = {str(kind)[:60]: number for kind, number in kinds[:MAX_KINDS]}
    if others := sum(number for _, number in kinds[MAX_KINDS:]):
        failures["other"] = others
    steps = " ".join(f"WHEN took <= {edge!r} THEN {n}" for n, edge in enumerate(SOLVE_EDGES))
    # A clock that was set back lets a solve end before it began: it then took no time.
    solves = db.execute(
        f"SELECT CASE {steps} ELSE {len(SOLVE_EDGES)} END, count(*), sum(took) FROM"
        f" (SELECT max(finished - {_BEGIN}, 0.0) AS took FROM jobs WHERE status = 'done'"
        " AND started IS NOT NULL AND finished IS NOT NULL) GROUP BY 1"
    ).fetchall()
    buckets = [0] * (len(SOLVE_EDGES) + 1)
    for bucket, number, _ in solves:
        buckets[bucket] = number
    oldest = db.execute("SELECT min(created) FROM jobs WHERE status = 'waiting'").fetchone()[0]
    seconds = sum(took for _, _, took in solves)
    return Statistics(counts(db), failures, tuple(buckets), seconds, oldest)


def ahead(db: Connection, job_id: int, priority: int, now: float) -> list[Ahead]:
    """Return the waiting jobs that start before a job, by component, with the time of a solve."""
    # Before a job start as many jobs of each actor with its priority as there are jobs of its own
    # actor before it.
    records = db.execute(
        "WITH due AS (SELECT id, component, priority, row_number() OVER"
        " (PARTITION BY actor, priority ORDER BY id) AS turn FROM jobs WHERE status = 'waiting'"
        " AND coalesce(not_before, 0) <= :now OR id = :id),"
        " this AS (SELECT turn FROM due WHERE id = :id)"
        " SELECT component, count(*) FROM due, this WHERE priority > :priority"
        " OR (priority = :priority AND (due.turn, id) < (this.turn, :id)) GROUP BY component",
        {"priority": priority, "id": job_id, "now": now},
    ).fetchall()
    return [Ahead(name, number, solve_seconds(db, name)) for name, number in records]


def solve_seconds(db: Connection, component: str) -> float | None:
    """Return the mean time of the newest done solves of a component, s; None without any."""
    select = (
        f"SELECT avg(took) FROM (SELECT finished - {_BEGIN} AS took FROM jobs WHERE component = ?"
        f" AND status = 'done' AND finished >= {_BEGIN} ORDER BY id DESC LIMIT ?)"
    )
    return db.execute(select, (component, _RECENT)).fetchone()[0]


def actor_for(db: Connection, component: str, quota: Quota | None) -> str:
    """Return the caller, the actor of one more open job.

    Raises QuotaError if the quota does not allow it.
    """
    actor = CALLER.get().actor
    if quota is None or actor in (LOCAL, SERVER):
        return actor
    if quota.open_jobs is not None:
        open_ = "SELECT count(*) FROM jobs WHERE status IN ('waiting', 'running') AND actor = ?"
        if db.execute(open_, (actor,)).fetchone()[0] >= quota.open_jobs:
            raise QuotaError(
                f"{actor} would exceed its quota of {quota.open_jobs} open jobs (serve "
                "--actor-jobs). Nothing was queued; send fewer wrenches, wait, or cancel "
                "open jobs",
                solve_seconds(db, component) or UNKNOWN_SECONDS,
            )
    if quota.solver_seconds is not None:
        now = time.time()
        spent, first = db.execute(
            f"SELECT sum(max(0.0, coalesce(finished, :now) - {_BEGIN})), min(started) FROM jobs"
            " WHERE actor = :actor AND started > :now - :day",
            {"actor": actor, "now": now, "day": DAY_SECONDS},
        ).fetchone()
        if (spent or 0.0) >= quota.solver_seconds:
            raise QuotaError(
                f"{actor} has used {spent or 0.0:.0f} s of its quota of "
                f"{quota.solver_seconds:g} solver seconds in 24 hours (serve "
                "--actor-seconds). Nothing was queued; ask again later, or ask the operator "
                "for a larger quota",
                max(1.0, (first or now) + DAY_SECONDS - now),
            )
    return actor
