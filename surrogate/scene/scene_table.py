"""A table cut to a scene: the whole table's answers at the scene's wrenches, from less."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import isnan
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..answer import COVERED, NAMES, OUTSIDE, Answer, Batch, UnknownMethodError
from ..build import AnyTable
from ..exact_rows import ExactRows, sources_at
from ..limits import within_limits, within_limits_many
from ..solver_error import SolverError, bars_are_whole
from ..surrogate import Surrogate
from ..table.merging import merge
from ..table.rows import (
    OUTPUTS,
    Floats,
    LoadRange,
    Rows,
    Tolerance,
    acting_one,
    without_locked,
)
from .need import Need
from .part import Part, PartAnswer, part_of, parts_of

UNREAD = "no row holds any output that the scene reads"


class OtherMethodError(UnknownMethodError):
    """A method that the scene's table does not hold."""

    def __init__(self, method: str, kept: str) -> None:
        ValueError.__init__(
            self,
            f"a scene's table answers by its component's default alone, {kept!r}, not by "
            f"{method!r}: download the whole table for that",
        )


class SceneTable:
    """What answers a scene's wrenches as the whole table does, for the outputs that it reads.

    An output that is not read is NaN (None in `answer`), as one that nobody measured; a load that
    cannot occur has no answer at all, one beyond the scene's range the whole's estimate without a
    bar. Both are `outside`.

    Attributes
    ----------
    need : Need
    parts : tuple of Part
        Outputs that the same rows hold.
    rows : Rows
        Those whose loads can occur: they answer their own wrench where nothing else does.
    version : int
    default : str
    plan : dict
        The scene plan that it follows, JSON-able; empty if none was made.
    solver_error : SolverError or None
        What the solver of the rows may be wrong by: no part of any bar here.
    bars_are_whole : bool
        Whether that is known where rows are solved.
    """

    def __init__(
        self,
        need: Need,
        parts: Sequence[Part],
        rows: Rows,
        version: int,
        default: str,
        plan: dict[str, Any] | None = None,
        solver_error: SolverError | None = None,
    ) -> None:
        self.solver_error = solver_error
        self.bars_are_whole = bars_are_whole(rows, solver_error)
        self.need, self.parts, self.rows = need, tuple(parts), rows
        self.version, self.default, self.plan = version, default, plan or {}
        answered = {output for part in self.parts for output in part.outputs}
        self.missing = tuple(name for k, name in enumerate(OUTPUTS) if k not in answered)
        ends = need.span.low - need.slack, need.span.high + need.slack
        self._ends = tuple(end.tolist() for end in ends)
        self._exact = [_exact_rows(rows, part, need.idle) for part in self.parts]

    def answer(
        self,
        wrench: Sequence[float],
        tolerance: Tolerance | None = None,
        method: str | None = None,
    ) -> Answer:
        """Answer one wrench of six finite floats, N and N·m, of the scene.

        Raises
        ------
        OtherMethodError
            If a method is asked for that is not the whole table's default.
        """
        self._check(method)
        wrench = acting_one(wrench, self.locked)
        asked = np.array((wrench,), dtype=float)
        for load, low, high in zip(wrench, *self._ends, strict=True):
            if not low <= load <= high:
                return self._beyond(asked, tolerance)
        told, methods = [], []
        for part, rows in zip(self.parts, self._exact, strict=True):
            one, method = part.answer(asked, tolerance), part.method
            if one.state != COVERED:
                allowed = part.allowed(tolerance).tolist()
                if (row := rows.at(wrench, allowed)) is not None:
                    moved, error = row.displacement.tolist(), row.error.tolist()
                    one, method = PartAnswer(moved, error, COVERED, ""), "row"
            told.append(one)
            methods.append(((one.state, method != "row"), method))
        moved, error, state, reason = told[0] if len(told) == 1 else self._joined(told)
        # The worst part's; an answer is a row's only if all its outputs are.
        worst = max(methods, key=lambda one: one[0])[1] if methods else self.default
        return self._told(moved, error, state, reason, worst)

    def batch(
        self,
        wrenches: ArrayLike,
        tolerance: Tolerance | None = None,
        method: str | None = None,
    ) -> Batch:
        """Answer many wrenches, shape (n, 6), N and N·m; NaN for an output that is not read.

        Raises
        ------
        OtherMethodError
            As in `answer`.
        """
        self._check(method)
        asked = self.need.acting(np.asarray(wrenches, dtype=float).reshape(-1, 6))
        return within_limits_many(self._estimated(asked, tolerance, rows=True))

    def derivatives(self, wrenches: ArrayLike, method: str | None = None) -> Floats:
        """Return du/dw (n, 6, 6) at wrenches (n, 6): m/N, m/(N·m), rad/N, rad/(N·m).

        NaN for an output that is not read, and by a load whose axis the scene's table lacks.

        Raises
        ------
        OtherMethodError
            As in `answer`.
        """
        self._check(method)
        asked = self.need.acting(np.asarray(wrenches, dtype=float).reshape(-1, 6))
        found = np.full((len(asked), 6, 6), np.nan)
        for part in self.parts:
            own = list(part.outputs)
            found[:, own] = part.derivatives(asked)[:, own]
        return without_locked(found, self.locked)

    def source_of(self, wrench: Sequence[float]) -> str | None:
        """Return the source of the rows at or beside a wrench, N and N·m; None if none is."""
        return sources_at(self.rows, [rows.wrench_at(wrench) for rows in self._exact])

    def has_row(self, wrench: Sequence[float]) -> bool:
        """Return whether the row at or beside a wrench (6,), N and N·m, has just that."""
        return any(rows.has(wrench) for rows in self._exact)

    @property
    def load_range(self) -> LoadRange:
        """The whole table's, N and N·m: rows beyond it answer their own wrench alone."""
        return self.parts[0].load_range

    @property
    def locked(self) -> tuple[int, ...]:
        """The places of the loads on locked freedoms, which change no answer."""
        return self.need.idle

    def near_rows(self, wrenches: Floats) -> NDArray[np.bool_]:
        """Return at or beside which wrenches (k, 6), N and N·m, there is a row, shape (k,)."""
        near = [rows.near(wrenches) for rows in self._exact]
        return np.logical_or.reduce(near) if near else np.zeros(len(wrenches), dtype=bool)

    def row_tangent(self, wrench: Sequence[float]) -> Floats:
        """Return the tangent (6, 6), SI, of the rows at or beside a wrench; NaN where none has."""
        found = np.full((6, 6), np.nan)
        for part, rows in zip(self.parts, self._exact, strict=True):
            found[list(part.outputs)] = rows.tangent(wrench)[list(part.outputs)]
        return found

    def _check(self, method: str | None) -> None:
        if method is not None and method != self.default:
            raise OtherMethodError(method, self.default)

    def _beyond(self, asked: Floats, tolerance: Tolerance | None) -> Answer:
        """Answer a wrench (1, 6) that the scene has not."""
        found = self._estimated(asked, tolerance)
        moved, error = found.displacement[0].tolist(), found.error[0].tolist()
        return self._told(moved, error, OUTSIDE, self.need.why_beyond(asked[0]), self.default)

    def _joined(self, told: list[PartAnswer]) -> PartAnswer:
        """Return what several parts say as one: each its outputs, the worst coverage."""
        moved: list[float | None] = [None] * 6
        error: list[float | None] = [None] * 6
        for part, one in zip(self.parts, told, strict=True):
            for output in part.outputs:
                moved[output], error[output] = one.displacement[output], one.error[output]
        reasons = dict.fromkeys(one.reason for one in told if one.reason)
        state = max((one.state for one in told), default=OUTSIDE)
        return PartAnswer(moved, error, state, "; ".join(reasons) or ("" if told else UNREAD))

    def _told(
        self,
        moved: list[float | None],
        error: list[float | None],
        state: int,
        reason: str,
        method: str,
    ) -> Answer:
        if self.missing or state != COVERED:  # NaN is no number of the wire
            moved, error = _known(moved), _known(error)
        any_moved = any(one is not None for one in moved)
        any_error = any(one is not None for one in error)
        found = Answer(
            tuple(moved) if any_moved else None,  # pyright: ignore[reportArgumentType]  # None: not read
            tuple(error) if any_error else None,  # pyright: ignore[reportArgumentType]
            NAMES[state],
            reason,
            method,
            self.missing,
        )
        return within_limits(found)

    def _estimated(
        self, asked: Floats, tolerance: Tolerance | None, *, rows: bool = False
    ) -> Batch:
        """Return what the parts say, or rows of just these wrenches where a part covers none.

        And nothing of loads that cannot occur.
        """
        moved, bars = np.full((len(asked), 6), np.nan), np.full((len(asked), 6), np.nan)
        coverage = np.zeros(len(asked), dtype=np.uint8)
        for part, exact in zip(self.parts, self._exact, strict=True):
            found, own = part.batch(asked, tolerance), list(part.outputs)
            if rows:
                found = exact.put_into(asked, found, part.allowed(tolerance).tolist())
            moved[:, own], bars[:, own] = found.displacement[:, own], found.error[:, own]
            coverage = np.maximum(coverage, found.coverage)
        beyond = self.need.beyond(asked)
        moved[(beyond & ~self.need.varying).any(axis=1)] = np.nan
        bars[beyond.any(axis=1)] = np.nan
        coverage[beyond.any(axis=1)] = OUTSIDE
        return Batch(moved, bars, coverage)


