"""The surrogate of one version of a table: rows in; displacement, error bar and coverage out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .answer import (
    COVERED,
    NAMES,
    OUTSIDE,
    THIN,
    Answer,
    Batch,
    allowed_by,
    over_tolerance,
)
from .composition.build import build_composition
from .composition.composition import Composition
from .describe.explain import explain_axes, explain_linear
from .describe.summary import summarise
from .kriging import Kriging, SingularCovarianceError, TooFewRowsError
from .methods.gaussian import GaussianProcess
from .methods.griddata import Griddata
from .methods.linear import Linear
from .methods.method import Method
from .methods.nearest import Nearest
from .methods.reference import BentReference, KrigingReference, Reference
from .methods.registry import Registry
from .methods.selection import (
    ENOUGH_FULL,
    Choice,
    choose,
    knows_interaction,
)
from .table.axes import OffAxis, clean_rows, clean_wrenches
from .table.compliance import ComplianceFit, fit_compliance
from .table.merging import merge
from .table.rows import CLEAN, Floats, LoadRange, Rows, Tolerance

MOST_INTERACTION = 200  # full wrenches that tell what the axes miss: one quick factor
WITHOUT_TOLERANCE = 0.01  # of an output's range: what a kriging's bar may be where nobody says
EMPTY = "the table has no rows"
ONLY_BEYOND = "all rows of the table are outside its load range"
UNKNOWN_AT_REST = (
    "no row is at zero load and the rows of no axis surround it: what the component does without "
    "load is not known"
)
UNKNOWN_ERROR = "no row tells how far this answer may be wrong"
UNKNOWN_TOGETHER = (
    f"{{full}} full wrenches and no tangents: at least {ENOUGH_FULL} full wrenches are needed to "
    "tell what loads of several axes do together"
)


class Surrogate:
    """The interpolators built from one version of a table; immutable.

    Attributes
    ----------
    rows : Rows
        All rows, in ascending order of `seq`.
    used : Rows
        Those that answers are made of: within the load range, repeated ones merged.
    members : tuple of tuple of int
        The numbers (`seq`) of the rows behind each of `used`.
    full_wrenches : int
        How many of those load more than one axis.
    load_range : LoadRange
    tolerance : Tolerance or None
    linear : bool
        Whether the component is linear, so that its 6x6 compliance is the whole truth.
    version : int
    fit : ComplianceFit
    kriging : Kriging or None
        None for linear components and where rows are too few.
    choice : Choice
        The default method, and why.
    """

    def __init__(
        self,
        rows: Rows,
        load_range: LoadRange,
        *,
        tolerance: Tolerance | None = None,
        linear: bool = False,
        off_axis: OffAxis = "correct",
        version: int = 0,
    ) -> None:
        if (np.diff(rows.seq) < 0).any():  # so that the order they come in changes nothing
            rows = rows.take(np.argsort(rows.seq, kind="stable"))
        self.rows, self.load_range, self.tolerance = rows, load_range, tolerance
        self.linear, self.version = linear, version
        self.off_axis: OffAxis = off_axis
        merged = merge(rows, load_range)
        self._exact, self._owner = merged.rows, merged.owner
        self.used = merged.rows.take(merged.within)
        self.members = tuple(merged.members[place] for place in np.flatnonzero(merged.within))
        self.full_wrenches = int((~clean_rows(self.used, load_range).any(axis=1)).sum())
        self.fit: ComplianceFit = fit_compliance(self.used, load_range, linear=linear)
        self.kriging = None if linear else self._kriging()
        self.knows_interaction = linear or knows_interaction(self.used, load_range)
        self._small = CLEAN * load_range.scale
        self._place = {tuple(w): p for p, w in reversed(list(enumerate(rows.wrench.tolist())))}
        self._methods = Registry(
            {
                "griddata": lambda: Griddata(self.composition, self.reference, bent=False),
                "tangent": lambda: Griddata(self.composition, self.reference, bent=True),
                "kriging": self._gaussian,
                "linear": self._linear,
                "nearest": lambda: Nearest(self.used, load_range, self.reference),
            }
        )
        self.choice = self._choice()
        if len(self.used):
            _ = self._methods.get(self.default)

    @property
    def default(self) -> str:
        """The method that answers where nobody asks for one."""
        return self.choice.method

    @cached_property
    def composition(self) -> Composition:
        """The three axes of the straight direction influence."""
        return self._compose(self.used)

    @cached_property
    def reference(self) -> Reference:
        """What the answers of methods are held against for their bars."""
        if self.kriging is not None and self.kriging.is_dense:
            return KrigingReference(self.kriging)
        return BentReference(self.composition, self._interaction())

    def answer(
        self,
        wrench: Sequence[float],
        tolerance: Tolerance | None = None,
        method: str | None = None,
    ) -> Answer:
        """Answer one wrench of six finite floats, N and N·m.

        Raises
        ------
        UnknownMethodError
            If the method is none of `METHODS`.
        """
        name = method or self.default
        if not len(self.used):
            self._methods.check(name)
            reason = ONLY_BEYOND if len(self.rows) else EMPTY
            return self._or_row(wrench, Answer(None, None, "outside", reason, "estimate"))
        found = self._methods.get(name)
        asked = np.array((wrench,), dtype=float)
        told = found.estimate(asked)
        displacement, error = tuple(told.displacement[0].tolist()), tuple(told.error[0].tolist())
        state, reason = int(told.state[0]), ""
        if state != COVERED:
            reason = found.reason(asked[0])
        elif not self._sure and (reason := self._doubt(asked)):
            state = OUTSIDE if reason == UNKNOWN_AT_REST else THIN
        if state == COVERED and not _within(error, allowed := self._allowed(name, tolerance)):
            state, reason = THIN, over_tolerance(error, allowed) or UNKNOWN_ERROR
        bars = error if isfinite(sum(error)) else None
        answer = Answer(displacement, bars, NAMES[state], reason, name)
        return answer if state == COVERED else self._or_row(wrench, answer)

    def batch(
        self,
        wrenches: ArrayLike,
        tolerance: Tolerance | None = None,
        method: str | None = None,
    ) -> Batch:
        """Answer many wrenches, shape (n, 6), N and N·m, with the same numbers as `answer`.

        Raises
        ------
        UnknownMethodError
            If the method is none of `METHODS`.
        """
        asked = np.asarray(wrenches, dtype=float).reshape(-1, 6)
        name = method or self.default
        if not len(self.used):
            self._methods.check(name)
            return self._with_rows(asked, _nothing(len(asked)))
        told = self._methods.get(name).estimate(asked)
        state = told.state.copy()
        over = ~(told.error <= np.array(self._allowed(name, tolerance))).all(axis=1)
        together, at_rest = self._doubtful(asked)
        state[(state == COVERED) & at_rest] = OUTSIDE
        state[(state == COVERED) & (over | together)] = THIN
        unknown = ~np.isfinite(told.error).all(axis=1)
        told.error[unknown] = np.nan
        return self._with_rows(asked, Batch(told.displacement, told.error, state))

    def derivatives(self, wrenches: ArrayLike, method: str | None = None) -> Floats:
        """Return du/dw (n, 6, 6) at wrenches (n, 6): m/N, m/(N·m), rad/N, rad/(N·m).

        Exact of the method's interpolant; NaN for a table without rows.

        Raises
        ------
        UnknownMethodError
            If the method is none of `METHODS`.
        """
        asked = np.asarray(wrenches, dtype=float).reshape(-1, 6)
        name = method or self.default
        if not len(self.used):
            self._methods.check(name)
            return np.full((len(asked), 6, 6), np.nan)
        return self._methods.get(name).derivatives(asked)

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
        asked = np.array(wrench, dtype=float)
        if name == "linear" and len(self.used):
            found = self.answer(wrench, tolerance, name)
            return explain_linear(self.fit, self.used, self.members, asked, found)
        limit = tolerance or self.tolerance
        return explain_axes(self.composition, self.members, asked, limit)

    def source_of(self, wrench: Sequence[float]) -> str | None:
        """Return the source of the row that has just this wrench, N and N·m; None if none has.

        Of several rows that have it, all their sources.
        """
        same = (self.rows.wrench == np.asarray(wrench, dtype=float)).all(axis=1)
        return ", ".join(dict.fromkeys(self.rows.source[same].tolist())) if same.any() else None

    def coverage_summary(self) -> dict[str, Any]:
        """Return how the table covers the load range, as JSON-able values."""
        composition = None if self.default == "linear" else self.composition
        summary = summarise(self.rows, self.used, self.load_range, self.fit, composition)
        return summary | {
            "method": self.default,
            "method_reason": self.choice.reason,
            "method_detail": "" if self.kriging is None else self.kriging.detail,
            "errors_left_out": self.choice.errors,
            "table_version": self.version,
            "full_wrench_rows": self.full_wrenches,
            "tells_full_wrenches": self.knows_interaction,
        }

    def is_ready(self, method: str | None) -> bool:
        """Return whether a method answers at once, rather than being made first."""
        return not len(self.used) or self._methods.is_made(method or self.default)

    @cached_property
    def ranges(self) -> Floats:
        """What each output varies by over the rows and from zero, shape (6,), m and rad."""
        moved = self.used.displacement
        return np.maximum(moved.max(axis=0, initial=0.0), 0.0) - np.minimum(
            moved.min(axis=0, initial=0.0), 0.0
        )

    def _compose(self, rows: Rows) -> Composition:
        return build_composition(rows, self.load_range, self.fit, self.off_axis)

    def _kriging(self) -> Kriging | None:
        try:
            return Kriging.build(self.used, self.load_range)
        except (TooFewRowsError, SingularCovarianceError):
            return None

    def _choice(self) -> Choice:
        if self.linear and self.fit.complete:
            return Choice("linear", "the component is linear: its compliance is exact", {})
        if self.linear:
            reason = "the component is linear, but its compliance is not known in all loads yet"
            return Choice("griddata", reason, {})
        return choose(self.used, self.load_range, self.kriging, self._compose)

    def _gaussian(self) -> Method:
        if self.kriging is None:  # too few rows, or rows that contradict each other
            return Griddata(self.composition, self.reference, bent=True)
        return GaussianProcess(self.kriging, self.load_range)

    def _linear(self) -> Method:
        exact = self.linear and self.fit.complete
        return Linear(self.fit, self.load_range, None if exact else self.reference)

    def _interaction(self) -> Kriging | None:
        """Return the kriging of what the bent axes miss full wrenches by that are not their own."""
        full = np.flatnonzero(~clean_rows(self.used, self.load_range).any(axis=1))
        tables = [table for table in self.composition.tables if table is not None]
        taken = [place for table in tables for group in table.rows.members for place in group]
        free = np.setdiff1d(full, taken)
        if len(free) < ENOUGH_FULL:
            return None
        rows = self.used.take(free[:MOST_INTERACTION])
        composed = self.composition.evaluate(rows.wrench)
        missed = rows.displacement - composed.displacement - composed.bend
        blank = np.full_like(rows.compliance, np.nan)
        try:
            return Kriging.build(
                replace(rows, displacement=missed, compliance=blank), self.load_range
            )
        except (TooFewRowsError, SingularCovarianceError):
            return None

    def _allowed(self, method: str, tolerance: Tolerance | None) -> Sequence[float]:
        """Return the largest bar of each output, shape (6,), m and rad, for a covered answer."""
        limit = tolerance or self.tolerance
        if limit is not None:
            return allowed_by(limit)
        if method == "kriging":
            return self._hundredths
        return (np.inf,) * 6

    def _doubtful(self, asked: Floats) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return which wrenches (n, 6) ask what no row shows, each (n,), whatever the bars say.

        What loads of several axes do together, and what the component does without load.
        """
        none = np.zeros(len(asked), dtype=bool)
        together = at_rest = none
        if not self.knows_interaction:
            together = np.asarray(~clean_wrenches(asked, self.load_range).any(axis=1))
        if self._rest_unknown:
            at_rest = np.asarray((np.abs(asked) <= self._small).all(axis=1))
        return together, at_rest

    def _doubt(self, asked: Floats) -> str:
        """Return why nothing tells how far one wrench, (1, 6), is right, or an empty text."""
        together, at_rest = self._doubtful(asked)
        if at_rest[0]:
            return UNKNOWN_AT_REST
        return UNKNOWN_TOGETHER.format(full=self.full_wrenches) if together[0] else ""

    @cached_property
    def _hundredths(self) -> list[float]:
        """A hundredth of each output's range; what no row moves has none to take a share of."""
        return np.where(self.ranges > 0, WITHOUT_TOLERANCE * self.ranges, np.inf).tolist()

    @cached_property
    def _sure(self) -> bool:
        """Whether no wrench is doubtful, whatever it loads."""
        return self.knows_interaction and not self._rest_unknown

    @cached_property
    def _rest_unknown(self) -> bool:
        return not self.linear and self.default == "griddata" and not self.composition.at_rest.known

    def _or_row(self, wrench: Sequence[float], found: Answer) -> Answer:
        """Return the row of just this wrench if there is one, else what was found."""
        place = self._place.get(tuple(wrench))
        if place is None:
            return found
        displacement, error = (tuple(each.tolist()) for each in self._row(place))
        return Answer(displacement, error, "covered", "", "row")

    def _row(self, place: int) -> tuple[Floats, Floats]:
        """Return displacement and uncertainty, (6,) each, m and rad, of a row or its merged one."""
        owner = self._owner[place]
        doubt = np.nan_to_num(self._exact.uncertainty[owner])
        return self._exact.displacement[owner], doubt

    def _with_rows(self, asked: Floats, found: Batch) -> Batch:
        """Where not covered, take the row of just that wrench if there is one."""
        doubtful = np.flatnonzero(found.coverage != COVERED)
        for place, wrench in zip(doubtful, map(tuple, asked[doubtful].tolist()), strict=True):
            row = self._place.get(wrench)
            if row is not None:
                found.displacement[place], found.error[place] = self._row(row)
                found.coverage[place] = COVERED
        return found


def _within(error: Sequence[float], allowed: Sequence[float]) -> bool:
    """Whether six error bars are within what is allowed; one that is not a number is not."""
    a, b, c, d, e, f = error
    u, v, w, x, y, z = allowed
    return a <= u and b <= v and c <= w and d <= x and e <= y and f <= z


def _nothing(count: int) -> Batch:
    """Return the answers of a table without rows."""
    blank = np.full((count, 6), np.nan)
    return Batch(blank, blank.copy(), np.full(count, OUTSIDE, dtype=np.uint8))
