"""Which wrenches to solve next: a first design, then where the error bar is largest.

The kriging gives a bar without a solve, also the one that remains once pending wrenches are
solved (Sacks, Welch, Mitchell and Wynn 1989: sequential design by the posterior deviation). So a
round is chosen one after another, each counted as solved for those after it. The largest bar is the
only criterion: on `plate_thin`, with 30 / 54 / 120 solves, the worst output's error is

    largest bar                       0.037  0.014  0.0034 % of its range
    largest mean reduction of bars    0.033  0.014  0.0042 %
    bar, less the nearer to a face    0.032  0.015  0.0057 %
    evenly spread                     0.050  0.019  0.0063 %

and its bars hold best of all (93 to 97 % of the errors; 82 to 100 % with the others). Each fourth
wrench is evenly spread, for the bars' sake.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, log
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .answer import allowed_by
from .build import Group, Table, build
from .packed.writer import packed_of
from .table.axes import AXES
from .table.rows import LONGEST, ZERO_LOAD, Floats, LoadRange, Rows, Tolerance
from .table.spread import FORCE_ERROR, sample_of, spread_wrenches, weakest

SAMPLE = 256  # wrenches at which error bars are compared with the tolerance
ENOUGH = 0.95  # part of the sample within the tolerance that ends a fill: bars hold 95 % of errors
# Candidates of a round: their spacing is finer than the range in which one row changes the bars.
CANDIDATES = 384
AXIS_CANDIDATES = 32  # candidates on each axis alone, where the rows of a table bring no tangents
# Each fourth wrench comes from an even sequence, as later queries do. The largest bars are at the
# ends of the range, and rows left out there show little of its inside. Over five synthetic
# responses with 39 solves, the part of errors inside the bar of the worst output rises from 89 to
# 93 % by this, and errors stay the same.
EVEN_PERIOD = 4
EVEN_START = 10_000  # in the sequence, so that the even wrenches are not in the sample
# Candidates chosen between two checks of the remaining bars: a check costs as much as these.
BETWEEN_CHECKS = 3
# Upper limit of the estimated number of solves: a larger number has no further use.
MAX_SOLVES = 1e6
# Smallest power of the number of solves by which errors fall: below, they do not fall.
MIN_RATE = 0.01
RECOMPUTED = 16  # candidates recomputed at once: the largest loss is nearly always among them

# First wrenches of six loads, in eighths of half ranges: a Latin hypercube based on an orthogonal
# array (Tang 1993). Its signs are those of the third 2^(6-3) fraction, which confounds no load's
# effect with another's (Box and Hunter 1961). Each load has the sizes 1, 3, 5 and 7 with either
# sign, in the order, of 60,000 random ones, that keeps the wrenches farthest apart, less half the
# largest correlation of two loads. A span of few loads has fewer of them: the first three have both
# signs of each load, the first four two of each.
#
# Corners at 0.8 give each load three values, between which rows left out show nothing: with zero
# load and them, 9 solves of `plate_thin` had 15 to 79 % of the errors of the worst output outside
# its bar and 2 to 4 times the error. Points of the sequence alone lie near a diagonal: of 24
# made-up parts 8 had more than 10 % outside, with this design 1. `make bench NAME=bars ONLY=filled`
# judges tables of such designs.
HYPERCUBE = np.array(
    [
        (-1, -1, -7, 1, 3, 7),
        (7, -3, 5, -1, 1, -7),
        (-3, 5, 7, -3, -3, 5),
        (3, 7, -1, 3, -5, -5),
        (-7, -7, 1, 5, -7, -1),
        (5, -5, -5, -5, -1, 3),
        (-5, 3, -3, -7, 5, -3),
        (1, 1, 3, 7, 7, 1),
    ]
)
# Wrenches of the first design: two for each load and three more, 15 for six loads. With second
# derivatives 1 for each load and three more, 9 for six loads.
PER_LOAD, PER_LOAD_CURVED, FURTHER = 2, 1, 3
_MAX_STEPS = 2.0**62  # half the range of an int64, for wrenches in steps; no query is as large


class Known:
    """The wrenches that need no further solve: rows and pending wrenches."""

    def __init__(self, load_range: LoadRange, rows: Floats, pending: Floats) -> None:
        self.scale = load_range.scale
        self.pending = pending
        self.keys = {self._key(wrench) for wrench in np.concatenate((rows, pending))}

    def _key(self, wrench: Floats) -> tuple[int, ...]:
        """Return a wrench (6,), N and N·m, in integer steps; the same wrench has the same steps."""
        with np.errstate(over="ignore"):
            steps = np.round(wrench / self.scale / ZERO_LOAD)
        return tuple(np.clip(steps, -_MAX_STEPS, _MAX_STEPS).astype(np.int64).tolist())

    def new(self, wrenches: Floats) -> Floats:
        """Return the wrenches (k, 6), N and N·m, that are not known yet, without duplicates.

        The returned wrenches are known from then on.
        """
        fresh = []
        for wrench in wrenches:
            if (key := self._key(wrench)) not in self.keys:
                self.keys.add(key)
                fresh.append(wrench)
        return np.array(fresh).reshape(-1, len(self.scale))


def first_count(span: LoadRange, rows: Rows) -> int:
    """Return the number of wrenches in the first design of a span; 1 where no load varies.

    The number is smaller as long as all `rows` of the table bring second derivatives.
    """
    loads = int((span.high > span.low).sum())
    has_curvature = not len(rows) or (rows.curvature.shape[1] and np.isfinite(rows.curvature).all())
    return (PER_LOAD_CURVED if has_curvature else PER_LOAD) * loads + FURTHER if loads else 1


def first_design(span: LoadRange, known: Known, count: int) -> Floats:
    """Return new wrenches of the first design within a span, shape (count, 6), N and N·m.

    The design is zero load, for six loads `HYPERCUBE`, then an additive recurrence (Roberts 2018,
    the R sequence). A load whose span is a single value keeps this value. A narrow span that has
    fewer than `count` different wrenches returns fewer.
    """
    zero_load = np.clip(span.space.zero, span.low, span.high)
    middle, half = (span.low + span.high) / 2, (span.high - span.low) / 2
    parts = HYPERCUBE / 8 if span.space.is_default else np.empty((0, len(half)))
    chosen = list(known.new(np.concatenate((zero_load[None], middle + parts * half))))
    # A wrench of the sequence is refused only if it is known already. As many refusals as there are
    # known wrenches mean that all wrenches of the span are known.
    last = count + len(known.keys) if half.any() else 0
    for number in range(1, last + 1):
        if len(chosen) >= count:
            break
        chosen.extend(known.new(spread_wrenches(span, 1, number)))
    return np.array(chosen[:count]).reshape(-1, len(half))


@dataclass(frozen=True)
class Design:
    """Wrenches to solve next."""

    wrenches: Floats  # (k, 6), N and N·m
    stage: Literal["first", "refine", "met"]
    reason: str


def next_wrenches(
    table: Table,
    budget: int,
    *,
    pending: ArrayLike | None = None,
    tolerance: Tolerance | None = None,
    span: LoadRange | None = None,
    outputs: Sequence[int] = (),
    for_joint: bool = False,
) -> Design:
    """Return at most `budget` wrenches that lower the error most, none of them known or pending.

    A linear component needs a single solve, which brings its compliance. Without a tolerance (the
    table's if None) the refinement has no end.

    `pending` (m, 6), N and N·m: wrenches that are being solved.
    `span`: the part of the load range that a scene needs; all of it by default.
    `outputs`: the outputs whose error bars count; empty for all.
    `for_joint`: whether the compliance must be positive definite, and the force error of a
    displacement at most `FORCE_ERROR` of the load range.
    """
    wrenches = table.rows.wrench
    waiting = np.asarray(() if pending is None else pending, dtype=float)
    span = span or table.load_range
    outputs = outputs or range(table.rows.displacement.shape[1])
    known = Known(table.load_range, wrenches, waiting.reshape(-1, wrenches.shape[1]))
    # If some rows lack outputs, the group with the fewest rows has the largest errors.
    surrogate = table.groups[0]
    if surrogate.linear:
        return _linear_design(surrogate, known, span, budget)
    if not (span.high > span.low).any():
        return _first(known.new(span.low[None])[:budget], "the scene has one wrench")
    remaining = first_count(span, surrogate.used) - len(surrogate.used) - len(known.pending)
    if remaining > 0:
        more = first_design(span, known, min(budget, remaining))
        return _first(
            more, f"the first design needs {remaining} solves; their error bars place the next ones"
        )
    if surrogate.kriging is None:
        more = first_design(span, known, budget)
        return _first(more, "too few rows for error bars, so these solves are evenly spread")
    limit = tolerance or surrogate.tolerance
    indices = np.delete(np.arange(len(outputs)), surrogate.locked) if for_joint else None
    return _Refinement(table, known, limit, span, list(outputs), indices).design(budget)


def _linear_design(surrogate: Group, known: Known, span: LoadRange, budget: int) -> Design:
    """Return one wrench: any solve of a linear component brings all of its compliance.

    Solves of an expert's deck bring no compliance. For these return the single loads, restricted to
    the span if it is a part of the load range.
    """
    if surrogate.fit.complete:
        return Design(known.pending[:0], "met", "the compliance is known")
    needed = np.ones(len(span.low), dtype=bool)
    if span is not surrogate.load_range:
        needed = (span.low != 0) | (span.high != 0)
    if surrogate.fit.known[needed].all():
        return Design(known.pending[:0], "met", "the compliance is known in all loads that occur")
    high, low = surrogate.load_range.high, surrogate.load_range.low
    amounts = np.where(high > 0, high, low)
    single = np.diag(np.where(amounts != 0, amounts, 1.0))[needed]
    if not len(surrogate.rows):
        single = known.pending[:0] if len(known.pending) else single[:1]
    reason = "one solve gives the compliance of a linear component"
    return Design(known.new(single)[:budget], "first", reason)


def _first(wrenches: Floats, reason: str) -> Design:
    """Return a first design; its stage is "met" where the span has no wrench that is not known."""
    if len(wrenches):
        return Design(wrenches, "first", reason)
    reason = "the range is so narrow that all its wrenches are solved or being solved"
    return Design(wrenches, "met", reason)


class _Refinement:
    """Chooses, one after another, the candidate with the largest error bar over the allowed bar."""

    def __init__(
        self,
        table: Table,
        known: Known,
        tolerance: Tolerance | None,
        span: LoadRange,
        outputs: list[int],
        joint: NDArray[np.intp] | None = None,
    ) -> None:
        """Take the arguments of `next_wrenches`.

        `joint`: indices of the loads on a joint's free axes, which no guide locks.
        """
        self.table = table
        surrogate = table.groups[0]
        assert surrogate.kriging is not None
        self.surrogate = surrogate
        self.kriging = surrogate.kriging
        self.known = known
        self.tolerance = tolerance
        self.span = span
        self.outputs = outputs
        spread = np.maximum(surrogate.ranges, np.finfo(float).tiny)
        self.allowed = np.array(allowed_by(tolerance, span.space)) if tolerance else spread
        self.joint = joint
        self.indefinite = span.low[None][:0]
        if joint is not None:
            sample = sample_of(span.ends, span.space.zero, joint)
            turned = self.kriging.answer_many(sample)[0][:, span.space.is_rotation]
            sample = sample[~(np.linalg.norm(turned, axis=1) > LONGEST)]
            smallest = weakest(self._slopes(sample), span.scale[joint])[0]
            self.indefinite = sample[smallest < 0.0]
        self.may_end = (tolerance is not None or joint is not None) and not len(self.indefinite)

    def design(self, budget: int) -> Design:
        """Return the next round, or none where the tolerance is met once all pending is solved."""
        sample = spread_wrenches(self.span, SAMPLE)
        pending = self.known.pending
        losses = self._losses(sample) * self._reduction(pending, sample)
        # Where errors are not known no wrench is covered, however small the deviation is.
        known = np.isfinite(self.kriging.answer_many(sample)[1]).all(axis=1)
        within = float(((losses <= 1.0) & (known | (len(pending) > 0))).mean())
        worst = float(np.quantile(losses, ENOUGH))
        if self.may_end and within >= ENOUGH:
            reason = (
                f"the interpolation error of {within:.0%} of a sample of the range is within the "
                "tolerance"
            )
            if self.joint is not None:
                part = f"{FORCE_ERROR:.0%} of the load range"
                reason += f", that of a joint's wrench {part}, the compliance positive definite"
            return Design(sample[:0], "met", reason)
        unit = "the tolerance" if self.tolerance is not None else "the outputs' range"
        if self.joint is not None:
            unit += f" (of a joint's wrench: {FORCE_ERROR:.0%} of the load range)"
        reason = f"95 % of the interpolation errors are at most {worst:.3g} times {unit}"
        if not known.any():
            reason = "the rows are too few to show the interpolation error"
        elif self.tolerance is not None and not self.span.space.is_default:
            reason += self._estimate_of_solves(sample, worst, budget)
        if len(self.indefinite):
            reason += f"; not positive definite: the compliance at {len(self.indefinite)} wrenches"
        return Design(self._largest(sample, budget), "refine", reason)

    def _candidates(self) -> Floats:
        """Return the candidates of a round, shape (k, 6), N and N·m.

        They are evenly spread, and start at another place with each row. Where rows bring no
        tangents, wrenches of one axis are worth as much as multi-axis ones.
        """
        start = 1 + CANDIDATES + len(self.surrogate.rows)
        parts = [self.indefinite, spread_wrenches(self.span, CANDIDATES, start)]
        has_tangents = self.surrogate.used.has_tangent.any()
        if self.surrogate.has_axes and not has_tangents:
            zero_load = np.clip(self.span.space.zero, self.span.low, self.span.high)
            single = spread_wrenches(self.span, AXIS_CANDIDATES, start)
            parts += [
                np.where(np.isin(np.arange(6), axis.inputs), single, zero_load) for axis in AXES
            ]
        return self.known.new(np.concatenate(parts))

    def _largest(self, sample: Floats, budget: int) -> Floats:
        """Return at most `budget` candidates, shape (k, 6), N and N·m, in order of decreasing loss.

        Stop early once the error bars at the sample will be within the tolerance. Solved wrenches
        only ever lower a bar, so a candidate's loss computed earlier is an upper limit: only those
        that may still be the largest are computed again (Minoux 1978).
        """
        candidates = self._candidates()
        losses = self._losses(candidates)
        pending = self.known.pending
        expected = losses * self._reduction(pending, candidates)
        now = self._losses(sample)
        first = len(pending)
        before = len(pending) + len(self.surrogate.used)
        while (count := len(pending) - first) < min(budget, len(candidates)):
            if self.may_end and count and count % BETWEEN_CHECKS == 0:
                within = now * self._reduction(pending, sample) <= 1.0
                if float(within.mean()) >= ENOUGH:
                    break
            number = before + count
            even = spread_wrenches(self.span, 1, EVEN_START + number // EVEN_PERIOD)
            fresh = self.known.new(even) if number % EVEN_PERIOD == 0 else even[:0]
            if not len(fresh):
                computed = np.zeros(len(expected), dtype=bool)
                while not computed[best := int(np.argmax(expected))]:
                    top = np.argsort(-expected)[:RECOMPUTED]
                    top = top[~computed[top]]
                    expected[top] = losses[top] * self._reduction(pending, candidates[top])
                    computed[top] = True
                losses[best] = expected[best] = -1.0
                fresh = candidates[best : best + 1]
            pending = np.concatenate((pending, fresh))
        return pending[first:]

    def _estimate_of_solves(self, sample: Floats, worst: float, budget: int) -> str:
        """Return a sentence on the number of solves for the tolerance; empty within the budget.

        The error as a power of the number of solves goes through the error with the first half of
        the rows and the error with all rows. `worst` is the latter, over the tolerance.
        """
        rows, before = self.surrogate.rows, np.nan
        count, half_count = len(rows), len(rows) // 2
        half = build(rows.take(np.arange(half_count)), self.surrogate.load_range).groups[0]
        if half.kriging is not None:
            bars = half.kriging.sigma_with(sample[:0], sample) / self.allowed
            before = float(np.quantile(bars[:, self.outputs].max(axis=1), ENOUGH))
        if not (np.isfinite(before) and before > worst > 1.0):
            return "; its rows do not show yet how many solves the tolerance takes"
        rate = log(before / worst) / log(count / half_count)
        more = np.inf
        if rate > MIN_RATE:
            more = count * (exp(min(log(worst) / rate, log(MAX_SOLVES))) - 1)
        if more <= budget:
            return ""
        number = (
            f"about {int(float(f'{more:.2g}')):,}" if more <= MAX_SOLVES else "more than a million"
        )
        return (
            f"; the tolerance takes {number} further solves, an estimate by the rate so far: "
            f"{before:.3g} times the tolerance with {half_count} rows, {worst:.3g} with {count}"
        )

    def _losses(self, wrenches: Floats) -> Floats:
        """Return the largest error bar over the allowed one, (n,), at wrenches (n, 6)."""
        bars = self.kriging.sigma_with(wrenches[:0], wrenches)
        over = (bars / self.allowed)[:, self.outputs].max(axis=1)
        if self.joint is None or not len(wrenches):
            return over
        stiffness = np.linalg.pinv(self._slopes(wrenches))
        # The formula of wb_joint_step.
        forces = (np.abs(stiffness) @ bars[:, self.joint, None])[:, :, 0]
        return np.maximum(over, (forces / (FORCE_ERROR * self.span.scale[self.joint])).max(axis=1))

    def _slopes(self, wrenches: Floats) -> Floats:
        """Return the kriging's du/dw (n, k, k), SI, of the part of a joint at wrenches (n, 6)."""
        slopes = packed_of(self.table).derivatives(wrenches, method="kriging", without_rows=True)
        return slopes[:, self.joint][:, :, self.joint]

    def _reduction(self, solved: Floats, wrenches: Floats) -> Floats:
        """Return the part (n,) of the bars at wrenches (n, 6) that remains after further solves."""
        if not len(solved):
            return np.ones(len(wrenches))
        now = self.kriging.sigma_with(solved[:0], wrenches).sum(axis=1)
        later = self.kriging.sigma_with(solved, wrenches).sum(axis=1)
        return np.divide(later, now, out=np.ones_like(now), where=now > 0)