def _exact_rows(rows: Rows, part: Part, locked: Sequence[int]) -> ExactRows:
    """Return the rows that answer in a part's stead: those that hold its outputs."""
    kept = rows.take(np.isfinite(rows.displacement[:, list(part.outputs)]).all(axis=1))
    told = part.limits.ranges, kept, np.arange(len(kept))
    return ExactRows(kept.wrench, part.load_range, *told, locked)


def scene_table(whole: AnyTable, need: Need, plan: dict[str, Any] | None = None) -> SceneTable:
    """Return a table cut to what a scene needs, its answers those of the whole.

    Parameters
    ----------
    plan : dict, optional
        The scene plan that it follows.
    """
    groups = parts_of(whole)
    parts = []
    for outputs, surrogate in groups:
        read = tuple(output for output in outputs if output in need.outputs)
        if read:
            parts.append(part_of(surrogate, read, need))
    own = _own_rows(groups, whole, need)
    return SceneTable(need, parts, own, whole.version, whole.default, plan, whole.solver_error)


def _own_rows(
    groups: Sequence[tuple[Sequence[int], Surrogate]], whole: AnyTable, need: Need
) -> Rows:
    """Return the rows whose loads can occur, with what they answer to their own wrench.

    That is the mean of the rows merged with one, NaN where an output is not read.
    """
    beyond = (need.beyond(whole.rows.wrench) & ~need.varying).any(axis=1)
    kept = whole.rows.take(~beyond)
    moved, doubt = np.full((len(kept), 6), np.nan), np.full((len(kept), 6), np.nan)
    compliance = np.full((len(kept), 6, 6), np.nan)
    for outputs, surrogate in groups:
        own = [output for output in outputs if output in need.outputs]
        merged = merge(surrogate.rows, surrogate.load_range)
        places = np.searchsorted(surrogate.rows.seq, kept.seq)
        there = np.isin(kept.seq, surrogate.rows.seq)
        owner = merged.owner[places[there]]
        to = np.ix_(np.flatnonzero(there), np.array(own, dtype=np.intp))
        moved[to] = merged.rows.displacement[owner][:, own]
        compliance[to] = merged.rows.compliance[owner][:, own]
        doubt[to] = np.nan_to_num(merged.rows.uncertainty[owner][:, own])
    held = np.asarray(np.isfinite(moved).any(axis=1))
    told = replace(kept, displacement=np.where(held[:, None], moved, 0.0), uncertainty=doubt)
    return replace(told, compliance=compliance).take(held)


def _known(values: list[float | None]) -> list[float | None]:
    """Return numbers, None for one that is not known."""
    return [None if one is None or isnan(one) else one for one in values]
