"""Rigid coupling: the section moves as one rigid piece with the interface point."""

from __future__ import annotations

import numpy as np

from wrenchbook.fea.coupling.coupling import Border, CoupledState, Coupling
from wrenchbook.fea.coupling.rotation import (
    rotation_less_identity,
    skew,
    spin_per_vector,
    spin_slope,
)

Array = np.ndarray


class Rigid(Coupling):
    """Tie u_i = t + (R - I) x_i for the section's nodes, x_i measured from the interface point.

    The section's nodes are no unknowns of the body; its reactions there balance the wrench. The
    rotation vector itself is the unknown (rotations stay far below a half turn), so freedoms that a
    guide holds are simply left out.

    Parameters
    ----------
    points
        Shape (n, 3), m.
    nodes
        Shape (k,): the section's nodes.
    active
        Indices of the interface freedoms that are not locked.
    """

    def __init__(self, points: Array, nodes: Array, active: Array) -> None:
        super().__init__(points, nodes, active)
        self._arms = points[nodes]

    @property
    def tied(self) -> Array:
        """The section's nodes, shape (k,), int64, indices."""
        return self._nodes

    def moved(self, state: CoupledState, nodes: Array, border: Array) -> CoupledState:
        """Return the state after a correction, of shapes (n, 3), m, and (border,), m and rad.

        The section is placed exactly, not incrementally.
        """
        interface = state.interface.copy()
        interface[self.active] += border
        placed = state.nodes + nodes
        R_minus_I = rotation_less_identity(interface[3:])
        placed[self._nodes] = interface[:3] + self._arms @ R_minus_I.T
        return CoupledState(placed, interface, state.multipliers)

    def residual(self, state: CoupledState, forces: Array, wrench: Array) -> tuple[Array, Array]:
        """Return what is out of balance, N and N·m, under forces (n, 3) and a wrench (6,).

        Shape (n, 3) at the nodes, shape (border,) in the interface freedoms.
        """
        pull = forces[self._nodes]
        moment = np.cross(self._turned(state), pull).sum(axis=0)
        spin = spin_per_vector(state.interface[3:])
        border = np.concatenate([pull.sum(axis=0) - wrench[:3], spin.T @ (moment - wrench[3:])])
        return forces, border[self.active]

    def bordered(self, state: CoupledState, forces: Array, wrench: Array) -> Border:
        """Return the ties, and what turning the arms adds to the moment.

        Forces have shape (n, 3), N, the wrench shape (6,), N and N·m.
        """
        pull, arms = forces[self._nodes], self._turned(state)
        spin = spin_per_vector(state.interface[3:])
        turning = (skew(pull) @ skew(arms)).sum(axis=0)
        excess = np.cross(arms, pull).sum(axis=0) - wrench[3:]
        block = np.zeros((6, 6))
        block[3:, 3:] = spin.T @ turning @ spin + spin_slope(state.interface[3:], excess)
        ties = self._ties(arms, spin)
        return Border(ties, np.zeros_like(ties), block[np.ix_(self.active, self.active)])

    def wrench_columns(self, state: CoupledState) -> Array:
        """Return minus the derivative of the border's residual by the wrench.

        Shape (border, 6), dimensionless.
        """
        columns = np.eye(6)
        columns[3:, 3:] = spin_per_vector(state.interface[3:]).T
        return columns[self.active]

    def _turned(self, state: CoupledState) -> Array:
        return self._arms + self._arms @ rotation_less_identity(state.interface[3:]).T

    def _ties(self, arms: Array, spin: Array) -> Array:
        """Return the change of all nodes per change of the active freedoms, (n, 3, border)."""
        ties = np.zeros((self._size, 3, 6))
        ties[self._nodes, :, :3] = np.eye(3)
        ties[self._nodes, :, 3:] = -skew(arms) @ spin
        return ties[:, :, self.active]
