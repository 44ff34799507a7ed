"""Distributed coupling: the interface follows the least-squares rigid motion of its section."""

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


class Distributed(Coupling):
    """Weighted mean translation and rotation of the section; the wrench is spread conjugately.

    With weights w_i of sum 1, section centre c, rho_i = x_i - c (undeformed), b_i = R rho_i:

        sum w_i u_i = t + (R - I) c          (mean translation)
        sum w_i b_i x (x_i + u_i) = 0        (the R that fits best: stationary sum w |Rrho - x|^2)

    Both are linear in u. Two multipliers l, m enforce them; node i then feels w_i (l + m x b_i).
    The interface displacement and the multipliers are the border.

    Parameters
    ----------
    points
        Shape (n, 3), m, measured from the interface point.
    nodes
        Shape (k,): the section's nodes.
    weights
        Shape (k,): area weights, of any scale.
    active
        Indices of the interface freedoms that are not locked.
    """

    multipliers = 6

    def __init__(self, points: Array, nodes: Array, weights: Array, active: Array) -> None:
        super().__init__(points, nodes, active)
        self._weights = weights / weights.sum()
        self._places = points[nodes]
        self._centre = self._weights @ self._places
        self._arms = self._places - self._centre

    def moved(self, state: CoupledState, nodes: Array, border: Array) -> CoupledState:
        """Return the state after a correction of nodes, shape (n, 3), m, and border.

        The border's correction has shape (border,): m and rad, then the multipliers' N and N/m.
        """
        interface = state.interface.copy()
        interface[self.active] += border[:-6]
        return CoupledState(state.nodes + nodes, interface, state.multipliers + border[-6:])

    def residual(self, state: CoupledState, forces: Array, wrench: Array) -> tuple[Array, Array]:
        """Return what is out of balance under forces (n, 3), N, and a wrench (6,), N and N·m.

        Shape (n, 3), N, at the nodes; shape (border,) in the interface freedoms, N and N·m, and in
        the six constraints, m and m^2.
        """
        own = _Turned(self, state)
        nodes = forces.copy()
        nodes[self._nodes] += self._weights[:, None] * (own.force + np.cross(own.moment, own.arms))
        border = np.concatenate(
            [
                -own.force - wrench[:3],
                own.spin.T @ (own.carried_moment() - wrench[3:]),
            ]
        )
        moved = state.nodes[self._nodes]
        gaps = np.concatenate(
            [
                self._weights @ moved
                - state.interface[:3]
                - rotation_less_identity(state.interface[3:]) @ self._centre,
                self._weights @ np.cross(own.arms, own.places),
            ]
        )
        return nodes, np.concatenate([border[self.active], gaps])

    def bordered(self, state: CoupledState, forces: Array, wrench: Array) -> Border:
        """Return the derivatives of the residual by the border; nothing is tied.

        Forces have shape (n, 3), N, the wrench shape (6,), N and N·m.
        """
        own = _Turned(self, state)
        weighted_arms = self._weights[:, None, None] * skew(own.arms)
        columns = np.zeros((self._size, 3, 12))
        columns[self._nodes, :, 3:6] = -skew(own.moment) @ weighted_arms @ own.spin
        columns[self._nodes, :, 6:9] = self._weights[:, None, None] * np.eye(3)
        columns[self._nodes, :, 9:] = -weighted_arms
        block = np.zeros((12, 12))
        self._fill(block, own)
        excess = own.carried_moment() - wrench[3:]
        block[3:6, 3:6] += spin_slope(state.interface[3:], excess)
        chosen = self._chosen
        columns = columns[:, :, chosen]
        return Border(np.zeros_like(columns), columns, block[np.ix_(chosen, chosen)])

    def wrench_columns(self, state: CoupledState) -> Array:
        """Return minus the derivative of the border's residual by the wrench.

        Shape (border, 6), dimensionless; the rows of the six constraints are zero.
        """
        columns = np.zeros((12, 6))
        columns[:3, :3] = np.eye(3)
        columns[3:6, 3:] = spin_per_vector(state.interface[3:]).T
        return columns[self._chosen]

    @property
    def _chosen(self) -> Array:
        return np.concatenate([self.active, np.arange(6, 12)])

    def _fill(self, block: Array, own: _Turned) -> None:
        """Write the border's own derivatives, less those of the spin itself."""
        centre = skew(own.centre) @ own.spin
        inertia = own.inertia()
        turning = -skew(own.force) @ skew(own.centre) + np.einsum(
            "i,iab,ibc->ac",
            self._weights,
            skew(np.cross(own.places, own.moment)),
            skew(own.arms),
        )
        block[3:6, 3:6] = own.spin.T @ turning @ own.spin
        block[:3, 6:9] = block[6:9, :3] = -np.eye(3)
        block[6:9, 3:6] = centre
        block[3:6, 6:9] = centre.T
        block[3:6, 9:] = own.spin.T @ inertia
        block[9:, 3:6] = inertia.T @ own.spin


class _Turned:
    """The section's quantities at one state."""

    def __init__(self, coupling: Distributed, state: CoupledState) -> None:
        R_minus_I = rotation_less_identity(state.interface[3:])
        self.spin = spin_per_vector(state.interface[3:])
        self.arms = coupling._arms + coupling._arms @ R_minus_I.T
        self.centre = coupling._centre + R_minus_I @ coupling._centre
        self.places = coupling._places + state.nodes[coupling._nodes]
        self.weights = coupling._weights
        self.force, self.moment = state.multipliers[:3], state.multipliers[3:]

    def inertia(self) -> Array:
        """Return sum w (x b^T - (b . x) I), shape (3, 3)."""
        outer = (self.places * self.weights[:, None]).T @ self.arms
        return outer - np.trace(outer) * np.eye(3)

    def carried_moment(self) -> Array:
        """Return the moment about the interface point that the multipliers balance."""
        return -np.cross(self.centre, self.force) + self.inertia() @ self.moment
