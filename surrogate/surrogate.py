"""The interpolators of one version of a table; its packed form answers (`surrogate.kernel`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from time import thread_time
from typing import Any

import numpy as np

from .answer import Allowed, allowed_of
from .axes.axes import Composition, build_composition
from .describe import summarise
from .exact_rows import ExactRows
from .kriging import (
    Kriging,
    SingularCovarianceError,
    TooFewRowsError,
    equation_count,
    fits_one_factor,
    too_large_in_words,
)
from .methods import (
    MethodChoice,
    choose,
    choose_without_axes,
    full_needed,
    interaction_of,
    knows_interaction,
    linear_choice,
    without_kriging,
)
from .table.axes import OffAxis, count_full
from .table.compliance import ComplianceFit, fit_compliance
from .table.merging import merge
from .table.rows import Floats, LoadRange, Rows, Tolerance


class Surrogate:
    """The interpolators built from one version of a table; immutable.

    Attributes
    ----------
    outputs : tuple of int
        Places, in `OUTPUTS`, of the outputs it answers.
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
        Whether one factor holds them: error bars then come from the kriging.
    choice : MethodChoice
        The default method, and why.
    has_axes : bool
        Whether straight direction influence is defined: of one interface without further inputs.
    evidence : Evidence
        Whether rows show interaction of axes, and the answer at no load.
    exact : ExactRows
        The rows that answer at or next to their own wrenches.
    build_s : float, s
        Processor time that building it took.
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
        before: Surrogate | None = None,
        locked: Sequence[int] = (),
        outputs: tuple[int, ...] = (),
    ) -> None:
        """Build from rows; axes that another version has as well are taken from it.

        `outputs` are those that the rows have, all where none are named; the others are 0 and
        count for nothing.
        """
        started = thread_time()
        self.has_axes = load_range.space.is_default
        self.outputs = outputs or tuple(range(len(load_range.space.outputs)))
        self.rows, self.load_range, self.tolerance = rows, load_range, tolerance
        self.linear, self.version = linear, version
        self.off_axis: OffAxis = off_axis
        self.locked = tuple(locked)
        merged = merge(rows, load_range)
        self.used, self.members, self._readings = merged.usable()
        self.fit: ComplianceFit = fit_compliance(self.used, load_range, linear=linear)
        self.equations = self._equations()
        self.one_factor = fits_one_factor(self.equations)
        if self.has_axes and len(self.used) and not (linear and self.fit.complete):
            # Not kept: versions would hold each other without end.
            known = before.composition_if_made if before is not None else None
            self.composition = self._compose(known)
        self.choice = self._choice()
        if self.by_axes:
            _ = self.interaction
        if self.by_axes and (thinning := self.composition.thinning):
            self.choice = replace(self.choice, reason=f"{self.choice.reason}; {thinning}")
        self.evidence = self._evidence()
        of_rows = self.ranges, merged.rows, merged.owner
        self.exact = ExactRows(rows.wrench, load_range, *of_rows, self.locked)
        self.build_s = thread_time() - started

    @property
    def default(self) -> str:
        """The method that answers where a query names none."""
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
        """The composition, if it has been made."""
        return self.__dict__.get("composition")

    @property
    def reading(self) -> Floats:
        """Noise of one reading, 95 %, (6,), m and rad; NaN where it is not known."""
        if not self.by_kriging or self.kriging is None:
            return np.full(self.rows.displacement.shape[1], np.nan)
        return self.kriging.reading

    @property
    def by_kriging(self) -> bool:
        """Whether the kriging answers by default: then its own error bars hold."""
        return self.default == "kriging" and self.kriging is not None

    @cached_property
    def interaction(self) -> Kriging | None:
        """The kriging of what the additive composition of the axes leaves out."""
        return interaction_of(self.used, self.load_range, self.composition)

    @cached_property
    def kriging(self) -> Kriging | None:
        """The kriging; None where one factor does not hold it.

        That is of linear components, and where rows are too few or too many, or contradict.
        """
        if self.linear or not self.one_factor:
            return None
        try:
            return Kriging.build(self.used, self.load_range, readings=self._readings)
        except (TooFewRowsError, SingularCovarianceError):
            return None

    def coverage_summary(self) -> dict[str, Any]:
        """Return how the table covers the load range, as JSON-able values."""
        return dict(self._summary)

    @cached_property
    def _summary(self) -> dict[str, Any]:
        """The summary, which takes seconds for 100,000 rows and is the same for one version."""
        no_axes = self.default == "linear" or not self.has_axes
        composition = None if no_axes else self.composition
        summary = summarise(self.rows, self.used, self.load_range, self.fit, composition)
        return summary | {
            "method": self.default,
            "method_reason": self.choice.reason,
            "method_detail": self._kriging_detail,
            "errors_left_out": self.choice.errors,
            "table_version": self.version,
            "full_wrench_rows": self.evidence.full_wrenches,
            "tells_full_wrenches": self.evidence.knows_interaction,
        }

    @cached_property
    def allowed(self) -> Allowed:
        """How large the bars of covered answers may be."""
        return allowed_of(self.used, self.tolerance, self.outputs)

    @property
    def ranges(self) -> Floats:
        """What each output varies by over the rows and from zero, shape (m,), m and rad."""
        return self.allowed.ranges

    @property
    def is_exact(self) -> bool:
        """Whether the compliance answers by itself, with its own error bars."""
        by_compliance = self.linear or (not self.has_axes and self.default == "linear")
        return by_compliance and self.fit.complete

    @property
    def can_answer(self) -> bool:
        """Whether there are rows to answer from, and a method that does."""
        by_axes_or_kriging = self.has_axes or self.by_kriging
        return len(self.used) > 0 and (by_axes_or_kriging or self.is_exact)

    def _evidence(self) -> Evidence:
        if not self.has_axes:  # the kriging's own error bars tell what interaction is not known
            return Evidence(True, False, 0, 0)
        rest_unknown = self.by_axes and not self.linear and not self.composition.at_rest.known
        return evidence_of(
            self.used, self.load_range, linear=self.linear, rest_unknown=rest_unknown
        )

    def _equations(self) -> int:
        try:
            return 0 if self.linear else equation_count(self.used, self.load_range)
        except TooFewRowsError:
            return 0

    def _choice(self) -> MethodChoice:
        if not len(self.used):
            method = "griddata" if self.has_axes else "linear"
            return MethodChoice(method, "there are no rows", {})
        if not self.has_axes:
            return choose_without_axes(self.used, self.fit, lambda: self.kriging, self.linear)
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
        return self.kriging.detail if self.by_kriging and self.kriging else ""


@dataclass(frozen=True)
class Evidence:
    """What the rows of a table show of interaction and of zero load.

    Attributes
    ----------
    knows_interaction : bool
        Whether rows show what loads of several axes do together.
    rest_unknown : bool
        Whether nothing tells what the component does without load.
    full_wrenches, needed : int
        How many rows load more than one axis, and how many must for `knows_interaction`.
    """

    knows_interaction: bool
    rest_unknown: bool
    full_wrenches: int
    needed: int


def evidence_of(rows: Rows, load_range: LoadRange, *, linear: bool, rest_unknown: bool) -> Evidence:
    """Return what the rows that answers are made of do not show.

    Loads of a linear component act by themselves.
    """
    knows = linear or knows_interaction(rows, load_range)
    full = count_full(rows, load_range)
    return Evidence(knows, rest_unknown, full, full_needed(rows))
