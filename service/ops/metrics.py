"""Metrics for Prometheus (`GET /metrics`), collected on request."""

from __future__ import annotations

import contextlib
import shutil
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from importlib.metadata import version
from typing import Protocol

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
from wrenchbook.service.ledger.job_statistics import SOLVE_EDGES, Statistics
from wrenchbook.service.library.library import Library
from wrenchbook.service.ops.counts import FOLDER as COUNTS
from wrenchbook.service.ops.counts import REQUEST_EDGES, Counts, SharedCounts, cumulative
from wrenchbook.service.settings import Settings
from wrenchbook.service.tables.coordinator_state import FOLDER as SHARED
from wrenchbook.service.tables.coordinator_state import CoordinatorState
from wrenchbook.service.tables.mapped import MappedTables
from wrenchbook.surrogate.kernel.build import sources_hash

# Components with their own series: a component is a label and adds four; GET /v1/components has the
# rest.
MAX_COMPONENTS = 200
FRESH_S = 1.0  # s, age of cached ledger statistics: several scrapers cost one query


class MetricsSource(Protocol):
    """The parts of an opened data directory that metrics read: `service.workspace.Workspace`."""

    settings: Settings
    ledger: Ledger
    library: Library
    tables: MappedTables
    faults: Callable[[], list[str]]
    broken: Callable[[], dict[str, str]]


