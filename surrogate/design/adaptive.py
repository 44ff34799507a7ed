"""Which wrenches to solve next: a first design per axis, then where a solve lowers the error most.

The refinement follows the loss-per-simplex idea of adaptive sampling (Nijholt et al., the
`adaptive` package): the middle of the simplex with the largest loss is asked next, and losses near
a wrench already asked count less. A share of the solves goes to full six-component wrenches, the
only ones that show what straight direction influence leaves out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import qmc

from surrogate.build import AnyTable
from surrogate.composition.axis_table import AxisTable
from surrogate.composition.composition import Composition
from surrogate.design.initial import Known, axis_box, first_design, full_wrenches
from surrogate.leftout import LeftOut
from surrogate.surrogate import ENOUGH_FULL
from surrogate.table.axes import AXES, CLEAN, clean_rows
from surrogate.table.rows import Floats, Rows, Tolerance

SAMPLE = 256  # wrenches at which the composed error bar is held against the tolerance

# The part of all solves that full wrenches get: at first, and at least and at most once rows show
# how much is left out.
FULL_SHARE = 0.2
LEAST_FULL, MOST_FULL = 0.1, 0.35
FEWEST_FULL = 8  # full wrenches from which on they are believed


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
    surrogate: AnyTable,
    budget: int,
    *,
    pending: ArrayLike | None = None,
    tolerance: Tolerance | None = None,
) -> Design:
    """Return at most `budget` wrenches that lower the error most, none of them known or pending.

    Only the three loads of one axis are non-zero in most; a share of the refinement is full
    wrenches. A linear component needs but one solve, which brings its compliance. The tolerance
    (the surrogate's own if None) ends the refinement; without one it goes on as long as it is
    asked.
    """
    waiting = np.empty((0, 6)) if pending is None else np.asarray(pending, dtype=float)
    known = Known(surrogate.load_range, surrogate.rows.wrench, waiting.reshape(-1, 6))
    if surrogate.methods.linear:
        return _linear_design(surrogate, known, budget)
    tangents = bool(np.isfinite(surrogate.rows.compliance).all(axis=(1, 2)).any())
    first = known.new(first_design(surrogate.load_range, tangents=tangents))
    if len(first):
        return Design(first[:budget], "first", f"{len(first)} wrenches of the first design to go")
    return _refine(surrogate, known, budget, tolerance or surrogate.tolerance)


def _linear_design(surrogate: AnyTable, known: Known, budget: int) -> Design:
    """Return one wrench, since any solve of a linear component brings the whole compliance.

    Where solves bring none (an expert's deck), the six single loads.
    """
    if surrogate.fit.complete:
        return Design(np.empty((0, 6)), "met", "the 6x6 compliance is known")
    full = np.where(
        surrogate.load_range.high > 0, surrogate.load_range.high, surrogate.load_range.low
    )
    single = np.diag(np.where(full != 0, full, 1.0))
    if not len(surrogate.rows):
        single = single[:1]
    fresh = known.new(single)
    if len(known.pending) and not len(surrogate.rows):
        fresh = fresh[:0]
    return Design(fresh[:budget], "first", "a solve that tells the 6x6 compliance is needed")


def _refine(surrogate: AnyTable, known: Known, budget: int, tolerance: Tolerance | None) -> Design:
    """Pick full wrenches, then the middles of the worst simplices, one after another."""
    limit = tolerance or _whole_range(surrogate)
    axes, whole = _composed_losses(surrogate, limit)
    spots = _candidates(surrogate, tolerance)
    worst = float(spots.losses.max(initial=0.0))
    met = tolerance is not None and worst <= 1.0 and axes <= 1.0
    asked = 0 if met and whole <= 1.0 else budget
    count = _full_count(surrogate, known, asked, axes, whole)
    lacking = max(ENOUGH_FULL - _full_rows(surrogate, known), 0)
    if met:
        count = max(count if whole > 1.0 else 0, lacking)
    count = min(count, budget if met else (budget + 1) // 2)
    wrenches = full_wrenches(surrogate.load_range, known, count)
    if met:
        stage = "refine" if len(wrenches) else "met"
        return Design(wrenches, stage, _met_reason(surrogate, lacking))
    # Rows within the tolerance by themselves may yet compose to more than it.
    least = 0.0
    if tolerance is not None:
        worst, least = max(worst, axes), min(1.0, 0.5 / axes) if axes > 1.0 else 1.0
    more = _worst_first(spots, known, budget - len(wrenches), least)
    unit = "the tolerance" if tolerance is not None else "the outputs' range"
    reason = f"the largest error bar is {worst:.3g} times {unit}"
    return Design(np.concatenate((wrenches, more)), "refine", reason)


def _worst_first(spots: _Spots, known: Known, count: int, least: float) -> Floats:
    """Return at most `count` wrenches, those first whose solve takes most of the error away."""
    scaled, gains = spots.wrenches / known.scale, spots.gains * (spots.losses > least)
    for wrench in known.pending / known.scale:
        gains = gains * _shadow(scaled, spots.sizes, wrench)
    chosen: list[Floats] = []
    while len(chosen) < count and len(gains) and gains.max() > 0:
        best = int(gains.argmax())
        chosen.extend(known.new(spots.wrenches[best : best + 1]))
        gains = gains * _shadow(scaled, spots.sizes, scaled[best])
        gains[best] = 0.0
    return np.array(chosen).reshape(-1, 6)


def _full_count(surrogate: AnyTable, known: Known, budget: int, axes: float, whole: float) -> int:
    """Return how many full wrenches the table lacks to have their share of all its solves."""
    asked = len(surrogate.used) + len(known.pending)
    share = FULL_SHARE
    if surrogate.composition.left_out.shown >= FEWEST_FULL and whole > 0:
        left = np.sqrt(max(whole**2 - axes**2, 0.0)) / whole
        share = float(np.clip(left * MOST_FULL, LEAST_FULL, MOST_FULL))
    return max(int(np.ceil(share * (asked + budget))) - _full_rows(surrogate, known), 0)


def _full_rows(surrogate: AnyTable, known: Known) -> int:
    """Return how many wrenches, solved or pending, load more than one axis."""
    asked = np.concatenate((surrogate.used.wrench, known.pending))
    return int((~clean_rows(Rows.of(asked, asked), surrogate.load_range).any(axis=1)).sum())


def _whole_range(surrogate: AnyTable) -> Tolerance:
    """Return the sizes of the displacements, which stand in for a tolerance without one."""
    moved, tiny = np.abs(surrogate.used.displacement), np.finfo(float).tiny
    translation, rotation = moved[:, :3].max(initial=tiny), moved[:, 3:].max(initial=tiny)
    return Tolerance(float(translation), float(rotation))


def _composed_losses(surrogate: AnyTable, tolerance: Tolerance) -> tuple[float, float]:
    """Return the composed error bars over the tolerance that 95 % of the load range stays below.

    First without what straight direction influence leaves out, which no row of one axis lowers;
    then with it.
    """
    low, high = surrogate.load_range.low, surrogate.load_range.high
    sample = low + qmc.Halton(6, scramble=False).random(SAMPLE) * (high - low)
    composition = surrogate.composition
    silent = Composition(composition.tables, composition.rest, LeftOut(composition.left_out.scale))
    allowed = np.repeat([tolerance.translation, tolerance.rotation], 3)
    losses = []
    for one in (silent, composition):
        composed = one.many(sample)
        over = (composed.error[composed.told] / allowed).max(axis=1)
        losses.append(float(np.quantile(over, 0.95)) if len(over) else 0.0)
    return losses[0], losses[1]


def _met_reason(surrogate: AnyTable, lacking: int) -> str:
    reason = "every error bar looked at is within the tolerance"
    if surrogate.composition.left_out.silent or not lacking:
        return reason
    return f"{reason}; full wrenches tell what loads of several axes do together"


def _shadow(scaled: Floats, sizes: Floats, asked: Floats) -> Floats:
    """Return how much of each candidate's loss, (k,), one more row at `asked` would leave."""
    apart = ((scaled - asked) ** 2).sum(axis=1)
    return np.minimum(1.0, apart / sizes)


@dataclass(frozen=True)
class _Spots:
    """Candidates of all axes.

    Attributes
    ----------
    wrenches : ndarray, shape (k, 6), N and N·m
    losses : ndarray, shape (k,)
        The largest error bar over the tolerance, or over the output's range without one.
    gains : ndarray, shape (k,)
        What a solve takes away: of the largest loss where there is a tolerance, else of the mean
        the whole in the mean square.
    sizes : ndarray, shape (k,)
        Squared size of the simplex, scaled.
    """

    wrenches: Floats
    losses: Floats
    gains: Floats
    sizes: Floats


def _candidates(surrogate: AnyTable, tolerance: Tolerance | None) -> _Spots:
    parts = [(np.empty((0, 6)), np.empty(0), np.empty(0), np.empty(0))]
    for axis, table in zip(AXES, surrogate.composition.tables, strict=True):
        low, high = axis_box(surrogate.load_range, axis)
        if table is None or not (high > low).any():
            continue
        middle, loss, size = _worst_spots(table, tolerance)
        gain = loss if tolerance is not None else loss * np.sqrt(table.parts())
        loads = middle * np.array(table.scale)
        inside = ((loads >= low) & (loads <= high)).all(axis=1)
        full = np.zeros((int(inside.sum()), 6))
        full[:, list(axis.inputs)] = loads[inside]
        parts.append((full, loss[inside], gain[inside], size[inside]))
    return _Spots(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def _worst_spots(table: AxisTable, tolerance: Tolerance | None) -> tuple[Floats, Floats, Floats]:
    """Return the middle of each simplex, scaled (m, 3), its loss (m,) and squared size (m,)."""
    shape = table.interpolant
    corners = shape.points[shape.simplices]
    middle = corners.mean(axis=1)
    bars = table.read(np.arange(len(middle)), middle).bars
    if tolerance is not None:
        allowed = np.array([tolerance.translation, *[tolerance.rotation] * 3])
    else:
        allowed = np.maximum(np.ptp(table.values, axis=0), _negligible(table.rows.displacement))
    size = ((corners - middle[:, None]) ** 2).sum(axis=2).mean(axis=1)
    return middle, (bars / allowed).max(axis=1), np.maximum(size, CLEAN**2)


def _negligible(displacement: Floats) -> Floats:
    """Return, shape (4,), below which output range no solve is spent: rounding, not stiffness."""
    translation = float(np.abs(displacement[:, :3]).max(initial=0.0))
    rotation = float(np.abs(displacement[:, 3:]).max(initial=0.0))
    tiny = np.finfo(float).tiny
    return np.maximum(1e-2 * np.array([translation, rotation, rotation, rotation]), tiny)
