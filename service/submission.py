"""Which solves become jobs: one wrench's own, a fill's many, and those of a simulator's loop.

A simulator in a loop of 1 kHz asks for wrenches that hardly differ. Its solves are keyed after
rounding, join open jobs near by, and are limited in number, so that the loop can ask on without
flooding the queue. Loads on locked freedoms are in no job: see `Component.acting`.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from wrenchbook.service.ledger import JobRecord, Ledger, OpenJob, packed, unpacked
from wrenchbook.service.library.component import Component
from wrenchbook.service.library.library import Library

Floats = NDArray[np.float64]

GRAINS = 1e6  # to a load's scale: two wrenches that round to the same grains are one job
REACH = 0.05  # of a load's scale: an open job as near as this is joined
QUEUE_LIMIT = 64  # open jobs of a component that queries may have
MOST_FAILED = 100_000  # failed jobs that a fill leaves out: more than anyone lets happen
BLOCK = 65_536  # differences of wrenches looked at in one go, 3 MB


class NoSetupError(ValueError):
    """The component has no finite-element setup, so nothing can be solved for it."""


@dataclass(frozen=True)
class Placed:
    """The job of one wrench.

    Attributes
    ----------
    job : Job or None
        None where the limit of open jobs is reached.
    own : bool
        Whether it solves this very wrench (as rounded), not one near by.
    """

    job: JobRecord | None
    own: bool


class _Open:
    """The open jobs of a component's present setup as points of scaled loads."""

    def __init__(self, version: int, jobs: list[OpenJob], scale: Floats) -> None:
        self.version = version
        self.ids = [job.id for job in jobs]
        self.queries = _from_queries(jobs)
        self._wrenches = unpacked((job.wrench for job in jobs), len(scale))
        self._scaled = self._wrenches / scale

    @cached_property
    def _tree(self) -> KDTree:
        return KDTree(self._scaled)

    def near(self, scaled: Floats, reach: float) -> NDArray[np.intp]:
        """Return the place of the open job within reach of each, shape (n,); -1 for none."""
        if not self.ids or not reach:
            return np.full(len(scaled), -1)
        # The bound is exclusive; a job at just the reach is joined.
        bound = reach * (1 + 1e-12)
        _, place = self._tree.query(scaled, p=np.inf, distance_upper_bound=bound)
        return np.where(place < len(self.ids), place, -1)


