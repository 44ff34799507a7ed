"""What answers the outputs that the same rows hold, cut to a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import isfinite
from typing import NamedTuple

import numpy as np

from ..allowed import Allowed
from ..answer import COVERED, OUTSIDE, THIN, Batch, over_tolerance
from ..bars.error_law import ErrorLaw
from ..build import AnyTable
from ..composition.axis_table import AxisTable
from ..composition.composition import AtRest, Composition
from ..doubt import UNKNOWN_AT_REST, Doubt
from ..kriging import Kriging
from ..methods.gaussian import GaussianProcess
from ..methods.linear import Linear
from ..methods.method import Method
from ..methods.reference import AxesReference
from ..methods.straight_direction import StraightDirection
from ..missing_outputs import MissingOutputs
from ..surrogate import (
    EMPTY,
    ONLY_BEYOND,
    UNKNOWN_ERROR,
    Surrogate,
)
from ..table.axes import AXES, AxisRows
from ..table.compliance import ComplianceFit
from ..table.rows import Floats, LoadRange, Tolerance
from .lean import lean_kriging
from .need import Need


class PartAnswer(NamedTuple):
    """What a part says of one wrench: six numbers each, m and rad, None where it has none."""

    displacement: list[float | None]
    error: list[float | None]
    state: int
    reason: str


_NOTHING: list[float | None] = [None] * 6


@dataclass(frozen=True)
class Axes:
    """What a composition is made of: the rows of the axes that the scene loads.

    Attributes
    ----------
    rows : tuple of AxisRows or None, length 3
    laws : tuple of ErrorLaw or None, length 3
        How their error bars grow.
    at_rest : AtRest
    """

    rows: tuple[AxisRows | None, ...]
    laws: tuple[ErrorLaw | None, ...]
    at_rest: AtRest


@dataclass(frozen=True)
class Part:
    """What answers some outputs within a scene; its fields are all that a file of it holds.

    Attributes
    ----------
    outputs : tuple of int
        Those it answers, of those that the scene reads.
    method : str
        The whole table's default: the one method that is kept.
    linear : bool
        Whether the component is.
    load_range : LoadRange
        The component's, N and N·m: what loads are scaled by.
    tolerance : Tolerance or None, m and rad
    ranges : ndarray, shape (6,), m and rad
        What each output varies by over all rows.
    rows : int
        How many rows the whole has.
    fit : ComplianceFit
    kriging, interaction : Kriging or None
        What answers; what the axes leave out.
    axes : Axes or None
        None where the method needs none.
    doubt : Doubt
        What the whole's rows do not show.
    """

    outputs: tuple[int, ...]
    method: str
    linear: bool
    load_range: LoadRange
    tolerance: Tolerance | None
    limits: Allowed
    rows: int
    fit: ComplianceFit
    kriging: Kriging | None
    interaction: Kriging | None
    axes: Axes | None
    doubt: Doubt

    @cached_property
    def answering(self) -> Method | None:
        """The method, made of what is kept; None where no row is within the load range."""
        if not self.limits.ranges.any() and self.axes is None and self.kriging is None:
            return Linear(self.fit, self.load_range, None) if self.method == "linear" else None
        if self.method == "linear":
            return Linear(self.fit, self.load_range, None)
        if self.method == "kriging":
            assert self.kriging is not None
            return GaussianProcess(self.kriging, self.load_range)
        reference = AxesReference(self.composition, self.interaction)
        return StraightDirection(self.composition, reference, self.method)

    @cached_property
    def composition(self) -> Composition:
        """The axes that the scene loads."""
        assert self.axes is not None
        pairs = zip(self.axes.rows, self.axes.laws, strict=True)
        tables = [rows and AxisTable(rows, self.load_range, law) for rows, law in pairs]
        return Composition(tables, self.axes.at_rest, self.fit, self.load_range.scale)

    def batch(self, asked: Floats, tolerance: Tolerance | None) -> Batch:
        """Answer wrenches (n, 6), N and N·m, of the scene, as the whole table's default does.

        An output that is not the part's own is not judged and NaN.
        """
        if self.answering is None:
            blank = np.full((len(asked), 6), np.nan)
            return Batch(blank, blank.copy(), np.full(len(asked), OUTSIDE, dtype=np.uint8))
        told = self.answering.estimate(asked)
        state, own = told.state.copy(), list(self.outputs)
        over = ~(told.error <= self.allowed(tolerance))[:, own].all(axis=1)
        together, at_rest = self.doubt.of_many(asked)
        state[(state == COVERED) & at_rest] = OUTSIDE
        state[(state == COVERED) & (over | together)] = THIN
        moved, error = np.full((len(asked), 6), np.nan), np.full((len(asked), 6), np.nan)
        moved[:, own] = told.displacement[:, own]
        known = np.asarray(np.isfinite(told.error[:, own]).all(axis=1))
        error[:, own] = np.where(known[:, None], told.error[:, own], np.nan)
        return Batch(moved, error, state)

    def answer(self, asked: Floats, tolerance: Tolerance | None) -> PartAnswer:
        """Answer one wrench (1, 6), N and N·m, with the same numbers as `batch`."""
        if self.answering is None:
            return PartAnswer(_NOTHING, _NOTHING, OUTSIDE, ONLY_BEYOND if self.rows else EMPTY)
        told = self.answering.estimate(asked)
        state, reason = int(told.state[0]), ""
        moved, error = told.displacement[0].tolist(), told.error[0].tolist()
        if state != COVERED:
            reason = self.answering.reason(asked[0])
        elif not self.doubt.none and (reason := self.doubt.of_one(asked[0])):
            state = OUTSIDE if reason == UNKNOWN_AT_REST else THIN
        if state == COVERED:
            allowed = self._usual if tolerance is None else self.allowed(tolerance).tolist()
            if not all(error[output] <= allowed[output] for output in self.outputs):
                own = [error[k] if k in self.outputs else 0.0 for k in range(6)]
                state, reason = THIN, over_tolerance(own, allowed) or UNKNOWN_ERROR
        for output in self._unread:
            moved[output] = error[output] = None
        told_bars = all(isfinite(error[output]) for output in self.outputs)
        return PartAnswer(moved, error if told_bars else _NOTHING, state, reason)

    @cached_property
    def _usual(self) -> list[float]:
        return self.allowed(None).tolist()

    @cached_property
    def _unread(self) -> list[int]:
        return [output for output in range(6) if output not in self.outputs]

    def derivatives(self, asked: Floats) -> Floats:
        """Return du/dw (n, 6, 6), m/N, m/(N·m), rad/N, rad/(N·m); NaN where not the part's own."""
        found = np.full((len(asked), 6, 6), np.nan)
        if self.answering is not None:
            own = list(self.outputs)
            found[:, own] = self.answering.derivatives(asked)[:, own]
        if self.axes is not None and self.method != "kriging":
            lost = [axis.inputs[0] for axis, rows in zip(AXES, self.axes.rows, strict=True)]
            gone = [load for load, rows in zip(lost, self.axes.rows, strict=True) if rows is None]
            found[:, :, gone] = np.nan
        return found

    def allowed(self, tolerance: Tolerance | None) -> Floats:
        """Return the largest bar of each output, (6,), m and rad, of a covered answer."""
        return np.array(self.limits.of(tolerance or self.tolerance))


