"""One axis ready to answer: its triangulation and what each of its points knows."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..bars.conformal import conformal_factor
from ..interpolation.delaunay import Indices, Triangulation
from ..interpolation.local_bars import local_bars
from ..interpolation.slope_recovery import fit_patches, mean_slopes
from ..interpolation.walk import DEGENERATE
from ..table.axes import AxisRows
from ..table.rows import Floats, LoadRange

# The largest fraction of the load range, by dimension, that one simplex may take before it is
# `thin`: half a range along a line, a fifth of a rectangle, a tenth of a box is no table.
LARGEST = {0: 1.0, 1: 0.4, 2: 0.2, 3: 0.1}

MOST_CHECKED = 2000  # points left out that check the bars: their 95 % quantile is known to 1 %

SOUND, WEAK = 0, 1


@dataclass(frozen=True)
class AxisReading:
    """What an axis answers at k points: all six outputs, of which four are its own.

    Attributes
    ----------
    outputs, bends, rest : ndarray, shape (k, 6), m and rad
        Barycentric outputs; the bends, which are the error to be expected of them with its sign;
        and the rest of the error bars, which may come on top.
    slopes, bend_slopes : ndarray, shape (k, 6, 3), m and rad
        Derivatives of the outputs and of the bends by the scaled inputs.
    simplices : ndarray of int, shape (k,)
        Where the points, or the nearest points of the hull, lie.
    inside : ndarray of bool, shape (k,)
        Whether the hull holds the point. Elsewhere the outputs are those at the hull's nearest
        point and their slopes from there.
    at : ndarray, shape (k, 3), dimensionless
        The points, or those of the hull.
    """

    outputs: Floats
    bends: Floats
    rest: Floats
    slopes: Floats
    bend_slopes: Floats
    simplices: Indices
    inside: NDArray[np.bool_]
    at: Floats


class AxisTable:
    """The rows of one axis, triangulated.

    Attributes
    ----------
    rows : AxisRows
    triangulation : Triangulation
        Over the scaled inputs.
    scale : ndarray, shape (3,), N and N·m
        What the inputs are divided by.
    values : ndarray, shape (n, 6), m and rad
    slopes : ndarray, shape (n, 6, 3), m and rad
        Derivative by the scaled inputs: stored tangents, else recovered from neighbours.
    given : int
        Points there were to choose from: more than n where the table was thinned.
    rest, own_rest : ndarray, shape (n, 6), m and rad
        Error bar of the outputs with their bends, given at the points (`local_bars`), and as it
        was before points that were left out had their say.
    state : ndarray of int, shape (m,)
        `SOUND`, `WEAK` or `DEGENERATE`, per simplex.
    fewest : int
        How many points the axis needs not to be thin.
    """

    def __init__(self, rows: AxisRows, load_range: LoadRange) -> None:
        """Triangulate the rows, at least one."""
        self.rows, self.axis = rows, rows.axis
        self.scale = load_range.scale[list(rows.axis.inputs)]
        self.triangulation = Triangulation(rows.points)
        self.values = rows.displacement
        self.fewest = 2 * (self.triangulation.dimension + 1)
        patches = fit_patches(self.triangulation, self.values)
        self.slopes = self._slopes(patches.slopes)
        bars = local_bars(self.triangulation, self.values, patches.misses)
        self.rest = self.own_rest = bars + rows.uncertainty
        self.given = len(self.values)
        self.state = self._state()

    @property
    def enough(self) -> bool:
        """Whether there are points enough to tell an error."""
        return len(self.values) >= self.fewest

    def is_made_like(self, other: AxisTable) -> bool:
        """Return whether one was taken over from the other: they differ in nothing they answer."""
        return self.triangulation is other.triangulation and self.rest is other.rest

    def held_to(self, left: AxisRows) -> AxisTable:
        """Return this table, its bars widened to hold points that are not in it, at least one."""
        some = np.linspace(0, len(left.points) - 1, MOST_CHECKED).astype(np.intp)
        some = np.unique(some)
        reading = self.read(left.points[some])
        errors = np.abs(reading.outputs + reading.bends - left.displacement[some])
        factor = conformal_factor(errors[reading.inside], reading.rest[reading.inside])
        held = copy(self)
        held.given = len(self.values) + len(left.points)
        held.rest = self.own_rest * np.maximum(factor, 1.0)
        return held

    def fractions(self) -> Floats:
        """Return what fraction of the load range each simplex takes, shape (m,)."""
        dimension = self.triangulation.dimension
        if dimension == 0:
            return np.zeros(1)
        return self.triangulation.volumes / 2.0**dimension

    def read(self, x: Floats) -> AxisReading:
        """Return what the axis answers at scaled inputs, inside its hull or not.

        The inputs have shape (k, 3), dimensionless.
        """
        found = self.triangulation.locate(x)
        inside = found >= 0
        if inside.all():
            return self.read_in(found, x)
        at = x.copy()
        at[~inside], found[~inside] = self.triangulation.nearest_on_hull(x[~inside])
        reading = self.read_in(found, at)
        # Slopes blended from the vertices are continuous along the hull; those of simplices jump.
        shares = self.triangulation.barycentric(found[~inside], at[~inside])
        corners = self.slopes[self.triangulation.simplices[found[~inside]]]
        slopes = np.einsum("kv,kvqi->kqi", shares, corners)
        reading.slopes[~inside], reading.bend_slopes[~inside] = slopes, 0.0
        reading.outputs[~inside] += np.einsum("kqi,ki->kq", slopes, (x - at)[~inside])
        return replace(reading, inside=inside)

    def read_in(self, simplices: Indices, x: Floats) -> AxisReading:
        """Return the same at points of the simplices that they lie in.

        Shapes (k, 3), dimensionless, and (k,).
        """
        shape, vertices = self.triangulation, self.triangulation.simplices[simplices]
        shares = shape.barycentric(simplices, x)
        outputs = np.einsum("kv,kvq->kq", shares, self.values[vertices])
        apart = x[:, None] - shape.points[vertices]
        rises = 0.5 * np.einsum("kvqi,kvi->kvq", self.slopes[vertices], apart)
        bends = np.einsum("kv,kvq->kq", shares, rises)
        bend_slopes = np.einsum("kvi,kvq->kqi", shape.share_slopes(simplices), rises)
        bend_slopes += 0.5 * np.einsum("kv,kvqi->kqi", shares, self.slopes[vertices])
        rest = np.einsum("kv,kvq->kq", shares, self.rest[vertices])
        slopes = shape.gradients_at(simplices, self.values)
        inside = np.ones(len(x), dtype=bool)
        return AxisReading(outputs, bends, rest, slopes, bend_slopes, simplices, inside, x)

    def _slopes(self, recovered: Floats) -> Floats:
        """Return the rows' own tangents, else recovered slopes, else the mean of what is around."""
        slopes = recovered
        if np.isnan(recovered).any():
            slopes = mean_slopes(self.triangulation, self.values)
        told = np.isfinite(self.rows.tangent)
        return np.where(told, self.rows.tangent, slopes)

    def _state(self) -> NDArray[np.int32]:
        large = self.fractions() > LARGEST[self.triangulation.dimension]
        state = np.where(large | (not self.enough), WEAK, SOUND)
        state[self.triangulation.degenerate] = DEGENERATE
        return state.astype(np.int32)


def axis_table(rows: AxisRows, load_range: LoadRange, before: AxisTable | None) -> AxisTable:
    """Return the table of an axis' rows, at least one.

    Parameters
    ----------
    before : AxisTable or None
        Of another version: taken over where it was made of the same numbers, since nothing else
        has a say in it.
    """
    scale = load_range.scale[list(rows.axis.inputs)]
    if before is None or not np.array_equal(before.scale, scale) or not rows.equals(before.rows):
        return AxisTable(rows, load_range)
    same = copy(before)
    same.rows = rows  # the rows behind a point may have other places
    same.rest, same.given = same.own_rest, len(same.values)
    return same