class Submission:
    """Turn wrenches into jobs of the ledger.

    Parameters
    ----------
    ledger, library:
        Where jobs are accepted, and which components can be solved.
    queue_limit:
        Open jobs of a component that may come from queries.
    """

    def __init__(self, ledger: Ledger, library: Library, queue_limit: int = QUEUE_LIMIT) -> None:
        self._ledger = ledger
        self._library = library
        self.queue_limit = queue_limit
        self._seen: dict[tuple[str, str], _Open] = {}
        self._lock = threading.Lock()

    def own(
        self, name: str, wrench: tuple[float, ...], *, urgent: bool, asked_by: str
    ) -> JobRecord:
        """Accept the job of exactly this wrench's acting loads, N and N·m, whatever is queued.

        An urgent one, somebody waits for it, starts before those of a fill.

        Raises
        ------
        NoSetupError
            If the component has no finite-element setup.
        """
        component, priority = self.solvable(name), 1 if urgent else 0
        acting = component.acting(np.array(wrench)).tolist()
        return self._ledger.accept(
            name, component.fingerprint, acting, priority=priority, asked_by=asked_by
        )[0]

    def fill(
        self, name: str, wrenches: Floats, *, urgent: bool = False, asked_by: str = "fill"
    ) -> list[JobRecord]:
        """Accept a job for each different wrench, shape (n, 6), N and N·m, in one transaction.

        Urgent ones start before those of a fill. No limit holds: somebody has asked for them.

        Raises
        ------
        NoSetupError
            If the component has no finite-element setup.
        """
        component = self.solvable(name)
        return self._ledger.accept_many(
            name,
            component.fingerprint,
            dict.fromkeys(map(tuple, component.acting(wrenches).tolist())),
            priority=1 if urgent else 0,
            asked_by=asked_by,
        )

    def queue(self, name: str, wrenches: Floats) -> list[Placed]:
        """Find or accept the jobs of queries' wrenches, shape (n, 6), N and N·m.

        Each is rounded to whole grains, takes the job there is for it, else joins the open job
        within `REACH`, else becomes a job unless `queue_limit` of them are open. A linear
        component's one open job is within reach of every wrench: any solve tells all.

        Raises
        ------
        NoSetupError
            If the component has no finite-element setup.
        """
        component = self.solvable(name)
        wrenches = component.acting(wrenches)
        # Divided at the end, not multiplied: a decimal wrench then stays the decimal it is.
        per_unit = GRAINS / component.load_range.scale
        reach = np.inf if component.linear else REACH
        return self._place(component, np.round(wrenches * per_unit) / per_unit, reach)

    def each(self, name: str, wrenches: Floats) -> list[Placed]:
        """Find or accept each wrench's own exact job, shape (n, 6), N and N·m, up to the limit.

        Raises
        ------
        NoSetupError
            If the component has no finite-element setup.
        """
        component = self.solvable(name)
        return self._place(component, component.acting(wrenches), 0.0)

    def pending_wrenches(self, name: str) -> Floats:
        """Return the wrenches of a component's open and failed jobs, shape (n, 6), N and N·m.

        A failed one is not solved again by asking.
        """
        component = self._library[name]
        jobs = self._ledger.open_jobs(name, component.fingerprint)
        failed = [
            job.wrench
            for job in self._ledger.jobs(name, "failed", limit=MOST_FAILED)
            if job.fingerprint == component.fingerprint
        ]
        inputs = len(component.space.inputs)
        open_ones = unpacked((job.wrench for job in jobs), inputs)
        both = open_ones, np.array(failed).reshape(-1, inputs)
        return np.concatenate(both)

    def solvable(self, name: str) -> Component:
        """Return a component that solves can be queued for.

        Raises
        ------
        NoSetupError
            If it has no finite-element setup.
        """
        component = self._library[name]
        if not component.has_fea:
            raise NoSetupError(
                f"{name!r} has rows loaded from outside and no finite-element setup, so nothing "
                "can be solved for it. Load more rows, or ask with on_thin 'estimate'."
            )
        return component

    def _place(self, component: Component, wrenches: Floats, reach: float) -> list[Placed]:
        """Place wrenches as they are: their own jobs, open ones within reach, new ones."""
        keys, scale = packed(wrenches), component.load_range.scale
        jobs = self._found(component, set(keys))
        left = [place for place, key in enumerate(keys) if key not in jobs]
        joined = dict.fromkeys(left, -1)
        if left:
            scaled = wrenches[left] / scale
            open_jobs = self._open(component)
            near = open_jobs.near(scaled, reach)
            if (near < 0).any() and open_jobs.queries < self.queue_limit:
                self._accept(component, scaled[near < 0], wrenches[left][near < 0], reach)
                jobs |= self._found(component, {keys[place] for place in left})
                open_jobs = self._open(component)
                near = open_jobs.near(scaled, reach)
            ids = [*open_jobs.ids, -1]
            joined = dict(zip(left, (ids[one] for one in near.tolist()), strict=True))
        others = {number: self._ledger.job(number) for number in {*joined.values()} - {-1}}
        return [
            Placed(jobs[key], True) if key in jobs else Placed(others.get(joined[place]), False)
            for place, key in enumerate(keys)
        ]

    def _found(self, component: Component, keys: set[bytes]) -> dict[bytes, JobRecord]:
        """Return the jobs there are for wrenches; a cancelled one is to be asked for anew."""
        found = self._ledger.jobs_for(component.name, component.fingerprint, keys)
        return {key: job for key, job in found.items() if job.status != "cancelled"}

    def _open(self, component: Component) -> _Open:
        """Return the open jobs; read again only when something was committed."""
        key, version = (component.name, component.fingerprint), self._ledger.version()
        with self._lock:
            seen = self._seen.get(key)
            if seen is None or seen.version != version:
                jobs = self._ledger.open_jobs(*key)
                seen = self._seen[key] = _Open(version, jobs, component.load_range.scale)
            return seen

    def _accept(self, component: Component, scaled: Floats, wrenches: Floats, reach: float) -> None:
        """Accept jobs such that each of the wrenches has one within reach, up to the limit."""
        scale = component.load_range.scale

        def choose(jobs: list[OpenJob]) -> list[bytes]:
            room = self.queue_limit - _from_queries(jobs)
            free = _Open(0, jobs, scale).near(scaled, reach) < 0
            return packed(wrenches[free][spread(scaled[free], reach, room)])

        self._ledger.accept_chosen(component.name, component.fingerprint, choose, asked_by="query")


def spread(scaled: Floats, reach: float, most: int) -> list[int]:
    """Pick points, first come first, that no two are within reach of each other.

    Parameters
    ----------
    scaled : ndarray, shape (n, 6), dimensionless
        Loads by their scale.
    reach : float
        Largest difference of a load, of its scale.
    most : int
        How many to pick at most.

    Returns
    -------
    list of int
        Places; every point is within reach of one of them unless `most` were picked.
    """
    picked: list[int] = []
    start = 0
    while start < len(scaled) and len(picked) < most:
        # In blocks: where points lie apart, the first few are enough and the rest is never read.
        stop = start + max(1, BLOCK // max(len(picked), 64))
        left = np.arange(start, min(stop, len(scaled)))
        if picked:
            apart = np.abs(scaled[left, None] - scaled[picked]).max(axis=2)
            left = left[(apart > reach).all(axis=1)]
        while len(left) and len(picked) < most:
            picked.append(int(left[0]))
            left = left[np.abs(scaled[left] - scaled[left[0]]).max(axis=1) > reach]
        start = stop
    return picked


def _from_queries(jobs: list[OpenJob]) -> int:
    return sum(job.asked_by == "query" for job in jobs)
