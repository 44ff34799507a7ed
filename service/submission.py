"""The choice of solves that become jobs: of one wrench, of a fill, and of a simulator's loop.

A simulator in a loop of 1 kHz queries wrenches that hardly differ. Its solves are keyed after
rounding, join open jobs nearby, and are limited in number, so that the loop can continue without
flooding the queue. Loads on locked freedoms are in no job: see `Component.acting`.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from wrenchbook.service.ledger import JobRecord, Ledger, OpenJob, Quota, packed, unpacked
from wrenchbook.service.library.component import Component
from wrenchbook.service.library.library import Library
from wrenchbook.service.settings import Settings

Floats = NDArray[np.float64]

GRAINS = 1e6  # grains of a load's scale: two wrenches that round to the same grains are one job
JOIN_DISTANCE = 0.05  # part of a load's scale: an open job within this distance is joined
MAX_FAILED = 100_000  # failed jobs that a fill leaves out: more than any user lets happen
BLOCK = 65_536  # differences of wrenches computed at once, 3 MB


class NoSetupError(ValueError):
    """The component has no finite-element setup, so nothing can be solved for it."""


@dataclass(frozen=True)
class Placement:
    """The job of a wrench, or the reason why it has none: ``queue-limit`` or ``beyond-range``.

    `exact`: the job solves this wrench (as rounded), not one nearby. `refusal` is the reason as a
    text with the remedy.
    """

    job: JobRecord | None
    exact: bool
    reason: str = ""
    refusal: str = ""


class _Open:
    """The open jobs of a component's present setup as points of scaled loads."""

    def __init__(self, version: int, jobs: list[OpenJob], scale: Floats) -> None:
        self.version = version
        self.jobs = jobs
        self.queries = sum(job.asked_by == "query" for job in jobs)
        self._scaled = unpacked((job.wrench for job in jobs), len(scale)) / scale

    @cached_property
    def _tree(self) -> KDTree:
        return KDTree(self._scaled)

    def near(self, scaled: Floats, radius: float) -> NDArray[np.intp]:
        """Return the open job's index within `radius` of each point (n, inputs); -1 for none."""
        if not self.jobs or not radius:
            return np.full(len(scaled), -1)
        # The tree's bound is exclusive, but a job exactly at the radius is joined.
        bound = radius * (1 + 1e-12)
        _, place = self._tree.query(scaled, p=np.inf, distance_upper_bound=bound)
        return np.where(place < len(self.jobs), place, -1)


