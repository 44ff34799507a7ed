"""The table of an axis: triangulation, values and slopes at its points.

It has no error bars of its own: the error bar of an answer by the axes is its distance from the
kriging's answer plus the kriging's error bar.
"""

from __future__ import annotations

from copy import copy

import numpy as np

from ..table.axes import AxisRows
from ..table.rows import Floats, LoadRange
from .triangulation import Indices, Triangulation, recovered_slopes


class AxisTable:
    """The rows of an axis, triangulated.

    `triangulation`: over the scaled inputs.
    `scale` (3,), N and N·m: divisors of the inputs.
    `values` (n, 6), m and rad: displacements at the points.
    `slopes` (n, 6, 3), m and rad: derivatives by the scaled inputs, from stored tangents, else from
    a quadratic through neighbours.
    """

    def __init__(self, rows: AxisRows, load_range: LoadRange) -> None:
        """Triangulate the rows, at least one."""
        self.rows = rows
        self.axis = rows.axis
        self.scale = load_range.scale[list(rows.axis.inputs)]
        self.triangulation = Triangulation(rows.points)
        self.values = rows.displacement
        stored = np.isfinite(rows.tangent)
        self.slopes = rows.tangent
        if not stored.all():
            recovered = recovered_slopes(self.triangulation, self.values)
            self.slopes = np.where(stored, rows.tangent, recovered)

    def of(self, rows: AxisRows) -> AxisTable:
        """Return this table with the row indices of `rows`, whose numbers are the same."""
        table = copy(self)
        table.rows = rows
        return table

    def fractions(self) -> Floats:
        """Return the fraction of the load range that each simplex takes, shape (m,)."""
        dimension = self.triangulation.dimension
        return np.zeros(1) if dimension == 0 else self.triangulation.volumes / 2.0**dimension

    def interpolate(self, simplices: Indices, x: Floats) -> Floats:
        """Return the outputs (k, 6), m and rad, at scaled inputs x (k, 3) in simplices (k,)."""
        weights = self.triangulation.barycentric(simplices, x)
        corners = self.values[self.triangulation.simplices[simplices]]
        return np.einsum("kv,kvq->kq", weights, corners)


def axis_table(rows: AxisRows, load_range: LoadRange, earlier: AxisTable | None) -> AxisTable:
    """Return the table of an axis' rows, at least one.

    `earlier`: the table of another version, which is reused if its points, values and slopes are
    equal.
    """
    scale = load_range.scale[list(rows.axis.inputs)]
    is_same = earlier is not None and np.array_equal(earlier.scale, scale)
    if earlier is not None and is_same and rows.equals(earlier.rows):
        return earlier.of(rows)
    return AxisTable(rows, load_range)
