"""One version of a component's table: built from rows, packed, and answered from."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping

import numpy as np

from wrenchbook.service.contract import CONTRACT
from wrenchbook.service.library.component import Component
from wrenchbook.service.tables.solver_errors import SolverErrors
from wrenchbook.surrogate.answer import BY_AXES, allowed_by
from wrenchbook.surrogate.build import AnyTable, build
from wrenchbook.surrogate.kernel.binding import PackedTable
from wrenchbook.surrogate.kriging import Hyperparameters
from wrenchbook.surrogate.packed.writer import pack
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.compliance import ComplianceFit
from wrenchbook.surrogate.table.rows import Floats, LoadRange, Rows, Tolerance
from wrenchbook.surrogate.table.space import Space


class TableBehindError(Exception):
    """The table does not hold yet all rows that the ledger has; ask again."""

    @classmethod
    def late(cls, name: str, why: str | None, seconds: float, more: str = "") -> TableBehindError:
        """Return the error of a table that lacks the newest rows after so long."""
        why = why or f"its newest rows are not in it after {seconds:g} s"
        return cls(
            f"the table of {name!r} is older than the ledger: {why}{more}. No solve was "
            "queued; ask again in a while"
        )

    @classmethod
    def unbuilt(cls, name: str, why: str | None) -> TableBehindError:
        """Return the error of a table with rows that was never built since the start."""
        why = why or "it is being built for the first time since the start"
        return cls(
            f"the table of {name!r} has rows and cannot answer yet: {why}. No solve was queued; "
            "ask again in a while"
        )


ROW = "row"  # the method of an answer by one row
ROW_DETAIL = "the displacement that a row of the table has at this wrench"
_WHOLE = 4  # the place in the solver's flags of whether error bars have all their parts
# MB of rows and numpy tables that a process keeps. The packed tables answer; numpy tables serve
# fills, plans and the build of the next version.
TABLE_MEMORY = 700
ROW_MB = 0.013  # of a numpy table, a row: measured with 20,000 clean and full rows


class ServedTable:
    """A packed table and its facts; rows and numpy tables are read and built on first use.

    Parameters
    ----------
    packed : PackedTable
    rows_of : callable
        Returns the rows of this version.
    built : AnyTable, optional
        The numpy table, if it is in memory.

    Attributes
    ----------
    built : AnyTable or None
        The numpy table while it is in memory.
    version, row_count : int
    sources : dict of str to int
        How many rows each source has.
    default : str
        The method that answers without a choice of the caller's.
    linear, needs_compliance : bool
        Whether the component is linear, and whether solves of its 6x6 compliance are missing.
    bars_are_whole : bool
        Whether error bars have all their parts.
    load_range : LoadRange
    interfaces : tuple of str
        The names of the interfaces where there are several.
    tolerance : Tolerance or None, m and rad
    solver_error : SolverError or None
    other_rows, other_wrenches : int
        Rows of another setup of the component, and how many of their wrenches no row here has.
    """

    other_rows: int = 0
    other_wrenches: int = 0

    def __init__(
        self,
        packed: PackedTable,
        rows_of: Callable[[], Rows] | None = None,
        built: AnyTable | None = None,
    ) -> None:
        self.packed, self._rows_of, self.built = packed, rows_of, built
        self._rows = None if built is None else built.rows
        self._used, self._lock = time.monotonic(), threading.Lock()
        about, self.summary = packed.words["provenance"], packed.words["summary"]
        self.version: int = about["version"]
        self.row_count: int = about["rows"]
        self.sources: dict[str, int] = about["sources"]
        self.linear: bool = about["linear"]
        self.default: str = packed.words["groups"][0]["method"]
        self.needs_compliance = self.linear and not self.fit.complete
        self.bars_are_whole = bool(packed.arrays["solver/flags"][_WHOLE])
        low, high = packed.arrays["space/range"]
        self.load_range = LoadRange(low, high, Space.read(packed.words["space"]))
        self.locked = tuple(np.flatnonzero(packed.arrays["space/locked"]).tolist())
        self.interfaces = self.load_range.space.several
        limit = packed.arrays["space/tolerance"][[0, 3]].tolist()
        self.tolerance = Tolerance(*limit) if np.isfinite(limit).all() else None
        self.solver_error = SolverError.read(packed.words["solver_error"])
        packed.answer([0.0] * len(packed.words["space"]["inputs"]))  # reads pages: 0.1 ms

    def prefer(self, method: str | None) -> None:
        """Answer by a method where a request names none; None keeps the table's own default.

        So does one that does not exist for the table's inputs.
        """
        exists = self.load_range.space.is_default or method not in BY_AXES
        if method is not None and exists:
            self.packed.method = self.default = method

    @property
    def rows(self) -> Rows:
        """The rows of this version, read on first use: 0.05 s for 20,000."""
        rows, self._used = self._rows, time.monotonic()
        if rows is None:
            assert self._rows_of is not None
            rows = self._rows = self._rows_of()
        return rows

    def surrogate(self) -> AnyTable:
        """Return the numpy table, built from the rows on first use: seconds for 20,000."""
        with self._lock:
            built, self._used = self.built, time.monotonic()
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

    def limits(self, tolerance: Tolerance | None) -> tuple[float, ...] | None:
        """Return the largest error of each output by a tolerance, (m,), m and rad."""
        return None if tolerance is None else allowed_by(tolerance, self.load_range.space)

    @property
    def fit(self) -> ComplianceFit:
        """The compliance of the outputs that the fewest rows hold."""
        matrix, half_width, known = (
            self.packed.arrays[f"g0/fit/{name}"] for name in ("matrix", "bar", "known")
        )
        origin = self.summary["compliance"]["origin"]
        offset = self.packed.arrays.get("g0/fit/offset", np.zeros(len(matrix)))
        return ComplianceFit(matrix, known.astype(bool), half_width, origin, offset)

    @property
    def steepest(self) -> Floats:
        """What each output moves over half the load range at most, (6,), m and rad."""
        arrays = self.packed.arrays
        found = np.zeros(len(self.load_range.space.outputs))
        for group in range(len(self.packed.words["groups"])):
            own = arrays[f"g{group}/outputs"].astype(bool)
            found[own] = arrays[f"g{group}/row/steepest"][own]
        return found

    @property
    def hyperparameters(self) -> Hyperparameters | None:
        """Those of the first outputs that have a kriging, None without one."""
        arrays = self.packed.arrays
        for group in range(len(self.packed.words["groups"])):
            if f"g{group}/kriging/rates" in arrays:
                weights = arrays[f"g{group}/kriging/terms"][:, -1]
                groups = self.load_range.space.kriging_groups
                stated = arrays.get(f"g{group}/kriging/smoothness", [Hyperparameters.smoothness])
                rates = arrays[f"g{group}/kriging/rates"]
                return Hyperparameters(rates, weights, groups, int(stated[0]))
        return None

    def method_detail(self, method: str) -> str:
        """Return in words how a method answers, or why it is the one that does.

        Of several groups of outputs, that of the fewest rows is described.
        """
        one = self.packed.words["groups"][0]
        if method == ROW:
            return ROW_DETAIL
        if method == "kriging" and one["kriging"]:
            return one["kriging"]
        return one["method_reason"] if method == one["method"] else "asked for"


def drop_built(tables: Iterable[ServedTable], most: float) -> None:
    """Drop the rows and numpy tables used longest ago, so that at most so many MB stay.

    Those used last stay whatever their size, and so do those that nothing could be read from again.
    """
    kept = 0.0
    for table in sorted(tables, key=lambda one: -one._used):
        if table._rows is not None and table._rows_of is not None:
            size = ROW_MB * table.row_count
            if kept and kept + size > most:
                table.built = table._rows = None
            else:
                kept += size


def make(
    component: Component,
    rows: Rows,
    version: int,
    before: AnyTable | None = None,
    errors: SolverErrors | None = None,
) -> AnyTable:
    """Build the surrogate; its version is the number of the ledger's newest change in it.

    It is a function of the rows alone, whatever `before` is: with the same rows, a
    simulator that has downloaded them or this server after a restart, has the same digits. What
    has not changed since the version before is not made again. What `errors` knows of the solver
    is part of it.
    """
    own = errors if component.has_fea else None
    return build(
        rows,
        component.load_range,
        tolerance=component.tolerance,
        linear=component.linear,
        version=version,
        before=before,
        solver_error=own and own.read(component.name, component.fingerprint),
        locked=component.idle,
    )


def row_table(
    component: Component, row: Rows, error: SolverError | None, near: ServedTable
) -> ServedTable:
    """Return a table of one row, which answers its wrench until the component's table holds it.

    Parameters
    ----------
    row : Rows
        Of one row.
    error : SolverError or None
        What the solver of the row may be wrong by.
    near : ServedTable
        The component's newest: a row without a tangent takes the steepest slopes of its rows.
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
    for _, group in built.groups:
        group.exact.steepest = np.fmax(group.exact.steepest, near.steepest)
    return in_memory(built, packed_bytes(built, component.name, component.fingerprint))


def packed_bytes(
    table: AnyTable, name: str, fingerprint: str, origin: Mapping[str, str] | None = None
) -> bytes:
    """Return the packed file of a component's table; `origin` is that of `packed_files`."""
    pieces = pack(table, component=name, fingerprint=fingerprint, contract=CONTRACT, origin=origin)
    return b"".join(pieces)


def in_memory(table: AnyTable, content: bytes) -> ServedTable:
    """Return a table that answers from its packed bytes, without a file."""
    return ServedTable(PackedTable.from_bytes(content), built=table)


def empty_table(component: Component, errors: SolverErrors | None = None) -> ServedTable:
    """Return the table of a component without rows."""
    table = make(component, Rows.empty(component.space), 0, errors=errors)
    return in_memory(table, packed_bytes(table, component.name, component.fingerprint))