class Submission:
    """Turns wrenches into jobs of the ledger; at most `queue_limit` open ones come from queries.

    An actor's new jobs are within its `quota`: `accept` and `fill` raise QuotaError.
    """

    def __init__(
        self,
        ledger: Ledger,
        library: Library,
        queue_limit: int = Settings.queue_limit,
        quota: Quota | None = None,
    ) -> None:
        self._ledger = ledger
        self._library = library
        self.queue_limit = queue_limit
        self._quota = quota
        self._known: dict[tuple[str, str], _Open] = {}
        self._lock = threading.Lock()

    def accept(
        self, name: str, wrench: tuple[float, ...], *, urgent: bool, asked_by: str
    ) -> JobRecord:
        """Accept the job of exactly this wrench, whatever is queued.

        An urgent one, for which a caller waits, starts before those of a fill.

        Raises NoSetupError if the component cannot be solved.
        """
        component = self.solvable(name)
        acting = component.acting(np.array(wrench)).tolist()
        priority = 1 if urgent else 0
        setup = name, component.fingerprint
        more = {"priority": priority, "asked_by": asked_by, "quota": self._quota}
        return self._ledger.accept(*setup, acting, **more)[0]

    def fill(
        self, name: str, wrenches: Floats, *, urgent: bool = False, asked_by: str = "fill"
    ) -> list[JobRecord]:
        """Accept a job for each different wrench (n, inputs), without a limit.

        All are accepted in one transaction. Urgent ones start before those of a fill.

        Raises NoSetupError if the component cannot be solved.
        """
        component = self.solvable(name)
        return self._ledger.accept_many(
            name,
            component.fingerprint,
            dict.fromkeys(map(tuple, component.acting(wrenches).tolist())),
            priority=1 if urgent else 0,
            asked_by=asked_by,
            quota=self._quota,
        )

    def queue(self, name: str, wrenches: Floats) -> list[Placement]:
        """Find or accept the jobs of queries' wrenches (n, inputs).

        Each is rounded to whole grains, takes its existing job, else joins the open job within
        `JOIN_DISTANCE`, else becomes a job unless `queue_limit` of them are open. A linear
        component's open job serves every wrench: any solve gives its compliance.

        Raises NoSetupError if the component cannot be solved.
        """
        component = self.solvable(name)
        # Divided at the end, not multiplied: a decimal wrench then stays the same decimal.
        per_unit = GRAINS / component.load_range.scale
        rounded = np.round(component.acting(wrenches) * per_unit) / per_unit
        return self._place(component, rounded, np.inf if component.linear else JOIN_DISTANCE)

    def each(self, name: str, wrenches: Floats) -> list[Placement]:
        """Find or accept the job of exactly each wrench, (n, inputs), up to the limit.

        Raises NoSetupError if the component cannot be solved.
        """
        component = self.solvable(name)
        return self._place(component, component.acting(wrenches), 0.0)

    def pending_wrenches(self, name: str) -> Floats:
        """Return the wrenches (n, inputs) of open jobs and of failed ones: none is solved again."""
        waiting = self.open_wrenches(name)
        now = self._library[name].fingerprint
        jobs = self._ledger.jobs(name, "failed", limit=MAX_FAILED)
        failed = [job.wrench for job in jobs if job.fingerprint == now]
        return np.concatenate((waiting, np.array(failed).reshape(-1, waiting.shape[1])))

    def open_wrenches(self, name: str) -> Floats:
        """Return the wrenches (n, inputs) of open jobs."""
        part = self._library[name]
        waiting = (job.wrench for job in self._ledger.open_jobs(name, part.fingerprint))
        return unpacked(waiting, len(part.space.inputs))

    def solvable(self, name: str, why: str = "") -> Component:
        """Return a component for which solves can be queued; `why`: a part of the error's message.

        Raises NoSetupError for any other component.
        """
        component = self._library[name]
        if not component.has_fea:
            remedy = f"Load rows into it with: wrenchbook import {name} FILE"
            if why:
                why = f"The table does not cover the load: {why}. "
                remedy = f"{remedy}, or ask with on_thin 'estimate'"
            raise NoSetupError(
                f"{why}{name!r} is a table of measured rows without a finite-element setup, so it "
                f"cannot be solved. {remedy}."
            )
        return component

    def _place(self, component: Component, wrenches: Floats, radius: float) -> list[Placement]:
        """Place wrenches without rounding: their jobs, open ones within `radius`, new ones.

        New ones are chosen in the transaction that accepts them, so that the limit holds for any
        number of processes.
        """
        setup = (component.name, component.fingerprint)
        scale = component.load_range.scale
        keys = packed(wrenches)
        # A cancelled job can be requested again.
        jobs = {
            key: job
            for key, job in self._ledger.jobs_for(*setup, set(keys)).items()
            if job.status != "cancelled"
        }
        unplaced = [place for place, key in enumerate(keys) if key not in jobs]
        if not unplaced:
            return [Placement(jobs[key], exact=True) for key in keys]
        points = wrenches[unplaced] / scale
        candidates = self._open(*setup, scale)
        if (candidates.near(points, radius) < 0).any() and candidates.queries < self.queue_limit:
            new, candidates = self._accept_new(component, wrenches[unplaced], radius)
            jobs |= new
        records = {job.id: job for job in jobs.values()}
        joined: dict[int, OpenJob] = {}
        for place, near in zip(unplaced, candidates.near(points, radius).tolist(), strict=True):
            if near >= 0:
                joined[place] = job = candidates.jobs[near]
                if job.id not in records:
                    records[job.id] = self._ledger.job(job.id)
        why = "the caller's quota is used up"
        if candidates.queries >= self.queue_limit:
            why = f"{self.queue_limit} jobs of queries are open (serve --queue-limit)"
        refusal = f"no solve is queued: {why}; ask again when jobs have ended"
        placements = []
        for place, key in enumerate(keys):
            if key in jobs:
                placements.append(Placement(jobs[key], exact=True))
            elif place in joined:
                job = joined[place]
                placements.append(Placement(records[job.id], exact=job.wrench == key))
            else:
                placements.append(Placement(None, False, "queue-limit", refusal))
        return placements

    def _accept_new(
        self, component: Component, wrenches: Floats, radius: float
    ) -> tuple[dict[bytes, JobRecord], _Open]:
        """Accept jobs of wrenches that no open job is near, up to the limit.

        Returns the new jobs by wrench, and all open jobs.
        """
        scale = component.load_range.scale
        open_before = _Open(0, [], component.load_range.scale)

        def choose(open_jobs: list[OpenJob]) -> list[bytes]:
            """Pick new wrenches, in the ledger's transaction, by its open jobs at that time."""
            nonlocal open_before
            open_before = _Open(0, open_jobs, scale)
            points = wrenches / scale
            free = open_before.near(points, radius) < 0
            room = self.queue_limit - open_before.queries
            return packed(wrenches[free][spread(points[free], radius, room)])

        accepted = self._ledger.accept_chosen(
            component.name, component.fingerprint, choose, asked_by="query", quota=self._quota
        )
        keys = packed(np.array([job.wrench for job in accepted]).reshape(-1, len(scale)))
        new = dict(zip(keys, accepted, strict=True))
        opened = [OpenJob(job.id, key, "query") for key, job in new.items()]
        return new, _Open(0, open_before.jobs + opened, scale)

    def _open(self, name: str, fingerprint: str, scale: Floats) -> _Open:
        """Return the open jobs, read again only after a commit."""
        key = (name, fingerprint)
        version = self._ledger.version()
        with self._lock:
            known = self._known.get(key)
            if known is None or known.version != version:
                known = self._known[key] = _Open(version, self._ledger.open_jobs(*key), scale)
            return known


def spread(scaled: Floats, radius: float, count: int) -> list[int]:
    """Return at most `count` indices of points (n, inputs), none within `radius` of another.

    Every point is within `radius` of one of them unless `count` were picked.
    """
    picked: list[int] = []
    start = 0
    while start < len(scaled) and len(picked) < count:
        # In blocks: if points are far apart, the first few are enough and the rest is never read.
        stop = start + max(1, BLOCK // max(len(picked), 64))
        free = np.arange(start, min(stop, len(scaled)))
        if picked:
            apart = np.abs(scaled[free, None] - scaled[picked]).max(axis=2)
            free = free[(apart > radius).all(axis=1)]
        while len(free) and len(picked) < count:
            picked.append(int(free[0]))
            free = free[np.abs(scaled[free] - scaled[free[0]]).max(axis=1) > radius]
        start = stop
    return picked
