"""The tables of a web worker, memory-mapped from the files that the builder process writes."""

from __future__ import annotations

import logging
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np

from wrenchbook.service.ledger import LedgerUnavailableError
from wrenchbook.service.ledger.connection import with_remedy
from wrenchbook.service.library.component import Component
from wrenchbook.service.library.library import Library
from wrenchbook.service.settings import Settings
from wrenchbook.service.tables.build import START_S, build_table, packed_bytes
from wrenchbook.service.tables.coordinator_state import CoordinatorState, PublishedTable, Status
from wrenchbook.service.tables.rows import unsolved
from wrenchbook.service.tables.store import (
    PackedFile,
    TableStore,
    drop_least_used,
    is_of,
    origin_of,
    setup_of,
)
from wrenchbook.surrogate.answer import BY_AXES, allowed_by
from wrenchbook.surrogate.build import Table, build
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.kernel.format import PackedTableError
from wrenchbook.surrogate.kriging import Hyperparameters
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.compliance import ComplianceFit
from wrenchbook.surrogate.table.rows import Floats, LoadRange, Rows, Tolerance

log = logging.getLogger(__name__)

POLL_S = 0.005  # s between polls of the web workers' versions, while a caller waits
MEMORY_S = 0.1  # s between checks of the memory of tables
# A folder's time advances in steps of up to 10 ms (a kernel's tick), so that two changes may have
# the same time. For this time after a change, ns, each check looks at the files again.
SETTLED_NS = 100_000_000
# Time, s, for which a computing thread may keep the interpreter from one that answers: about the
# time of an answer; Python's 5 ms would delay each call.
SWITCH_S = 0.0005
ROW = "row"  # the method of an answer by one row
ROW_DETAIL = "the displacement that a row of the table has at this wrench"


class TableBehindError(Exception):
    """The table lacks rows that the ledger has; the caller should repeat the request."""

    retry_s = 1.0  # most tables are built in less

    @classmethod
    def unbuilt(cls, name: str, why: str | None) -> TableBehindError:
        """Return the error of a table with rows that was never built since the start."""
        why = why or "it is being built for the first time since the start"
        return cls(
            f"the table of {name!r} cannot answer yet, because {why}. No solve was queued; ask "
            "again in a moment"
        )


