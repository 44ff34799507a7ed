"""Composition of the three axes to one displacement.

    u_i(w) = axis i's translation at (F_i, M_j, M_k)
    r(w)   = sum_i r_i(F_i, M_j, M_k) - sum_m r(M_m alone) + r(0)

It is the second-order part, for these groups, of a high-dimensional model representation (Rabitz
and Alis 1999, "General foundations of high-dimensional model representations"). The answer to
M_j alone is read from axis i, the one whose first moment it is, so that axis i adds
r_i(F_i, M_j, M_k) - r_i(0, M_j, 0), which is exactly nothing if M_j acts alone. The careful path
(coverage.py) turns to the other axis that knows M_j where this one does not.

The bends of the parts, the errors to be expected, are composed as the parts are, with their signs;
so is what is left out. On top of their sum's size comes what those estimates miss: for different
parts it is independent to a good approximation and adds up in quadrature.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrogate.composition.axis_table import AxisTable
from surrogate.interpolation.morton import curve_order
from surrogate.leftout import LeftOut
from surrogate.table.axes import AXES
from surrogate.table.rows import Floats

_INPUTS = tuple(axis.inputs for axis in AXES)


class Composed(NamedTuple):
    """Displacements and error bars, shapes (n, 6), m and rad, and where they are told, (n,).

    `bend` is the error to be expected of the axes, with its sign, and `rest` what may come on top
    of it; `expected` is the size of the bend and of what is left out together, as the bar holds it.
    """

    displacement: Floats
    error: Floats
    told: NDArray[np.bool_]
    bend: Floats
    rest: Floats
    expected: Floats

    def at(self, places: NDArray[np.intp]) -> Composed:
        """Return what is told at some places."""
        columns: list[Any] = [column[places] for column in self]
        return Composed(*columns)


class AtRest(NamedTuple):
    """What the component does without load, u(0) and r(0).

    Attributes
    ----------
    displacement : tuple of float, length 6, m and rad
        Of the row at zero load; or the mean of what axes that hold zero interpolate there; or 0.
    bars : tuple of float, length 6, m and rad
        What is to be expected of the error, `bends`, included.
    bends : tuple of float, length 6, m and rad
        The error to be expected, with its sign.
    rounding : tuple of float, length 6, m and rad
        The smallest bar any answer has.
    known : bool
        False where no row is at zero load and no axis holds it: zero load is not covered then.
    """

    displacement: tuple[float, ...]
    bars: tuple[float, ...]
    bends: tuple[float, ...]
    rounding: tuple[float, ...]
    known: bool


class Composition:
    """Three axis tables (None where there are no rows), what no load does, and what is left out.

    Attributes
    ----------
    tables : tuple of AxisTable or None, length 3
    rest : AtRest
    zero : tuple of float, length 6, m and rad
        The displacement at rest.
    left_out : LeftOut
    """

    def __init__(
        self,
        tables: Sequence[AxisTable | None],
        rest: AtRest,
        left_out: LeftOut,
    ) -> None:
        self.tables = tuple(tables)
        self.rest, self.zero = rest, rest.displacement
        self.left_out = left_out
        self._least = [bar * bar for bar in rest.rounding]
        # Of the bars at rest, what comes on top of their bends, squared.
        self._doubt = [
            max(bar - abs(bend), 0.0) ** 2 for bar, bend in zip(rest.bars, rest.bends, strict=True)
        ]
        self._sure = rest.known and not any(rest.bars)

    def quick(self, wrench: Sequence[float]) -> tuple[tuple, tuple] | None:
        """Return the six outputs and their six error bars, or None.

        None where an axis has no rows, does not hold the inputs in its hull, or holds them in a
        weak simplex; the careful path then says why. This is the hot path: plain floats, one
        point location per axis, one small product per point.
        """
        moved, spread, bent = list(self.zero), self._least.copy(), [0.0] * 6
        lean, times = [0.0] * 3, 1  # how often r(0) is counted in all
        for axis, table in enumerate(self.tables):
            i, j, k = _INPUTS[axis]
            force, first, second = wrench[i], wrench[j], wrench[k]
            if force == 0.0 and first == 0.0 and second == 0.0:
                spread[axis] += self._doubt[axis]
                bent[axis] = self.rest.bends[axis]
                continue
            if table is None or not table.sound:
                return None
            scale = table.scale
            x, y, z = force / scale[0], first / scale[1], second / scale[2]
            if first == 0.0:
                points = ((x, 0.0, z),)
                times -= 1
            elif force == 0.0 and second == 0.0:
                points = ((0.0, y, 0.0),)
            else:
                points = ((x, y, z), (0.0, y, 0.0))
            if not self._add_axis(table, axis, points, moved, spread, bent, lean):
                return None
        if not (self._sure or self._add_rest(wrench, times, spread, bent)):
            return None
        for turn in (0, 1, 2):
            spread[3 + turn] += lean[turn] * lean[turn]
        self.left_out.widen(wrench, spread, bent)
        a, b, c, d, e, f = bent
        p, q, r = lean
        size = (abs(a), abs(b), abs(c), abs(d), abs(e), abs(f), abs(d + p), abs(e + q), abs(f + r))
        a, b, c, d, e, f, p, q, r = size
        size = (a, b, c, max(d, p), max(e, q), max(f, r))
        return tuple(moved), tuple([b + sqrt(s) for b, s in zip(size, spread, strict=True)])

    def _add_rest(
        self, wrench: Sequence[float], times: int, spread: list[float], bent: list[float]
    ) -> bool:
        """Add the doubt about r(0), so often counted; False if nothing but it answers, unknown."""
        for turn in (3, 4, 5) if times else ():
            spread[turn] += times * times * self._doubt[turn]
            bent[turn] += times * self.rest.bends[turn]
        return self.rest.known or any(wrench)

    def _add_axis(
        self,
        table: AxisTable,
        axis: int,
        points: tuple,
        moved: list[float],
        spread: list[float],
        bent: list[float],
        lean: list[float],
    ) -> bool:
        """Add one axis' share to `moved` and `spread`; False if a simplex is weak or missing."""
        weak = table.weak
        found = table.find(points).tolist()
        simplex = found[0]
        if simplex < 0 or weak[simplex]:
            return False
        u, rx, ry, rz, eu, ex, ey, ez, bu, bx, by, bz = _piece(table, simplex, points[0])
        moved[axis] = u
        spread[axis] += eu * eu
        bent[axis] = bu
        if len(points) == 2:
            simplex = found[1]
            if simplex < 0 or weak[simplex]:
                return False
            _, zx, zy, zz, _, dx, dy, dz, _, cx, cy, cz = _piece(table, simplex, points[1])
            tilt = table.lean
            bx -= cx
            by -= cy
            bz -= cz
            for turn in (0, 1, 2):
                lean[turn] -= tilt[turn]
        elif points[0][1] != 0.0:  # M_j alone: its two answers, to subtract, are one
            return True
        else:
            _, _, _, zx, zy, zz = self.zero
            dx = dy = dz = 0.0
        moved[3] += rx - zx
        moved[4] += ry - zy
        moved[5] += rz - zz
        spread[3] += ex * ex + dx * dx
        spread[4] += ey * ey + dy * dy
        spread[5] += ez * ez + dz * dz
        bent[3] += bx
        bent[4] += by
        bent[5] += bz
        return True

    def many(self, wrenches: Floats) -> Composed:
        """Return the same for many wrenches, shape (n, 6), at once."""
        moved = np.tile(self.zero, (len(wrenches), 1))
        spread, bent = np.tile(self._least, (len(wrenches), 1)), np.zeros((len(wrenches), 6))
        told = np.ones(len(wrenches), dtype=bool)
        lean = np.zeros((len(wrenches), 3))
        for axis, table in enumerate(self.tables):
            force, first, second = (wrenches[:, load] for load in _INPUTS[axis])
            loaded = (force != 0) | (first != 0) | (second != 0)
            used = slice(None) if loaded.all() else np.flatnonzero(loaded)
            if table is None or not table.sound:
                told[used] = False
            elif loaded.any():
                x = np.stack((force[used], first[used], second[used]), axis=1) / table.scale
                share = _share(table, x, self.zero[3:])
                told[used] &= share.known
                moved[used, axis] = share.outputs[:, 0]
                moved[used, 3:] += share.outputs[:, 1:]
                bent[used, axis] = share.bends[:, 0]
                bent[used, 3:] += share.bends[:, 1:]
                spread[used, axis] += share.squares[:, 0]
                spread[used, 3:] += share.squares[:, 1:]
                lean[used] -= share.both[:, None] * np.array(table.lean)
        if not self._sure:
            self._add_rests(wrenches, spread, bent)
        if not self.rest.known:
            told &= wrenches.any(axis=1)
        spread[:, 3:] += lean**2
        bend, rest = bent.copy(), np.sqrt(spread)
        self.left_out.widen_many(wrenches, spread, bent)
        expected = np.abs(bent)
        expected[:, 3:] = np.maximum(expected[:, 3:], np.abs(bent[:, 3:] + lean))
        return Composed(moved, expected + np.sqrt(spread), told, bend, rest, expected)

    def _add_rests(self, wrenches: Floats, spread: Floats, bent: Floats) -> None:
        """Do for wrenches (n, 6) what `quick` does with the doubt about u(0) and r(0)."""
        times, doubt, bends = np.ones(len(wrenches)), np.array(self._doubt), self.rest.bends
        for axis, inputs in enumerate(_INPUTS):
            force, first, second = (wrenches[:, load] == 0 for load in inputs)
            idle = force & first & second
            spread[idle, axis] += doubt[axis]
            bent[idle, axis] += bends[axis]
            times -= first & ~idle
        spread[:, 3:] += times[:, None] ** 2 * doubt[3:]
        bent[:, 3:] += times[:, None] * np.array(bends[3:])


