"""The careful path: composed answers wherever there is a row to estimate from, as arrays.

A wrench outside an axis or in a weak simplex costs about as much here as a covered one, not a
thousand times as much. coverage.py puts the findings into words.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrogate.answer import COVERED, OUTSIDE, THIN, Batch
from surrogate.composition.axis_table import SOUND, AxisTable
from surrogate.composition.composition import AtRest, Composition
from surrogate.methods.nearest import NearestRow
from surrogate.table.axes import AXES, Axis
from surrogate.table.compliance import ComplianceFit
from surrogate.table.rows import Floats, LoadRange

Mask = NDArray[np.bool_]
NOWHERE = -1  # the table and the simplex of what rests on no row


@dataclass
class Spots:
    """Six outputs read from axes at k wrenches.

    Attributes
    ----------
    displacement, bars : ndarray, shape (k, 6), m and rad
        Bars are NaN where nothing tells them.
    state : ndarray of uint8, shape (k,)
    table, simplex : ndarray of int, shape (k,)
        Which axis' table and which of its simplices was read, or is nearest; `NOWHERE` if none.
    """

    displacement: Floats
    bars: Floats
    state: NDArray[np.uint8]
    table: NDArray[np.intp]
    simplex: NDArray[np.intp]

    @classmethod
    def at_rest(cls, rest: AtRest, count: int) -> Spots:
        """Return spots at zero load, which rest on no simplex."""
        return cls(
            np.tile(rest.displacement, (count, 1)),
            np.tile(rest.bars, (count, 1)),
            np.zeros(count, dtype=np.uint8),
            np.full(count, NOWHERE, dtype=np.intp),
            np.full(count, NOWHERE, dtype=np.intp),
        )

    def put(self, where: Mask | NDArray[np.intp], other: Spots) -> None:
        """Replace the spots at some places."""
        for name in ("displacement", "bars", "state", "table", "simplex"):
            getattr(self, name)[where] = getattr(other, name)

    def at(self, where: Mask | NDArray[np.intp]) -> Spots:
        """Return the spots at some places."""
        return Spots(
            self.displacement[where],
            self.bars[where],
            self.state[where],
            self.table[where],
            self.simplex[where],
        )


class Diagnosed(NamedTuple):
    """Composed answers, and what they are composed of.

    Attributes
    ----------
    batch : Batch
    spots : tuple of Spots, length 3
        Each axis' own answer.
    adrift : ndarray of bool, shape (3, k)
        Where no table holds the moment alone that the axis' rotation is counted from.
    """

    batch: Batch
    spots: tuple[Spots, ...]
    adrift: Mask


def diagnose(composition: Composition, fit: ComplianceFit, loads: Floats) -> Diagnosed:
    """Compose the answers to wrenches (k, 6), N and N·m, traces of loads taken as none."""
    rest, count = composition.rest, len(loads)
    moved, squares = np.tile(rest.displacement, (count, 1)), np.zeros((count, 6))
    lean, state = np.zeros((count, 3)), np.zeros(count, dtype=np.uint8)
    times, adrift = np.ones(count), np.zeros((3, count), dtype=bool)
    spots = []
    for index, axis in enumerate(AXES):
        force, first, second = (loads[:, load] != 0 for load in axis.inputs)
        used, own = force | first | second, axis.outputs[0]
        spot, base, adrift[index] = _axis_spots(composition, fit, axis, loads)
        moved[:, own] = spot.displacement[:, own]
        moved[:, 3:] += spot.displacement[:, 3:] - base.displacement[:, 3:]
        squares[:, own] += spot.bars[:, own] ** 2
        counted = spot.bars[:, 3:] ** 2 + np.where(first[:, None], base.bars[:, 3:] ** 2, 0.0)
        squares[:, 3:] += np.where((used & ~(first & ~force & ~second))[:, None], counted, 0.0)
        times -= used & ~first
        # Unknown bars of one output make the whole error unknown, as in a single answer.
        squares[~np.isfinite(spot.bars + base.bars).all(axis=1)] = np.nan
        state = np.maximum(state, spot.state)
        table = composition.tables[index]
        if table is not None:
            lean[base.table != NOWHERE] += table.lean
        spots.append(spot)
    squares[:, 3:] += (times[:, None] * rest.bars[3:]) ** 2 + lean**2
    composition.left_out.widen_many(loads, squares)
    if not rest.known:
        state[~loads.any(axis=1)] = OUTSIDE
    error = np.maximum(np.sqrt(squares), rest.rounding)
    return Diagnosed(Batch(moved, error, state), tuple(spots), adrift)


def _axis_spots(
    composition: Composition, fit: ComplianceFit, axis: Axis, loads: Floats
) -> tuple[Spots, Spots, Mask]:
    """Return an axis' spots, those its rotation counts from, and where no table holds the latter.

    An axis without load is at rest, and counts from rest; one whose first moment acts alone counts
    from itself.
    """
    spot, base = (Spots.at_rest(composition.rest, len(loads)) for _ in range(2))
    adrift = np.zeros(len(loads), dtype=bool)
    force, first, second = (loads[:, load] != 0 for load in axis.inputs)
    used = force | first | second
    if not used.any():
        return spot, base, adrift
    spot.put(used, _spots(composition, fit, axis, loads[used]))
    only = first & ~force & ~second
    base.displacement[only], base.bars[only] = spot.displacement[only], spot.bars[only]
    counted = np.flatnonzero(first & ~only)
    if len(counted):
        alone, held = _alone(composition, fit, axis.inputs[1], loads[counted])
        base.put(counted, alone)
        adrift[counted[~held]] = True
        spot.state[counted[~held]] = OUTSIDE
    return spot, base, adrift


def _spots(composition: Composition, fit: ComplianceFit, axis: Axis, loads: Floats) -> Spots:
    """Return an axis' own answers, those of another axis to one moment alone, or estimates."""
    index = AXES.index(axis)
    spot, found = _read(composition, index, loads)
    force, first, second = (loads[:, load] != 0 for load in axis.inputs)
    own = np.where(np.isin(np.arange(6), axis.inputs), loads, 0.0)
    if not found.all():
        spot.put(~found, _beyond(composition, fit, index, own[~found]))
    for moment, single in ((1, first & ~force & ~second), (2, second & ~force & ~first)):
        weak = np.flatnonzero(single & (spot.state != COVERED))
        if len(weak):
            alone, held = _alone(composition, fit, axis.inputs[moment], loads[weak])
            lone = composition.tables[index] is None
            better = lone | (held & (alone.state < spot.state[weak]))
            spot.put(weak[better], alone.at(better))
    return spot


