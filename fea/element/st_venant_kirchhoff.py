"""Internal forces and tangent stiffness of cells: total Lagrangian, St. Venant-Kirchhoff.

The unknowns of a cell are ordered component first, (ux of all nodes, uy of all nodes, uz of all
nodes), which lets both Gram products below run as matrix products without moving anything first.

With F = I + H, E = sym H + H^T H / 2, S = lambda tr(E) I + 2 mu E and g_a = F dN_a/dX the tangent
is

    K_ia,kb = lambda g_ia g_kb + mu g_ka g_ib + mu (F F^T)_ik dN_a . dN_b + delta_ik dN_a . S dN_b

(integrated), which costs a third of B^T D B. The strain is never formed as (F^T F - I)/2: at small
loads that loses every digit to roundoff.

Cells of a nearly incompressible material have `volume_modes`
(`fea.element.pressure_projection`): tr(E) in the energy is then its projection onto them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fea.element.mapping import Gradients

Array = np.ndarray

_CHUNK = 64  # cells at a time: the temporaries of a chunk stay in cache


@dataclass(frozen=True, eq=False)
class Stiffness:
    """Cells of one block with their material.

    Attributes
    ----------
    gradients
        Shape gradients and weights of the cells.
    first_lame, shear
        Shape (cells,), Pa: lambda and mu.
    volume_modes
        Shape (cells, points, modes), m^1.5: orthonormal functions onto which the volumetric
        strain is projected, times the weights; None takes it as it is.
    """

    gradients: Gradients
    first_lame: Array
    shear: Array
    volume_modes: Array | None = None

    @property
    def size(self) -> int:
        """Unknowns of one cell."""
        return 3 * self.gradients.slopes.shape[3]

    def __len__(self) -> int:
        return len(self.first_lame)

    def forces(self, displacement: Array, step: Array | None = None) -> tuple[Array, float, float]:
        """Return the internal forces, the strain energy and the least det F.

        Parameters
        ----------
        displacement
            Shape (cells, 3, nodes), m.
        step
            Shape (2, cells, 3, nodes), m: the last step of Newton's method, see `Body.tangent`;
            None for the forces proper.

        Returns
        -------
        forces
            Shape (cells, 3, nodes), N.
        energy
            J.
        least
            The smallest determinant of the deformation gradient.
        """
        forces = np.empty_like(displacement)
        energy, least = 0.0, np.inf
        for part in self._parts():
            state = _State(self, part, displacement[part])
            if step is not None:
                state.extrapolate(step[:, part])
            forces[part] = state.forces()
            energy += state.energy()
            least = min(least, float(np.linalg.det(state.F).min()))
        return forces, energy, least

    def tangent(self, displacement: Array | None, step: Array | None, out: Array) -> None:
        """Write the tangent stiffness of all cells.

        Parameters
        ----------
        displacement
            Shape (cells, 3, nodes), m; None for the undeformed state.
        step
            Shape (2, cells, 3, nodes), m: the last step of Newton's method, see `Body.tangent`;
            None for the tangent proper.
        out
            Shape (cells, size, size), N/m: written.
        """
        for part in self._parts():
            state = _State(self, part, None if displacement is None else displacement[part])
            if step is not None:
                state.extrapolate(step[:, part])
            state.tangent(out[part])

    def small_strain_forces(self, fields: Array) -> Array:
        """Return the forces of several small displacement fields, by way of their stresses.

        Parameters
        ----------
        fields
            Shape (k, cells, 3, nodes), m.

        Returns
        -------
        Array
            Shape (k, cells, 3, nodes), N.
        """
        forces = np.empty_like(fields)
        for part in self._parts():
            _, stress = self._small_strain(fields[:, part], part)
            slopes = self.gradients.slopes[part]
            cells, points, _, nodes = slopes.shape
            stacked = stress.transpose(0, 1, 3, 2, 4).reshape(len(fields), cells, 3, 3 * points)
            forces[:, part] = stacked @ slopes.reshape(cells, 3 * points, nodes)
        return forces

    def strain_energy_products(self, fields: Array) -> Array:
        """Integrate strain : C : strain for pairs of small displacement fields.

        Parameters
        ----------
        fields
            Shape (k, cells, 3, nodes), m.

        Returns
        -------
        Array
            Shape (k, k), J: twice the mutual strain energy of each pair.
        """
        count = len(fields)
        total = np.zeros((count, count))
        for part in self._parts():
            strain, stress = self._small_strain(fields[:, part], part)
            total += strain.reshape(count, -1) @ stress.reshape(count, -1).T
        return total

    def _small_strain(self, fields: Array, part: slice) -> tuple[Array, Array]:
        """Return strains and weighted stresses, each of shape (k, cells, points, 3, 3)."""
        weights = self.gradients.weights[part]
        H = fields[:, :, None] @ self.gradients.slopes[part].swapaxes(2, 3)
        strain = 0.5 * (H + H.swapaxes(3, 4))
        stress = (2 * weights * self.shear[part, None])[..., None, None] * strain
        trace = np.trace(strain, axis1=3, axis2=4)
        volumetric = _weighted(trace, weights, self.modes_of(part)) * self.first_lame[part, None]
        stress += volumetric[..., None, None] * np.eye(3)
        return strain, stress

    def modes_of(self, part: slice) -> Array | None:
        """Return the volume modes of a few cells, shape (cells, points, modes), m^1.5."""
        return None if self.volume_modes is None else self.volume_modes[part]

    def _parts(self) -> Iterator[slice]:
        for start in range(0, len(self), _CHUNK):
            yield slice(start, start + _CHUNK)


class _State:
    """Strains and stresses of a few cells at one displacement (None: undeformed)."""

    def __init__(self, cells: Stiffness, part: slice, displacement: Array | None) -> None:
        self.slopes = cells.gradients.slopes[part]
        self.weights = cells.gradients.weights[part]
        self.first_lame = cells.first_lame[part, None]
        self.shear = cells.shear[part, None]
        self.modes = cells.modes_of(part)
        self.undeformed = displacement is None
        if displacement is None:
            return
        H = displacement[:, None] @ self.slopes.swapaxes(2, 3)
        self.F = H + np.eye(3)
        self.E = _green_strain(H)
        self.wS = self._weighted_stress(self.E)

    def extrapolate(self, step: Array) -> None:
        """Replace the stress by its linear extrapolation from the state one step before."""
        aim, change = (field[:, None] @ self.slopes.swapaxes(2, 3) for field in step)
        E = _green_strain(aim) - 0.5 * (change.swapaxes(2, 3) @ change)
        self.wS = self._weighted_stress(E)

    def _weighted_stress(self, strain: Array) -> Array:
        trace = np.trace(strain, axis1=2, axis2=3)
        volumetric = self.first_lame * _weighted(trace, self.weights, self.modes)
        shear = 2 * self.weights * self.shear
        return volumetric[..., None, None] * np.eye(3) + shear[..., None, None] * strain

    def energy(self) -> float:
        return 0.5 * float(np.vdot(self.wS, self.E))

    def forces(self) -> Array:
        """Integrate P_iJ dN_a/dX_J, shape (cells, 3, nodes)."""
        P = self.F @ self.wS
        cells, points, _, nodes = self.slopes.shape
        stacked = P.transpose(0, 2, 1, 3).reshape(cells, 3, 3 * points)
        return stacked @ self.slopes.reshape(cells, 3 * points, nodes)

    def tangent(self, out: Array) -> None:
        cells, points, _, nodes = self.slopes.shape
        size = 3 * nodes
        g = (self.slopes if self.undeformed else self.F @ self.slopes).reshape(cells, points, size)
        K = out.reshape(cells, 3, nodes, 3, nodes)
        gram = ((g * self.weights[..., None]).swapaxes(1, 2) @ g).reshape(K.shape)
        volumetric = gram if self.modes is None else self._projected_gram(g).reshape(K.shape)
        np.multiply(volumetric, self.first_lame[..., None, None, None], out=K)
        gram *= self.shear[..., None, None, None]
        K += gram.swapaxes(1, 3)
        K += self._shear_and_stress().transpose(0, 1, 3, 2, 4)

    def _projected_gram(self, g: Array) -> Array:
        """Integrate the products of the projected volumetric strains of unit displacements."""
        assert self.modes is not None
        projected = self.modes.swapaxes(1, 2) @ g
        return projected.swapaxes(1, 2) @ projected

    def _shear_and_stress(self) -> Array:
        """Integrate mu (F F^T)_ik dN_a . dN_b + delta_ik dN_a . S dN_b as (cells, i, k, a, b)."""
        cells, points, _, nodes = self.slopes.shape
        stacked = self.slopes.reshape(cells, 3 * points, nodes)
        weights = self.weights * self.shear
        if self.undeformed:
            scaled = stacked * np.repeat(weights, 3, axis=1)[..., None]
            same = scaled.swapaxes(1, 2) @ stacked
            return np.eye(3)[None, :, :, None, None] * same[:, None, None]
        products = (self.slopes.swapaxes(2, 3) @ self.slopes).reshape(cells, points, nodes**2)
        stretch = (self.F @ self.F.swapaxes(2, 3) * weights[..., None, None]).reshape(
            cells, points, 9
        )
        total = (stretch.swapaxes(1, 2) @ products).reshape(cells, 3, 3, nodes, nodes)
        stressed = (self.wS @ self.slopes).reshape(cells, 3 * points, nodes)
        geometric = stacked.swapaxes(1, 2) @ stressed
        for axis in range(3):
            total[:, axis, axis] += geometric
        return total


def _weighted(trace: Array, weights: Array, modes: Array | None) -> Array:
    """Return weights times the volumetric strain, or its projection: (..., cells, points)."""
    if modes is None:
        return weights * trace
    parts = modes.swapaxes(1, 2) @ trace[..., None]
    return (modes @ parts)[..., 0]


def _green_strain(H: Array) -> Array:
    """Return sym H + H^T H / 2 for displacement gradients H, shape (..., 3, 3)."""
    return 0.5 * (H + H.swapaxes(-1, -2) + H.swapaxes(-1, -2) @ H)