class _Share(NamedTuple):
    """One axis' share: outputs and bends (k, 4), rotations from their base; squares; flags."""

    outputs: Floats
    bends: Floats
    squares: Floats
    known: NDArray[np.bool_]
    both: NDArray[np.bool_]


def _share(table: AxisTable, x: Floats, zero: tuple[float, ...]) -> _Share:
    """Return what one axis adds at scaled inputs (k, 3) of which none is all zero.

    Without its first moment that is the axis' part less r(0), with that moment alone nothing.
    """
    outputs, bends, squares, known = _read(table, x)
    only = (x[:, 0] == 0) & (x[:, 2] == 0)
    both = (x[:, 1] != 0) & ~only
    where = slice(None) if both.all() else both
    outputs[~both, 1:] -= zero
    outputs[only, 1:], bends[only, 1:], squares[only, 1:] = 0.0, 0.0, 0.0
    if both.any():
        base, turned, doubt, sound = _read_alone(table, x[where])
        outputs[where, 1:] -= base[:, 1:]
        bends[where, 1:] -= turned[:, 1:]
        squares[where, 1:] += doubt[:, 1:]
        known[where] &= sound
    return _Share(outputs, bends, squares, known, both)


_Read = tuple[Floats, Floats, Floats, NDArray[np.bool_]]


