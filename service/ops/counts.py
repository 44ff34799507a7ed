"""Counts of answered queries as plain integers, of this process and of all web workers.

A single query takes tens of microseconds and its count 0.3 µs: a dictionary access, a bisection and
three additions. Prometheus' counters take a lock and a few microseconds; `metrics` makes them from
these numbers on request.
"""

from __future__ import annotations

import json
import logging
import os
import threading
from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wrenchbook.service.contract import COVERAGE
from wrenchbook.service.files.durable import write_whole_bytes
from wrenchbook.service.files.lock import take

log = logging.getLogger(__name__)

FOLDER = "counts"
WRITE_S = 0.5  # between writes: a killed process loses the counts of that time

# Upper ends of the histogram, s: from a single answer to a batch of a million.
EDGES = (2e-5, 5e-5, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 0.1, 1.0, 10.0)
# Upper ends of the histogram of requests by route, s: from the fast path to a long poll.
REQUEST_EDGES = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 0.1, 0.3, 1.0, 3.0, 10.0, 60.0)
_EDGES_US = tuple(1e6 * edge for edge in EDGES)
_NONE = "none"


class Counts:
    """Queries by coverage and method, and their times. Not thread-safe: for the event loop.

    Attributes
    ----------
    buckets : list of int
        Calls in each bucket of `EDGES`, and beyond the last edge.
    seconds : float
        Total time of all calls, s.
    """

    def __init__(self) -> None:
        self._queries: dict[tuple[str, str | None], int] = {}
        self.buckets = [0] * (len(EDGES) + 1)
        self._microseconds = 0.0
        self._requests: dict[tuple[str, str, int], list[float]] = {}

    def add(self, coverage: str, method: str | None, elapsed_us: float) -> None:
        """Count one answer."""
        key = (coverage, method)
        queries = self._queries
        queries[key] = queries.get(key, 0) + 1
        self.buckets[bisect_left(_EDGES_US, elapsed_us)] += 1
        self._microseconds += elapsed_us

    def add_batch(self, coverage: NDArray[np.integer], method: str, us: float) -> None:
        """Count a batch of wrenches with coverage numbers (n,), as one call of `us` µs."""
        for word, number in zip(COVERAGE, np.bincount(coverage, minlength=3).tolist(), strict=True):
            if number:
                self._queries[word, method] = self._queries.get((word, method), 0) + number
        self.buckets[bisect_left(_EDGES_US, us)] += 1
        self._microseconds += us

    def add_request(self, route: str, method: str, status: int, seconds: float) -> None:
        """Count an HTTP request by its route's template, method and status."""
        key = (route, method, status)
        found = self._requests.get(key)
        if found is None:
            found = self._requests[key] = [0.0] * (len(REQUEST_EDGES) + 2)
        found[bisect_left(REQUEST_EDGES, seconds)] += 1
        found[-1] += seconds

    def add_all(self, other: Counts) -> None:
        """Add the counts of another process."""
        for key, number in other._queries.items():
            self._queries[key] = self._queries.get(key, 0) + number
        self.buckets = [one + more for one, more in zip(self.buckets, other.buckets, strict=True)]
        self._microseconds += other._microseconds
        for request, found in other._requests.items():
            own = self._requests.get(request, [0.0] * len(found))
            self._requests[request] = [one + more for one, more in zip(own, found, strict=True)]

    def as_json(self) -> dict[str, Any]:
        """Return the counts as JSON values."""
        queries = [[*key, number] for key, number in self._queries.copy().items()]
        requests = [[*key, list(found)] for key, found in self._requests.copy().items()]
        return {
            "queries": queries,
            "buckets": list(self.buckets),
            "us": self._microseconds,
            "requests": requests,
        }

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Counts:
        """Return the counts of `as_json`."""
        found = cls()
        found._queries = {(cov, method): number for cov, method, number in values["queries"]}
        if len(values["buckets"]) == len(found.buckets):
            found.buckets = values["buckets"]
        found._microseconds = values["us"]
        found._requests = {
            (route, method, status): numbers
            for route, method, status, numbers in values["requests"]
        }
        return found

    @property
    def seconds(self) -> float:
        """Total time of all calls, s."""
        return self._microseconds / 1e6

    def queries(self) -> Mapping[tuple[str, str], int]:
        """Return the number of queries by coverage and method."""
        counted = self._queries.copy()
        return {(coverage, method or _NONE): n for (coverage, method), n in counted.items()}

    def requests(self) -> Mapping[tuple[str, str, int], Sequence[float]]:
        """Return requests by route, method and status: the buckets of REQUEST_EDGES, then s."""
        return self._requests.copy()

    def histogram(self) -> Sequence[tuple[str, float]]:
        """Return Prometheus' cumulative buckets, with their upper ends in seconds as text."""
        return cumulative(EDGES, list(self.buckets))


def cumulative(edges: Sequence[float], numbers: Sequence[float]) -> list[tuple[str, float]]:
    """Return cumulative counts by upper edge, the last one infinite."""
    total, found = 0, []
    for edge, number in zip((*map(repr, edges), "+Inf"), numbers, strict=True):
        total += number
        found.append((edge, float(total)))
    return found


class SharedCounts:
    """The counts of all processes of a server, each written to a file by its process.

    No scrape of any process may see a count go down: each process writes its own counts before it
    returns the sum, and continues from its file after a restart.

    Parameters
    ----------
    folder : path
        Created if missing.
    counts : Counts
        Counts of this process; those before a restart are added.
    listeners : callable
        Returns the number of event listeners of this process.
    """

    def __init__(self, folder: Path, counts: Counts, listeners: Callable[[], int]) -> None:
        self._counts, self._listeners = counts, listeners
        number = 0
        with suppress(OSError):  # on a read-only disk counts are not shared
            folder.mkdir(parents=True, exist_ok=True)
            number = _free_number(folder)
        self._folder, self._own = folder, folder / f"{number}.json"
        counts.add_all(_read(self._own)[0])
        self._writing = threading.Lock()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._keep, name="counts", daemon=True)
        self._thread.start()

    def together(self) -> tuple[Counts, int, dict[str, int]]:
        """Return the counts, the event listeners and the pids, by number, of all processes."""
        self._write()
        total, listeners, pids = Counts(), 0, {}
        for path in sorted(self._folder.glob("*.json")):
            found, more, pid = _read(path)
            total.add_all(found)
            listeners += more
            if pid:
                pids[path.stem] = pid
        return total, listeners, pids

    def stop(self) -> None:
        """Write once more and end the thread."""
        self._stopping.set()
        self._thread.join()
        self._write()

    def _keep(self) -> None:
        while not self._stopping.wait(WRITE_S):
            self._write()

    def _write(self) -> None:
        with self._writing:
            values = {
                "counts": self._counts.as_json(),
                "listeners": self._listeners(),
                "pid": os.getpid(),
            }
            try:
                write_whole_bytes(self._own, json.dumps(values).encode(), durable=False)
            except OSError as error:
                log.debug("counts are not written: %s", error)


def _free_number(folder: Path) -> int:
    """Return the lowest number that no other process has, locked until this process ends."""
    return next(number for number in count(1) if take(folder / f"{number}.lock", 0.0) is not None)


def _read(path: Path) -> tuple[Counts, int, int]:
    """Return the counts, the event listeners and the pid of a process; zeros if unreadable."""
    try:
        values = json.loads(path.read_bytes())
        return Counts.from_json(values["counts"]), values["listeners"], values["pid"]
    except (OSError, ValueError, KeyError, TypeError):
        return Counts(), 0, 0