class Metrics(Collector):
    """The metrics of one server: `counts` and event `listeners` are those of this process."""

    def __init__(
        self, workspace: MetricsSource, counts: Counts, listeners: Callable[[], int]
    ) -> None:
        settings = workspace.settings
        self._workspace = workspace
        self._lock = threading.Lock()
        self._read_at = -FRESH_S
        self._read: Statistics | None = None
        self._version: int | None = None
        self._registry = CollectorRegistry()
        self._shared = SharedCounts(settings.data / SHARED / COUNTS, counts, listeners)
        self._registry.register(self)

    def stop(self) -> None:
        """Stop sharing counts with other processes."""
        self._shared.stop()

    def text(self) -> bytes:
        """Return Prometheus' text format. It reads the ledger: do not call it in the event loop."""
        return generate_latest(self._registry)

    def collect(self) -> Iterator[Metric]:
        """Yield all metrics."""
        counts, listening, pids = self._shared.together()
        text = "time a table took for one call"
        yield _counters("queries", "wrenches answered", ("coverage", "method"), counts.queries())
        yield HistogramMetricFamily(
            "wrenchbook_query_seconds", text, counts.histogram(), counts.seconds
        )

        requests = {}
        of_route = dict[str, list[float]]()
        for (route, method, status), numbers in counts.of("request"):
            requests[route, method, status] = sum(numbers[:-1])
            total = of_route.get(route, [0.0] * len(numbers))
            of_route[route] = [sum(pair) for pair in zip(total, numbers, strict=True)]
        labels = ("route", "method", "status")
        yield _counters(
            "http_requests", "HTTP requests by route template, method and status", labels, requests
        )
        text = "time from a request's head to the end of its reply"
        times = HistogramMetricFamily("wrenchbook_http_request_seconds", text, labels=("route",))
        for route, numbers in of_route.items():
            times.add_metric((route,), cumulative(REQUEST_EDGES, numbers[:-1]), numbers[-1])
        yield times
        yield _gauge("event_listeners", "open connections to GET /v1/events", listening)

        builder = CoordinatorState(self._workspace.settings.data / SHARED).read().pid
        processes: dict[str, Metric] = {}
        for name, pid in (pids | ({"builder": builder} if builder else {})).items():
            for metric in ProcessCollector(pid=lambda pid=pid: pid, registry=None).collect():
                family = Metric(metric.name, metric.documentation, metric.type)
                family = processes.setdefault(metric.name, family)
                for sample in metric.samples:
                    family.add_sample(sample.name, {"process": name}, sample.value)
        yield from processes.values()
        yield from self._of_ledger()
        yield from self._of_workspace()

    def _of_ledger(self) -> Iterator[Metric]:
        """Yield the metrics of jobs, solves and the ledger's files; one without a usable ledger."""
        ledger = self._workspace.ledger
        read: Statistics | None = None
        with self._lock, contextlib.suppress(LedgerUnavailableError):
            if time.monotonic() - self._read_at >= FRESH_S:
                self._read_at = time.monotonic()
                version = ledger.version()
                if self._read is None or version != self._version:
                    # Earlier numbers are not shown while the ledger cannot be read.
                    self._read = None
                    self._read = ledger.statistics()
                    self._version = version
            read = self._read
        yield _gauge("ledger_usable", "1 if the ledger can be used now", int(read is not None))
        if read is None:
            return
        yield _gauges("jobs", "jobs as they stand", "status", read.jobs)
        yield _gauges("failed_jobs", "failed jobs", "kind", read.failures)
        buckets = cumulative(SOLVE_EDGES, read.solve_buckets)
        text = "time a done solve took"
        yield HistogramMetricFamily("wrenchbook_solve_seconds", text, buckets, read.solve_seconds)
        age = max(0.0, time.time() - read.oldest_waiting) if read.oldest_waiting else 0.0
        yield _gauge("oldest_waiting_seconds", "age of the oldest job", age)
        text = "sizes of the ledger's files on the disk"
        yield _gauges("ledger_bytes", text, "file", ledger.sizes())

    def _of_workspace(self) -> Iterator[Metric]:
        """Yield the metrics of tables, components, the program and the disk."""
        workspace = self._workspace
        now = time.time()
        names, present = workspace.library.names(), workspace.tables.present()
        listed = names[:MAX_COMPONENTS]
        known = {name: present[name] for name in listed if present.get(name) is not None}
        versions = {name: table.version for name, table in known.items()}
        yield _gauges("table_version", "version of the table that answers", "component", versions)
        rows = {name: table.row_count for name, table in known.items()}
        yield _gauges("table_rows", "rows of the table that answers", "component", rows)
        written = {name: workspace.tables.written(name) for name in listed}
        ages = {name: max(0.0, now - at) for name, at in written.items() if at is not None}
        text = "time since the table's file was written"
        yield _gauges("table_file_age_seconds", text, "component", ages)
        yield _gauge("components", "components in the library", len(names))
        text = "components that cannot be used; GET /health/ready names them"
        yield _gauge("broken_components", text, len(workspace.broken()))
        yield InfoMetricFamily("wrenchbook_build", "version of the program that answers", _build())
        yield _gauge("ready", "1 if jobs are accepted and solved", int(not workspace.faults()))
        yield _gauge("solvers", "solves that this server runs at once", workspace.settings.solvers)
        with contextlib.suppress(OSError):
            free = shutil.disk_usage(workspace.settings.data).free
            yield _gauge("disk_free_bytes", "free space on the disk of the data directory", free)


@cache
def _build() -> dict[str, str]:
    """Return the version of the program, and digests of its Python code and its kernel."""
    code = code_digest("fea", "surrogate", "service")
    return {"version": version("wrenchbook"), "code": code, "kernel": sources_hash()[:16]}


def _gauge(name: str, text: str, value: float) -> Metric:
    return GaugeMetricFamily(f"wrenchbook_{name}", text, value=value)


def _gauges(name: str, text: str, label: str, values: Mapping[str, float]) -> Metric:
    family = GaugeMetricFamily(f"wrenchbook_{name}", text, labels=(label,))
    for value_label, value in values.items():
        family.add_metric((value_label,), value)
    return family


def _counters(
    name: str, text: str, labels: Sequence[str], values: Mapping[tuple[str, ...], float]
) -> Metric:
    family = CounterMetricFamily(f"wrenchbook_{name}", text, labels=labels)
    for of_labels, value in values.items():
        family.add_metric(of_labels, value)
    return family