def _read(table: AxisTable, x: Floats) -> _Read:
    """Return outputs, bends and squared rests, (k, 4), and whether a sound simplex holds each."""
    order = curve_order(x)
    ordered = x.take(order, axis=0)
    found = table.interpolant.locate(ordered)
    reading = table.read(np.maximum(found, 0), ordered)
    outputs, bends, squares = (np.empty((len(x), 4)) for _ in range(3))
    outputs[order], bends[order], squares[order] = reading.outputs, reading.bends, reading.rest**2
    known = np.empty(len(x), bool)
    known[order] = (found >= 0) & (table.weak_at[found] == 0)
    return outputs, bends, squares, known


def _read_alone(table: AxisTable, x: Floats) -> _Read:
    """Return the same where the axis' first moment acts alone."""
    if table.line is None:
        return _read(table, np.array([0.0, 1.0, 0.0]) * x)
    reading = table.line.read(x[:, 1])
    return reading.outputs, reading.bends, reading.rest**2, reading.known


def _piece(table: AxisTable, simplex: int, point: tuple[float, float, float]) -> tuple[float, ...]:
    """Return the four outputs, the rests of their bars and their bends at one point, as floats."""
    x, y, z = point
    a, b, c = table.anchors[simplex]
    x -= a
    y -= b
    z -= c
    told = table.pieces[simplex].dot((x, y, z, 1.0)).tolist()
    u, rx, ry, rz, fu, fx, fy, fz, cu, cx, cy, cz, bubble = told[:13]
    bubble -= x * x + y * y + z * z
    fu, fx, fy, fz = fu + cu * bubble, fx + cx * bubble, fy + cy * bubble, fz + cz * bubble
    if not table.bent:
        return u, rx, ry, rz, fu, fx, fy, fz, 0.0, 0.0, 0.0, 0.0
    p, q, r, ux, uy, uz, vx, vy, vz, wx, wy, wz = told[13:]
    p, q = p * x + q * y + r * z, ux * x + uy * y + uz * z
    r, s = vx * x + vy * y + vz * z, wx * x + wy * y + wz * z
    a, b, c, d = table.bending
    fu, fx, fy, fz = fu + a * abs(p), fx + b * abs(q), fy + c * abs(r), fz + d * abs(s)
    return u, rx, ry, rz, fu, fx, fy, fz, p, q, r, s
