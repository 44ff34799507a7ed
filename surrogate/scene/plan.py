"""The scene plan: one simulation's requirements on a component, and the way to meet them.

Fills, downloads of a table and the server's replies follow the plan.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..answer import allowed_by
from ..build import Table
from ..design import Design, Known, first_count, first_design, next_wrenches
from ..kernel.reasons import UNKNOWN_ERROR
from ..packed.writer import packed_of
from ..table.axes import AXES
from ..table.rows import ZERO_LOAD, Floats, LoadRange, Tolerance
from ..table.space import LOADS
from ..table.spread import spread_wrenches

Mask = NDArray[np.bool_]

Decision = Literal["rigid", "linear", "table"]
AxisNeed = Literal["inputs", "dimensions"]

SAMPLE = 64  # wrenches of the scene besides its corners: as many as six loads have corners
NO_ROWS = (
    "there is no row yet; solve one wrench for the tangent compliance, and fill the table for a "
    "bound of the displacement"
)
LOOKED_UP = (
    "its table is used; only a component with one interface and no further inputs, or a linear "
    "one, can be planned as rigid or linear"
)
NO_LOAD = "no load can occur in the scene, so the component stays undeformed"


@dataclass(frozen=True, eq=False)
class Need:
    """The requirements of a scene on one component."""

    span: LoadRange  # the possible loads, N and N·m; a load on a locked freedom is held at 0
    outputs: tuple[int, ...]  # the outputs that the scene reads, ascending
    tolerance: Tolerance | None  # m and rad: the scene's, else the component's
    idle: tuple[int, ...]  # loads on locked freedoms, on which nothing depends
    # (n,), N and N·m: rounding that may be added to an end: 1e-9 of the component's range.
    slack: Floats

    @property
    def occurring(self) -> Mask:
        """Which inputs can have an effect, shape (n,): not fixed at 0, or a temperature."""
        zero = self.span.space.zero
        return (self.span.low != zero) | (self.span.high != zero)

    @property
    def varying(self) -> Mask:
        """Which loads, N and N·m, can have more than one value, shape (n,): the dimensions."""
        return self.span.high > self.span.low

    @property
    def loads(self) -> list[str]:
        """The names of the loads that can occur."""
        return [self.span.space.input_names[load] for load in np.flatnonzero(self.occurring)]

    def beyond(self, wrenches: Floats) -> Mask:
        """Return which loads of wrenches (k, n), N and N·m, are outside the scene, shape (k, n)."""
        return (wrenches < self.span.low - self.slack) | (wrenches > self.span.high + self.slack)

    def axes(self) -> dict[str, dict[AxisNeed, Any]]:
        """Return the combined axes: their inputs that can occur, and their dimensions.

        An axis is combined if some of its loads can occur and one of its outputs is read. Tables of
        several interfaces or further inputs combine no axes.
        """
        axes: dict[str, dict[AxisNeed, Any]] = {}
        for axis in AXES if self.span.space.is_default else ():
            inputs = [load for load in axis.inputs if self.occurring[load]]
            if inputs and set(axis.outputs) & set(self.outputs):
                names = [LOADS[load] for load in inputs]
                dimensions = int(self.varying[list(axis.inputs)].sum())
                axes[axis.name] = {"inputs": names, "dimensions": dimensions}
        return axes

    def output_names(self) -> list[str]:
        """Return the names of the outputs that are read."""
        return [self.span.space.output_names[output] for output in self.outputs]


class NeedError(ValueError):
    """Impossible loads of a scene: each mistake by the index of its load.

    `mistakes`: index of the load among the inputs, and the mistake in its ends.
    """

    def __init__(self, mistakes: list[tuple[int, str]]) -> None:
        super().__init__("; ".join(message for _, message in mistakes))
        self.mistakes = mistakes


def need_of(
    limits: LoadRange,
    bounds: Floats | None = None,
    outputs: Sequence[int] | None = None,
    tolerance: Tolerance | None = None,
    idle: Sequence[int] = (),
) -> Need:
    """Return the requirements of a scene on a component.

    `limits`: the component's load range, N and N·m; it is extended to zero.
    `bounds` (n, 2), N and N·m: low and high end of each load; the component's by default.
    `outputs`: those that the scene reads; all by default.
    `idle`: loads on locked freedoms.

    Raises NeedError if an end lies outside the component's load range, or the low end is above the
    high one.
    """
    ends = np.column_stack((limits.low, limits.high)) if bounds is None else np.array(bounds, float)
    slack = ZERO_LOAD * limits.scale
    mistakes = []
    for load, (low, high) in enumerate(ends.tolist()):
        entry = limits.space.inputs[load]
        lowest, highest = min(limits.low[load], entry.zero), max(limits.high[load], entry.zero)
        if low > high:
            ends_given = f"{low:g} {entry.unit}, must not be above the high end, {high:g}"
            message = f"the low end of {entry.name}, {ends_given}; swap the two"
            mistakes.append((load, message))
        elif load not in idle and (low < lowest - slack[load] or high > highest + slack[load]):
            within = f"{lowest:g} to {highest:g} {entry.unit}, the load range"
            message = f"{entry.name} must lie within {within}, not {low:g} to {high:g}"
            mistakes.append((load, message))
    if mistakes:
        raise NeedError(mistakes)
    ends[list(idle)] = 0.0
    ends += 0.0  # no minus zero
    read = tuple(sorted(set(range(len(limits.space.outputs)) if outputs is None else outputs)))
    span = LoadRange(ends[:, 0], ends[:, 1], limits.space)
    return Need(span, read, tolerance, tuple(idle), slack)


@dataclass(frozen=True)
class ScenePlan:
    """The part that a component plays in a scene, and the reason."""

    need: Need
    # "rigid": left out; "linear": one compliance answers; "table": its table answers.
    decision: Decision
    reason: str
    # (m,), m and rad: largest size of each output within the scene; NaN where unknown
    bound: Floats
    # (m, n), SI: of a "linear" decision, if known: the displacement is this matrix times the
    # wrench. Columns of loads that cannot occur are 0.
    compliance: Floats | None
    # numbers of solves of the first design, from an empty table: for the load range, for the scene
    solves: tuple[int, int]


def plan_of(table: Table, need: Need, *, solved: bool = True) -> ScenePlan:
    """Return the plan that meets a scene's need of a component, by the rows of its table, if any.

    `solved`: whether the rows are solves, whose displacement at zero load is 0.
    """
    solves = first_solves(table, table.load_range), first_solves(table, need.span)
    need, space = replace(need, tolerance=need.tolerance or table.tolerance), need.span.space
    moves_unloaded = any(group.fit.offset.any() for group in table.groups)  # weight, temperature
    if solved and not need.occurring.any() and not moves_unloaded:
        still = np.zeros(len(space.outputs))
        return ScenePlan(need, "rigid", NO_LOAD, still, None, (solves[0], 0))
    bound, why = _bound(table, need)
    if need.tolerance is not None:
        allowed = allowed_by(need.tolerance, space)
        ratios = [bound[output] / allowed[output] for output in need.outputs]
        if all(ratio <= 1.0 for ratio in ratios):
            worst = need.outputs[int(np.argmax(ratios))]
            name, unit = space.outputs[worst].name, space.outputs[worst].unit
            reason = (
                f"it does not move by more than the tolerance: {name} at most {bound[worst]:.2g} "
                f"{unit} of {allowed[worst]:.2g} {unit}"
            )
            return ScenePlan(need, "rigid", reason, bound, None, (solves[0], 0))
    if table.linear:
        is_known = "it is known" if table.groups[0].fit.complete else "one solve gives it"
        reason = f"the component is linear: one compliance answers, and {is_known}"
        compliance = None
        # The compliance times the wrench lacks a displacement at zero load.
        if table.groups[0].fit.known[need.occurring].all() and not moves_unloaded:
            compliance = np.where(need.occurring, table.groups[0].fit.matrix, 0.0)
        return ScenePlan(need, "linear", reason, bound, compliance, solves)
    if not space.is_default:
        return ScenePlan(need, "table", LOOKED_UP, bound, None, solves)
    compliance, why_not = _single_compliance(table, need)
    decision: Decision = "table" if compliance is None else "linear"
    return ScenePlan(need, decision, why or why_not, bound, compliance, solves)


def design_of(
    table: Table, plan: ScenePlan, budget: int, pending: ArrayLike | None = None
) -> Design:
    """Return at most `budget` wrenches to solve next for a scene, none if its plan needs none.

    Parameters are those of `next_wrenches`: `pending` has shape (m, 6), N and N·m.
    """
    need = plan.need
    if plan.decision == "rigid":
        return Design(need.span.low[None][:0], "met", f"the scene needs no solve: {plan.reason}")
    return next_wrenches(
        table,
        budget,
        pending=pending,
        tolerance=need.tolerance,
        span=need.span,
        outputs=need.outputs,
    )


def first_solves(table: Table, span: LoadRange) -> int:
    """Return the number of solves in the first design of a span, from an empty table.

    A solve of a linear component brings all of its compliance.
    """
    if table.linear:
        return 1
    none = span.low[None][:0]
    known = Known(table.load_range, none, none)
    return len(first_design(span, known, first_count(span, table.rows)))


def _bound(table: Table, need: Need) -> tuple[Floats, str]:
    """Return upper bounds of the displacement, (m,), m and rad, and the reason of unknown ones.

    One bound is the answers with their error bars at wrenches of the scene, another the
    compliance's sum over the loads with its error: the larger counts. It is limited by the bound of
    the slopes: see `_by_answers`. NaN where it is unknown.
    """
    space, largest_loads = need.span.space, need.span.largest
    bound = np.full(len(space.outputs), np.nan)
    why = NO_ROWS
    if not table.linear and not space.is_default:
        return bound, LOOKED_UP  # with many inputs there are too many corners
    solver = np.zeros(len(bound))
    if table.solver_error is not None:  # the solver's error is largest at the largest loads
        parts = table.solver_error.parts(largest_loads).values()
        solver = solver + sum(np.array(part) for part in parts if part is not None)
    answered = np.zeros_like(bound)
    by_slopes = np.full_like(bound, np.nan)
    if not table.linear:
        answered, by_slopes = _by_answers(table, need)
    for group in table.groups:
        outputs = list(group.outputs)
        fit = group.fit
        if not len(group.used):
            continue
        unknown = np.flatnonzero(need.occurring & ~fit.known)
        if len(unknown):
            names = [space.input_names[load] for load in unknown]
            why = f"no row shows the influence of {', '.join(names)}"
            continue
        by_fit = np.abs(fit.matrix) @ largest_loads + np.abs(fit.offset) + fit.error + solver
        bound[outputs] = np.maximum(np.fmin(by_fit, by_slopes), answered)[outputs]
        why = UNKNOWN_ERROR if np.isnan(bound[outputs]).any() else ""
    return bound, why if np.isnan(bound[list(need.outputs)]).any() else ""


def _by_answers(table: Table, need: Need) -> tuple[Floats, Floats]:
    """Return two bounds of a nonlinear table's displacement in the scene, (m,) each, m and rad.

    The first is the largest answer with its error bar at `_sample`. The second is the answer in the
    scene's middle plus the steepest slopes of the sample up to the ends (mean value theorem): under
    small loads the component moves little, even if it is far from linear at its largest loads.
    Slopes of a table that does not cover the sample prove nothing: NaN.
    """
    packed, sample = packed_of(table), _sample(need)
    answers = packed.batch(sample)
    answered = (np.abs(answers.outputs) + answers.errors).max(axis=0)
    if answers.coverage.any():  # thin or outside
        return answered, np.full_like(answered, np.nan)
    middle = (need.span.low + need.span.high) / 2
    there = packed.batch(middle[None])
    steepest = np.abs(packed.derivatives(sample)).max(axis=0)
    by_slopes = np.abs(there.outputs[0]) + steepest @ (need.span.high - middle)
    return answered, by_slopes + there.errors[0] + answers.errors.max(axis=0)


def _sample(need: Need) -> Floats:
    """Return wrenches of a scene, (n, 6), N and N·m: all its corners, and some in between."""
    ends = [sorted({low, high}) for low, high in zip(need.span.low, need.span.high, strict=True)]
    corners = np.array(list(product(*ends)))
    inner = spread_wrenches(need.span, SAMPLE) if need.varying.any() else corners
    return np.concatenate((corners, inner))


def _single_compliance(table: Table, need: Need) -> tuple[Floats | None, str]:
    """Return the compliance (6, 6), SI, that answers within the tolerance, if any, and the reason.

    It is fitted by least squares to the answers at `_sample`. Its error at each of them plus the
    answer's error bar must be within the tolerance.
    """
    if need.tolerance is None:
        return None, "its table is used, because no tolerance says what may be left out; set one"
    wrenches = _sample(need)
    read = list(need.outputs)
    answers = packed_of(table).batch(wrenches, allowed_by(need.tolerance))
    scale = table.load_range.scale
    finite = np.asarray(np.isfinite(answers.outputs).all(axis=0))
    moved = np.where(finite, answers.outputs, 0.0)
    columns = np.linalg.lstsq(wrenches / scale, moved, rcond=None)[0]
    matrix = np.where(finite[:, None], columns.T / scale, 0.0)
    residual = np.abs(moved - wrenches @ matrix.T) + answers.errors
    ratio = (residual / np.array(allowed_by(need.tolerance)))[:, read]
    if (ratio <= 1.0).all():
        reason = f"over the scene's loads one compliance answers within {ratio.max():.2g} of the "
        return np.where(need.occurring, matrix, 0.0), reason + "tolerance"
    if not np.isfinite(ratio).all():
        return None, "its rows do not show how its response curves there; fill the table"
    worst = need.output_names()[int(np.argmax(ratio.max(axis=0)))]
    reason = f"one compliance would miss {worst} by {ratio.max():.3g} times the "
    return None, reason + "tolerance"
