"""Counts of answered queries, kept as plain integers.

The main call is answered in tens of microseconds, so what counts it may cost well below one: a
look into a dictionary, a bisection and three additions (0.3 µs). Prometheus' own counters take a
lock and a few microseconds each; they are made of these numbers when somebody asks for them.
"""

from __future__ import annotations

import json
import logging
import threading
from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.files.durable import write_whole_bytes
from surrogate.answer import NAMES

log = logging.getLogger(__name__)

FOLDER = "counts"
WRITE_S = 0.5  # between writes: a killed process loses the counts of that time

# Upper ends of the histogram, s: from a compiled single answer to a batch of a million.
EDGES = (2e-5, 5e-5, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 0.1, 1.0, 10.0)
_EDGES_US = tuple(1e6 * edge for edge in EDGES)
# Methods and coverages are few words of this program; no client can make one up.
_NONE = "none"


class Counts:
    """Queries by coverage and method, and how long the table took. For one thread, the loop's.

    Attributes
    ----------
    buckets : list of int
        Calls a bucket of `EDGES`, and those beyond the last.
    seconds : float
        Time that all calls took together, s.
    """

    def __init__(self) -> None:
        self._queries: dict[tuple[str, str | None], int] = {}
        self.buckets = [0] * (len(EDGES) + 1)
        self._microseconds = 0.0

    def add(self, coverage: str, method: str | None, elapsed_us: float) -> None:
        """Count one answer."""
        key = (coverage, method)
        queries = self._queries
        queries[key] = queries.get(key, 0) + 1
        self.buckets[bisect_left(_EDGES_US, elapsed_us)] += 1
        self._microseconds += elapsed_us

    def add_batch(self, coverage: NDArray[np.integer], method: str, us: float) -> None:
        """Count a batch: one call, `us` µs, and wrenches by the numbers of their coverage, (n,)."""
        for word, number in zip(NAMES, np.bincount(coverage, minlength=3).tolist(), strict=True):
            if number:
                self._queries[word, method] = self._queries.get((word, method), 0) + number
        self.buckets[bisect_left(_EDGES_US, us)] += 1
        self._microseconds += us

    def add_all(self, other: Counts) -> None:
        """Add what another has counted."""
        for key, number in other._queries.items():
            self._queries[key] = self._queries.get(key, 0) + number
        self.buckets = [one + more for one, more in zip(self.buckets, other.buckets, strict=True)]
        self._microseconds += other._microseconds

    def as_words(self) -> dict[str, Any]:
        """Return all of it as JSON has it."""
        queries = [[*key, number] for key, number in self._queries.copy().items()]
        return {"queries": queries, "buckets": list(self.buckets), "us": self._microseconds}

    @classmethod
    def of_words(cls, words: Mapping[str, Any]) -> Counts:
        """Return the counts of `as_words`."""
        found = cls()
        found._queries = {(cov, method): number for cov, method, number in words["queries"]}
        if len(words["buckets"]) == len(found.buckets):
            found.buckets = words["buckets"]
        found._microseconds = words["us"]
        return found

    @property
    def seconds(self) -> float:
        """Time that all calls took together, s."""
        return self._microseconds / 1e6

    def queries(self) -> Mapping[tuple[str, str], int]:
        """Return the number of queries by coverage and method."""
        counted = self._queries.copy()
        return {(coverage, method or _NONE): n for (coverage, method), n in counted.items()}

    def histogram(self) -> Sequence[tuple[str, float]]:
        """Return Prometheus' cumulative buckets, with their upper ends in seconds as words."""
        return cumulative(EDGES, list(self.buckets))


def cumulative(edges: Sequence[float], numbers: Sequence[int]) -> list[tuple[str, float]]:
    """Return how many are at most each edge, the last one being without end."""
    total, found = 0, []
    for edge, number in zip((*map(repr, edges), "+Inf"), numbers, strict=True):
        total += number
        found.append((edge, float(total)))
    return found


class SharedCounts:
    """The counts of this process and of those beside it.

    A scraper must never see a count go down, whichever process it meets: so each writes its own
    before it tells the sum, and one that is started again goes on from what it wrote last.

    Parameters
    ----------
    folder : path
        Made if there is none.
    number : int
        Which process this is; no other one has it.
    counts : Counts
        This process' own; what it counted before it was started again is added.
    listeners : callable
        How many follow the events here.
    """

    def __init__(
        self, folder: Path, number: int, counts: Counts, listeners: Callable[[], int]
    ) -> None:
        self._folder, self._own = folder, folder / f"{number}.json"
        self._counts, self._listeners = counts, listeners
        folder.mkdir(parents=True, exist_ok=True)
        counts.add_all(_read(self._own)[0])
        self._writing = threading.Lock()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._keep, name="counts", daemon=True)
        self._thread.start()

    def together(self) -> tuple[Counts, int]:
        """Return the sum of all processes' counts, and how many follow the events."""
        self._write()
        total, listeners = Counts(), 0
        for path in sorted(self._folder.glob("*.json")):
            found, more = _read(path)
            total.add_all(found)
            listeners += more
        return total, listeners

    def stop(self) -> None:
        """Write no longer."""
        self._stopping.set()
        self._thread.join()
        self._write()

    def _keep(self) -> None:
        while not self._stopping.wait(WRITE_S):
            self._write()

    def _write(self) -> None:
        with self._writing:
            told = {"counts": self._counts.as_words(), "listeners": self._listeners()}
            try:
                write_whole_bytes(self._own, json.dumps(told).encode(), durable=False)
            except OSError as error:
                log.debug("counts are not written: %s", error)


def _read(path: Path) -> tuple[Counts, int]:
    try:
        told = json.loads(path.read_bytes())
        return Counts.of_words(told["counts"]), told["listeners"]
    except (OSError, ValueError, KeyError, TypeError):
        return Counts(), 0
