"""One axis of a surrogate, ready to answer: triangulation, affine pieces, bars, weak spots."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from surrogate.bars.errorbar import RowBars, calibrate
from surrogate.composition.pure_moment import MomentLine
from surrogate.interpolation.delaunay import Indices, Interpolant
from surrogate.interpolation.hull import nearest_in_hull
from surrogate.interpolation.slope_recovery import (
    edge_bends,
    quadratic_maps,
    row_slopes,
    simplex_slopes,
)
from surrogate.table.axes import AxisRows
from surrogate.table.rows import Floats, LoadRange

# The largest part of the load range, by dimension, that one simplex may take before it is `thin`.
LARGEST = {0: 1.0, 1: 0.4, 2: 0.2, 3: 0.1}

CHUNK = 2048  # points read at once

LINE = 33  # points at which the line of one moment alone is looked at

SHARP = 0.2  # of held-out errors: what is missing of them where slopes jump
ONE_SIDED = 0.4  # mean sign of the bends along a kink
KINK = 3.0  # the bend that is missing on a kink, per bend there and missing part elsewhere

SOUND, LARGE, DEGENERATE = 0, 1, 2


class Reading(NamedTuple):
    """Outputs (u_i, rx, ry, rz), their bends and the rest of their bars, (k, 4), m and rad.

    A bend is the error to be expected, with its sign; the rest is what may come on top of it.
    """

    outputs: Floats
    bends: Floats
    rest: Floats

    @property
    def bars(self) -> Floats:
        """The error bars, shape (k, 4)."""
        return np.abs(self.bends) + self.rest


class Beyond(NamedTuple):
    """Six outputs estimated outside the hull at k scaled inputs.

    Attributes
    ----------
    displacement, bars : ndarray, shape (k, 6), m and rad
    simplices : ndarray of int, shape (k,)
        Those that hold the hull's nearest point.
    aside : ndarray of bool, shape (k, 3)
        Which loads lead off the plane, the line or the point that all rows lie in.
    """

    displacement: Floats
    bars: Floats
    simplices: Indices
    aside: NDArray[np.bool_]


class AxisTable:
    """The piecewise affine map of one axis.

    In simplex s, with dx the distance of the scaled inputs from the simplex' anchor, `pieces[s]`
    times (dx_1, dx_2, dx_3, 1) is thirteen numbers: the four outputs, the flat part of their four
    error bars, the curvature of the four, and the bubble of the error bar plus |dx|^2. So one
    small product tells the outputs and, with flat + curvature * bubble, the bars. Where slopes are
    known twelve more tell the bends: three for each output, to be multiplied by dx once more.

    Attributes
    ----------
    rows : AxisRows
    interpolant : Interpolant
    pieces : ndarray, shape (m, 13 or 25, 4)
    bent : bool
        Whether the pieces tell bends.
    weak : list of int, length m
        SOUND, LARGE or DEGENERATE, per simplex.
    fewest : int
        How many points the axis needs not to be thin.
    """

    def __init__(self, rows: AxisRows, load_range: LoadRange, *, repeatable: bool = False) -> None:
        """Triangulate the rows, at least one, and calibrate their error bars.

        `repeatable` rows are solves, which have no noise.
        """
        self.rows, self.axis = rows, rows.axis
        self.scale = tuple(load_range.scale[list(rows.axis.inputs)].tolist())
        self.interpolant = Interpolant(rows.points)
        self.values = rows.displacement[:, list(rows.axis.outputs)]
        self.doubt = rows.uncertainty[:, list(rows.axis.outputs)]
        self.fewest = 2 * (self.interpolant.dimension + 1)
        self.tangent = rows.tangent[:, list(rows.axis.outputs)]
        self.bars = calibrate(
            self.interpolant, self.values, self.doubt, self.tangent, repeatable=repeatable
        )
        self.bent = bool(self.bars.bend.any())
        self.bending = tuple(self.bars.bending.tolist())
        self.pieces = self._pieces(self.bars)
        self.anchors = list(map(tuple, self.interpolant.anchors.tolist()))
        self.weak = self._weak_spots()
        self.weak_at = np.array(self.weak)
        self.sound = len(rows.points) >= self.fewest
        self.find = self._finder()
        self.lean = self._line_lean()
        self.line = (
            MomentLine(self.interpolant, self.pieces, self.weak_at, self.bending)
            if self.interpolant.dimension == 3
            else None
        )

    def _finder(self):
        """Return the cheapest point location: qhull's own in three dimensions."""
        if self.interpolant.dimension == 3:
            return self.interpolant.delaunay.find_simplex
        return self.interpolant.locate

    def _pieces(self, bars: RowBars) -> Floats:
        shape = self.interpolant
        vertices = np.concatenate((self.values, self.doubt + bars.flat, bars.curvature), axis=1)
        pieces = np.empty((len(shape.simplices), 25 if self.bent else 13, 4))
        pieces[:, :12, :3] = shape.gradients(vertices)
        pieces[:, :12, 3] = vertices[shape.simplices[:, -1]]
        reach = ((shape.points[shape.simplices] - shape.anchors[:, None]) ** 2).sum(axis=2)
        pieces[:, 12, :3] = np.einsum("md,mdi->mi", reach[:, :-1], shape.weights)
        pieces[:, 12, 3] = 0.0
        if self.bent:
            square, line = self._bends()
            pieces[:, 13:, :3] = square.reshape(-1, 12, 3)
            pieces[:, 13:, 3] = line.reshape(-1, 12)
        return pieces

    def _bends(self) -> tuple[Floats, Floats]:
        """Return the share of the bends that is taken, as the maps of `quadratic_maps`."""
        shape = self.interpolant
        slopes = row_slopes(shape, self.values, self.tangent)
        edges = edge_bends(shape, simplex_slopes(shape, self.values, slopes))
        return quadratic_maps(shape, edges * self.bars.bend)

    def _weak_spots(self) -> list[int]:
        shape = self.interpolant
        weak = np.where(self.parts() > LARGEST[shape.dimension], LARGE, SOUND)
        weak[shape.degenerate] = DEGENERATE
        return weak.tolist()

    def _line_lean(self) -> tuple[float, ...]:
        """Return the signed error (rx, ry, rz), rad, to be expected at the first moment alone.

        The composition reads every answer there, and a kink at zero load (a contact, a clearance)
        makes all those readings err to one side, which adding up in quadrature would not see.
        """
        line = np.zeros((LINE, 3))
        line[:, 1] = np.linspace(-1, 1, LINE)
        found = self.interpolant.locate(line)
        crossed = np.unique(found[found >= 0])
        if not len(crossed):
            return (0.0, 0.0, 0.0)
        corners = self.bars.signed[self.interpolant.simplices[crossed], 1:]
        low, high = corners.min(axis=1), corners.max(axis=1)
        # Its middle four fifths: the simplices at the line's ends, on the hull, err by more.
        along = np.sort(np.where(high > -low, high, low), axis=0)
        middle = along[len(along) // 10 : len(along) - len(along) // 10]
        mean, doubt = middle.mean(axis=0), middle.std(axis=0) / np.sqrt(len(middle))
        shown = np.sign(mean) * np.maximum(np.abs(mean) - doubt, 0.0)
        # On the kink itself slopes recovered from both its sides tell too little of a bend.
        bends = self.read(found[found >= 0], line[found >= 0]).bends[:, 1:]
        one_sided = np.abs(np.sign(bends).mean(axis=0)) > ONE_SIDED
        missing = np.where(self.bars.missing[1:] > SHARP, np.minimum(self.bars.missing[1:], 0.5), 0)
        bent = KINK * one_sided * missing * bends.mean(axis=0)
        return tuple(np.where(np.abs(bent) > np.abs(shown), bent, shown).tolist())

    def parts(self) -> Floats:
        """Return what part of the load range each simplex takes, shape (m,)."""
        dimension = self.interpolant.dimension
        if dimension == 0:
            return np.zeros(1)
        return self.interpolant.volumes / 2.0**dimension

    def read(self, simplices: Indices, x: Floats) -> Reading:
        """Return outputs and bars at scaled inputs (k, 3) in the simplices (k,) they lie in."""
        reading = Reading(*(np.zeros((len(x), 4)) for _ in range(3)))
        for start in range(0, len(x), CHUNK):  # what is gathered for one chunk fits the cache
            part = slice(start, start + CHUNK)
            self._read_part(simplices[part], x[part], Reading(*(each[part] for each in reading)))
        return reading

    def read_six(self, simplices: Indices, x: Floats) -> tuple[Floats, Floats, Floats]:
        """Return all six outputs, bars and bends, each (k, 6), m and rad, at scaled inputs (k, 3).

        The two translations that are not the axis' own have no calibrated bar: how much they vary
        over the simplex stands in for it.
        """
        corners = self.rows.displacement[self.interpolant.simplices[simplices]]
        shares = self.interpolant.barycentric(simplices, x)
        moved, bars = np.einsum("kd,kdq->kq", shares, corners), np.ptp(corners, axis=1)
        reading, outputs = self.read(simplices, x), list(self.axis.outputs)
        bends = np.zeros_like(moved)
        moved[:, outputs], bars[:, outputs] = reading.outputs, reading.bars
        bends[:, outputs] = reading.bends
        return moved, bars, bends

    def beyond(self, x: Floats, columns: Floats) -> Beyond:
        """Estimate outside the hull: the value at its nearest point, and the slope from there.

        Parameters
        ----------
        x : ndarray, shape (k, 3), dimensionless
            Scaled inputs outside the hull.
        columns : ndarray, shape (6, 3), m and rad
            The fitted compliance per scaled input, for what no row of this axis varies.
        """
        shape = self.interpolant
        start = nearest_in_hull(self._hull, x)
        simplices = shape.locate(start)
        lost = np.flatnonzero(simplices < 0)  # on a hull of slivers: some simplex of that vertex
        if len(lost):
            simplices[lost] = self._simplex_of[shape.nearest(start[lost])]
        moved, bars, _ = self.read_six(simplices, start)
        shares = np.clip(shape.barycentric(simplices, start), 0.0, 1.0)
        shares /= shares.sum(axis=1, keepdims=True)
        off_span = np.eye(3) - shape.basis.T @ shape.basis
        known, slopes = self._slopes
        slopes = slopes + np.where(known[:, None, None], 0.0, columns @ off_span)
        slope = np.einsum("kd,kdqi->kqi", shares, slopes[shape.simplices[simplices]])
        step = x - start
        moved += np.einsum("kqi,ki->kq", slope, step)
        steepest = np.maximum(np.abs(slope), np.abs(columns))
        bars = bars + np.einsum("kqi,ki->kq", steepest, np.abs(step))
        return Beyond(moved, bars, simplices, np.abs(step @ off_span) > shape.slack)

    @cached_property
    def _hull(self) -> Floats:
        """The points that may be vertices of the hull, shape (h, 3), scaled."""
        points, dimension = self.interpolant.points, self.interpolant.dimension
        if dimension < 2:
            return points
        flat = (points - self.interpolant.origin) @ self.interpolant.basis.T
        try:
            return points[ConvexHull(flat).vertices]
        except QhullError:
            return points

    @cached_property
    def _simplex_of(self) -> Indices:
        """One simplex at each point, shape (n,)."""
        found = np.zeros(len(self.rows.points), dtype=np.intp)
        found[self.interpolant.simplices] = np.arange(len(self.interpolant.simplices))[:, None]
        return found

    @cached_property
    def _slopes(self) -> tuple[NDArray[np.bool_], Floats]:
        """Which points bring a tangent, (n,), and all points' slopes, (n, 6, 3), m and rad.

        Without a tangent it is the mean of the simplices' slopes around, by their volumes. Slopes
        at points, rather than in simplices, are what makes estimates continuous outside the hull.
        """
        shape, moved = self.interpolant, self.rows.displacement
        weight = np.where(shape.degenerate, 0.0, shape.volumes)
        own = weight[:, None, None] * shape.gradients(moved)
        total, size = np.zeros((len(moved), 6, 3)), np.zeros(len(moved))
        for corner in shape.simplices.T:
            np.add.at(total, corner, own)
            np.add.at(size, corner, weight)
        slopes = total / np.maximum(size, np.finfo(float).tiny)[:, None, None]
        known = np.asarray(np.isfinite(self.rows.tangent).all(axis=(1, 2)), dtype=bool)
        return known, np.where(known[:, None, None], self.rows.tangent, slopes)

    def _read_part(self, simplices: Indices, x: Floats, into: Reading) -> None:
        apart = x - self.interpolant.anchors.take(simplices, axis=0)
        terms = np.concatenate((apart, np.ones((len(x), 1))), axis=1)
        told = np.einsum("kij,kj->ki", self.pieces.take(simplices, axis=0), terms)
        bubble = told[:, 12] - np.einsum("ki,ki->k", apart, apart)
        into.outputs[:] = told[:, :4]
        into.rest[:] = np.abs(told[:, 4:8] + told[:, 8:12] * bubble[:, None])
        if self.bent:
            np.einsum("kqi,ki->kq", told[:, 13:].reshape(-1, 4, 3), apart, out=into.bends)
            into.rest[:] += np.abs(into.bends) * self.bending
