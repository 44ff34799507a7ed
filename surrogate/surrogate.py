"""The surrogate of one version of a table: rows in; displacement, error bar and coverage out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from math import isfinite
from time import thread_time
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .allowed import Allowed, allowed_of
from .answer import COVERED, NAMES, OUTSIDE, THIN, Answer, Batch, no_answers, over_tolerance, within
from .composition.build import build_composition
from .composition.composition import Composition
from .describe.explain import explain_axes, explain_linear
from .describe.summary import summarise
from .doubt import UNKNOWN_AT_REST, Doubt, doubt_of
from .exact_rows import ExactRows, sources_at
from .kriging import (
    Kriging,
    Readings,
    SingularCovarianceError,
    TooFewRowsError,
    equation_count,
    fits_one_factor,
    readings_of,
    too_large_in_words,
)
from .limits import LimitedAnswers
from .methods.makers import makers
from .methods.reference import AxesReference, KrigingReference, Reference, interaction_of
from .methods.registry import Registry
from .methods.selection import Choice, choose, linear_choice, without_kriging
from .solver_error import SolverError
from .table.axes import OffAxis
from .table.compliance import ComplianceFit, fit_compliance
from .table.merging import merge
from .table.rows import Floats, LoadRange, Rows, Tolerance, acting, acting_one, without_locked

EMPTY = "the table has no rows"
ONLY_BEYOND = "all rows of the table are outside its load range"
UNKNOWN_ERROR = "no row tells how far this answer may be wrong"


class Surrogate(LimitedAnswers):
    """The interpolators built from one version of a table; immutable.

    Attributes
    ----------
    rows : Rows
        All rows, in ascending order of `seq`.
    used : Rows
        Those that answers are made of: within the load range, repeated ones merged.
    members : tuple of tuple of int
        The numbers (`seq`) of the rows behind each of `used`.
    load_range : LoadRange
    tolerance : Tolerance or None
    linear : bool
        Whether the component is linear, so that its 6x6 compliance is the whole truth.
    version : int
    locked : tuple of int
        Places, in `LOADS`, of the loads on locked freedoms: every call sets them to zero first.
    fit : ComplianceFit
    equations : int
        How many a kriging of the table has.
    one_factor : bool
        Whether one factor holds them: then the kriging is what bars are told by.
    choice : Choice
        The default method, and why.
    doubt : Doubt
        What the rows do not show, whatever the bars say.
    exact : ExactRows
        What rows say at and beside their own wrenches.
    build_s : float, s
        Processor time that building it took.
    solver_error : SolverError or None
        What the solver may be wrong by: in no bar here; `bars_are_whole` says if it is known.
    """

    solver_error: SolverError | None = None
    bars_are_whole: bool = True

    def __init__(
        self,
        rows: Rows,
        load_range: LoadRange,
        *,
        tolerance: Tolerance | None = None,
        linear: bool = False,
        off_axis: OffAxis = "correct",
        version: int = 0,
        before: Surrogate | None = None,
        locked: Sequence[int] = (),
    ) -> None:
        """Build from rows; axes that another version has as well are taken from it."""
        started = thread_time()
        if (np.diff(rows.seq) < 0).any():  # so that the order they come in changes nothing
            rows = rows.take(np.argsort(rows.seq, kind="stable"))
        self.rows, self.load_range, self.tolerance = rows, load_range, tolerance
        self.linear, self.version = linear, version
        self.off_axis: OffAxis = off_axis
        self.locked = tuple(locked)
        merged = merge(rows, load_range)
        self._merged = merged
        self.used, self.members = merged.usable()
        self.fit: ComplianceFit = fit_compliance(self.used, load_range, linear=linear)
        self.equations = self._equations()
        self.one_factor = fits_one_factor(self.equations)
        self._methods = Registry(makers(self))
        if len(self.used) and not (linear and self.fit.complete):
            # Not kept: versions would hold each other without end.
            known = before.composition_if_made if before is not None else None
            self.composition = self._compose(known)
        self.choice = self._choice()
        if len(self.used):
            _ = self._methods.get(self.default)
        if self.by_axes and (thinning := self.composition.thinning):
            self.choice = replace(self.choice, reason=f"{self.choice.reason}; {thinning}")
        self.doubt = self._doubt()
        told = self.ranges, merged.rows, merged.owner
        self.exact = ExactRows(rows.wrench, load_range, *told, self.locked)
        self.build_s = thread_time() - started

    @property
    def default(self) -> str:
        """The method that answers where nobody asks for one."""
        return self.choice.method

    @cached_property
    def composition(self) -> Composition:
        """The three axes of the straight direction influence."""
        return self._compose(None)

    def _compose(self, before: Composition | None) -> Composition:
        return build_composition(self.used, self.load_range, self.fit, self.off_axis, before)

    @property
    def by_axes(self) -> bool:
        """Whether the default method is one of the axes'."""
        return len(self.used) > 0 and self.default in ("griddata", "additive")

    @property
    def composition_if_made(self) -> Composition | None:
        """The composition, if something has asked for it."""
        return self.__dict__.get("composition")

    @cached_property
    def reference(self) -> Reference:
        """What the answers of methods are compared with for their error bars."""
        if self.default == "kriging" and self.kriging is not None:
            return KrigingReference(self.kriging)
        interaction = interaction_of(self.used, self.load_range, self.composition)
        return AxesReference(self.composition, interaction)

    @cached_property
    def kriging(self) -> Kriging | None:
        """The kriging; None where one factor does not hold it.

        That is of linear components, and where rows are too few or too many, or contradict.
        """
        if self.linear or not self.one_factor:
            return None
        try:
            return Kriging.build(self.used, self.load_range, readings=self._readings())
        except (TooFewRowsError, SingularCovarianceError):
            return None

    def estimate(
        self,
        wrench: Sequence[float],
        tolerance: Tolerance | None = None,
        method: str | None = None,
    ) -> Answer:
        """Answer one wrench of six finite floats, N and N·m."""
        wrench = acting_one(wrench, self.locked)
        name = method or self.default
        if not len(self.used):
            self._methods.check(name)
            reason = ONLY_BEYOND if len(self.rows) else EMPTY
            nothing, allowed = Answer(None, None, "outside", reason, "estimate"), self.allowed
            return self.exact.instead_of(wrench, nothing, allowed.of(tolerance))
        found = self._methods.get(name)
        told = found.one(tuple(map(float, wrench)))
        displacement, error, state, reason = told[:6], told[6:12], int(told[12]), ""
        if state != COVERED:
            reason = found.reason(np.array(wrench, dtype=float))
        elif not self.doubt.none and (reason := self.doubt.of_one(wrench)):
            state = OUTSIDE if reason == UNKNOWN_AT_REST else THIN
        allowed = self.allowed.of(tolerance)
        if state == COVERED and not within(error, allowed):
            unknown = None if isfinite(sum(error)) else self._why_unknown(wrench)
            state, reason = THIN, unknown or over_tolerance(error, allowed)
        bars = error if isfinite(sum(error)) else None
        answer = Answer(displacement, bars, NAMES[state], reason, name)
        return answer if state == COVERED else self.exact.instead_of(wrench, answer, allowed)

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
            self._methods.check(name)
            return self.exact.put_into(asked, no_answers(len(asked)), allowed)
        told = self._methods.get(name).estimate(asked)
        state = told.state.copy()
        over = ~(told.error <= np.array(allowed)).all(axis=1)
        together, at_rest = self.doubt.of_many(asked)
        state[(state == COVERED) & at_rest] = OUTSIDE
        state[(state == COVERED) & (over | together)] = THIN
        unknown = ~np.isfinite(told.error).all(axis=1)
        told.error[unknown] = np.nan
        return self.exact.put_into(asked, Batch(told.displacement, told.error, state), allowed)

    def derivatives(self, wrenches: ArrayLike, method: str | None = None) -> Floats:
        """Return du/dw (n, 6, 6) at wrenches (n, 6): m/N, m/(N·m), rad/N, rad/(N·m).

        Exact of the method's interpolant; NaN for a table without rows.

        Raises
        ------
        UnknownMethodError
            If the method is none of `METHODS`.
        """
        asked = acting(wrenches, self.locked).reshape(-1, 6)
        name = method or self.default
        if not len(self.used):
            self._methods.check(name)
            return np.full((len(asked), 6, 6), np.nan)
        return without_locked(self._methods.get(name).derivatives(asked), self.locked)

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
        self._methods.check(name)
        asked = acting(wrench, self.locked)
        if name == "linear" and len(self.used):
            found = self.answer(wrench, tolerance, name)
            return explain_linear(self.fit, self.used, self.members, asked, found)
        limit = tolerance or self.tolerance
        return explain_axes(self.composition, self.members, asked, limit)

    def source_of(self, wrench: Sequence[float]) -> str | None:
        """Return the source of the row at or beside a wrench, N and N·m; None if none is.

        Of several rows that have its wrench, all their sources.
        """
        return sources_at(self.rows, [self.exact.wrench_at(wrench)])

    def has_row(self, wrench: Sequence[float]) -> bool:
        """Return whether the row at or beside a wrench (6,), N and N·m, has just that."""
        return self.exact.has(wrench)

    def near_rows(self, wrenches: Floats) -> NDArray[np.bool_]:
        """Return at or beside which wrenches (k, 6), N and N·m, there is a row, shape (k,)."""
        return self.exact.near(wrenches)

    def row_tangent(self, wrench: Sequence[float]) -> Floats:
        """Return that row's tangent (6, 6), m/N, m/(N·m), rad/N, rad/(N·m); NaN if it has none."""
        return self.exact.tangent(wrench)

    def coverage_summary(self) -> dict[str, Any]:
        """Return how the table covers the load range, as JSON-able values."""
        return dict(self._summary)

    @cached_property
    def _summary(self) -> dict[str, Any]:
        """The summary, which takes seconds for 100,000 rows and is the same for one version."""
        composition = None if self.default == "linear" else self.composition
        summary = summarise(self.rows, self.used, self.load_range, self.fit, composition)
        return summary | {
            "method": self.default,
            "method_reason": self.choice.reason,
            "method_detail": self._kriging_detail,
            "errors_left_out": self.choice.errors,
            "table_version": self.version,
            "full_wrench_rows": self.doubt.full_wrenches,
            "tells_full_wrenches": self.doubt.knows_interaction,
        }

    @cached_property
    def allowed(self) -> Allowed:
        """How large the bars of covered answers may be."""
        return allowed_of(self.used, self.tolerance)

    @property
    def steepest(self) -> Floats:
        """What each output moves over half the load range at most, (6,), m and rad: `ExactRows`."""
        return self.exact.steepest

    @property
    def ranges(self) -> Floats:
        """What each output varies by over the rows and from zero, shape (6,), m and rad."""
        return self.allowed.ranges

    def __getstate__(self) -> dict[str, Any]:
        """Return what is pickled: all but how methods are made that are not."""
        return {**self.__dict__, "_methods": self._methods.made}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._methods = Registry(makers(self), state["_methods"])

    def _doubt(self) -> Doubt:
        rest_unknown = self.by_axes and not self.linear and not self.composition.at_rest.known
        return doubt_of(self.used, self.load_range, linear=self.linear, rest_unknown=rest_unknown)

    def _why_unknown(self, wrench: Sequence[float]) -> str:
        """Return why the error of an answer to a wrench (6,), N and N·m, is not known."""
        told = isinstance(self.reference, KrigingReference) and self.kriging is not None
        found = self.kriging.why_unknown(np.array(wrench)) if told and self.kriging else ""
        return found or UNKNOWN_ERROR

    def _readings(self) -> Readings:
        """Return what was measured behind each of `used`, for the noise that nobody stated."""
        inside = np.flatnonzero(self._merged.within)
        return readings_of(self.rows, self._merged.owner).take(inside)

    def _equations(self) -> int:
        try:
            return 0 if self.linear else equation_count(self.used, self.load_range)
        except TooFewRowsError:
            return 0

    def _choice(self) -> Choice:
        if not len(self.used):
            return Choice("griddata", "there are no rows", {})
        if self.linear:
            return linear_choice(self.used, self.load_range, self.fit, self.composition_if_made)
        if not self.one_factor:
            detail = self._kriging_detail
            return without_kriging(self.used, self.load_range, self.composition, detail)
        return choose(self.used, self.load_range, self.composition, lambda: self.kriging)

    @property
    def _kriging_detail(self) -> str:
        if not self.one_factor:
            return too_large_in_words(len(self.used), self.equations)
        by_kriging = self.default == "kriging" and self.kriging is not None
        return self.kriging.detail if by_kriging and self.kriging else ""
