"""One axis of a surrogate, ready to answer: triangulation, affine pieces, bars, weak spots."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from surrogate.axes import AxisRows
from surrogate.errorbar import RowBars, calibrate
from surrogate.interpolant import Indices, Interpolant
from surrogate.momentline import MomentLine
from surrogate.rows import Floats, LoadRange

# The largest part of the load range, by dimension, that one simplex may take before it is `thin`.
LARGEST = {0: 1.0, 1: 0.4, 2: 0.2, 3: 0.1}

CHUNK = 2048  # points read at once

LINE = 33  # points at which the line of one moment alone is looked at

SOUND, LARGE, DEGENERATE = 0, 1, 2


class Reading(NamedTuple):
    """Outputs (u_i, rx, ry, rz) and their error bars, each of shape (k, 4), m and rad."""

    outputs: Floats
    bars: Floats


class AxisTable:
    """The piecewise affine map of one axis.

    In simplex s, with dx the distance of the scaled inputs from the simplex' anchor, `pieces[s]`
    times (dx_1, dx_2, dx_3, 1) is thirteen numbers: the four outputs, the flat part of their four
    error bars, the curvature of the four, and the bubble of the error bar plus |dx|^2. So one
    small product tells the outputs and, with flat + curvature * bubble, the bars.

    Attributes
    ----------
    rows : AxisRows
    interpolant : Interpolant
    pieces : ndarray, shape (m, 13, 4)
    weak : list of int, length m
        SOUND, LARGE or DEGENERATE, per simplex.
    fewest : int
        How many points the axis needs not to be thin.
    """

    def __init__(self, rows: AxisRows, load_range: LoadRange) -> None:
        """Triangulate the rows, at least one, and calibrate their error bars."""
        self.rows, self.axis = rows, rows.axis
        self.scale = tuple(load_range.scale[list(rows.axis.inputs)].tolist())
        self.interpolant = Interpolant(rows.points)
        self.values = rows.displacement[:, list(rows.axis.outputs)]
        self.doubt = rows.uncertainty[:, list(rows.axis.outputs)]
        self.fewest = 2 * (self.interpolant.dimension + 1)
        self.bars = calibrate(self.interpolant, self.values, self.doubt)
        self.pieces = self._pieces(self.bars)
        self.anchors = list(map(tuple, self.interpolant.anchors.tolist()))
        self.weak = self._weak_spots()
        self.weak_at = np.array(self.weak)
        self.sound = len(rows.points) >= self.fewest
        self.find = self._finder()
        self.lean = self._line_lean()
        self.line = MomentLine(self) if self.interpolant.dimension == 3 else None

    def _finder(self):
        """Return the cheapest point location: qhull's own in three dimensions."""
        if self.interpolant.dimension == 3:
            return self.interpolant.delaunay.find_simplex
        return self.interpolant.locate

    def _pieces(self, bars: RowBars) -> Floats:
        shape = self.interpolant
        vertices = np.concatenate((self.values, self.doubt + bars.flat, bars.curvature), axis=1)
        pieces = np.empty((len(shape.simplices), 13, 4))
        pieces[:, :12, :3] = shape.gradients(vertices)
        pieces[:, :12, 3] = vertices[shape.simplices[:, -1]]
        reach = ((shape.points[shape.simplices] - shape.anchors[:, None]) ** 2).sum(axis=2)
        pieces[:, 12, :3] = np.einsum("md,mdi->mi", reach[:, :-1], shape.weights)
        pieces[:, 12, 3] = 0.0
        return pieces

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
        return tuple((np.sign(mean) * np.maximum(np.abs(mean) - doubt, 0.0)).tolist())

    def parts(self) -> Floats:
        """Return what part of the load range each simplex takes, shape (m,)."""
        dimension = self.interpolant.dimension
        if dimension == 0:
            return np.zeros(1)
        return self.interpolant.volumes / 2.0**dimension

    def read(self, simplices: Indices, x: Floats) -> Reading:
        """Return outputs and bars at scaled inputs (k, 3) in the simplices (k,) they lie in."""
        outputs, bars = np.empty((len(x), 4)), np.empty((len(x), 4))
        for start in range(0, len(x), CHUNK):  # what is gathered for one chunk fits the cache
            part = slice(start, start + CHUNK)
            outputs[part], bars[part] = self._read_part(simplices[part], x[part])
        return Reading(outputs, bars)

    def _read_part(self, simplices: Indices, x: Floats) -> tuple[Floats, Floats]:
        apart = x - self.interpolant.anchors.take(simplices, axis=0)
        terms = np.concatenate((apart, np.ones((len(x), 1))), axis=1)
        told = np.einsum("kij,kj->ki", self.pieces.take(simplices, axis=0), terms)
        bubble = told[:, 12] - np.einsum("ki,ki->k", apart, apart)
        return told[:, :4], np.abs(told[:, 4:8] + told[:, 8:12] * bubble[:, None])
