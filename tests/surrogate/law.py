"""Tables as tests ask them: the product's, every number of which is the kernel's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wrenchbook.surrogate import build as product
from wrenchbook.surrogate.answer import allowed_by
from wrenchbook.surrogate.kernel.explain import explain
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.rows import Floats, LoadRange, Rows, Tolerance


class Answer(NamedTuple):
    """What a table says of one wrench, m and rad; the error is that of the interpolation."""

    displacement: tuple[float, ...] | None
    error: tuple[float, ...] | None
    coverage: str
    reason: str
    method: str
    missing: tuple[str, ...]


class Batch(NamedTuple):
    """The same of n wrenches: (n, 6) each, and (n,); NaN where `Answer` has None."""

    displacement: Floats
    error: Floats
    coverage: NDArray[np.uint8]


def build(*arguments: Any, before: Any = None, **more: Any) -> Any:
    """Build a table: `surrogate.build.build`, with the calls of `Law`."""
    earlier = before.table if isinstance(before, Law) else before
    return Law(product.build(*arguments, before=earlier, **more))


def build_without_kriging(rows: Rows, load_range: LoadRange) -> Any:
    """Build a table that its axes answer, in a hundredth of the time."""
    with patch.object(product.Group, "kriging", None):
        table = build(rows, load_range)
        packed_of(table.table)
    return table


class Law:
    """A table that answers; all else is the table's or its first group's."""

    def __init__(self, table: product.Table) -> None:
        self.table = table

    def __getattr__(self, name: str) -> Any:
        if name == "table":  # while a copy or a pickle is made
            raise AttributeError(name)
        return getattr(self.table if hasattr(self.table, name) else self.table.groups[0], name)

    def answer(
        self,
        wrench: Sequence[float],
        tolerance: Tolerance | None = None,
        method: str | None = None,
    ) -> Answer:
        """Answer one wrench of six floats, N and N·m."""
        reported = packed_of(self.table).answer(wrench, tolerance and allowed_by(tolerance), method)
        words = reported.coverage, reported.reason, reported.method, reported.missing
        return Answer(reported.outputs, reported.interpolation, *words)

    def batch(
        self,
        wrenches: ArrayLike,
        tolerance: Tolerance | None = None,
        method: str | None = None,
    ) -> Batch:
        """Answer wrenches (n, 6), N and N·m."""
        asked = np.asarray(wrenches, dtype=float).reshape(-1, 6)
        outputs, errors, coverage = packed_of(self.table).batch(
            asked, tolerance and allowed_by(tolerance), method
        )
        table = self.table
        if table.solver_error or table.rig_error.any() or not table.bars_are_complete:
            reported = [self.answer(wrench, tolerance, method).error for wrench in asked.tolist()]
            errors = np.array([item or (None,) * 6 for item in reported], dtype=float).reshape(
                -1, 6
            )
        return Batch(outputs, errors, coverage)

    def by_method(self, wrenches: Floats, method: str = "griddata") -> Batch:
        """Answer wrenches (n, 6), N and N·m, by a method alone, also at rows."""
        return Batch(*packed_of(self.table).batch(wrenches, None, method, without_rows=True))

    def derivatives(self, wrenches: ArrayLike, method: str | None = None) -> Floats:
        """Return du/dw (n, 6, 6), SI, of a method at wrenches (n, 6), whatever rows are there."""
        return packed_of(self.table).derivatives(wrenches, method=method, without_rows=True)

    def explain(
        self,
        wrench: Sequence[float],
        tolerance: Tolerance | None = None,
        method: str | None = None,
    ) -> list[dict[str, Any]]:
        """Return what each axis contributes: see `kernel.explain`."""
        return explain(packed_of(self.table), wrench, tolerance and allowed_by(tolerance), method)


def mesh_errors(
    error: SolverError, wrenches: Floats, displacements: Floats, tangents: Floats
) -> Floats:
    """Return the mesh's share (n, 6), m and rad, of rows that have just these wrenches (n, 6).

    Displacements (n, 6), m and rad, and tangents (n, 6, 6), SI; NaN where unknown.
    """
    rows = Rows.of(wrenches, displacements, compliance=tangents, source=["fea"] * len(wrenches))
    sizes = np.where(rows.wrench == 0.0, np.inf, np.abs(rows.wrench)).min(axis=0)
    inner = np.where(np.isfinite(sizes), sizes / 2, 1.0)  # beyond it rows alone answer
    packed = packed_of(product.build(rows, LoadRange(-inner, inner), solver_error=error))
    return np.array([packed.answer(wrench).discretisation for wrench in wrenches.tolist()])
