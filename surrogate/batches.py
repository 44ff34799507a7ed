"""The careful path for many wrenches at once: the numbers of coverage.py without its words.

A wrench outside an axis or in a weak simplex costs as much here as a covered one, not a thousand
times as much.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surrogate.answers import Batch
from surrogate.axes import AXES, Axis
from surrogate.axistable import SOUND, AxisTable
from surrogate.compliance import ComplianceFit
from surrogate.composition import Composition
from surrogate.coverage import COVERED, OUTSIDE, THIN
from surrogate.nearest import NearestRow
from surrogate.rows import Floats, LoadRange

Mask = NDArray[np.bool_]


@dataclass
class Spots:
    """What `coverage.Spot` holds, of k wrenches.

    Attributes
    ----------
    displacement, bars : ndarray, shape (k, 6), m and rad
        Bars are NaN where nothing tells them.
    state : ndarray of uint8, shape (k,)
    there : ndarray of bool, shape (k,)
        Whether rows stand behind it.
    """

    displacement: Floats
    bars: Floats
    state: NDArray[np.uint8]
    there: Mask

    @classmethod
    def at_rest(cls, zero: Floats, count: int) -> Spots:
        """Return spots at zero load, which are exact and rest on no row."""
        return cls(
            np.tile(zero, (count, 1)),
            np.zeros((count, 6)),
            np.zeros(count, dtype=np.uint8),
            np.zeros(count, dtype=bool),
        )

    def put(self, where: Mask | NDArray[np.intp], other: Spots) -> None:
        """Replace the spots at some places."""
        self.displacement[where], self.bars[where] = other.displacement, other.bars
        self.state[where], self.there[where] = other.state, other.there

    def at(self, where: Mask) -> Spots:
        """Return the spots at some places."""
        return Spots(
            self.displacement[where], self.bars[where], self.state[where], self.there[where]
        )


def read_many_carefully(composition: Composition, fit: ComplianceFit, loads: Floats) -> Batch:
    """Compose the answers to wrenches (k, 6), N and N·m, traces of loads taken as none."""
    zero = np.array(composition.zero)
    moved = np.tile(zero, (len(loads), 1))
    squares, lean = np.zeros((len(loads), 6)), np.zeros((len(loads), 3))
    state = np.zeros(len(loads), dtype=np.uint8)
    for index, axis in enumerate(AXES):
        spot, base = _axis_spots(composition, fit, axis, loads)
        own = axis.outputs[0]
        moved[:, own] = spot.displacement[:, own]
        moved[:, 3:] += spot.displacement[:, 3:] - base.displacement[:, 3:]
        squares[:, own] += spot.bars[:, own] ** 2
        squares[:, 3:] += spot.bars[:, 3:] ** 2 + base.bars[:, 3:] ** 2
        # Unknown bars of one output make the whole error unknown, as in a single answer.
        unknown = ~np.isfinite(spot.bars + base.bars).all(axis=1)
        squares[unknown] = np.nan
        state = np.maximum(state, spot.state)
        table = composition.tables[index]
        if table is not None:
            lean[base.there & ~unknown] += table.lean
    squares[:, 3:] += lean**2
    composition.left_out.widen_many(loads, squares)
    return Batch(moved, np.sqrt(squares), state)


def _axis_spots(
    composition: Composition, fit: ComplianceFit, axis: Axis, loads: Floats
) -> tuple[Spots, Spots]:
    """Return an axis' spots and those its rotation counts from; see `coverage`."""
    zero = np.array(composition.zero)
    spot, base = Spots.at_rest(zero, len(loads)), Spots.at_rest(zero, len(loads))
    force, first, second = (loads[:, load] != 0 for load in axis.inputs)
    used = force | first | second
    if not used.any():
        return spot, base
    spot.put(used, _spots(composition, fit, axis, loads[used]))
    only = first & ~force & ~second
    base.displacement[only] = spot.displacement[only]
    counted = first & ~only
    if counted.any():
        alone, missing = _base_spots(composition, fit, axis, loads[counted])
        base.put(counted, alone)
        spot.state[np.flatnonzero(counted)[missing]] = OUTSIDE
    return spot, base


def _base_spots(
    composition: Composition, fit: ComplianceFit, axis: Axis, loads: Floats
) -> tuple[Spots, Mask]:
    """Return the spots at the first moment alone, and which of them no table holds."""
    alone, found = _alone(composition, axis.inputs[1], loads)
    if not found.all():
        only = np.where(np.arange(6) == axis.inputs[1], loads[~found], 0.0)
        alone.put(~found, _guesses(composition, fit, axis, only))
    return alone, ~found