class ServedTable:
    """A packed table with its properties; rows and numpy table are read and built on first use."""

    other_rows: int = 0  # rows of another setup of the component
    other_wrenches: int = 0  # wrenches of these rows that no row of this table has

    def __init__(
        self,
        packed: PackedTable,
        rows_of: Callable[[], Rows] | None = None,
        built: Table | None = None,
        method: str | None = None,
    ) -> None:
        self.packed = packed
        self._rows_of = rows_of
        self.built = built
        self._rows = None if built is None else built.rows
        self.used = time.monotonic()  # of the last use
        self._lock = threading.Lock()
        provenance, self.summary = packed.meta["provenance"], packed.meta["summary"]
        self.version: int = provenance["version"]
        self.row_count: int = provenance["rows"]
        self.sources: dict[str, int] = provenance["sources"]  # number of rows by source
        self.linear: bool = provenance["linear"]
        self.default: str = packed.meta["groups"][0]["method"]  # of requests without a method
        self.bars_are_complete = packed.bars_are_complete  # error bars have all their parts
        low, high = packed.load_range
        self.load_range = LoadRange(low, high, packed.space)
        # Solves of a linear component's compliance are missing.
        self.needs_compliance = self.linear and not self.fit.complete
        self.locked = tuple(np.flatnonzero(packed.locked).tolist())
        self.interfaces = self.load_range.space.several  # names if there are several
        self.tolerance = None if packed.tolerance is None else Tolerance(*packed.tolerance)
        self.solver_error = SolverError.read(packed.meta["solver_error"])
        # The server's method answers if it applies to the table's inputs.
        if method is not None and (self.load_range.space.is_default or method not in BY_AXES):
            self.packed.method = self.default = method
        # The first answer reads pages from the disk, 0.1 ms; no caller waits for it.
        packed.answer([0.0] * len(packed.meta["space"]["inputs"]))

    @property
    def rows(self) -> Rows:
        """The rows of this version, read on first use: 0.05 s for 20,000."""
        self.used = time.monotonic()
        rows = self._rows  # another thread may drop it
        if rows is None:
            assert self._rows_of is not None
            rows = self._rows = self._rows_of()
        return rows

    def surrogate(self) -> Table:
        """Return the numpy table, built from the rows on first use: seconds for 20,000."""
        with self._lock:
            built = self.built  # another thread may drop it
            self.used = time.monotonic()
            if built is None:
                built = self.built = build(
                    self.rows,
                    self.load_range,
                    tolerance=self.tolerance,
                    linear=self.linear,
                    version=self.version,
                    solver_error=self.solver_error,
                    locked=self.locked,
                )
            built.packed = self.packed
            return built

    def rows_in_memory(self) -> int:
        """Return the number of rows in memory; 0 if they could not be read again."""
        return 0 if self._rows is None or self._rows_of is None else self.row_count

    def drop(self) -> None:
        """Drop rows and numpy table."""
        self.built = self._rows = None

    def limits(self, tolerance: Tolerance | None) -> tuple[float, ...] | None:
        """Return the largest error of each output by a tolerance, (m,), m and rad."""
        return None if tolerance is None else allowed_by(tolerance, self.load_range.space)

    @property
    def fit(self) -> ComplianceFit:
        """The compliance of each output's group; its known loads are those that all groups know."""
        names = [f"g{group}/fit/known" for group in range(len(self.packed.meta["groups"]))]
        known = np.all([self.packed.arrays[name] for name in names], axis=0)
        return ComplianceFit(
            self._of_groups("fit/matrix", len(known)),
            known,
            self._of_groups("fit/bar"),
            self.summary["compliance"]["origin"],
            self._of_groups("fit/offset"),
        )

    @property
    def allowed(self) -> Floats:
        """The largest interpolation error of each output of a covered answer, (m,), m and rad."""
        return self._of_groups("allowed")

    @property
    def steepest(self) -> Floats:
        """The largest change of each output over half the load range, (m,), m and rad."""
        return self._of_groups("row/steepest")

    def _of_groups(self, name: str, *columns: int) -> Floats:
        """Merge an array of the output groups, (m, ...): 0 for an output whose group lacks it."""
        merged = np.zeros((len(self.load_range.space.outputs), *columns))
        for group in range(len(self.packed.meta["groups"])):
            outputs = self.packed.arrays[f"g{group}/outputs"].astype(bool)
            merged[outputs] = self.packed.arrays.get(f"g{group}/{name}", merged)[outputs]
        return merged

    @property
    def hyperparameters(self) -> Hyperparameters | None:
        """The hyperparameters of the first outputs that have a kriging, None if none has."""
        arrays = self.packed.arrays
        for group in range(len(self.packed.meta["groups"])):
            if f"g{group}/kriging/terms" in arrays:
                groups = self.load_range.space.kriging_groups
                terms = arrays[f"g{group}/kriging/terms"][: len(groups)]
                order = arrays.get(f"g{group}/kriging/smoothness", [Hyperparameters.smoothness])
                return Hyperparameters(terms[-1, :-1], terms[:, -1], groups, int(order[0]))
        return None

    def method_detail(self, method: str) -> str:
        """Return the details of a method, or its reason, in the first output group."""
        group = self.packed.meta["groups"][0]
        if method == ROW:
            return ROW_DETAIL
        if method == "kriging" and group["kriging"]:
            return group["kriging"]
        # A table without rows answers by "estimate", which no request can name.
        is_default = method in (group["method"], "estimate")
        return group["method_reason"] if is_default else "asked for"


