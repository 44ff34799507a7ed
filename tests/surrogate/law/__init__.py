"""The law of a table's answers in numpy: the reference that the kernel is compared with."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wrenchbook.surrogate import build as product
from wrenchbook.surrogate.answer import COVERED, NAMES, THIN
from wrenchbook.surrogate.build import Group
from wrenchbook.surrogate.kernel.reasons import (
    EMPTY,
    ERRORS_UNKNOWN,
    ONLY_BEYOND,
    TOO_FAR,
    UNKNOWN_ERROR,
    UNKNOWN_TOGETHER,
)  # fmt: skip
from wrenchbook.surrogate.kriging.kriging import besides
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.table.rows import (
    Floats,
    Tolerance,
    acting,
    acting_wrench,
)  # fmt: skip
from wrenchbook.surrogate.table.space import LOAD_UNITS, LOADS, OUTPUTS

from .answer import Answer, Batch, no_answers, over_tolerance, within
from .exact_rows import RowLaw, sources_at
from .explain import explain_axes, explain_linear
from .limits import within_limits, within_limits_many
from .methods import Method, Reference, check, method_of, reference_of


def build(*arguments: Any, before: Any = None, **more: Any) -> Any:
    """Build a table with its law: `surrogate.build.build`, with the answers of `Law`."""
    earlier = before.table if isinstance(before, Law) else before
    return Law(product.build(*arguments, before=earlier, **more))


class Law:
    """A table's answers in numpy; all else is the table's."""

    def __init__(self, table: product.Table) -> None:
        self.table = table
        self.parts = [(group.outputs, GroupLaw(group)) for group in table.groups]
        held = {output for outputs, _ in self.parts for output in outputs}
        self.unmeasured = tuple(name for k, name in enumerate(OUTPUTS) if k not in held)

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
        """Answer one wrench of six finite floats, N and N·m."""
        return within_limits(self.estimate(wrench, tolerance, method))

    def batch(
        self,
        wrenches: ArrayLike,
        tolerance: Tolerance | None = None,
        method: str | None = None,
    ) -> Batch:
        """Answer many wrenches, shape (n, 6), N and N·m, with the same numbers as `answer`."""
        return within_limits_many(self.estimates(wrenches, tolerance, method))

    def estimate(
        self,
        wrench: Sequence[float],
        tolerance: Tolerance | None = None,
        method: str | None = None,
    ) -> Answer:
        """Answer one wrench, N and N·m; an output that no row holds is None, in the bars too."""
        moved: list[float | None] = [None] * 6
        bars: list[float | None] = [None] * 6
        answers = [part.estimate(wrench, tolerance, method) for _, part in self.parts]
        for (outputs, _), found in zip(self.parts, answers, strict=True):
            for output in outputs:
                moved[output] = found.displacement[output] if found.displacement else None
                bars[output] = found.error[output] if found.error else None
        # An answer is a row's only if all its outputs are.
        worst = max(answers, key=lambda one: (NAMES.index(one.coverage), one.method != "row"))
        texts = "; ".join(one.reason for one in answers if one.reason)
        reasons = list(dict.fromkeys(texts.split("; "))) if texts else []
        if self.unmeasured:
            reasons.append(f"not measured in any row: {', '.join(self.unmeasured)}")
        displacement = tuple(moved) if any(one is not None for one in moved) else None
        error = tuple(bars) if any(one is not None for one in bars) else None
        return Answer(
            displacement,  # pyright: ignore[reportArgumentType]  # None where not measured
            error,  # pyright: ignore[reportArgumentType]
            worst.coverage,
            "; ".join(reasons),
            worst.method,
            self.unmeasured,
        )

    def estimates(
        self,
        wrenches: ArrayLike,
        tolerance: Tolerance | None = None,
        method: str | None = None,
    ) -> Batch:
        """Answer many wrenches, shape (n, 6), N and N·m; NaN for an output that no row holds."""
        asked = np.asarray(wrenches, dtype=float).reshape(-1, 6)
        moved, bars = np.full((len(asked), 6), np.nan), np.full((len(asked), 6), np.nan)
        coverage = np.zeros(len(asked), dtype=np.uint8)
        for outputs, part in self.parts:
            found = part.estimates(asked, tolerance, method)
            chosen = list(outputs)
            moved[:, chosen] = found.displacement[:, chosen]
            bars[:, chosen] = found.error[:, chosen]
            coverage = np.maximum(coverage, found.coverage)
        return Batch(moved, bars, coverage)

    def derivatives(self, wrenches: ArrayLike, method: str | None = None) -> Floats:
        """Return du/dw (n, 6, 6), SI, of a method at wrenches (n, 6), whatever rows are there.

        The kernel's: test_parity compares it with differences of answers.
        """
        return packed_of(self.table).derivatives(wrenches, method=method, without_rows=True)

    def explain(
        self,
        wrench: Sequence[float],
        tolerance: Tolerance | None = None,
        method: str | None = None,
    ) -> list[dict[str, Any]]:
        """Return per group and axis what `GroupLaw.explain` does, for the outputs there are.

        The wrench is six floats, N and N·m.
        """
        detail = []
        for outputs, part in self.parts:
            names = {OUTPUTS[output] for output in outputs}
            for axis in part.explain(wrench, tolerance, method):
                for key in ("outputs", "error"):
                    if axis[key] is not None:
                        axis[key] = {k: v for k, v in axis[key].items() if k in names}
                if axis["outputs"]:
                    detail.append(axis)
        return detail

    def source_of(self, wrench: Sequence[float]) -> str | None:
        """Return the source of the rows at or beside a wrench, N and N·m; None if none is.

        Of several rows that have it, which may hold different outputs, all their sources.
        """
        return sources_at(self.rows, [part.by_row.wrench_at(wrench) for _, part in self.parts])

    def has_row(self, wrench: Sequence[float]) -> bool:
        """Return whether the row at or beside a wrench (6,), N and N·m, has just that."""
        return any(part.has_row(wrench) for _, part in self.parts)

    def near_rows(self, wrenches: Floats) -> NDArray[np.bool_]:
        """Return at or beside which wrenches (k, 6), N and N·m, there is a row, shape (k,)."""
        return np.logical_or.reduce([part.near_rows(wrenches) for _, part in self.parts])

    def row_tangent(self, wrench: Sequence[float]) -> Floats:
        """Return the tangent (6, 6), SI, of the rows at or beside a wrench; NaN where none has."""
        found = np.full((6, 6), np.nan)
        for outputs, part in self.parts:
            found[list(outputs)] = part.row_tangent(wrench)[list(outputs)]
        return found


class GroupLaw:
    """The answers of the outputs that the same rows hold."""

    def __init__(self, table: Group) -> None:
        self.table = table
        self.by_row = RowLaw(table)
        self._made: dict[str, Method] = {}

    def __getattr__(self, name: str) -> Any:
        return getattr(self.table, name)

    @cached_property
    def reference(self) -> Reference:
        """What the answers of methods are compared with for their error bars."""
        return reference_of(self.table)

    def answer(self, *asked: Any) -> Answer:
        """Answer one wrench: see `Law`."""
        return within_limits(self.estimate(*asked))

    def _method(self, name: str) -> Method:
        if name not in self._made:
            self._made[name] = method_of(self, name)
        return self._made[name]

    def estimate(
        self,
        wrench: Sequence[float],
        tolerance: Tolerance | None = None,
        method: str | None = None,
    ) -> Answer:
        """Answer one wrench of six finite floats, N and N·m."""
        wrench = acting_wrench(wrench, self.locked)
        name = method or self.default
        if not len(self.used):
            check(name)
            reason = ONLY_BEYOND if len(self.rows) else EMPTY
            nothing, allowed = Answer(None, None, "outside", reason, "estimate"), self.allowed
            return self.by_row.instead_of(wrench, nothing, allowed.of(tolerance))
        found = self._method(name)
        told = found.estimate(np.array((wrench,), dtype=float))
        displacement, error = tuple(told.displacement[0].tolist()), tuple(told.error[0].tolist())
        state, reason = int(told.state[0]), ""
        if state != COVERED:
            reason = found.reason(np.array(wrench, dtype=float))
        allowed = self.allowed.of(tolerance)
        if state == COVERED and not within(error, allowed):
            unknown = None if isfinite(sum(error)) else self._why_unknown(wrench)
            state, reason = THIN, unknown or over_tolerance(error, allowed)
        bars = error if isfinite(sum(error)) else None
        answered = self.default if name == "kriging" and self.kriging is None else name
        answer = Answer(displacement, bars, NAMES[state], reason, answered)
        return answer if state == COVERED else self.by_row.instead_of(wrench, answer, allowed)

    def estimates(
        self,
        wrenches: ArrayLike,
        tolerance: Tolerance | None = None,
        method: str | None = None,
    ) -> Batch:
        """Answer many wrenches, shape (n, 6), N and N·m, with the same numbers as `estimate`."""
        asked = acting(wrenches, self.locked).reshape(-1, 6)
        name = method or self.default
        allowed = self.allowed.of(tolerance)
        if not len(self.used):
            check(name)
            return self.by_row.put_into(asked, no_answers(len(asked)), allowed)
        told = self._method(name).estimate(asked)
        state = told.state.copy()
        over = ~(told.error <= np.array(allowed)).all(axis=1)
        state[(state == COVERED) & over] = THIN
        unknown = ~np.isfinite(told.error).all(axis=1)
        told.error[unknown] = np.nan
        return self.by_row.put_into(asked, Batch(told.displacement, told.error, state), allowed)

    def explain(
        self,
        wrench: Sequence[float],
        tolerance: Tolerance | None = None,
        method: str | None = None,
    ) -> list[dict[str, Any]]:
        """Return per axis its inputs, outputs, error bars, coverage, reason and rows (their seq).

        They are those of the compliance if it answers, of the composition otherwise.
        """
        name = method or self.default
        check(name)
        asked = acting(wrench, self.locked)
        if name == "linear" and len(self.used):
            found = self.answer(wrench, tolerance, name)
            return explain_linear(self.fit, self.used, self.members, asked, found)
        return explain_axes(self.table.axes, self.members, asked)

    def source_of(self, wrench: Sequence[float]) -> str | None:
        """Return the source of the row at or beside a wrench, N and N·m; None if none is.

        Of several rows that have its wrench, all their sources.
        """
        return sources_at(self.rows, [self.by_row.wrench_at(wrench)])

    def has_row(self, wrench: Sequence[float]) -> bool:
        """Return whether the row at or beside a wrench (6,), N and N·m, has just that."""
        return self.by_row.has(wrench)

    def near_rows(self, wrenches: Floats) -> NDArray[np.bool_]:
        """Return at or beside which wrenches (k, 6), N and N·m, there is a row, shape (k,)."""
        return self.by_row.near(wrenches)

    def row_tangent(self, wrench: Sequence[float]) -> Floats:
        """Return that row's tangent (6, 6), m/N, m/(N·m), rad/N, rad/(N·m); NaN if it has none."""
        return self.by_row.tangent(wrench)

    def _why_unknown(self, wrench: Sequence[float]) -> str:
        """Return why the error of an answer to a wrench (6,), N and N·m, is not known."""
        kriging = self.kriging
        if kriging is None:
            return UNKNOWN_ERROR
        if not kriging.knows_errors:
            return ERRORS_UNKNOWN
        bars = kriging.answer_many(np.asarray(wrench, dtype=float).reshape(1, 6))[1]
        if np.isfinite(bars).all():
            return UNKNOWN_ERROR
        low, high = kriging.scaling.wrenches(kriging.span)
        found = [
            f"{LOADS[load]} = {wrench[load]:.6g} {LOAD_UNITS[load]} is further from the rows, "
            f"which tell errors from {low[load]:.6g} to {high[load]:.6g} {LOAD_UNITS[load]}"
            for load in range(6)
            if not low[load] <= wrench[load] <= high[load]
        ]
        if found:
            return "; ".join(found)
        asked = kriging.scaling.loads(np.asarray(wrench, dtype=float)[None])
        together = (besides(asked, kriging.scaling) <= kriging.together).all()
        return TOO_FAR if together else UNKNOWN_TOGETHER
