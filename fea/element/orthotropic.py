"""Cells of an orthotropic material: S = C : E with nine constants in directions of its own.

The law of isotropic cells (St. Venant-Kirchhoff) with another C; at large rotations the directions
rotate with the material, since E and S stand in the undeformed axes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from wrenchbook.fea.element.cell_state import (
    COLUMNS,
    ROWS,
    UNIT_STRAINS,
    CellState,
    DenseState,
    Which,
)
from wrenchbook.fea.element.cell_stiffness import CellStiffness

Array = np.ndarray

_SHEARS_TWICE = (1.0, 1.0, 1.0, 2.0, 2.0, 2.0)


@dataclass(frozen=True, eq=False)
class OrthotropicStiffness(CellStiffness):
    """Orthotropic cells of one block."""

    # Shape (cells, points or 1, 6, 6), Pa: stresses (xx, yy, zz, xy, xz, yz) by strains, the shears
    # 2 E_ij, in the axes of the mesh.
    elasticity: Array

    def state(self, part: Which, displacement: Array | None) -> CellState:
        """Return strains and stresses, displacements of shape (cells, 3, nodes), m."""
        return _State(self, part, displacement)

    def stretched(self, stretch: Array) -> OrthotropicStiffness:
        """Return the cells after a stretch without stress, shape (cells, 3, 3)."""
        inverse = np.linalg.inv(stretch)[:, None]
        strains = (inverse @ UNIT_STRAINS @ inverse)[..., ROWS, COLUMNS] * _SHEARS_TWICE
        strains = strains[:, None]
        elasticity = strains @ self.elasticity @ strains.swapaxes(2, 3)
        return replace(self, elasticity=np.linalg.det(stretch)[:, None, None, None] * elasticity)

    def small_stress(self, strain: Array, part: Which) -> Array:
        """Return weighted stresses, Pa times m^3, of strains: shape (k, cells, points, 3, 3)."""
        return _stress(self._weighted(part), strain)

    def _weighted(self, part: Which) -> Array:
        """Return elasticities times weights, shape (cells, points, 6, 6), Pa times m^3."""
        return self.elasticity[part] * self.gradients.weights[part][..., None, None]


class _State(DenseState):
    def __init__(self, cells: OrthotropicStiffness, part: Which, displacement: Array | None):
        super().__init__(cells.gradients, part, displacement, cells.thermal_strain(part))
        self._moduli = cells._weighted(part)
        if displacement is not None:
            self.wS = self.weighted_change(self.elastic(self.E))

    def weighted_change(self, strain: Array) -> Array:
        return _stress(self._moduli, strain)

    def moduli(self) -> Array:
        return self._moduli

    def energy(self) -> float:
        return 0.5 * float(np.vdot(self.wS, self.elastic(self.E)))


def turned_elasticity(elasticity: Array, directions: Array) -> Array:
    """Return an elasticity in other axes.

    elasticity: shape (6, 6), Pa: in the material's own directions, as in `OrthotropicStiffness`.
    directions: shape (..., 3, 3): row i is the material's direction i in the target axes.
    Result: shape (..., 6, 6), Pa.
    """
    rows = directions[..., None, :, :]
    stresses = _stress(elasticity, rows @ UNIT_STRAINS @ rows.swapaxes(-1, -2))
    back = rows.swapaxes(-1, -2) @ stresses @ rows
    return np.ascontiguousarray(back[..., ROWS, COLUMNS].swapaxes(-1, -2))


def _stress(elasticity: Array, strain: Array) -> Array:
    """Return C : E, shapes (..., 6, 6) and (..., 3, 3)."""
    six = strain[..., ROWS, COLUMNS] * _SHEARS_TWICE
    stress = (elasticity @ six[..., None])[..., 0]
    return stress[..., (0, 3, 4, 3, 1, 5, 4, 5, 2)].reshape(strain.shape)
