"""Metrics for Prometheus (`GET /metrics`), collected on request."""

from __future__ import annotations

import contextlib
import shutil
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from importlib.metadata import version
from typing import Any, Protocol

from prometheus_client import CollectorRegistry, ProcessCollector, generate_latest
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    InfoMetricFamily,
    Metric,
)
from prometheus_client.registry import Collector

from wrenchbook.service.files.program import code_digest
from wrenchbook.service.ledger import Ledger, LedgerUnavailableError
from wrenchbook.service.ledger.jobs import SOLVE_EDGES, Statistics
from wrenchbook.service.library.library import Library
from wrenchbook.service.ops.counts import FOLDER as COUNTS
from wrenchbook.service.ops.counts import REQUEST_EDGES, Counts, SharedCounts, cumulative
from wrenchbook.service.tables.coordinator_state import FOLDER as SHARED
from wrenchbook.service.tables.coordinator_state import CoordinatorState
from wrenchbook.surrogate.kernel.build import sources_hash

# A component is a label and adds four series; GET /v1/components has the rest.
MAX_COMPONENTS = 200
FRESH_S = 1.0  # age of cached ledger statistics: several scrapers cost one query


class MetricsSource(Protocol):
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


class Metrics(Collector):
    """The metrics of one server: `counts` and event `listeners` are those of this process."""

    def __init__(
        self, workspace: MetricsSource, counts: Counts, listeners: Callable[[], int]
    ) -> None:
        settings, self._workspace = workspace.settings, workspace
        self._lock = threading.Lock()
        self._read_at = -FRESH_S
        self._read: Statistics | None = None
        self._version: int | None = None
        self._registry = CollectorRegistry()
        folder = settings.data / SHARED / COUNTS
        self._shared = SharedCounts(folder, counts, listeners)
        self._registry.register(self)

    def stop(self) -> None:
        """Stop sharing counts with other processes."""
        self._shared.stop()

    def text(self) -> bytes:
        """Return Prometheus' text format. It reads the ledger: not for the event loop."""
        return generate_latest(self._registry)

    def collect(self) -> Iterator[Metric]:
        """Yield all metrics."""
        counts, listening, pids = self._shared.together()
        yield from _of_queries(counts)
        yield from _of_requests(counts)
        yield GaugeMetricFamily("wrenchbook_event_listeners", "of GET /v1/events", value=listening)
        builder = CoordinatorState(self._workspace.settings.data / SHARED).read().pid
        yield from _of_processes({**pids, "builder": builder} if builder else pids)
        yield from self._of_ledger()
        yield from self._of_tables()
        yield from self._of_server()

    def _of_ledger(self) -> Iterator[Metric]:
        found = self._statistics()
        text, rows_for = "1 if the ledger can be used now", int(found is not None)
        yield GaugeMetricFamily("wrenchbook_ledger_usable", text, value=rows_for)
        if found is None:
            return
        yield _gauges("wrenchbook_jobs", "jobs as they stand", "status", found.jobs)
        yield _gauges("wrenchbook_failed_jobs", "failed jobs", "kind", found.failures)
        buckets = cumulative(SOLVE_EDGES, found.solve_buckets)
        text = "time a done solve took"
        seconds = found.solve_seconds
        yield HistogramMetricFamily("wrenchbook_solve_seconds", text, buckets, seconds)
        age = max(0.0, time.time() - found.oldest_waiting) if found.oldest_waiting else 0.0
        text = "age of the oldest job"
        yield GaugeMetricFamily("wrenchbook_oldest_waiting_seconds", text, value=age)
        sizes = self._workspace.ledger.sizes()
        yield _gauges("wrenchbook_ledger_bytes", "on the disk", "file", sizes)

    def _statistics(self) -> Statistics | None:
        """Return the ledger's statistics, at most `FRESH_S` old; None if it cannot be read."""
        ledger = self._workspace.ledger
        with self._lock, contextlib.suppress(LedgerUnavailableError):
            if time.monotonic() - self._read_at < FRESH_S:
                return self._read
            self._read_at = time.monotonic()
            version = ledger.version()
            if self._read is None or version != self._version:
                self._read = None
                self._read, self._version = ledger.statistics(), version
            return self._read
        return None

    def _of_tables(self) -> Iterator[Metric]:
        names, tables = self._workspace.library.names(), self._workspace.tables
        some, now = names[:MAX_COMPONENTS], time.time()
        present = tables.present()
        known = {name: present[name] for name in some if present.get(name) is not None}
        written = {name: tables.written(name) for name in some}
        ages = {name: max(0.0, now - at) for name, at in written.items() if at is not None}
        versions = {name: table.version for name, table in known.items()}
        rows = {name: table.row_count for name, table in known.items()}
        yield _gauges("wrenchbook_table_version", "that answers", "component", versions)
        yield _gauges("wrenchbook_table_rows", "that answer", "component", rows)
        text = "since a table's file was written"
        yield _gauges("wrenchbook_table_file_age_seconds", text, "component", ages)
        yield GaugeMetricFamily("wrenchbook_components", "in the library", value=len(names))
        text, broken = "see GET /health/ready", len(self._workspace.broken())
        yield GaugeMetricFamily("wrenchbook_broken_components", text, value=broken)

    def _of_server(self) -> Iterator[Metric]:
        yield InfoMetricFamily("wrenchbook_build", "what answers", _build())
        settings, ready = self._workspace.settings, int(not self._workspace.faults())
        text = "1 if jobs are accepted and solved"
        yield GaugeMetricFamily("wrenchbook_ready", text, value=ready)
        text = "solves at once of this server"
        yield GaugeMetricFamily("wrenchbook_solvers", text, value=settings.solvers)
        with contextlib.suppress(OSError):
            free = shutil.disk_usage(settings.data).free
            text = "where the data directory is"
            yield GaugeMetricFamily("wrenchbook_disk_free_bytes", text, value=free)