class MappedTables:
    """The newest table of each component, mapped from the builder's files.

    A request uses the present table (`surrogate`, a dictionary look-up). One thread maps each new
    version and then replaces the earlier one; without a builder the last versions continue to
    answer. `method` is that of requests without a method; `memory` is in MB.
    """

    def __init__(
        self,
        files: TableStore,
        library: Library,
        state: CoordinatorState,
        memory: float = Settings.table_memory,
        method: str | None = None,
    ) -> None:
        self._store = files
        self._ledger = files.ledger
        self._library = library
        self._state = state
        self._memory = memory
        self._method = method
        self.written, self.written_version = files.written, files.written_version
        # The following thread writes these; `surrogate` adds empty tables. Requests read.
        self._tables: dict[str, ServedTable] = {}
        self._mapped: dict[str, tuple[PackedFile, Component]] = {}
        self._refused: dict[Path, tuple[PackedFile, Component]] = {}
        self._unread: dict[str, str] = {}
        self._status = Status()
        self._published: dict[str, PublishedTable] = {}
        self._changed = threading.Condition()
        self._wake, self._stopping = threading.Event(), threading.Event()
        self.wake = self._wake.set
        self._thread = threading.Thread(target=self._follow, name="tables-follow", daemon=True)

    def start(self) -> None:
        """Start to map; return once the small tables that the builder can build are mapped.

        From then on the caller calls `wake` whenever `stamp` changes.
        """
        sys.setswitchinterval(min(sys.getswitchinterval(), SWITCH_S))
        self.wake()
        self._thread.start()
        names = self._store.small(self._library.names())
        with self._changed:
            self._changed.wait_for(lambda: names <= {*self._mapped, *self.faults()}, START_S)

    def stop(self) -> None:
        """Stop mapping."""
        self._stopping.set()
        self.wake()
        if self._thread.is_alive():
            self._thread.join()
        self._state.unpublish()

    def surrogate(self, name: str, *, or_empty: bool = False) -> ServedTable:
        """Return the newest table of a component.

        Raises UnknownComponentError if there is no such component, and TableBehindError if it has
        rows and was not built since the start; with `or_empty` it then returns a table without
        rows.
        """
        known = self._tables.get(name)
        if known is not None:
            return known
        component = self._library[name]
        is_behind = bool(self._store.size(name))
        if is_behind and not or_empty:
            raise TableBehindError.unbuilt(name, self.faults().get(name))
        error = self._store.solver_error(component)
        table = build_table(component, Rows.empty(component.space), 0, error)
        packed = PackedTable.from_bytes(packed_bytes(table, component))
        empty = ServedTable(packed, built=table, method=self._method)
        if is_behind:
            return empty
        with self._changed:
            return self._tables.setdefault(name, empty)

    def present(self) -> dict[str, ServedTable]:
        """Return the tables that answer now, by component."""
        return self._tables.copy()

    def faults(self) -> dict[str, str]:
        """Return by component the reason why its table differs from the ledger."""
        return {**self._status.faults, **self._unread}

    def trouble(self) -> str | None:
        """Return the reason why no job runs, as far as this process knows."""
        if not self._state.is_locked_by_builder():
            return "the process that runs them has ended; it is started again"
        return self._status.trouble

    def progress(self, name: str) -> Callable[[], bool | None]:
        """Return a function that shows whether every web worker's table has all present rows.

        It returns None while a table may still get them, and False if it cannot be built: see
        `faults`.
        """
        goal = self._ledger.last_seq(name)
        wanted = setup_of(self._library[name])

        def is_current(table: PublishedTable | None) -> bool:
            return table is not None and table.version >= goal and table.setup == wanted

        def progress() -> bool | None:
            status = self._status  # another thread replaces it
            table, failed = self._tables.get(name), False
            if table is not None and is_current(published_table(table)):
                if all(is_current(mapped.get(name)) for mapped in self._state.others()):
                    return True
            else:  # a table of another setup is built again, as of a component that was just added
                failed = name in status.faults and status.failed.get(name, -1) >= goal
            return False if failed or self._stopping.is_set() else None

        return progress

    def catch_up(self, name: str, timeout: float) -> bool:
        """Wait until every web worker's table has all rows committed at the time of the call.

        Return False after the timeout, or if the table cannot be built: see `faults`.
        """
        progress, end = self.progress(name), time.monotonic() + timeout
        while (caught_up := progress()) is None and (remaining := end - time.monotonic()) > 0:
            with self._changed:  # notified by this process alone
                self._changed.wait(min(remaining, POLL_S))
        return caught_up is True

    def caught_up(self, name: str, timeout: float) -> ServedTable:
        """Return the table with all rows committed by now.

        Raises TableBehindError after the timeout.
        """
        if self.catch_up(name, timeout):
            return self.surrogate(name)
        why = self.faults().get(name, f"its newest rows are not in it after {timeout:g} s")
        if not self._state.is_locked_by_builder():
            why += "; the process that builds tables has ended and is started again"
        raise TableBehindError(
            f"the table of {name!r} is older than the ledger, because {why}. No solve was queued; "
            "ask again in a moment"
        )

    def stamp(self) -> object:
        """Return a value that changes when there may be new tables; takes microseconds.

        The library's version includes components that another process has added.
        """
        files = self._store.stamp()
        settled = time.time_ns() - files > SETTLED_NS
        return self._library.version(), files, settled or time.monotonic(), self._state.stamp()

    def _follow(self) -> None:
        """Map new tables when woken, and keep the memory limit, until the tables are closed."""
        while not self._stopping.is_set():
            woken = self._wake.wait(MEMORY_S)
            self._wake.clear()
            try:
                drop_least_used(self.present().values(), self._memory)
                if woken:
                    self._map_new()
            except Exception:
                log.exception("looking for new tables failed; trying again")
                self._stopping.wait(1.0)
                self.wake()

    def _map_new(self) -> None:
        """Map the newest readable file of each table, and publish which versions answer."""
        status = self._state.read()
        failed = None
        for name, files in self._store.packed_files().items():
            component = self._library.get(name)
            if component is not None:
                try:
                    for file in files:
                        if self._map(component, file):
                            break
                except Exception as error:  # the other tables are mapped in spite of it
                    self._unread[name], failed = with_remedy(error), error
                    continue
                if not any(self._refused.get(file.path) == (file, component) for file in files):
                    self._unread.pop(name, None)
        mapped = {name: published_table(table) for name, table in self.present().items()}
        if mapped != self._published or status != self._status:  # a new builder's folder is empty
            with suppress(OSError):  # answers need no disk
                self._state.publish(mapped)
                self._published = mapped
        with self._changed:
            self._status = status
            self._changed.notify_all()
        if failed is not None:
            raise failed

    def _map(self, component: Component, file: PackedFile) -> bool:
        """Map a file unless it is of another component or setup; return whether it is mapped."""
        name = component.name
        source = (file, component)
        if source in (self._mapped.get(name), self._refused.get(file.path)):
            return source == self._mapped.get(name)
        level = logging.ERROR
        try:
            packed = PackedTable.open(file.path)
            error = self._store.solver_error(component)
            if not is_of(packed, name, self._store.origin(component, file.version, error)):
                level = logging.INFO  # as after an upgrade: the builder replaces the file
                raise PackedTableError(f"{file.path} is not version {file.version} of table {name}")
            rows_of = partial(self._store.rows, component, file.version)
            table = ServedTable(packed, rows_of, method=self._method)
        except (PackedTableError, KeyError) as error:
            if file.path.exists():
                log.log(level, "the table of %s stays as it is: %s", name, error)
                self._unread[name], self._refused[file.path] = str(error), source
            return False
        with suppress(LedgerUnavailableError):
            others = self._ledger.of_other_setups(name, component.fingerprint)
            table.other_rows = sum(others.values())
            needs_no_solves = table.linear and not table.needs_compliance
            if others and component.has_fea and not needs_no_solves:
                table.other_wrenches = len(unsolved(component, others, table.rows.wrench))
        with self._changed:
            self._unread.pop(name, None)
            self._tables[name], self._mapped[name] = table, source
            self._changed.notify_all()
        return True


