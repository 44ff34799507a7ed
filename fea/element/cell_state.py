"""Strains and stresses of a few cells at one displacement, whatever their material."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from wrenchbook.fea.mesh.mapping import Gradients
from wrenchbook.fea.tensors import COLUMNS, ROWS

Which = slice | np.ndarray
"""Cells of a block: a slice, or their indices."""


class CellState(ABC):
    """Strains and stresses of a few cells at one displacement.

    slopes, weights: of the cells, as in `Gradients`.
    H, F, E: shape (cells, points, 3, 3): gradient of the displacement, deformation gradient and
    Green-Lagrange strain. The strain is never computed as (F^T F - I)/2: at small loads that loses
    every digit to roundoff.
    wS: same shape, Pa times m^3: the second Piola-Kirchhoff stress times the weights.
    thermal: shape (cells, 1, 3, 3): the thermal strain, a part of E without stress; None without.
    """

    def __init__(
        self,
        gradients: Gradients,
        part: Which,
        displacement: np.ndarray | None,
        thermal: np.ndarray | None = None,
    ) -> None:
        self.wS: np.ndarray
        self.thermal = thermal
        self.slopes = gradients.slopes[part]
        self.weights = gradients.weights[part]
        self.undeformed = displacement is None
        if displacement is not None:
            self.H = self.gradient(displacement)
            self.F = self.H + np.eye(3)
            self.E = green_strain(self.H)

    def gradient(self, displacement: np.ndarray) -> np.ndarray:
        """Return the gradients of a field, shape (cells, 3, nodes), m, at the points."""
        return displacement[:, None] @ self.slopes.swapaxes(2, 3)

    def extrapolate(self, step: np.ndarray) -> None:
        """Replace the stress by its linear extrapolation from the state one step before.

        This method holds for a law whose stress is linear in E, which is quadratic in the
        displacement. `step` has shape (2, cells, 3, nodes), m: see
        `fea.assembly.body.ElasticBody.tangent`.
        """
        aim, change = (self.gradient(field) for field in step)
        E = green_strain(aim) - 0.5 * (change.swapaxes(2, 3) @ change)
        self.wS = self.weighted_change(self.elastic(E))

    def elastic(self, strain: np.ndarray) -> np.ndarray:
        """Return strains less the thermal ones, shape (cells, points, 3, 3), dimensionless."""
        return strain if self.thermal is None else strain - self.thermal

    @abstractmethod
    def weighted_change(self, strain: np.ndarray) -> np.ndarray:
        """Return the change of `wS`, Pa m^3, with E, both of shape (..., cells, points, 3, 3)."""

    def energy(self) -> float:
        """Return the strain energy, J; this method holds for a law whose stress is linear in E."""
        return 0.5 * float(np.vdot(self.wS, self.elastic(self.E)))

    @abstractmethod
    def tangent(self, out: np.ndarray) -> None:
        """Write the tangent stiffness, shape (cells, size, size), N/m."""

    def changes(self, fields: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the changes by fields, m, shape (k, cells, 3, nodes).

        All fields' 3x3 matrices are stacked, so that each product is computed at once.

        Returns dF: shape (cells, points, 3 k, 3): the deformation gradient, dimensionless. dE, wdS:
        shape (k, cells, points, 3, 3): the strain, dimensionless, and `wS`, Pa times m^3.
        """
        cells = len(self.slopes)
        count = len(fields)
        below = fields.swapaxes(0, 1).reshape(cells, 1, 3 * count, fields.shape[3])
        dF = below @ self.slopes.swapaxes(2, 3)
        half = _each_transposed(dF) @ self.F
        strain = 0.5 * (half + _each_transposed(half))
        dE = np.moveaxis(strain.reshape(*self.F.shape[:2], count, 3, 3), 2, 0)
        return dF, dE, self.weighted_change(dE)

    def second(self, fields: np.ndarray) -> np.ndarray:
        """Return the energy's second derivatives along fields, (k, cells, 3, nodes), m: (k, k), J.

        They are the integral of E_a : C : E_b + S : E_ab, see `third`.
        """
        dF, dE, wdS = self.changes(fields)
        along = dE.reshape(len(fields), -1) @ wdS.reshape(len(fields), -1).T
        return along + _by_field(dF) @ _by_field(dF @ self.wS).T

    def third(self, fields: np.ndarray) -> np.ndarray:
        """Return the energy's third derivatives along k fields: (k, k, k), J.

        The fields have shape (k, cells, 3, nodes), m. With E_a = sym(F^T grad a) and
        E_ab = sym(grad a^T grad b) the derivatives are the integral of
        E_ab : C : E_c + E_bc : C : E_a + E_ca : C : E_b, and of the law's part.
        """
        dF, dE, wdS = self.changes(fields)
        rows = _by_field(dF)
        products = [_by_field(dF @ stress) @ rows.T for stress in wdS]  # grad a (C : E_c) : grad b
        return symmetrised(np.stack(products, axis=2)) + self.third_of_law(fields, dE)

    def third_of_law(self, fields: np.ndarray, strain: np.ndarray) -> np.ndarray:
        """Return the addition of C's change to `third`, J: shape (k, k, k), or 0 for a constant C.

        `strain` has shape (k, cells, points, 3, 3), dimensionless: the strains of the fields.
        """
        return np.zeros((len(fields),) * 3)

    def cauchy(self, fields: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return Cauchy stresses, Pa, and their changes with fields, m, shape (k, ...)."""
        F_T = self.F.swapaxes(2, 3)
        shape = (*self.F.shape[:2], len(fields))
        scale = (1.0 / (np.linalg.det(self.F) * self.weights))[..., None, None]
        stress = self.F @ self.wS @ F_T * scale
        dF, _, changes = self.changes(fields)
        wdS = np.moveaxis(changes, 0, 2)
        FdS = _each_transposed(wdS.reshape(dF.shape) @ F_T)
        half = (dF @ self.wS + 0.5 * FdS) @ F_T
        growth = dF.reshape(*shape, 9) @ np.linalg.inv(F_T).reshape(*shape[:2], 9, 1)
        changes = ((half + _each_transposed(half)) * scale).reshape(*shape, 3, 3)
        changes -= stress[:, :, None] * growth[..., None]
        return stress, np.moveaxis(changes, 2, 0)

    def forces(self) -> np.ndarray:
        """Integrate P_iJ dN_a/dX_J, shape (cells, 3, nodes), N."""
        P = self.F @ self.wS
        cells, points, _, nodes = self.slopes.shape
        stacked = P.transpose(0, 2, 1, 3).reshape(cells, 3, 3 * points)
        return stacked @ self.slopes.reshape(cells, 3 * points, nodes)

    def geometric_stiffness(self) -> np.ndarray:
        """Integrate dN_a . S dN_b, shape (cells, nodes, nodes), N/m: the geometric stiffness."""
        cells, points, _, nodes = self.slopes.shape
        below = self.slopes.reshape(cells, 3 * points, nodes)
        return below.swapaxes(1, 2) @ (self.wS @ self.slopes).reshape(cells, 3 * points, nodes)


def green_strain(H: np.ndarray) -> np.ndarray:
    """Return sym H + H^T H / 2 for displacement gradients H, shape (..., 3, 3), dimensionless."""
    return 0.5 * (H + H.swapaxes(-1, -2) + H.swapaxes(-1, -2) @ H)


def symmetrised(product: np.ndarray) -> np.ndarray:
    """Sum products symmetric in their first two indices over the positions of the third: (k, k, k).

    The result has the unit of the products.
    """
    return product + product.swapaxes(1, 2) + product.swapaxes(0, 2)


def _each_transposed(below: np.ndarray) -> np.ndarray:
    """Transpose each of the stacked 3x3 matrices: (..., 3 k, 3)."""
    each = below.reshape(*below.shape[:2], below.shape[2] // 3, 3, 3)
    return each.swapaxes(3, 4).reshape(below.shape)


def _by_field(below: np.ndarray) -> np.ndarray:
    """Return stacked 3x3 matrices, (..., 3 k, 3), by field: (k, m)."""
    each = below.reshape(-1, below.shape[-2] // 3, 9)
    return np.ascontiguousarray(each.swapaxes(0, 1)).reshape(each.shape[1], -1)


UNIT_STRAINS = np.zeros((6, 3, 3))
"""The six unit strains; shears are 2 E_ij."""
UNIT_STRAINS[range(6), ROWS, COLUMNS] += 0.5
UNIT_STRAINS[range(6), COLUMNS, ROWS] += 0.5


class DenseState(CellState):
    """Strains and stresses of a few cells of a general material, with complete 6x6 moduli."""

    @abstractmethod
    def moduli(self) -> np.ndarray:
        """Return the change of `wS` with E, shape (cells, points, 6, 6), Pa times m^3."""

    def tangent(self, out: np.ndarray) -> None:
        """Write the tangent stiffness, shape (cells, size, size), N/m."""
        cells, points, _, nodes = self.slopes.shape
        B = self._strains_of_unknowns()
        below = B.reshape(cells, 6 * points, 3 * nodes)
        stress = (self.moduli() @ B).reshape(below.shape)
        np.matmul(below.swapaxes(1, 2), stress, out=out)
        if not self.undeformed:
            K = out.reshape(cells, 3, nodes, 3, nodes)
            geometric = self.geometric_stiffness()
            for axis in range(3):
                K[:, axis, :, axis] += geometric

    def _strains_of_unknowns(self) -> np.ndarray:
        """Return the six strains of each unit displacement, shape (cells, points, 6, size)."""
        cells, points, _, nodes = self.slopes.shape
        F = np.broadcast_to(np.eye(3), (cells, points, 3, 3)) if self.undeformed else self.F
        B = np.empty((cells, points, 6, 3, nodes))
        for number, (i, j) in enumerate(zip(ROWS, COLUMNS, strict=True)):
            B[:, :, number] = F[..., i, None] * self.slopes[:, :, None, j]
            if i != j:
                B[:, :, number] += F[..., j, None] * self.slopes[:, :, None, i]
        return B.reshape(cells, points, 6, 3 * nodes)