def _alone(
    composition: Composition, fit: ComplianceFit, moment: int, loads: Floats
) -> tuple[Spots, Mask]:
    """Return the answers to one moment alone, and which of them a table holds.

    They are read from the axis it is first in or else the other, and estimated from the first of
    these that has rows where neither holds it.
    """
    only = np.where(np.arange(6) == moment, loads, 0.0)
    spot = Spots.at_rest(composition.rest, len(loads))
    held = np.zeros(len(loads), dtype=bool)
    places = [next(i for i, axis in enumerate(AXES) if axis.inputs[p] == moment) for p in (1, 2)]
    for index in places:
        left = np.flatnonzero(~held)
        if len(left):
            read, there = _read(composition, index, only[left])
            spot.put(left[there], read.at(there))
            held[left[there]] = True
    if not held.all():
        index = next((i for i in places if composition.tables[i] is not None), places[0])
        spot.put(~held, _beyond(composition, fit, index, only[~held]))
    return spot, held


def _read(composition: Composition, index: int, loads: Floats) -> tuple[Spots, Mask]:
    """Read all six outputs of one axis' table, and tell which loads its hull holds."""
    spot = Spots.at_rest(composition.rest, len(loads))
    table = composition.tables[index]
    if table is None:
        return spot, np.zeros(len(loads), dtype=bool)
    x = loads[:, list(table.axis.inputs)] / np.array(table.scale)
    found = table.interpolant.locate(x)
    inside = found >= 0
    x, simplices = x[inside], found[inside]
    moved, bars, _ = table.read_six(simplices, x)
    thin = (table.weak_at[simplices] != SOUND) | (not table.sound)
    state = np.where(thin, THIN, COVERED).astype(np.uint8)
    which = np.full(len(x), index, dtype=np.intp)
    spot.put(inside, Spots(moved, bars, state, which, simplices))
    return spot, inside


def _beyond(composition: Composition, fit: ComplianceFit, index: int, loads: Floats) -> Spots:
    """Estimate outside an axis' hull: from the hull's nearest point, or from rest without rows.

    `loads` are the axis' own. The bar grows as the estimate does on its way there: it may be as
    wrong as the way is long.
    """
    table: AxisTable | None = composition.tables[index]
    spot = Spots.at_rest(composition.rest, len(loads))
    spot.state[:] = OUTSIDE
    if table is None:
        spot.displacement += np.where(fit.known, loads, 0.0) @ fit.matrix.T
        spot.bars = spot.bars + np.abs(loads) @ np.abs(fit.matrix).T + fit.bar
        spot.bars[(~fit.known & (loads != 0)).any(axis=1)] = np.nan
        return spot
    inputs, scale = list(table.axis.inputs), np.array(table.scale)
    columns = fit.matrix[:, inputs] * scale
    told = table.beyond(loads[:, inputs] / scale, columns)
    spot.displacement, spot.bars, spot.simplex = told.displacement, told.bars, told.simplices
    spot.table[:] = index
    # What no row of the axis varies is told by the fit, as well as that is.
    spot.bars = spot.bars + np.where(told.aside.any(axis=1, keepdims=True), fit.bar, 0.0)
    spot.bars[(told.aside & ~fit.known[inputs]).any(axis=1)] = np.nan
    return spot


def nothing_known(count: int) -> Batch:
    """Return the answers of a table without rows."""
    blank = np.full((count, 6), np.nan)
    return Batch(blank, blank.copy(), np.full(count, OUTSIDE, dtype=np.uint8))


def read_many_linearly(
    fit: ComplianceFit, load_range: LoadRange, loads: Floats, small: Floats
) -> Batch:
    """Return the 6x6 compliance times wrenches (k, 6); NaN errors where a load is not known."""
    moved = loads @ fit.matrix.T
    error = np.tile(fit.bar, (len(loads), 1))
    unknown = (~fit.known & (np.abs(loads) > small)).any(axis=1)
    error[unknown] = np.nan
    outside = unknown | ~load_range.holds(loads)
    return Batch(moved, error, np.where(outside, OUTSIDE, COVERED).astype(np.uint8))


def read_many_nearest(
    nearest: NearestRow, composition: Composition, fit: ComplianceFit, asked: Floats, loads: Floats
) -> Batch:
    """Return the nearest rows' displacements with the coverage that the composition has."""
    moved, bars = nearest.read(asked)
    return Batch(moved, bars, diagnose(composition, fit, loads).batch.coverage)
