"""Base class of the cells of all materials: forces, energies and stresses, total Lagrangian.

The unknowns of a cell are ordered component first, (ux of all nodes, uy of all nodes, uz of all
nodes), so that the products are matrix products without reordering. Each kind of material has its
own state at a displacement: `CellState`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from wrenchbook.fea.element.cell_state import CellState, Which
from wrenchbook.fea.mesh.mapping import Gradients

_CHUNK = 64  # cells at a time: their temporaries fit the cache


@dataclass(frozen=True, eq=False)
class CellStiffness(ABC):
    """Cells of one block with their material."""

    gradients: Gradients  # shape gradients and weights of the cells
    # Shape (cells, points or 1, 3, 3), 1/K: thermal strain per kelvin; None if no temperature is an
    # input.
    expansion: np.ndarray | None = field(default=None, kw_only=True)
    # The same shape: the thermal strain; None if there is none, and in Neo-Hookean cells.
    thermal: np.ndarray | None = field(default=None, kw_only=True)

    @property
    def size(self) -> int:
        """Unknowns of one cell."""
        return 3 * self.gradients.slopes.shape[3]

    def __len__(self) -> int:
        return len(self.gradients.weights)

    @property
    def projected(self) -> bool:
        """Whether the volumetric strain is projected, see `fea.element.pressure_projection`."""
        return False

    def thermal_strain(self, part: Which) -> np.ndarray | None:
        """Return the thermal strain of a few cells, (cells, points or 1, 3, 3), or None."""
        return None if self.thermal is None else self.thermal[part]

    def at(self, temperature: complex, finite: bool) -> CellStiffness:
        """Return these cells at a temperature, K from the reference.

        To first order, or with `finite` as F = F_e (I + A) with the elastic energy per heated
        volume, A the expansion times the temperature: E_e = (I + A)^-1 (E - A - A^2/2) (I + A)^-1.
        The factors have each cell's mean of A: they change moduli by some 0.1 %.
        """
        if self.expansion is None or temperature == 0.0:
            return self
        growth = temperature * self.expansion
        if not finite:
            return replace(self, thermal=growth)
        stretch = np.eye(3) + growth.mean(axis=1)
        return replace(self.stretched(stretch), thermal=growth + 0.5 * growth @ growth)

    @abstractmethod
    def stretched(self, stretch: np.ndarray) -> CellStiffness:
        """Return the cells with moduli for E after a stress-free stretch, (cells, 3, 3)."""

    @abstractmethod
    def state(self, part: Which, displacement: np.ndarray | None) -> CellState:
        """Return strains and stresses of a few cells.

        displacement: of these cells, shape (cells, 3, nodes), m; None for the undeformed state.
        """

    def forces(
        self, displacement: np.ndarray, step: np.ndarray | None = None
    ) -> tuple[np.ndarray, float, float]:
        """Return the internal forces, the strain energy and the least det F.

        displacement: shape (cells, 3, nodes), m.
        step: shape (2, cells, 3, nodes), m: the last step of Newton's method, see
        `ElasticBody.tangent`; None for the forces at the displacement.
        Returns forces: shape (cells, 3, nodes), N. energy: J. least: the smallest determinant of
        the deformation gradient.
        """
        forces = np.empty_like(displacement)
        energy = 0.0
        least = np.inf
        for part in self.chunks():
            state = self.state(part, displacement[part])
            if step is not None:
                state.extrapolate(step[:, part])
            forces[part] = state.forces()
            energy += state.energy()
            least = min(least, float(np.linalg.det(state.F).min()))
        return forces, energy, least

    def tangent(
        self, displacement: np.ndarray | None, step: np.ndarray | None, cells: np.ndarray
    ) -> np.ndarray:
        """Return the tangent stiffness of some cells.

        displacement: of these cells, shape (k, 3, nodes), m; None for the undeformed state.
        step: shape (2, k, 3, nodes), m: the last step of Newton's method, see
        `ElasticBody.tangent`; None for the consistent tangent.
        cells: shape (k,): indices.
        Result: shape (k, size, size), N/m.
        """
        out = np.empty((len(cells), self.size, self.size))
        for chunk in self.chunks(len(cells)):
            state = self.state(cells[chunk], None if displacement is None else displacement[chunk])
            if step is not None:
                state.extrapolate(step[:, chunk])
            state.tangent(out[chunk])
        return out

    def small_strain_forces(self, fields: np.ndarray, first: int = 0) -> np.ndarray:
        """Return the forces of several small displacement fields, by way of their stresses.

        fields: shape (k, cells, 3, nodes), m: of the cells from `first` on.
        Result: shape (k, cells, 3, nodes), N.
        """
        forces = np.empty_like(fields)
        for part in self.chunks(fields.shape[1]):
            chunk = slice(first + part.start, first + part.stop)
            _, stress = self._small_strain(fields[:, part], chunk)
            slopes = self.gradients.slopes[chunk]
            cells, points, _, nodes = slopes.shape
            stacked = stress.transpose(0, 1, 3, 2, 4).reshape(len(fields), cells, 3, 3 * points)
            forces[:, part] = stacked @ slopes.reshape(cells, 3 * points, nodes)
        return forces

    def strain_energy_products(self, fields: np.ndarray, first: int = 0) -> np.ndarray:
        """Integrate strain : C : strain for pairs of small displacement fields.

        fields: shape (k, cells, 3, nodes), m: of the cells from `first` on.
        Result: shape (k, k), J: twice the mutual strain energy of each pair.
        """
        count = len(fields)
        total = np.zeros((count, count))
        for part in self.chunks(fields.shape[1]):
            chunk = slice(first + part.start, first + part.stop)
            strain, stress = self._small_strain(fields[:, part], chunk)
            total += strain.reshape(count, -1) @ stress.reshape(count, -1).T
        return total

    def small_stresses(self, fields: np.ndarray) -> np.ndarray:
        """Return the stresses of several small displacement fields at the quadrature points.

        fields: shape (k, cells, 3, nodes), m.
        Result: shape (k, cells, points, 3, 3), Pa.
        """
        stresses = []
        for part in self.chunks():
            _, weighted = self._small_strain(fields[:, part], part)
            stresses.append(weighted / self.gradients.weights[part][..., None, None])
        return np.concatenate(stresses, axis=1)

    def cauchy_stresses(
        self, displacement: np.ndarray, fields: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the Cauchy stresses at the quadrature points, and their change with fields.

        sigma = F S F^T / J, and d sigma = (dF S F^T + F dS F^T + F S dF^T) / J - sigma tr(dF F^-1).

        displacement: shape (cells, 3, nodes), m.
        fields: shape (k, cells, 3, nodes): changes of the displacement, m over some unit.
        Returns stresses: shape (cells, points, 3, 3), Pa. changes: shape (k, cells, points, 3, 3),
        Pa over that unit.
        """
        pairs = [
            self.state(part, displacement[part]).cauchy(fields[:, part]) for part in self.chunks()
        ]
        return (
            np.concatenate([stress for stress, _ in pairs]),
            np.concatenate([changes for _, changes in pairs], axis=1),
        )

    def _small_strain(self, fields: np.ndarray, part: slice) -> tuple[np.ndarray, np.ndarray]:
        """Return elastic strains and weighted stresses, each (k, cells, points, 3, 3)."""
        H = fields[:, :, None] @ self.gradients.slopes[part].swapaxes(2, 3)
        strain = 0.5 * (H + H.swapaxes(3, 4))
        thermal = self.thermal_strain(part)
        if thermal is not None:
            strain = strain - thermal
        return strain, self.state(part, None).weighted_change(strain)

    def chunks(self, cells: int | None = None) -> Iterator[slice]:
        """Yield slices of all cells, or of `cells` of them, whose temporaries fit the cache."""
        count = len(self) if cells is None else cells
        for start in range(0, count, _CHUNK):
            yield slice(start, min(start + _CHUNK, count))
