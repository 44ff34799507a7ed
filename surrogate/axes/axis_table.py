"""The table of an axis: triangulation, values and slopes at its points.

It has no error bars of its own: those of answers by the axes are their distance from the kriging's
answers, and the kriging's error bars.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..table.axes import AxisRows
from ..table.rows import Floats, LoadRange
from .triangulation import Indices, Triangulation, recovered_slopes


@dataclass(frozen=True)
class AxisResult:
    """An axis' answers at k points: all six outputs.

    Attributes
    ----------
    outputs : ndarray, shape (k, 6), m and rad
    simplices : ndarray of int, shape (k,)
        Where the points, or the nearest points of the hull, lie.
    inside : ndarray of bool, shape (k,)
        Whether the hull holds the point. Elsewhere the outputs are those at the hull's nearest
        point and the step from there.
    at : ndarray, shape (k, 3), dimensionless
        The points, or those of the hull.
    """

    outputs: Floats
    simplices: Indices
    inside: NDArray[np.bool_]
    at: Floats


class AxisTable:
    """The rows of an axis, triangulated.

    Attributes
    ----------
    rows : AxisRows
    triangulation : Triangulation
        Over the scaled inputs.
    scale : ndarray, shape (3,), N and N·m
        What the inputs are divided by.
    values : ndarray, shape (n, 6), m and rad
        Displacements at the points.
    slopes : ndarray, shape (n, 6, 3), m and rad
        Derivative by the scaled inputs: stored tangents, else recovered from neighbours.
    """

    def __init__(self, rows: AxisRows, load_range: LoadRange) -> None:
        """Triangulate the rows, at least one."""
        self.rows, self.axis = rows, rows.axis
        self.scale = load_range.scale[list(rows.axis.inputs)]
        self.triangulation = Triangulation(rows.points)
        self.values = rows.displacement
        stored = np.isfinite(rows.tangent)
        self.slopes = rows.tangent
        if not stored.all():
            recovered = recovered_slopes(self.triangulation, self.values)
            self.slopes = np.where(stored, rows.tangent, recovered)

    def of(self, rows: AxisRows) -> AxisTable:
        """Return this table for rows of the same numbers, which may have other indices."""
        table = copy(self)
        table.rows = rows
        return table

    def fractions(self) -> Floats:
        """Return the fraction of the load range that each simplex takes, shape (m,)."""
        dimension = self.triangulation.dimension
        if dimension == 0:
            return np.zeros(1)
        return self.triangulation.volumes / 2.0**dimension

    def read(self, x: Floats) -> AxisResult:
        """Return the axis' answers at scaled inputs, inside its hull or not.

        The inputs have shape (k, 3), dimensionless.
        """
        simplices = self.triangulation.locate(x)
        inside = simplices >= 0
        if inside.all():
            return self.read_in(simplices, x)
        at = x.copy()
        at[~inside], simplices[~inside] = self.triangulation.nearest_on_hull(x[~inside])
        result = self.read_in(simplices, at)
        # Slopes blended from the vertices are continuous along the hull; those of simplices jump.
        weights = self.triangulation.barycentric(simplices[~inside], at[~inside])
        corners = self.slopes[self.triangulation.simplices[simplices[~inside]]]
        slopes = self.along_span(np.einsum("kv,kvqi->kqi", weights, corners))
        result.outputs[~inside] += np.einsum("kqi,ki->kq", slopes, (x - at)[~inside])
        return replace(result, inside=inside)

    def along_span(self, slopes: Floats) -> Floats:
        """Return slopes (k, 6, 3) by the scaled loads, projected on the span of the points."""
        basis = self.triangulation.basis
        return slopes if len(basis) == 3 else slopes @ basis.T @ basis

    def read_in(self, simplices: Indices, x: Floats) -> AxisResult:
        """Return the same at points of the simplices that they lie in.

        Shapes (k, 3), dimensionless, and (k,).
        """
        weights = self.triangulation.barycentric(simplices, x)
        corners = self.values[self.triangulation.simplices[simplices]]
        outputs = np.einsum("kv,kvq->kq", weights, corners)
        return AxisResult(outputs, simplices, np.ones(len(x), dtype=bool), x)


def axis_table(rows: AxisRows, load_range: LoadRange, before: AxisTable | None) -> AxisTable:
    """Return the table of an axis' rows, at least one.

    Parameters
    ----------
    before : AxisTable or None
        Of another version: taken over where it was made of the same numbers, the only
        input.
    """
    scale = load_range.scale[list(rows.axis.inputs)]
    usable = before is not None and np.array_equal(before.scale, scale)
    if before is None or not usable or not rows.equals(before.rows):
        before = AxisTable(rows, load_range)
    return before.of(rows)
