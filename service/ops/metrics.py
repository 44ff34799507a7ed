"""What `GET /metrics` tells, read where it is known at the moment somebody asks."""

from __future__ import annotations

import contextlib
import shutil
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any, Protocol

from prometheus_client import CollectorRegistry, GCCollector, ProcessCollector, generate_latest
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    Metric,
)
from prometheus_client.registry import Collector

from service.ledger import Ledger, LedgerUnavailableError
from service.ledger.statistics import SOLVE_EDGES, Statistics
from service.library.library import Library
from service.ops.counts import FOLDER as COUNTS
from service.ops.counts import Counts, SharedCounts, cumulative
from service.tables.coordinator_state import FOLDER as SHARED

# A component is a label. Whoever keeps more of them reads the rest from GET /v1/components: each
# costs the one who stores it four series.
MOST_COMPONENTS = 200
FRESH_S = 1.0  # what was read from the ledger is told again for so long: two scrapers are one


class Workspace(Protocol):
    """What the metrics read of an opened data directory (`service.workspace`)."""

    settings: Any
    ledger: Ledger
    library: Library
    tables: Any

    def faults(self) -> list[str]:
        """Return what keeps it from accepting and running jobs."""
        ...

    def broken(self) -> dict[str, str]:
        """Return what is wrong with single components, by name."""
        ...


class Metrics:
    """The metrics of one server.

    Parameters
    ----------
    workspace : Workspace
    counts : Counts
        The queries this process has answered.
    listeners : callable
        How many follow the events here.
    """

    def __init__(self, workspace: Workspace, counts: Counts, listeners: Callable[[], int]) -> None:
        settings, self._shared = workspace.settings, None
        self._registry = CollectorRegistry()
        if settings.part == "answering":
            folder = settings.folder / SHARED / COUNTS
            self._shared = SharedCounts(folder, settings.number, counts, listeners)
        else:  # of several processes, whichever is asked would tell of itself
            ProcessCollector(registry=self._registry)
            GCCollector(registry=self._registry)
        told = self._shared.together if self._shared else lambda: (counts, listeners())
        self._registry.register(_Queries(told))
        self._registry.register(_Ledger(workspace))
        self._registry.register(_Tables(workspace))
        self._registry.register(_Server(workspace))

    def stop(self) -> None:
        """Keep no counts for other processes any longer."""
        if self._shared:
            self._shared.stop()

    def text(self) -> bytes:
        """Return all of it in Prometheus' text form; reads the ledger, so not for the loop."""
        return generate_latest(self._registry)


class _Queries(Collector):
    def __init__(self, told: Callable[[], tuple[Counts, int]]) -> None:
        self._told = told

    def collect(self) -> Iterable[Metric]:
        counts, listening = self._told()
        queries = CounterMetricFamily(
            "wrenchbook_queries", "wrenches answered", labels=("coverage", "method")
        )
        for words, number in sorted(counts.queries().items()):
            queries.add_metric(words, number)
        yield queries
        taken = HistogramMetricFamily("wrenchbook_query_seconds", "time a table took for one call")
        taken.add_metric((), counts.histogram(), counts.seconds)
        yield taken
        listeners = GaugeMetricFamily("wrenchbook_event_listeners", "of GET /v1/events")
        listeners.add_metric((), listening)
        yield listeners


class _Ledger(Collector):
    """Jobs as the ledger has them, so that every process on it tells the same."""

    def __init__(self, workspace: Workspace) -> None:
        self._ledger = workspace.ledger
        self._lock = threading.Lock()
        self._read_at = -FRESH_S
        self._read: Statistics | None = None
        self._version: int | None = None

    def collect(self) -> Iterator[Metric]:
        found = self._statistics()
        usable = GaugeMetricFamily("wrenchbook_ledger_usable", "1 if the ledger can be used now")
        usable.add_metric((), 0 if found is None else 1)
        yield usable
        if found is None:
            return
        jobs = GaugeMetricFamily("wrenchbook_jobs", "jobs as they stand", labels=("status",))
        for status, number in found.jobs.items():
            jobs.add_metric((status,), number)
        failures = GaugeMetricFamily("wrenchbook_failed_jobs", "failed jobs", labels=("kind",))
        for kind, number in found.failures.items():
            failures.add_metric((kind,), number)
        solves = HistogramMetricFamily("wrenchbook_solve_seconds", "time a done solve took")
        buckets = cumulative(SOLVE_EDGES, found.solve_buckets)
        solves.add_metric((), buckets, found.solve_seconds)
        oldest = GaugeMetricFamily("wrenchbook_oldest_waiting_seconds", "age of the oldest job")
        age = max(0.0, time.time() - found.oldest_waiting) if found.oldest_waiting else 0.0
        oldest.add_metric((), age)
        size = GaugeMetricFamily("wrenchbook_ledger_bytes", "on the disk", labels=("file",))
        for file, number in self._ledger.sizes().items():
            size.add_metric((file,), number)
        yield from (jobs, failures, solves, oldest, size)

    def _statistics(self) -> Statistics | None:
        with self._lock, contextlib.suppress(LedgerUnavailableError):
            if time.monotonic() - self._read_at < FRESH_S:
                return self._read
            self._read_at = time.monotonic()
            version = self._ledger.version()
            if self._read is None or version != self._version:
                self._read = None
                self._read, self._version = self._ledger.statistics(), version
            return self._read
        return None


class _Tables(Collector):
    def __init__(self, workspace: Workspace) -> None:
        self._workspace = workspace

    def collect(self) -> Iterable[Metric]:
        named = ("component",)
        versions = GaugeMetricFamily("wrenchbook_table_version", "that answers", labels=named)
        rows = GaugeMetricFamily("wrenchbook_table_rows", "that answer", labels=named)
        ages = GaugeMetricFamily(
            "wrenchbook_table_file_age_seconds", "since a table's file was written", labels=named
        )
        names = self._workspace.library.names()
        known = self._workspace.tables.present()
        for name in names[:MOST_COMPONENTS]:
            if (table := known.get(name)) is not None:
                versions.add_metric((name,), table.version)
                rows.add_metric((name,), table.row_count)
            if (written := self._workspace.tables.written(name)) is not None:
                ages.add_metric((name,), max(0.0, time.time() - written))
        count = GaugeMetricFamily("wrenchbook_components", "in the library")
        count.add_metric((), len(names))
        broken = GaugeMetricFamily("wrenchbook_broken_components", "see GET /health/ready")
        broken.add_metric((), len(self._workspace.broken()))
        return versions, rows, ages, count, broken


class _Server(Collector):
    def __init__(self, workspace: Workspace) -> None:
        self._workspace = workspace

    def collect(self) -> Iterable[Metric]:
        ready = GaugeMetricFamily("wrenchbook_ready", "1 if jobs are accepted and solved")
        ready.add_metric((), 0 if self._workspace.faults() else 1)
        slots = GaugeMetricFamily("wrenchbook_solvers", "solves at once of this server")
        slots.add_metric((), self._workspace.settings.solvers)
        found = [ready, slots]
        with contextlib.suppress(OSError):
            free = GaugeMetricFamily("wrenchbook_disk_free_bytes", "where the data directory is")
            free.add_metric((), shutil.disk_usage(self._workspace.settings.folder).free)
            found.append(free)
        return found
