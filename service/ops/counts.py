"""Counts of answered queries as plain integers, of this process and of all web workers.

The counts of a single query take 1.3 µs of its tens: dictionary accesses, bisections and additions.
Two counters and two histograms of prometheus_client in its mode for several processes take 21 µs;
`metrics` makes them from these numbers on request.
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
from wrenchbook.service.files.durable import write_atomically
from wrenchbook.service.files.lock import take

log = logging.getLogger(__name__)

FOLDER = "counts"
WRITE_S = 0.5  # interval of writes: a killed process loses the counts of this time

# Upper ends of the histogram, s: from a single answer to a batch of a million.
EDGES = (2e-5, 5e-5, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 0.1, 1.0, 10.0)
# Upper ends of the histogram of requests by route, s: from the fast path to a long poll.
REQUEST_EDGES = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 0.1, 0.3, 1.0, 3.0, 10.0, 60.0)
_EDGES_US = tuple(1e6 * edge for edge in EDGES)


class Counts:
    """Queries by coverage and method, their times, and requests. Use it in the event loop only.

    Each entry is a list of numbers that add up over processes. Times are the counts of the buckets
    of `EDGES` or `REQUEST_EDGES`, then of longer ones, then the total time.
    """

    def __init__(self) -> None:
        self._times = [0.0] * (len(EDGES) + 2)  # the total in µs
        self._numbers: dict[tuple[str, ...], list[float]] = {("time",): self._times}

    def _entry(self, key: tuple[str, ...], size: int) -> list[float]:
        return self._numbers.get(key) or self._numbers.setdefault(key, [0.0] * size)

    def add(self, coverage: str, method: str | None, elapsed_us: float) -> None:
        """Count one answer."""
        self._entry(("query", coverage, method or "none"), 1)[0] += 1
        self._times[bisect_left(_EDGES_US, elapsed_us)] += 1
        self._times[-1] += elapsed_us

    def add_batch(self, coverage: NDArray[np.integer], method: str, us: float) -> None:
        """Count a batch of wrenches with coverage numbers (n,), as one call of `us` µs."""
        for word, number in zip(COVERAGE, np.bincount(coverage, minlength=3).tolist(), strict=True):
            if number:
                self._entry(("query", word, method), 1)[0] += number
        self._times[bisect_left(_EDGES_US, us)] += 1
        self._times[-1] += us

    def add_request(self, route: str, method: str, status: int, seconds: float) -> None:
        """Count an HTTP request by its route's template, method and status."""
        numbers = self._entry(("request", route, method, str(status)), len(REQUEST_EDGES) + 2)
        numbers[bisect_left(REQUEST_EDGES, seconds)] += 1
        numbers[-1] += seconds

    def add_all(self, other: Counts) -> None:
        """Add the counts of another process; those of other buckets are left out."""
        for key, more in other._numbers.items():
            numbers = self._entry(key, len(more))
            if len(numbers) == len(more):
                numbers[:] = [number + added for number, added in zip(numbers, more, strict=True)]

    def as_json(self) -> list[Any]:
        """Return the counts as JSON values."""
        return [[*key, list(numbers)] for key, numbers in self._numbers.copy().items()]

    @classmethod
    def from_json(cls, values: Sequence[Any]) -> Counts:
        """Return the counts of `as_json`."""
        counts, read = cls(), cls()
        read._numbers = {tuple(key): numbers for *key, numbers in values}
        counts.add_all(read)
        return counts

    def of(self, kind: str) -> list[tuple[tuple[str, ...], list[float]]]:
        """Return the labels and numbers of ``query`` or ``request``, by labels."""
        return sorted(
            (key[1:], list(n)) for key, n in self._numbers.copy().items() if key[0] == kind
        )

    @property
    def seconds(self) -> float:
        """Total time of all calls, s."""
        return self._times[-1] / 1e6

    def queries(self) -> Mapping[tuple[str, ...], float]:
        """Return the number of queries by coverage and method."""
        return {labels: numbers[0] for labels, numbers in self.of("query")}

    def histogram(self) -> Sequence[tuple[str, float]]:
        """Return Prometheus' cumulative buckets, with their upper ends in seconds as text."""
        return cumulative(EDGES, self._times[:-1])


def cumulative(edges: Sequence[float], numbers: Sequence[float]) -> list[tuple[str, float]]:
    """Return cumulative counts by upper edge, the last one infinite."""
    total = 0
    buckets = []
    for edge, number in zip((*map(repr, edges), "+Inf"), numbers, strict=True):
        total += number
        buckets.append((edge, float(total)))
    return buckets


class SharedCounts:
    """The counts of all processes of a server, each written to a file by its process.

    No scrape of any process may see a count decrease: each process writes its own counts before it
    returns the sum, and continues from its file after a restart. `counts` and event `listeners` are
    those of this process.
    """

    def __init__(self, folder: Path, counts: Counts, listeners: Callable[[], int]) -> None:
        self._counts = counts
        self._listeners = listeners
        number = 0
        with suppress(OSError):  # on a read-only disk counts are not shared
            folder.mkdir(parents=True, exist_ok=True)
            # The lowest number that no other process has, locked until this process ends.
            numbers = count(1)
            number = next(n for n in numbers if take(folder / f"{n}.lock", 0.0) is not None)
        self._folder = folder
        self._path = folder / f"{number}.json"
        counts.add_all(_read(self._path)[0])
        self._writing = threading.Lock()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._keep, name="counts", daemon=True)
        self._thread.start()

    def together(self) -> tuple[Counts, int, dict[str, int]]:
        """Return the counts, the event listeners and the pids, by number, of all processes."""
        self._write()
        total = Counts()
        listeners = 0
        pids = {}
        for path in sorted(self._folder.glob("*.json")):
            counts, more, pid = _read(path)
            total.add_all(counts)
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
            values = {"counts": self._counts.as_json(), "listeners": self._listeners()}
            values["pid"] = os.getpid()
            try:
                write_atomically(self._path, json.dumps(values).encode(), durable=False)
            except OSError as error:
                log.debug("counts are not written: %s", error)


def _read(path: Path) -> tuple[Counts, int, int]:
    """Return the counts, the event listeners and the pid of a process; zeros if unreadable."""
    try:
        values = json.loads(path.read_bytes())
        return Counts.from_json(values["counts"]), values["listeners"], values["pid"]
    except (OSError, ValueError, KeyError, TypeError):
        return Counts(), 0, 0
