"""Cells of an isotropic or orthotropic St. Venant-Kirchhoff material.

With F = I + H, E = sym H + H^T H / 2, S = lambda tr(E) I + 2 mu E and g_a = F dN_a/dX the tangent
of isotropic cells is

    K_ia,kb = lambda g_ia g_kb + mu g_ka g_ib + mu (F F^T)_ik dN_a . dN_b + delta_ik dN_a . S dN_b

(integrated), which costs a third of B^T D B.

Cells of a nearly incompressible material have `volume_modes`
(`fea.element.pressure_projection`): tr(E) in the energy is then its projection onto them.

Orthotropic cells have S = C : E with nine constants in material directions, which at large
rotations rotate with the material, since E and S stand in the undeformed axes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from wrenchbook.fea.element.cell_state import UNIT_STRAINS, CellState, DenseState, Which
from wrenchbook.fea.element.cell_stiffness import CellStiffness
from wrenchbook.fea.tensors import COLUMNS, ROWS


@dataclass(frozen=True, eq=False)
class IsotropicStiffness(CellStiffness):
    """Isotropic cells of one block."""

    first_lame: np.ndarray  # shape (cells,), Pa: lambda
    shear: np.ndarray  # shape (cells,), Pa: mu
    # Shape (cells, points, modes), m^1.5: orthonormal functions, times the weights, onto which the
    # volumetric strain is projected; None without projection.
    volume_modes: np.ndarray | None = None

    @property
    def projected(self) -> bool:
        """Whether the volumetric strain is projected."""
        return self.volume_modes is not None

    def state(self, part: Which, displacement: np.ndarray | None) -> CellState:
        """Return strains and stresses; `displacement` has shape (cells, 3, nodes), m."""
        return _IsotropicState(self, part, displacement)

    def stretched(self, stretch: np.ndarray) -> IsotropicStiffness:
        """Return the cells after a stress-free stretch (cells, 3, 3), equal in all directions."""
        factor = stretch[:, 0, 0]
        return replace(self, first_lame=self.first_lame / factor, shear=self.shear / factor)

    def modes_of(self, part: Which) -> np.ndarray | None:
        """Return the volume modes of a few cells, shape (cells, points, modes), m^1.5, or None."""
        return None if self.volume_modes is None else self.volume_modes[part]


class _IsotropicState(CellState):
    """Strains and stresses of a few isotropic cells at one displacement; None: undeformed."""

    def __init__(
        self, cells: IsotropicStiffness, part: Which, displacement: np.ndarray | None
    ) -> None:
        super().__init__(cells.gradients, part, displacement, cells.thermal_strain(part))
        self.first_lame = cells.first_lame[part, None]
        self.shear = cells.shear[part, None]
        self.modes = cells.modes_of(part)
        if displacement is not None:
            self.wS = self.weighted_change(self.elastic(self.E))

    def weighted_change(self, strain: np.ndarray) -> np.ndarray:
        trace = np.trace(strain, axis1=-2, axis2=-1)
        volumetric = self.first_lame * weighted(trace, self.weights, self.modes)
        shear = 2 * self.weights * self.shear
        return volumetric[..., None, None] * np.eye(3) + shear[..., None, None] * strain

    def tangent(self, out: np.ndarray) -> None:
        cells, points, _, nodes = self.slopes.shape
        size = 3 * nodes
        g = (self.slopes if self.undeformed else self.F @ self.slopes).reshape(cells, points, size)
        K = out.reshape(cells, 3, nodes, 3, nodes)
        gram = ((g * self.weights[..., None]).swapaxes(1, 2) @ g).reshape(K.shape)
        volumetric = gram if self.modes is None else projected_gram(self.modes, g).reshape(K.shape)
        np.multiply(volumetric, self.first_lame[..., None, None, None], out=K)
        gram *= self.shear[..., None, None, None]
        K += gram.swapaxes(1, 3)
        K += self._shear_and_stress().transpose(0, 1, 3, 2, 4)

    def _shear_and_stress(self) -> np.ndarray:
        """Integrate mu (F F^T)_ik dN_a . dN_b + delta_ik dN_a . S dN_b as (cells, i, k, a, b)."""
        cells, points, _, nodes = self.slopes.shape
        stacked = self.slopes.reshape(cells, 3 * points, nodes)
        weights = self.weights * self.shear
        if self.undeformed:
            scaled = stacked * np.repeat(weights, 3, axis=1)[..., None]
            gram = scaled.swapaxes(1, 2) @ stacked
            return np.eye(3)[None, :, :, None, None] * gram[:, None, None]
        products = (self.slopes.swapaxes(2, 3) @ self.slopes).reshape(cells, points, nodes**2)
        stretch = self.F @ self.F.swapaxes(2, 3) * weights[..., None, None]
        total = stretch.reshape(cells, points, 9).swapaxes(1, 2) @ products
        total = total.reshape(cells, 3, 3, nodes, nodes)
        geometric = self.geometric_stiffness()
        for axis in range(3):
            total[:, axis, axis] += geometric
        return total


def weighted(trace: np.ndarray, weights: np.ndarray, modes: np.ndarray | None) -> np.ndarray:
    """Return weights times the trace, or its projection, m^3: shape (..., cells, points)."""
    if modes is None:
        return weights * trace
    coefficients = modes.swapaxes(1, 2) @ trace[..., None]
    return (modes @ coefficients)[..., 0]


def projected_gram(modes: np.ndarray, g: np.ndarray) -> np.ndarray:
    """Integrate the products of the projected volumetric strains of unit displacements.

    Shapes (cells, points, modes), m^1.5, and (cells, points, size), 1/m: (cells, size, size), m.
    """
    coefficients = modes.swapaxes(1, 2) @ g
    return coefficients.swapaxes(1, 2) @ coefficients


# Factors of xx, yy, zz, xy, xz, yz: the elasticity takes the shears 2 E_ij (Voigt).
_VOIGT = (1.0, 1.0, 1.0, 2.0, 2.0, 2.0)
_SQUARE = (0, 3, 4, 3, 1, 5, 4, 5, 2)  # indices of these in the nine entries of a tensor


@dataclass(frozen=True, eq=False)
class OrthotropicStiffness(CellStiffness):
    """Orthotropic cells of one block."""

    # Shape (cells, points or 1, 6, 6), Pa: stresses (xx, yy, zz, xy, xz, yz) by strains, the shears
    # 2 E_ij, in the axes of the mesh.
    elasticity: np.ndarray

    def state(self, part: Which, displacement: np.ndarray | None) -> CellState:
        """Return strains and stresses; `displacement` has shape (cells, 3, nodes), m."""
        return _OrthotropicState(self, part, displacement)

    def stretched(self, stretch: np.ndarray) -> OrthotropicStiffness:
        """Return the cells after a stress-free stretch, shape (cells, 3, 3)."""
        inverse = np.linalg.inv(stretch)[:, None]
        strains = ((inverse @ UNIT_STRAINS @ inverse)[..., ROWS, COLUMNS] * _VOIGT)[:, None]
        elasticity = strains @ self.elasticity @ strains.swapaxes(2, 3)
        return replace(self, elasticity=np.linalg.det(stretch)[:, None, None, None] * elasticity)


class _OrthotropicState(DenseState):
    """Strains and stresses of a few orthotropic cells at one displacement; None: undeformed."""

    def __init__(self, cells: OrthotropicStiffness, part: Which, displacement: np.ndarray | None):
        super().__init__(cells.gradients, part, displacement, cells.thermal_strain(part))
        self._moduli = cells.elasticity[part] * self.weights[..., None, None]
        if displacement is not None:
            self.wS = self.weighted_change(self.elastic(self.E))

    def weighted_change(self, strain: np.ndarray) -> np.ndarray:
        return _stress(self._moduli, strain)

    def moduli(self) -> np.ndarray:
        return self._moduli


def turned_elasticity(elasticity: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Return an elasticity in other axes, shape (..., 6, 6), Pa.

    elasticity: shape (6, 6), Pa: in the material's directions, as in `OrthotropicStiffness`.
    directions: shape (..., 3, 3): row i is the material's direction i in the target axes.
    """
    turn = directions[..., None, :, :]
    back = turn.swapaxes(-1, -2)
    stresses = back @ _stress(elasticity, turn @ UNIT_STRAINS @ back) @ turn
    return np.ascontiguousarray(stresses[..., ROWS, COLUMNS].swapaxes(-1, -2))


def _stress(elasticity: np.ndarray, strain: np.ndarray) -> np.ndarray:
    """Return S = C : E, Pa, of C (..., 6, 6), Pa, and E (..., 3, 3)."""
    six = strain[..., ROWS, COLUMNS] * _VOIGT
    stress = (elasticity @ six[..., None])[..., 0]
    return stress[..., _SQUARE].reshape(strain.shape)