def _spots(composition: Composition, fit: ComplianceFit, axis: Axis, loads: Floats) -> Spots:
    """Return an axis' own answers, those of another axis to one moment alone, or estimates."""
    table = composition.tables[AXES.index(axis)]
    spot, found = _read(table, composition, loads)
    force, first, second = (loads[:, load] != 0 for load in axis.inputs)
    for moment, single in ((1, first & ~force & ~second), (2, second & ~force & ~first)):
        weak = single & ~(found & (spot.state == COVERED))
        if weak.any():
            alone, there = _alone(composition, axis.inputs[moment], loads[weak])
            better = there & (~found[weak] | (alone.state < spot.state[weak]))
            places = np.flatnonzero(weak)[better]
            spot.put(places, alone.at(better))
            found[places] = True
    if not found.all():
        inputs = np.isin(np.arange(6), axis.inputs)
        spot.put(~found, _guesses(composition, fit, axis, np.where(inputs, loads[~found], 0.0)))
    return spot


def _alone(composition: Composition, moment: int, loads: Floats) -> tuple[Spots, Mask]:
    """Return the answers to one moment alone, from the axis it is first in or else the other."""
    only = np.where(np.arange(6) == moment, loads, 0.0)
    spot = Spots.at_rest(np.array(composition.zero), len(loads))
    found = np.zeros(len(loads), dtype=bool)
    for place in (1, 2):
        index = next(i for i, axis in enumerate(AXES) if axis.inputs[place] == moment)
        left = np.flatnonzero(~found)
        if len(left):
            read, there = _read(composition.tables[index], composition, only[left])
            spot.put(left[there], read.at(there))
            found[left[there]] = True
    return spot, found


def _read(table: AxisTable | None, composition: Composition, loads: Floats) -> tuple[Spots, Mask]:
    """Read all six outputs of a table, and tell which loads its hull holds."""
    spot = Spots.at_rest(np.array(composition.zero), len(loads))
    if table is None:
        return spot, np.zeros(len(loads), dtype=bool)
    x = loads[:, list(table.axis.inputs)] / np.array(table.scale)
    found = table.interpolant.locate(x)
    inside = found >= 0
    x, simplices = x[inside], found[inside]
    corners = table.rows.displacement[table.interpolant.simplices[simplices]]
    shares = table.interpolant.barycentric(simplices, x)
    moved, bars = np.einsum("kd,kdq->kq", shares, corners), np.ptp(corners, axis=1)
    reading = table.read(simplices, x)
    outputs = list(table.axis.outputs)
    moved[:, outputs], bars[:, outputs] = reading.outputs, reading.bars
    thin = (table.weak_at[simplices] != SOUND) | (not table.sound)
    state = np.where(thin, THIN, COVERED).astype(np.uint8)
    spot.put(inside, Spots(moved, bars, state, np.ones(len(x), dtype=bool)))
    return spot, inside


def _guesses(composition: Composition, fit: ComplianceFit, axis: Axis, loads: Floats) -> Spots:
    """Estimate from the axis' nearest rows and the fitted compliance; r(0) if it has no rows."""
    spot = Spots.at_rest(np.array(composition.zero), len(loads))
    table, from_loads = composition.tables[AXES.index(axis)], np.zeros_like(loads)
    if table is not None:
        inputs, scale = list(axis.inputs), np.array(table.scale)
        nearest = table.interpolant.nearest(loads[:, inputs] / scale)
        spot.displacement = table.rows.displacement[nearest]
        spot.bars = table.rows.uncertainty[nearest]
        from_loads[:, inputs] = table.interpolant.points[nearest] * scale
        spot.there[:] = True
    step = loads - from_loads
    spot.displacement = spot.displacement + np.where(fit.known, step, 0.0) @ fit.matrix.T
    spot.bars = spot.bars + np.abs(step) @ np.abs(fit.matrix).T + fit.bar
    spot.bars[(~fit.known & (np.abs(step) > 0)).any(axis=1)] = np.nan
    spot.state[:] = OUTSIDE
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
    beyond = ((loads < load_range.low) | (loads > load_range.high)).any(axis=1)
    error[unknown] = np.nan
    return Batch(moved, error, np.where(unknown | beyond, OUTSIDE, COVERED).astype(np.uint8))


def read_many_nearest(
    nearest: NearestRow, composition: Composition, fit: ComplianceFit, asked: Floats, loads: Floats
) -> Batch:
    """Return the nearest rows' displacements with the coverage that the composition has."""
    moved, bars = nearest.read(asked)
    return Batch(moved, bars, read_many_carefully(composition, fit, loads).coverage)