def _of_queries(counts: Counts) -> Iterator[Metric]:
    queries = CounterMetricFamily(
        "wrenchbook_queries", "wrenches answered", labels=("coverage", "method")
    )
    for labels, number in counts.queries().items():
        queries.add_metric(labels, number)
    yield queries
    text = "time a table took for one call"
    yield HistogramMetricFamily(
        "wrenchbook_query_seconds", text, counts.histogram(), counts.seconds
    )


def _of_requests(counts: Counts) -> Iterator[Metric]:
    labels = ("route", "method", "status")
    requests = CounterMetricFamily("wrenchbook_http_requests", "by route template", labels=labels)
    of_route: dict[str, list[float]] = {}
    for (route, method, status), numbers in counts.of("request"):
        requests.add_metric((route, method, status), sum(numbers[:-1]))
        total = of_route.get(route, [0.0] * len(numbers))
        of_route[route] = [one + more for one, more in zip(total, numbers, strict=True)]
    yield requests
    text = "from a request's head to the end of its reply"
    times = HistogramMetricFamily("wrenchbook_http_request_seconds", text, labels=("route",))
    for route, numbers in of_route.items():
        times.add_metric((route,), cumulative(REQUEST_EDGES, numbers[:-1]), numbers[-1])
    yield times


def _of_processes(pids: Mapping[str, int]) -> Iterator[Metric]:
    """Yield `process_*` of several processes by the label `process`."""
    found: dict[str, Metric] = {}
    for name, pid in pids.items():
        for metric in ProcessCollector(pid=lambda pid=pid: pid, registry=None).collect():
            family = found.setdefault(
                metric.name, Metric(metric.name, metric.documentation, metric.type)
            )
            for sample in metric.samples:
                family.add_sample(sample.name, {"process": name}, sample.value)
    yield from found.values()


@cache
def _build() -> dict[str, str]:
    """Return the version of the program, and digests of its Python code and its kernel."""
    code = code_digest("fea", "surrogate", "service")
    return {"version": version("wrenchbook"), "code": code, "kernel": sources_hash()[:16]}


def _gauges(name: str, text: str, label: str, values: Mapping[str, float]) -> Metric:
    found = GaugeMetricFamily(name, text, labels=(label,))
    for word, value in values.items():
        found.add_metric((word,), value)
    return found
