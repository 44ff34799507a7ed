"""Tangents of any material from its 6x6 moduli: B^T D B and the geometric stiffness."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from wrenchbook.fea.element.cell_state import CellState

Array = np.ndarray

ROWS, COLUMNS = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
"""Of the six numbers of a symmetric 3x3 matrix: xx, yy, zz, xy, xz, yz."""

UNIT_STRAINS = np.zeros((6, 3, 3))
"""Strains of which one of the six, the shears as 2 E_ij, is one."""
UNIT_STRAINS[range(6), ROWS, COLUMNS] += 0.5
UNIT_STRAINS[range(6), COLUMNS, ROWS] += 0.5


class DenseState(CellState):
    """Strains and stresses of a few cells of a material that has nothing to save by."""

    @abstractmethod
    def moduli(self) -> Array:
        """Return the change of `wS` with E, shape (cells, points, 6, 6), Pa times m^3."""

    def tangent(self, out: Array) -> None:
        """Write the tangent stiffness, shape (cells, size, size), N/m."""
        cells, points, _, nodes = self.slopes.shape
        B = self._strains_of_unknowns()
        below = B.reshape(cells, 6 * points, 3 * nodes)
        stress = (self.moduli() @ B).reshape(below.shape)
        np.matmul(below.swapaxes(1, 2), stress, out=out)
        if not self.undeformed:
            K, geometric = out.reshape(cells, 3, nodes, 3, nodes), self.stressed()
            for axis in range(3):
                K[:, axis, :, axis] += geometric

    def _strains_of_unknowns(self) -> Array:
        """Return the six strains of each unit displacement, shape (cells, points, 6, size)."""
        cells, points, _, nodes = self.slopes.shape
        F = np.broadcast_to(np.eye(3), (cells, points, 3, 3)) if self.undeformed else self.F
        B = np.empty((cells, points, 6, 3, nodes))
        for number, (i, j) in enumerate(zip(ROWS, COLUMNS, strict=True)):
            B[:, :, number] = F[..., i, None] * self.slopes[:, :, None, j]
            if i != j:
                B[:, :, number] += F[..., j, None] * self.slopes[:, :, None, i]
        return B.reshape(cells, points, 6, 3 * nodes)
