"""Which wrenches to solve next: a first design, then where the error bar is largest.

The kriging tells a bar without a solve, also the one that will be left once pending wrenches are
solved (Sacks, Welch, Mitchell and Wynn 1989: sequential design by the posterior deviation). So a
round is chosen one after another, each counted as solved for those after it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ..answer import allowed_by
from ..surrogate import Surrogate
from ..table.axes import AXES
from ..table.rows import Floats, LoadRange, Tolerance
from .initial import FIRST, Known, first_design, spread_wrenches

SAMPLE = 256  # wrenches at which bars are held against the tolerance: 95 % of them are 243
ENOUGH = 0.95  # of the sample within the tolerance ends a fill, as bars hold 95 % of errors
CANDIDATES = 384  # wrenches to choose from: more differ by less than a row changes the bars
AXIS_CANDIDATES = 32  # of each axis by itself, where a table brings no tangents


@dataclass(frozen=True)
class Design:
    """Wrenches to solve next.

    Attributes
    ----------
    wrenches : ndarray, shape (k, 6), N and N·m
    stage : {"first", "refine", "met"}
    reason : str
    """

    wrenches: Floats
    stage: Literal["first", "refine", "met"]
    reason: str


def next_wrenches(
    surrogate: Surrogate,
    budget: int,
    *,
    pending: ArrayLike | None = None,
    tolerance: Tolerance | None = None,
    span: LoadRange | None = None,
    outputs: Sequence[int] = range(6),
) -> Design:
    """Return at most `budget` wrenches that lower the error most, none of them known or pending.

    A linear component needs but one solve, which brings its compliance. Without a tolerance (the
    surrogate's own if None) the refinement goes on as long as it is asked.

    Parameters
    ----------
    pending : ndarray, shape (m, 6), N and N·m
        Wrenches that are being solved.
    span : LoadRange, optional
        The part of the load range that a scene needs; all of it by default.
    outputs : sequence of int
        The outputs whose bars count.
    """
    waiting = np.empty((0, 6)) if pending is None else np.asarray(pending, dtype=float)
    span = span or surrogate.load_range
    known = Known(surrogate.load_range, surrogate.rows.wrench, waiting.reshape(-1, 6))
    if surrogate.linear:
        return _linear_design(surrogate, known, budget)
    asked = np.concatenate((surrogate.used.wrench, known.pending))
    there = int(span.holds(asked).sum())
    if there < FIRST or surrogate.kriging is None:
        more = first_design(span, known, min(budget, max(FIRST - there, 1)))
        return Design(more, "first", f"{FIRST - there} wrenches of the first design to go")
    return _refine(surrogate, known, budget, tolerance or surrogate.tolerance, span, list(outputs))


def _linear_design(surrogate: Surrogate, known: Known, budget: int) -> Design:
    """Return one wrench, since any solve of a linear component brings the whole compliance.

    Where solves bring none (an expert's deck), the six single loads.
    """
    if surrogate.fit.complete:
        return Design(np.empty((0, 6)), "met", "the 6x6 compliance is known")
    high, low = surrogate.load_range.high, surrogate.load_range.low
    full = np.where(high > 0, high, low)
    single = np.diag(np.where(full != 0, full, 1.0))
    if not len(surrogate.rows):
        single = single[:1]
    fresh = known.new(single)
    if len(known.pending) and not len(surrogate.rows):
        fresh = fresh[:0]
    return Design(fresh[:budget], "first", "a solve that tells the 6x6 compliance is needed")


def _refine(
    surrogate: Surrogate,
    known: Known,
    budget: int,
    tolerance: Tolerance | None,
    span: LoadRange,
    outputs: list[int],
) -> Design:
    """Pick, one after another, the candidate whose bar over what is allowed is largest."""
    allowed = np.array(allowed_by(tolerance)) if tolerance else np.maximum(surrogate.ranges, 1e-300)
    sample = _losses(surrogate, spread_wrenches(span, SAMPLE), known.pending, allowed, outputs)
    within = float((sample <= 1.0).mean())
    worst = float(np.quantile(sample, ENOUGH))
    unit = "the tolerance" if tolerance is not None else "the outputs' range"
    if tolerance is not None and within >= ENOUGH:
        reason = f"the error bars of {within:.0%} of a sample of the range are within the tolerance"
        return Design(np.empty((0, 6)), "met", reason)
    candidates = _candidates(surrogate, span)
    chosen: list[Floats] = []
    while len(chosen) < budget:
        asked = np.concatenate((known.pending, np.array(chosen).reshape(-1, 6)))
        losses = _losses(surrogate, candidates, asked, allowed, outputs)
        for best in np.argsort(-losses):
            fresh = known.new(candidates[best : best + 1])
            if len(fresh):
                chosen.extend(fresh)
                break
        else:
            break
    reason = f"95 % of the error bars are at most {worst:.3g} times {unit}"
    return Design(np.array(chosen).reshape(-1, 6), "refine", reason)


def _losses(
    surrogate: Surrogate,
    wrenches: Floats,
    pending: Floats,
    allowed: Floats,
    outputs: list[int],
) -> Floats:
    """Return the largest bar over what is allowed (6,) at wrenches (n, 6), pending ones solved."""
    assert surrogate.kriging is not None
    bars = surrogate.batch(wrenches).error
    if len(pending):
        own = surrogate.kriging.answer_many(wrenches)[1]
        later = surrogate.kriging.sigma_with(pending, wrenches)
        bars = bars * np.divide(later, own, out=np.ones_like(own), where=own > 0)
    return np.nan_to_num((bars / allowed)[:, outputs], nan=np.inf).max(axis=1)


def _candidates(surrogate: Surrogate, span: LoadRange) -> Floats:
    """Return wrenches to choose from, shape (k, 6): evenly spread, moved on with each row.

    Where rows bring no tangents, wrenches of one axis are worth as much as full ones.
    """
    start = 1 + FIRST + len(surrogate.rows)
    full = spread_wrenches(span, CANDIDATES, start)
    if np.isfinite(surrogate.used.compliance).all(axis=(1, 2)).any():
        return full
    parts = [full]
    at_rest = np.clip(np.zeros(6), span.low, span.high)
    for axis in AXES:
        own = np.isin(np.arange(6), axis.inputs)
        parts.append(np.where(own, spread_wrenches(span, AXIS_CANDIDATES, start), at_rest))
    return np.concatenate(parts)
