"""The scene plan: what one simulation needs of a component, and what is left out.

Filling, downloading and the reply of the server all follow what is decided here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ..answer import allowed_by
from ..build import Table
from ..design import Design, Known, first_count, first_design, next_wrenches
from ..kernel.binding import PackedTable
from ..kernel.packing import packed_of
from ..packed.reasons import UNKNOWN_ERROR
from ..table.rows import Floats, LoadRange
from ..table.spread import spread_wrenches
from .need import Need

Decision = Literal["rigid", "linear", "table"]

SAMPLE = 64  # wrenches of the scene, with its corners: as many as six loads have corners
NO_ROWS = (
    "no row yet: one solve tells the tangent compliance, and rows that show how large errors are "
    "tell a bound of the displacement"
)
LOOKED_UP = (
    "its response is looked up: whether one compliance answers, and how far it moves, is planned "
    "for components of one interface without further inputs and for linear ones only"
)
NO_LOAD = "no load can occur in the scene, so it stays as it is"


@dataclass(frozen=True)
class ScenePlan:
    """What a scene needs of a component.

    Attributes
    ----------
    need : Need
    decision : {"rigid", "linear", "table"}
        Leave it out; one compliance answers; its table does.
    reason : str
    bound : ndarray, shape (m,), m and rad
        What the displacement does not exceed within the scene; NaN where nothing tells it.
    compliance : ndarray, shape (m, n), SI, or None
        With ``linear``, where it is known: the displacement is it times the wrench. Zero by loads
        that cannot occur.
    solves : tuple of (int, int)
        Of the first design, from an empty table: for the whole load range, and for the scene.
    """

    need: Need
    decision: Decision
    reason: str
    bound: Floats
    compliance: Floats | None
    solves: tuple[int, int]


def plan_of(table: Table, need: Need, *, solved: bool = True) -> ScenePlan:
    """Return the plan of a scene's need of a component, from the rows there are, if any.

    Parameters
    ----------
    solved : bool
        Whether finite elements answer, which move by nothing where there is no load.
    """
    solves = first_solves(table, table.load_range), first_solves(table, need.span)
    limit = need.tolerance or table.tolerance
    need = replace(need, tolerance=limit)
    count, allowed = len(need.span.space.outputs), _allowed(need)
    hangs = any(group.fit.offset.any() for group in table.groups)
    if solved and not need.occurring.any() and not hangs:
        return ScenePlan(need, "rigid", NO_LOAD, np.zeros(count), None, (solves[0], 0))
    bound, why = _bound(table, need)
    if table.linear:
        decision: Decision = "linear"
        reason, matrix = _linear_reason(table), _restricted(table.groups[0].fit.matrix, need)
        known = (
            table.groups[0].fit.known[need.occurring].all() and not hangs
        )  # C w alone is no answer
        compliance = matrix if known else None
    elif not need.span.space.is_default:
        decision, reason, compliance = "table", LOOKED_UP, None
    else:
        compliance, missed = _one_compliance(table, need)
        decision = "table" if compliance is None else "linear"
        reason = why or missed
    read = list(need.outputs)
    if allowed is not None and (bound[read] <= allowed[read]).all():
        reason = f"it moves by no more than the tolerance: {_worst(bound, need)}"
        return ScenePlan(need, "rigid", reason, bound, None, (solves[0], 0))
    return ScenePlan(need, decision, reason, bound, compliance, solves)


def design_of(
    table: Table, plan: ScenePlan, budget: int, pending: ArrayLike | None = None
) -> Design:
    """Return at most `budget` wrenches to solve next for a scene, none where it needs none.

    Parameters are those of `next_wrenches`: `pending` has shape (m, 6), N and N·m.
    """
    if plan.decision == "rigid":
        return Design(
            plan.need.span.low[None][:0], "met", f"the scene needs no solve: {plan.reason}"
        )
    need = plan.need
    return next_wrenches(
        table,
        budget,
        pending=pending,
        tolerance=need.tolerance,
        span=need.span,
        outputs=need.outputs,
    )


def first_solves(table: Table, span: LoadRange) -> int:
    """Return how many solves the first design of a span has, from an empty table.

    A solve of a linear component brings its whole compliance.
    """
    if table.linear:
        return 1
    none = span.low[None][:0]
    known = Known(table.load_range, none, none)
    return len(first_design(span, known, first_count(span, table.rows)))


def _bound(table: Table, need: Need) -> tuple[Floats, str]:
    """Return what the displacement does not exceed, (m,), m and rad, and why it is not known.

    The larger of two: the answers with their errors at corners and wrenches of the scene; and the
    compliance's sum over the loads with its error, which is one for the whole load range, or what
    the steepest slopes of the scene's wrenches allow, if that is less.
    """
    count = len(need.span.space.outputs)
    bound, why = np.full(count, np.nan), NO_ROWS
    full = np.maximum(np.abs(need.span.low), np.abs(need.span.high))
    solver = np.zeros(count)
    if table.solver_error is not None:  # it is largest where the loads are
        solver = table.solver_error.share(full)
    if not table.linear and not need.span.space.is_default:
        return bound, LOOKED_UP  # corners of many inputs are too many to look at
    found = None if table.linear else packed_of(table).batch(_sample(need))
    for surrogate in table.groups:
        own, fit = list(surrogate.outputs), surrogate.fit
        unknown = need.occurring & ~fit.known
        if not len(surrogate.used) or unknown.any():
            names = [need.span.space.input_names[load] for load in np.flatnonzero(unknown)]
            why = (
                f"no row tells the influence of {', '.join(names)}" if len(surrogate.used) else why
            )
            continue
        most = np.abs(fit.matrix) @ full + np.abs(fit.offset) + fit.error + solver
        if found is not None:
            if not found.coverage.any():  # slopes of a table that is thin here prove nothing
                most = np.fmin(most, _reach(packed_of(table), need) + found.errors.max(axis=0))
            most = np.maximum(most, (np.abs(found.outputs) + found.errors).max(axis=0))
        bound[own], why = most[own], UNKNOWN_ERROR if np.isnan(most[own]).any() else ""
    return bound, why if np.isnan(bound[list(need.outputs)]).any() else ""


def _reach(table: PackedTable, need: Need) -> Floats:
    """Return how far the steepest slopes reach from a scene's middle to its ends, (6,), m and rad.

    By the mean value theorem: where loads are small the component moves little, however far it
    bends from one compliance at its largest.
    """
    middle = (need.span.low + need.span.high) / 2
    there = table.batch(middle[None])
    steepest = np.abs(table.derivatives(_sample(need))).max(axis=0)
    moved = np.abs(there.outputs[0]) + steepest @ (need.span.high - middle)
    return np.asarray(moved + there.errors[0])


def _sample(need: Need) -> Floats:
    """Return wrenches of a scene, (n, 6), N and N·m: all its corners, and some in between."""
    ends = [sorted({low, high}) for low, high in zip(need.span.low, need.span.high, strict=True)]
    corners = np.array(list(product(*ends)))
    inner = spread_wrenches(need.span, SAMPLE) if need.varying.any() else corners
    return np.concatenate((corners, inner))


def _restricted(matrix: Floats, need: Need) -> Floats:
    """Return a compliance (m, n), SI, without the loads that cannot occur."""
    return np.where(need.occurring, matrix, 0.0)


def _linear_reason(table: Table) -> str:
    if table.groups[0].fit.complete:
        return "the component is linear: one compliance answers, and it is known"
    return "the component is linear: one compliance answers, and one solve tells it"


def _one_compliance(table: Table, need: Need) -> tuple[Floats | None, str]:
    """Return the compliance (6, 6), SI, that answers within the tolerance, if one does, and why.

    The least-squares one through the answers at wrenches of the scene; it must miss each of them,
    with its error bar, by no more than the tolerance.
    """
    if need.tolerance is None:
        return None, "its response is looked up; no tolerance says what may be left out"
    wrenches, read = _sample(need), list(need.outputs)
    found = packed_of(table).batch(wrenches, allowed_by(need.tolerance))
    scale = table.load_range.scale
    finite = np.asarray(np.isfinite(found.outputs).all(axis=0))
    moved = np.where(finite, found.outputs, 0.0)
    if not np.isfinite(moved).all():
        return None, NO_ROWS
    columns = np.linalg.lstsq(wrenches / scale, moved, rcond=None)[0]
    matrix = np.where(finite[:, None], columns.T / scale, 0.0)
    missed = np.abs(moved - wrenches @ matrix.T) + found.errors
    share = (missed / np.array(allowed_by(need.tolerance)))[:, read]
    if (share <= 1.0).all():
        reason = f"over the scene's loads one compliance answers within {share.max():.2g} of the "
        return _restricted(matrix, need), reason + "tolerance"
    if not np.isfinite(share).all():
        return None, "its rows do not tell yet how its response bends over the scene's loads"
    worst = need.output_names()[int(np.argmax(share.max(axis=0)))]
    reason = f"one compliance would miss {worst} by {share.max():.3g} times the "
    return None, reason + "tolerance"


def _allowed(need: Need) -> Floats | None:
    """Return the largest error of each output, (m,), m and rad; None without a tolerance."""
    return need.tolerance and np.array(allowed_by(need.tolerance, need.span.space))


def _worst(bound: Floats, need: Need) -> str:
    """Return the output that comes nearest to its tolerance, and by how much it moves."""
    allowed = _allowed(need)
    assert allowed is not None
    worst = max(need.outputs, key=lambda output: bound[output] / allowed[output])
    one = need.span.space.outputs[worst]
    name, unit = one.name, one.unit
    return f"{name} at most {bound[worst]:.2g} {unit} of {allowed[worst]:.2g} {unit}"
