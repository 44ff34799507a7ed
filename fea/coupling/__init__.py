"""How the rigid side holds the section of the deformable body.

A coupling adds a few unknowns, the *border*, to the body's free nodes: the interface displacement
(and multipliers). The body's stiffness stays sparse and positive definite; the border is eliminated
last, by its Schur complement, which is also where the 6x6 tangent compliance comes from.

All vectors are in the undeformed interface frame, its origin at the interface point.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from wrenchbook.fea.coupling.distributed import Distributed
from wrenchbook.fea.coupling.rigid import Rigid
from wrenchbook.fea.coupling.state import Border, CoupledState

Array = np.ndarray

__all__ = ["Border", "CoupledState", "Coupling", "Distributed", "Rigid"]


class Coupling(Protocol):
    """What the analyses ask of a coupling.

    `active` holds indices, shape (k,).
    """

    active: Array
    """Shape (k,), int64: indices of the interface freedoms that are not locked, ascending."""
    border: int
    """Number of border unknowns."""

    @property
    def tied(self) -> Array:
        """Nodes that follow the interface and are no unknowns of their own.

        Shape (k,), int64, indices.
        """
        ...

    def start(self) -> CoupledState:
        """Return the undeformed state."""
        ...

    def moved(self, state: CoupledState, nodes: Array, border: Array) -> CoupledState:
        """Return the state after a correction.

        Parameters
        ----------
        state
            The state before.
        nodes
            Shape (n, 3), m: the correction of the free nodes.
        border
            Shape (border,): that of the interface freedoms, m and rad, and multipliers, N and N/m.
        """
        ...

    def residual(self, state: CoupledState, forces: Array, wrench: Array) -> tuple[Array, Array]:
        """Return what is out of balance.

        Parameters
        ----------
        state
            The configuration.
        forces
            Shape (n, 3), N: internal nodal forces in it.
        wrench
            Shape (6,), N and N·m.

        Returns
        -------
        nodal
            Shape (n, 3), N.
        border
            Shape (border,): N and N·m for interface freedoms, m and m^2 for constraints.
        """
        ...

    def bordered(self, state: CoupledState, forces: Array, wrench: Array) -> Border:
        """Return how the border joins the body's tangent.

        Parameters
        ----------
        state
            The configuration.
        forces
            Shape (n, 3), N: internal nodal forces in it.
        wrench
            Shape (6,), N and N·m.
        """
        ...

    def wrench_columns(self, state: CoupledState) -> Array:
        """Return minus the derivative of the border's residual by the wrench.

        Shape (border, 6), dimensionless; rows of constraints are zero.
        """
        ...

    def displacement_rows(self, border: Array) -> Array:
        """Pick the interface displacement out of border unknowns.

        Shape (border, k) to shape (6, k), m and rad; rows of locked freedoms are zero.
        """
        ...
