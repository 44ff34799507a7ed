"""Composition of the three axes to one displacement.

With z = u(0), the displacement at no load, a_i that of axis i at (F_i, M_j, M_k) and b_m that of
the moment M_m alone, all six outputs each,

    additive:  u(w) = z + sum_i (a_i - z) - sum_m (b_m - z)
    griddata:  rotations as above; u_i is the translation of axis i alone

It is the second-order part, for these groups, of a high-dimensional model representation (Rabitz
and Alis 1999, "General foundations of high-dimensional model representations"). An axis without
loads adds nothing and a moment that is zero takes nothing away. An axis that one moment acts on
alone answers by that moment's own answer, so that its part and the one taken away are the same
number: at a row of one axis the sum is that row. Slopes are composed alike. Errors are
independent to a good approximation and add up in quadrature, each times how often its part counts:

    error bar^2 = sum_i (n_i e_i)^2 + sum_m (n_m e_m)^2 + ((1 - sum_i n_i - sum_m n_m) e_z)^2

with n_i 1 for an axis that a force or two moments load, n_m the number of axes that M_m loads
alone, less one if it is there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..interpolation.delaunay import Indices
from ..table.axes import AXES, CLEAN, LoadAxis
from ..table.compliance import ComplianceFit
from ..table.rows import Floats
from .axis_table import WEAK, AxisTable
from .pure_moment import HOLE, PureMomentCut

# What an axis' part of an answer rests on, from the best to the worst: see `axis_table`; then a
# point off the hull, and an axis that has no rows at all.
OFF_HULL, NO_ROWS = HOLE, HOLE + 1


@dataclass(frozen=True)
class AtRest:
    """The answer at no load.

    Attributes
    ----------
    displacement, error : ndarray, shape (6,), m and rad
    known : bool
        Whether a row or the hull of an axis tells it.
    """

    displacement: Floats
    error: Floats
    known: bool


@dataclass(frozen=True)
class Composed:
    """What the axes answer to n wrenches.

    Attributes
    ----------
    additive, griddata : ndarray, shape (n, 6), m and rad
        The answers of these two methods; rotations are the same.
    rest : ndarray, shape (n, 6), m and rad
        Error bars of `additive`; NaN where errors are unknown.
    states : ndarray of int, shape (n, 3), dimensionless
        What each axis' part rests on: `SOUND`, `WEAK`, `DEGENERATE`, `OFF_HULL` or `NO_ROWS`.
    """

    additive: Floats
    griddata: Floats
    rest: Floats
    states: NDArray[np.int_]

    @property
    def state(self) -> NDArray[np.int_]:
        """The worst of the three axes, shape (n,)."""
        return self.states.max(axis=1)


class Composition:
    """Three axis tables (None where there are no rows) and the answer at no load.

    Attributes
    ----------
    tables : tuple of AxisTable or None, length 3
    cuts : tuple of tuple of PureMomentCut, length 3
        Of each moment, x, y, z: from the axis it comes first in, then from the other.
    at_rest : AtRest
    """

    def __init__(
        self,
        tables: Sequence[AxisTable | None],
        at_rest: AtRest,
        fit: ComplianceFit,
        scale: Floats,
        before: Composition | None = None,
    ) -> None:
        """Compose; cuts of axes that another composition has too are taken from it."""
        self.tables = tuple(tables)
        self.at_rest, self.fit, self.scale = at_rest, fit, scale
        known = before.cuts if before is not None else ((),) * 3
        self.cuts = tuple(
            _cuts(self.tables, moment, own) for moment, own in zip((3, 4, 5), known, strict=True)
        )

    @property
    def thinning(self) -> str:
        """Which axes are made of a choice of their points, in words; empty if none is."""
        found = [
            f"axis {table.axis.name} of {len(table.values)} of its {table.given} points"
            for table in self.tables
            if table is not None and table.given > len(table.values)
        ]
        return f"an even choice is triangulated: {', '.join(found)}" if found else ""

    def evaluate(self, wrenches: Floats) -> Composed:
        """Compose the answers to wrenches, shape (n, 6), N and N·m."""
        count = len(wrenches)
        loaded = np.abs(wrenches) > CLEAN * self.scale
        total = _Total(self.at_rest, count)
        acting = [np.flatnonzero(loaded[:, moment + 3]) for moment in range(3)]
        alone = [self._alone(m, wrenches[rows, m + 3]) for m, rows in enumerate(acting)]
        times = -loaded[:, 3:].astype(float)  # how often each moment's own answer is added
        for index, axis in enumerate(AXES):
            force, first, second = (loaded[:, load] for load in axis.inputs)
            for load, single in (
                (axis.inputs[1], first & ~second & ~force),
                (axis.inputs[2], second & ~first & ~force),
            ):
                times[single, load - 3] += 1.0
                rows = np.flatnonzero(single)
                part = alone[load - 3].take(np.searchsorted(acting[load - 3], rows))
                total.put_own(rows, axis, part)
                total.state[rows, index] = part.state
            rows = np.flatnonzero(force | (first & second))
            if len(rows):
                part = self._read(axis, wrenches[rows])
                total.put_own(rows, axis, part)
                total.add(rows, part, np.ones(len(rows)))
                total.state[rows, index] = part.state
        for moment in range(3):
            rows = np.flatnonzero(times[:, moment])
            part = alone[moment].take(np.searchsorted(acting[moment], rows))
            total.add(rows, part, times[rows, moment])
            total.mark_base(rows, moment, part.state)
        return total.composed()

    def derivatives(self, wrenches: Floats, method: str) -> Floats:
        """Return du/dw (n, 6, 6) at wrenches (n, 6): m/N, m/(N·m), rad/N, rad/(N·m).

        Of the law with all axes and moments in it, so that a load that is zero has its slope too.

        Parameters
        ----------
        method : {"griddata", "additive"}
        """
        found = np.zeros((len(wrenches), 6, 6))
        composed = slice(None) if method == "additive" else slice(3, None)
        for axis in AXES:
            slopes, inputs = self._read(axis, wrenches).slopes, list(axis.inputs)
            if method != "additive":
                found[:, axis.outputs[0], inputs] = slopes[:, axis.outputs[0]]
            found[:, composed, inputs] += slopes[:, composed]
        for moment in range(3):
            slopes = self._alone(moment, wrenches[:, moment + 3]).slopes
            found[:, composed, moment + 3] -= slopes[:, composed, 0]
        return found

    def _read(self, axis: LoadAxis, wrenches: Floats) -> _Part:
        """Return one axis' part at wrenches (k, 6) that load it."""
        table, inputs = self.tables[AXES.index(axis)], list(axis.inputs)
        if table is None:
            return self._guess(wrenches[:, inputs], inputs)
        x = wrenches[:, inputs] / table.scale
        reading = table.read(x)
        state = np.where(reading.inside, table.state[reading.simplices], OFF_HULL)
        if not table.shows_together:
            several = (np.abs(x) > CLEAN).sum(axis=1) > 1
            state = np.where(several, np.maximum(state, WEAK), state)
        part = _Part(reading.outputs, reading.rest, reading.slopes / table.scale, state)
        outside = np.flatnonzero(~reading.inside)
        if len(outside):
            # Account for steps (k, 3), scaled, from the hull's nearest point to the query. The
            # step along what the points span is in the outputs already, by the slope there. Off
            # it, where a table of fewer dimensions knows no slope, the fitted compliance tells
            # one; the bar grows by as much as the step moves the answer.
            rows, step = outside, (x - reading.at)[outside]
            basis = table.triangulation.basis
            off = step - step @ basis.T @ basis
            part.rest[rows] += np.abs(
                np.einsum("kqi,ki->kq", part.slopes[rows] * table.scale, step)
            )
            # Of each wrench by itself: batches change nothing.
            leaves = np.abs(off).max(axis=1) > CLEAN
            if leaves.any():
                rows, off = rows[leaves], off[leaves]
                loads = off * table.scale
                part.outputs[rows] += loads @ self.fit.matrix[:, inputs].T
                part.rest[rows] += (
                    np.abs(loads) @ np.abs(self.fit.matrix[:, inputs]).T + self.fit.error
                )
                unknown = (np.abs(off) > CLEAN) & ~self.fit.known[inputs]
                part.rest[rows[unknown.any(axis=1)]] = np.nan
        part.slopes += self._off_span(table)
        return part

    def _off_span(self, table: AxisTable) -> Floats:
        """Return the slopes (6, 3), SI, off the span of an axis' points.

        Those of the fitted compliance; NaN by loads whose influence no row tells.
        """
        basis, inputs = table.triangulation.basis, list(table.axis.inputs)
        if len(basis) == 3:
            return np.zeros((6, 3))
        off = np.eye(3) - basis.T @ basis
        off[np.abs(off) <= CLEAN] = 0.0
        slopes = (self.fit.matrix[:, inputs] * table.scale) @ off / table.scale
        unknown = (off != 0.0)[~self.fit.known[inputs]].any(axis=0)
        return np.where(unknown, np.nan, slopes)

    def _guess(self, loads: Floats, inputs: Sequence[int]) -> _Part:
        """Return the fitted compliance's part, for an axis or moment that has no rows."""
        matrix, count = self.fit.matrix[:, inputs], len(loads)
        moved = self.at_rest.displacement + loads @ matrix.T
        rest = np.abs(loads) @ np.abs(matrix).T + self.fit.error
        rest[((loads != 0) & ~self.fit.known[inputs]).any(axis=1)] = np.nan
        return _Part(moved, rest, np.tile(matrix, (count, 1, 1)), np.full(count, NO_ROWS))

    def _alone(self, moment: int, amounts: Floats) -> _Part:
        """Return the answers to amounts (k,), N·m, of one moment alone, from whichever axis tells.

        That is the axis it comes first in, or the other one where that one's rows do not hold it.
        """
        part = self._guess(amounts[:, None], [moment + 3])
        for cut in self.cuts[moment]:
            if not len(cut.state):  # the axis has rows, but none with this moment alone
                part.state = np.minimum(part.state, OFF_HULL)
                continue
            reading = cut.read(amounts)
            better = np.flatnonzero((part.state >= OFF_HULL) & (reading.state < part.state))
            outputs, rest = reading.outputs[better], reading.rest[better]
            slopes, state = reading.slopes[better], reading.state[better]
            part.put(better, _Part(outputs, rest, slopes[..., None], state))
        return part


