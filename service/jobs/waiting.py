"""Why a job waits, and how long it may."""

import time
from dataclasses import dataclass

from wrenchbook.service.ledger import Job, Ledger


@dataclass(frozen=True)
class Waiting:
    """Why a job waits.

    Attributes
    ----------
    reason : str
    ahead : int
        Jobs that start before it: they wait here, or in the queue of a cluster.
    running : int
        Jobs that a solver works on now, wherever.
    slots : int
        Solves at once of the server that was asked.
    solve_s : float or None
        What the newest solves of its component took on average, s; None if there is none.
    expected_s : float or None
        When it is expected to start, s from now: all that is ahead of it shared by the slots, at
        what solves of those components took. None where a component has not been solved yet.
    """

    reason: str
    ahead: int
    running: int
    slots: int
    solve_s: float | None
    expected_s: float | None


def why_waiting(ledger: Ledger, job: Job, slots: int, trouble: str | None) -> Waiting:
    """Return why a waiting job waits.

    Parameters
    ----------
    ledger : Ledger
    job : Job
    slots : int
        Solves at once here; 0 if other processes solve.
    trouble : str or None
        What keeps all jobs from running.
    """
    now = time.time()
    ahead, taken = ledger.ahead(job.id, job.priority, now), ledger.running()
    queued = sum(one.is_queued for one in taken)
    before = sum(one.waiting for one in ahead) + queued
    running = len(taken) - queued
    pause = max(0.0, (job.not_before or 0.0) - now)
    means = {one.component: one.seconds for one in ahead}
    for name in {one.component for one in taken} - means.keys():
        means[name] = ledger.solve_seconds(name)
    # Of those that run, what is left: nothing of one that takes longer than the others did.
    left = [
        max(0.0, mean - max(0.0, now - (now if one.is_queued else one.began or one.started or now)))
        if (mean := means[one.component]) is not None
        else None
        for one in taken
    ]
    work = [one.waiting * one.seconds if one.seconds is not None else None for one in ahead]
    expected = None if not slots or trouble else _start(slots, left, work, pause)
    reason = _reason(job, before, running, slots, trouble, pause)
    own = ledger.solve_seconds(job.component)
    return Waiting(reason, before, running, slots, own, expected)


def _start(
    slots: int, left: list[float | None], work: list[float | None], pause: float
) -> float | None:
    """Return when a slot is free for it, s from now, as far as the times are known."""
    if not any(work) and None not in work and len(left) < slots:
        return pause
    known = [time for time in (*left, *work) if time is not None]
    if len(known) < len(left) + len(work):
        return None
    soonest = min((time for time in left if time is not None), default=0.0)
    return max(pause, sum(known) / slots if any(work) else soonest)


def _reason(
    job: Job, before: int, running: int, slots: int, trouble: str | None, pause: float
) -> str:
    if trouble:
        return f"jobs do not run: {trouble}"
    if pause:
        return f"its solver has died {job.lost} times; it is tried again in {pause:.0f} s"
    if not slots:
        return "this server runs no solvers; it waits for a `wrenchbook work` on the same data"
    if before:
        return f"{before} jobs are ahead of it and {running} run, {slots} at a time"
    if running >= slots:
        return f"it is the next; all {slots} solvers are busy"
    return "it is the next and starts now"
