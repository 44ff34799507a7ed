"""A state and the forces in it under one wrench."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wrenchbook.fea.coupling import CoupledState

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Balance:
    """A state and the forces in it under one wrench.

    Attributes
    ----------
    state
        The configuration.
    wrench
        Shape (6,), N and N·m.
    forces
        Shape (n, 3), N: internal nodal forces.
    energy
        Strain energy, J.
    least_stretch
        Smallest determinant of the deformation gradient.
    nodal, border
        What is out of balance: shape (n, 3), N, at the free nodes, zero at others; and shape
        (border,), N and N·m for interface freedoms, m and m^2 for constraints.
    """

    state: CoupledState
    wrench: Array
    forces: Array
    energy: float
    least_stretch: float
    nodal: Array
    border: Array

    @property
    def norm(self) -> float:
        """Euclidean norm of the nodal forces out of balance, N."""
        return float(np.linalg.norm(self.nodal))

    @property
    def scale(self) -> float:
        """Euclidean norm of all nodal forces, those of supports and interface with them, N."""
        return float(np.linalg.norm(self.forces))