@dataclass
class _Part:
    """What an axis or a moment alone answers at k wrenches, its slopes by its own loads."""

    outputs: Floats
    rest: Floats
    slopes: Floats
    state: NDArray[np.int_]

    def take(self, rows: Indices) -> _Part:
        return _Part(*(column[rows] for column in self._columns()))

    def put(self, rows: Indices, other: _Part) -> None:
        for column, new in zip(self._columns(), other._columns(), strict=True):
            column[rows] = new

    def _columns(self) -> tuple[NDArray, ...]:
        return self.outputs, self.rest, self.slopes, self.state


class _Total:
    """The sum so far; what no load answers is added at the end, as often as the parts leave."""

    def __init__(self, at_rest: AtRest, count: int) -> None:
        self.at_rest = at_rest
        self.sum, self.squares = np.zeros((count, 6)), np.zeros((count, 6))
        self.own = np.tile(at_rest.displacement[:3], (count, 1))
        self.times = np.zeros((count, 1))
        self.state = np.zeros((count, 3), dtype=int)

    def put_own(self, rows: Indices, axis: LoadAxis, part: _Part) -> None:
        """Take the axis' own translation from its part."""
        own = axis.outputs[0]
        self.own[rows, own] = part.outputs[:, own]

    def add(self, rows: Indices, part: _Part, times: Floats) -> None:
        """Add a part so many times, shape (k,)."""
        often = times[:, None]
        self.sum[rows] += often * part.outputs
        self.squares[rows] += (often * part.rest) ** 2
        self.times[rows] += often

    def mark_base(self, rows: Indices, moment: int, state: NDArray[np.int_]) -> None:
        """Hold the axis a moment comes first in to what its own answer rests on."""
        first = next(place for place, axis in enumerate(AXES) if axis.inputs[1] == moment + 3)
        self.state[rows, first] = np.maximum(self.state[rows, first], state)

    def composed(self) -> Composed:
        """Return the sum."""
        zero, left = self.at_rest, 1.0 - self.times
        additive = self.sum + left * zero.displacement
        squares = self.squares + np.where(left == 0, 0.0, (left * zero.error) ** 2)
        return Composed(
            additive=additive,
            griddata=np.concatenate((self.own, additive[:, 3:]), axis=1),
            rest=np.sqrt(squares),
            states=self.state,
        )


def _cuts(
    tables: Sequence[AxisTable | None], moment: int, known: Sequence[PureMomentCut]
) -> tuple[PureMomentCut, ...]:
    """Return the cuts along a moment, the one of the axis it comes first in before the other."""
    cuts = []
    for column in (1, 2):
        index = next(place for place, axis in enumerate(AXES) if axis.inputs[column] == moment)
        table = tables[index]
        if table is None:
            continue
        same = [cut for cut in known if cut.column == column and cut.table.is_made_like(table)]
        cuts.append(same[0].of(table) if same else PureMomentCut(table, column))
    return tuple(cuts)