def parts_of(table: AnyTable) -> Sequence[tuple[Sequence[int], Surrogate]]:
    """Return the outputs that the same rows hold, with the surrogate of these rows."""
    return table.groups if isinstance(table, MissingOutputs) else ((range(6), table),)


def part_of(whole: Surrogate, outputs: tuple[int, ...], need: Need) -> Part:
    """Return what a scene needs of a surrogate, for some of its outputs."""
    told = replace(need, outputs=outputs)
    kriging = whole.kriging if whole.default == "kriging" else None
    return Part(
        outputs=outputs,
        method=whole.default,
        linear=whole.linear,
        load_range=whole.load_range,
        tolerance=need.tolerance or whole.tolerance,
        limits=whole.allowed,
        rows=len(whole.rows),
        fit=whole.fit,
        kriging=lean_kriging(kriging, told) if kriging else None,
        interaction=_interaction(whole, told) if whole.by_axes else None,
        axes=_axes(whole, need) if whole.by_axes else None,
        doubt=whole.doubt,
    )


def _interaction(whole: Surrogate, need: Need) -> Kriging | None:
    reference = whole.reference
    if not isinstance(reference, AxesReference) or reference.interaction is None:
        return None
    return lean_kriging(reference.interaction, need)


def _axes(whole: Surrogate, need: Need) -> Axes:
    """Return the rows of the axes that some load of the scene is an input of.

    Their whole triangulations: a plane through one is none of its own.
    """
    loaded = [need.occurring[list(axis.inputs)].any() for axis in AXES]
    pairs = zip(whole.composition.tables, loaded, strict=True)
    tables = [table if kept else None for table, kept in pairs]
    rows = tuple(table and table.rows for table in tables)
    laws = tuple(table and table.law for table in tables)
    return Axes(rows, laws, whole.composition.at_rest)
