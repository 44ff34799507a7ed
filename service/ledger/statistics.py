"""What the ledger says of all jobs together."""

from dataclasses import dataclass

from wrenchbook.service.ledger.jobs import counts
from wrenchbook.service.ledger.schema import Connection

# Upper ends of the histogram of solves, s: a small plate in a warm solver, a large nonlinear one.
SOLVE_EDGES = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0, 60.0, 300.0, 1800.0, 7200.0)
MOST_KINDS = 30  # of failures; a deck's own program may make up more, which are then one
_BEGIN = "coalesce(began, started)"  # without the time in the queue of a cluster
RECENT = 20  # solves that tell how long the next one takes


@dataclass(frozen=True)
class Statistics:
    """What there is of jobs.

    Attributes
    ----------
    jobs : dict of str to int
        How many are of each status.
    failures : dict of str to int
        Failed jobs by kind.
    solve_buckets : tuple of int
        Done solves in each bucket of `SOLVE_EDGES`, and those beyond the last.
    solve_seconds : float
        Time that the solvers of all done jobs took together, s; see `Job.seconds`.
    oldest_waiting : float or None
        When the oldest waiting job was accepted, seconds since the epoch.
    """

    jobs: dict[str, int]
    failures: dict[str, int]
    solve_buckets: tuple[int, ...]
    solve_seconds: float
    oldest_waiting: float | None


def statistics(db: Connection) -> Statistics:
    """Count all jobs, each read once."""
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
    return Statistics(counts(db, None), failures, tuple(buckets), seconds, oldest)


def recent_seconds(db: Connection, component: str) -> list[float]:
    """Return how long the newest done solves of a component took, s."""
    found = db.execute(
        f"SELECT finished - {_BEGIN} FROM jobs WHERE component = ? AND status = 'done'"
        f" AND finished >= {_BEGIN} ORDER BY id DESC LIMIT ?",
        (component, RECENT),
    )
    return [took for (took,) in found]