def published_table(table: ServedTable) -> PublishedTable:
    """Return the version and setup of a table; no setup if its file names none."""
    return PublishedTable(table.version, origin_of(table.packed).get("setup", ""))


def row_table(
    component: Component, row: Rows, error: SolverError | None, near: ServedTable
) -> ServedTable:
    """Return a table of one row, which answers its wrench until the component's table has it.

    A row without a tangent takes the steepest slopes of `near`, the component's newest table.
    """
    built = build(
        row,
        component.load_range,
        tolerance=component.tolerance,
        linear=False,  # the row answers, and no compliance through it
        version=max(near.version, int(row.seq[0])),
        solver_error=error,
        locked=component.idle,
    )
    for group in built.groups:
        group.steepest = np.fmax(group.steepest, near.steepest)
    return ServedTable(PackedTable.from_bytes(packed_bytes(built, component)), built=built)


def note_on_other_rows(name: str, table: ServedTable) -> str:
    """Return a text on rows of another setup and the remedy; empty if no wrench is to be solved."""
    if not table.other_wrenches:
        return ""
    return (
        f"{_belong(table)} to another setup of {name!r} and not to its table; wrenches to "
        f"solve again: {table.other_wrenches}, with POST "
        f"/v1/components/{name}/table/resolve or: wrenchbook resolve {name}"
    )


def _belong(table: ServedTable) -> str:
    return "1 row belongs" if table.other_rows == 1 else f"{table.other_rows} rows belong"


def warning_of(component: Component, table: ServedTable) -> str:
    """Return the text of `note_on_other_rows`, also for a component that cannot be solved."""
    if component.has_fea or not table.other_rows:
        return note_on_other_rows(component.name, table)
    return (
        f"{_belong(table)} to another setup of {component.name!r}, which has no "
        "finite-element setup now, and not to its table. Put its files back, or export the "
        "rows and load them as measured, without a fingerprint"
    )
