"""Rigid coupling: the section moves as one rigid piece with the interface point."""

from __future__ import annotations

import numpy as np

from wrenchbook.fea.coupling.coupling import PER_INTERFACE, Border, CoupledState, SectionCoupling
from wrenchbook.fea.coupling.rotation import (
    rotation_less_identity,
    skew,
    spin_per_vector,
    spin_slope,
)

Array = np.ndarray


class Rigid(SectionCoupling):
    """Tie u_i = t + (R - I) x_i for the section's nodes, x_i measured from the interface point.

    The section's nodes are no unknowns of the body; its reactions there balance the wrench. The
    rotation vector itself is the unknown (rotations stay far below a half turn), so freedoms that a
    guide holds are simply left out.
    """

    def placed(self, interface: Array) -> Array:
        """Return where an interface at (6,), m and rad, puts the nodes, (s, 3), m."""
        R_minus_I = rotation_less_identity(interface[3:])
        return interface[:3] + self.places @ R_minus_I.T

    def residual(self, state: CoupledState, forces: Array, wrench: Array) -> tuple[Array, Array]:
        """Return nothing for the nodes, (s, 3), N, and what is out of balance, (6,), N and N·m.

        The section's forces have shape (s, 3), N, the wrench (6,), N and N·m.
        """
        moment = np.cross(self._turned(state), forces).sum(axis=0)
        spin = spin_per_vector(state.interface[3:])
        border = np.concatenate([forces.sum(axis=0) - wrench[:3], spin.T @ (moment - wrench[3:])])
        return np.zeros_like(forces), border

    def bordered(self, state: CoupledState, forces: Array, wrench: Array) -> Border:
        """Return the ties, and what turning the arms adds to the moment.

        Forces have shape (s, 3), N, the wrench shape (6,), N and N·m.
        """
        arms = self._turned(state)
        spin = spin_per_vector(state.interface[3:])
        turning = (skew(forces) @ skew(arms)).sum(axis=0)
        excess = np.cross(arms, forces).sum(axis=0) - wrench[3:]
        block = np.zeros((PER_INTERFACE, PER_INTERFACE))
        block[3:, 3:] = spin.T @ turning @ spin + spin_slope(state.interface[3:], excess)
        ties = np.zeros((len(arms), 3, PER_INTERFACE))
        ties[:, :, :3] = np.eye(3)
        ties[:, :, 3:] = -skew(arms) @ spin
        return Border(ties, np.zeros_like(ties), block)

    def wrench_columns(self, state: CoupledState) -> Array:
        """Return minus the derivative of the border's residual by the wrench.

        Shape (6, 6), dimensionless.
        """
        columns = np.eye(PER_INTERFACE)
        columns[3:, 3:] = spin_per_vector(state.interface[3:]).T
        return columns

    def arm_moments(
        self, state: CoupledState, forces: tuple[Array, Array], fields: Array, border: Array
    ) -> tuple[Array, Array, Array]:
        """Return sum f x^T, 3x3 and N·m, and its derivatives along k inputs.

        The forces f have shapes (s, 3), N, and (s, 3, k). The second is zero: the body's own third
        derivatives have it.
        """
        moments, changes = (np.einsum("si...,sj->ij...", force, self.places) for force in forces)
        return moments, changes, np.zeros((3, 3, border.shape[1], border.shape[1]))

    def _turned(self, state: CoupledState) -> Array:
        return self.places + self.places @ rotation_less_identity(state.interface[3:]).T
