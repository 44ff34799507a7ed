"""Which wrenches to solve next: a first design per axis, then where the error bar is largest.

The first design is the centre, the faces and the corners of an axis' load range, half moments
alone (every answer is counted from them), then a Halton sequence (Halton 1960) inside it. The
second follows the loss-per-simplex idea of adaptive sampling (Nijholt et al., the `adaptive`
package): the middle of the simplex with the worst error bar is asked next, and bars near a wrench
already asked count less.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import qmc

from surrogate.axes import AXES, CLEAN, Axis
from surrogate.axistable import AxisTable
from surrogate.composition import Composition
from surrogate.leftout import LeftOut
from surrogate.rows import Floats, LoadRange, Tolerance
from surrogate.surrogate import Surrogate

# Wrenches of the first design, by how many of the axis' three loads vary.
FIRST = {0: 1, 1: 7, 2: 15, 3: 27}
SAMPLE = 256  # wrenches at which the composed error bar is held against the tolerance


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
) -> Design:
    """Return at most `budget` wrenches that lower the error most, none of them known or pending.

    Only the three loads of one axis are non-zero in each. A linear component needs but one solve,
    which brings its compliance. The tolerance (the surrogate's own if None) ends the refinement;
    without one it goes on as long as it is asked.
    """
    waiting = np.empty((0, 6)) if pending is None else np.asarray(pending, dtype=float)
    known = _Known(surrogate.load_range, surrogate.rows.wrench, waiting.reshape(-1, 6))
    if surrogate.linear:
        return _linear_design(surrogate, known, budget)
    first = known.new(first_design(surrogate.load_range))
    if len(first):
        return Design(first[:budget], "first", f"{len(first)} wrenches of the first design to go")
    return _refine(surrogate, known, budget, tolerance or surrogate.tolerance)


def first_design(load_range: LoadRange) -> Floats:
    """Return the first design of all axes, shape (k, 6), N and N·m, the most telling first.

    The load range is stretched to hold zero: the composition asks every axis about one moment
    alone. A wrench that two axes share, a pure moment, is in it once.
    """
    ranked: list[tuple[int, int, Floats]] = []
    for index, axis in enumerate(AXES):
        low, high = _box(load_range, axis)
        if (high > low).any():
            ranked += [(rank, index, w) for rank, w in _axis_design(axis, low, high)]
    ranked.sort(key=lambda entry: entry[:2])
    known = _Known(load_range, np.empty((0, 6)), np.empty((0, 6)))
    return known.new(np.array([wrench for _, _, wrench in ranked]).reshape(-1, 6))


class _Known:
    """The wrenches that need not be asked again: rows and pending ones."""

    def __init__(self, load_range: LoadRange, rows: Floats, pending: Floats) -> None:
        self.scale, self.pending = load_range.scale, pending
        self.keys = {self._key(wrench) for wrench in np.concatenate((rows, pending))}

    def _key(self, wrench: Floats) -> tuple[int, ...]:
        return tuple(np.round(wrench / self.scale / CLEAN).astype(np.int64).tolist())

    def new(self, wrenches: Floats) -> Floats:
        """Return those not known yet, each once, and know them from now on."""
        fresh = []
        for wrench in wrenches:
            key = self._key(wrench)
            if key not in self.keys:
                self.keys.add(key)
                fresh.append(wrench)
        return np.array(fresh).reshape(-1, 6)


def _box(load_range: LoadRange, axis: Axis) -> tuple[Floats, Floats]:
    inputs = list(axis.inputs)
    return np.minimum(load_range.low[inputs], 0.0), np.maximum(load_range.high[inputs], 0.0)


def _axis_design(axis: Axis, low: Floats, high: Floats) -> list[tuple[int, Floats]]:
    """Return one axis' first design as (rank, wrench), the lowest rank first."""
    vary = np.flatnonzero(high > low)
    signs = [(0, np.zeros(3))]
    for load, side in product(vary, (-1.0, 1.0)):
        signs.append((1, np.where(np.arange(3) == load, side, 0.0)))
    if len(vary) > 1:
        for corner in product((-1.0, 1.0), repeat=len(vary)):
            signs.append((2, np.zeros(3)))
            signs[-1][1][vary] = corner
    for load, side in product((1, 2), (-0.5, 0.5)):
        if load in vary and len(vary) > 1:
            signs.append((3, np.where(np.arange(3) == load, side, 0.0)))
    more = FIRST[len(vary)] - len(signs)
    sequence = qmc.Halton(3, scramble=False)
    sequence.fast_forward(1)  # its first point is a corner
    signs += [(4 + place, 2 * x - 1) for place, x in enumerate(sequence.random(more))]
    return [(rank, _wrench(axis, (low + high) / 2 + s * (high - low) / 2)) for rank, s in signs]


def _wrench(axis: Axis, loads: Floats) -> Floats:
    wrench = np.zeros(6)
    wrench[list(axis.inputs)] = loads
    return wrench


def _linear_design(surrogate: Surrogate, known: _Known, budget: int) -> Design:
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


def _refine(
    surrogate: Surrogate, known: _Known, budget: int, tolerance: Tolerance | None
) -> Design:
    """Pick the middles of the worst simplices, one after another."""
    wrenches, losses, sizes = _candidates(surrogate, tolerance)
    scaled = wrenches / known.scale
    worst, least = float(losses.max(initial=0.0)), 0.0
    if tolerance is not None:
        composed = _composed_loss(surrogate, tolerance)
        if worst <= 1.0 and composed <= 1.0:
            return Design(np.empty((0, 6)), "met", _met_reason(surrogate))
        # Rows within the tolerance by themselves may yet compose to more than it.
        worst, least = max(worst, composed), min(1.0, 0.5 / composed) if composed > 1.0 else 1.0
    for wrench in known.pending / known.scale:
        losses = losses * _shadow(scaled, sizes, wrench)
    chosen: list[Floats] = []
    while len(chosen) < budget and len(losses) and losses.max() > least:
        best = int(losses.argmax())
        chosen.extend(known.new(wrenches[best : best + 1]))
        losses = losses * _shadow(scaled, sizes, scaled[best])
        losses[best] = 0.0
    unit = "the tolerance" if tolerance is not None else "the outputs' range"
    reason = f"the largest error bar is {worst:.3g} times {unit}"
    return Design(np.array(chosen).reshape(-1, 6), "refine", reason)


def _composed_loss(surrogate: Surrogate, tolerance: Tolerance) -> float:
    """Return the composed error bar over the tolerance that 95 % of the load range stays below.

    Without what straight direction influence leaves out: no row of one axis lowers that.
    """
    low, high = surrogate.load_range.low, surrogate.load_range.high
    sample = low + qmc.Halton(6, scramble=False).random(SAMPLE) * (high - low)
    whole = surrogate.composition
    silent = Composition(whole.tables, whole.zero, LeftOut(whole.left_out.scale))
    composed = silent.many(sample)
    allowed = np.repeat([tolerance.translation, tolerance.rotation], 3)
    losses = (composed.error[composed.told] / allowed).max(axis=1)
    return float(np.quantile(losses, 0.95)) if len(losses) else 0.0


def _met_reason(surrogate: Surrogate) -> str:
    reason = "every error bar looked at is within the tolerance"
    if surrogate.composition.left_out.silent:
        return reason
    return f"{reason}, but for what loads of several axes do together: full wrenches would tell"


def _shadow(scaled: Floats, sizes: Floats, asked: Floats) -> Floats:
    """Return how much of each candidate's loss, (k,), one more row at `asked` would leave."""
    apart = ((scaled - asked) ** 2).sum(axis=1)
    return np.minimum(1.0, apart / sizes)


def _candidates(surrogate: Surrogate, tolerance: Tolerance | None) -> tuple[Floats, Floats, Floats]:
    """Return candidate wrenches (k, 6), losses (k,) and squared simplex sizes (k,) of all axes.

    The loss is the largest error bar over the tolerance, or over the output's range without one.
    """
    wrenches, losses, sizes = [np.empty((0, 6))], [np.empty(0)], [np.empty(0)]
    for axis, table in zip(AXES, surrogate.composition.tables, strict=True):
        low, high = _box(surrogate.load_range, axis)
        if table is None or not (high > low).any():
            continue
        middle, loss, size = _worst_spots(table, tolerance)
        loads = middle * np.array(table.scale)
        inside = ((loads >= low) & (loads <= high)).all(axis=1)
        full = np.zeros((int(inside.sum()), 6))
        full[:, list(axis.inputs)] = loads[inside]
        wrenches.append(full)
        losses.append(loss[inside])
        sizes.append(size[inside])
    return np.concatenate(wrenches), np.concatenate(losses), np.concatenate(sizes)


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
