"""The nodes of a section with their areas, and its rigid or distributed coupling."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wrenchbook.fea.coupling.coupling import (
    PER_INTERFACE,
    ArmMoments,
    Border,
    CoupledState,
    SectionCoupling,
)
from wrenchbook.fea.mesh.mapping import area_weights
from wrenchbook.fea.mesh.mesh import FacetGroup
from wrenchbook.fea.tensors import rotation_less_identity, skew, spin_per_vector, spin_slope

# Parts of a section's border: the interface's motion, then a distributed section's multipliers.
_TRANSLATION, _ROTATION = slice(0, 3), slice(3, 6)
_FORCE, _MOMENT = slice(6, 9), slice(9, 12)


class Rigid(SectionCoupling):
    """Tie u_i = t + (R - I) x_i for the section's nodes, x_i measured from the interface point.

    The section's nodes are no unknowns of the body; its reactions there balance the wrench. The
    rotation vector itself is the unknown (rotations stay far below a half turn), so freedoms that a
    guide holds are left out.
    """

    constrains = True

    def node_positions(self, interface: np.ndarray) -> np.ndarray:
        """Return where an interface at (6,), m and rad, puts the nodes, (s, 3), m."""
        R_minus_I = rotation_less_identity(interface[3:])
        return interface[:3] + self.points @ R_minus_I.T

    def residual(
        self, state: CoupledState, forces: np.ndarray, wrench: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return zero forces at the nodes, (s, 3), and the resultants less the wrench, (6,).

        forces: shape (s, 3), N: internal, at the section's nodes. wrench: shape (6,), N and N·m.
        """
        moment = np.cross(self._arms(state), forces).sum(axis=0)
        spin = spin_per_vector(state.interface[3:])
        border = np.concatenate([forces.sum(axis=0) - wrench[:3], spin.T @ (moment - wrench[3:])])
        return np.zeros_like(forces), border

    def bordered(self, state: CoupledState, forces: np.ndarray, wrench: np.ndarray) -> Border:
        """Return the constraint, (s, 3, 6), and the block, (6, 6).

        The block is the derivative of the residual's moment by the rotation vector, at constant
        forces: through the arms R x_i, and through J(r)^T (`fea.tensors.spin_slope`).
        forces: shape (s, 3), N: internal, at the section's nodes. wrench: shape (6,), N and N·m.
        """
        arms = self._arms(state)
        spin = spin_per_vector(state.interface[3:])
        by_arms = (skew(forces) @ skew(arms)).sum(axis=0)
        excess = np.cross(arms, forces).sum(axis=0) - wrench[3:]
        block = np.zeros((PER_INTERFACE, PER_INTERFACE))
        block[_ROTATION, _ROTATION] = spin.T @ by_arms @ spin
        block[_ROTATION, _ROTATION] += spin_slope(state.interface[3:], excess)
        constraint = np.zeros((len(arms), 3, PER_INTERFACE))
        constraint[:, :, _TRANSLATION] = np.eye(3)
        constraint[:, :, _ROTATION] = -skew(arms) @ spin
        return Border(constraint, np.zeros_like(constraint), block)

    def wrench_columns(self, state: CoupledState) -> np.ndarray:
        """Return the columns of `SectionCoupling.wrench_columns`, shape (6, 6)."""
        columns = np.eye(PER_INTERFACE)
        columns[_ROTATION, _ROTATION] = spin_per_vector(state.interface[3:]).T
        return columns

    def arm_moments(
        self,
        state: CoupledState,
        forces: tuple[np.ndarray, np.ndarray],
        fields: np.ndarray,
        border: np.ndarray,
    ) -> ArmMoments:
        """Return sum f x^T, 3x3 and N·m, and its derivatives along k inputs.

        The forces f have shapes (s, 3), N, and (s, 3, k). The second derivative is zero: it is part
        of the body's third derivatives.
        """
        return ArmMoments(
            np.einsum("si,sj->ij", forces[0], self.points),
            np.einsum("sik,sj->ijk", forces[1], self.points),
            np.zeros((3, 3, border.shape[1], border.shape[1])),
        )

    def _arms(self, state: CoupledState) -> np.ndarray:
        """Return R x_i of the nodes, shape (s, 3), m."""
        return self.points + self.points @ rotation_less_identity(state.interface[3:]).T


@dataclass(frozen=True, eq=False)
class InterfaceSection:
    """The interface's nodes with their weights in a mean."""

    node_ids: np.ndarray  # sorted, shape (s,), int64
    # Shape (s,). By area, m^2: the integral of each node's shape function over the section; those
    # of the corners of quad8 facets are negative, as they must be for a constant traction. Equal
    # weights and a deck's have any scale.
    weights: np.ndarray
    # m^2: area of the section's facets; None for a group of nodes that bound no facet
    area: float | None
    centre: np.ndarray  # shape (3,), m: the area's centre, or the mean of such nodes


def section_of_facets(
    points: np.ndarray, group: FacetGroup, node_ids: np.ndarray | None = None
) -> InterfaceSection:
    """Return the section of the facets of `group`.

    points: shape (n, 3), m.
    group: at least one facet.
    node_ids: the section's nodes if it has more than the facets; the others get the weight 0.
    """
    covered, areas = area_weights(points, group)
    ids = covered if node_ids is None else np.unique(node_ids)
    weights = np.zeros(len(ids))
    weights[np.searchsorted(ids, covered)] = areas
    area = float(areas.sum())
    # Isoparametric facets: the integral of x is the weighted sum of the nodes' coordinates.
    centre = areas @ points[covered] / area
    return InterfaceSection(ids, weights, area, centre)


def section_of_nodes(points: np.ndarray, node_ids: np.ndarray) -> InterfaceSection:
    """Return the section of nodes that bound no facet: all have the same weight, their sum is 1.

    points: shape (n, 3), m.
    node_ids: shape (k,), int64; in any order, and repeated ones count once.
    """
    ids = np.unique(node_ids)
    weights = np.full(len(ids), 1.0 / len(ids))
    return InterfaceSection(ids, weights, None, points[ids].mean(axis=0))


class Distributed(SectionCoupling):
    """Weighted mean translation and rotation of the section; the wrench is spread conjugately.

    With weights w_i of sum 1, section centre c, rho_i = x_i - c (undeformed), b_i = R rho_i:

        sum w_i u_i = t + (R - I) c          (mean translation)
        sum w_i b_i x (x_i + u_i) = 0        (the R that fits best: stationary sum w |Rrho - x|^2)

    Both are linear in u. Two multipliers l, m enforce them; node i then feels w_i (l + m x b_i).
    The interface displacement and the multipliers are the border.

    points: shape (s, 3), m: the section's nodes, from the interface point.
    weights: shape (s,): of any scale; their sum is above 0.
    """

    n_multipliers = PER_INTERFACE

    def __init__(self, points: np.ndarray, weights: np.ndarray) -> None:
        super().__init__(points)
        self._weights = weights / weights.sum()
        self._centre = self._weights @ points
        self._arms = points - self._centre

    def residual(
        self, state: CoupledState, forces: np.ndarray, wrench: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the forces of the multipliers, and the forces out of balance under a wrench (6,).

        Shape (s, 3), N, at the nodes; shape (12,) in the interface freedoms, N and N·m, and in
        the six constraints, m and m^2.
        """
        turned = self._turned(state)
        nodal = self._weights[:, None] * (turned.force + np.cross(turned.moment, turned.arms))
        moment = turned.spin.T @ (turned.carried_moment() - wrench[3:])
        gaps = [
            self._weights @ state.nodes
            - state.interface[:3]
            - rotation_less_identity(state.interface[3:]) @ self._centre,
            self._weights @ np.cross(turned.arms, turned.points),
        ]
        return nodal, np.concatenate([-turned.force - wrench[:3], moment, *gaps])

    def bordered(self, state: CoupledState, forces: np.ndarray, wrench: np.ndarray) -> Border:
        """Return the derivatives of the residual by the border; no node is constrained.

        Forces have shape (s, 3), N, the wrench shape (6,), N and N·m.
        """
        turned = self._turned(state)
        weighted_arms = self._weights[:, None, None] * skew(turned.arms)
        columns = np.zeros((len(self.points), 3, 2 * PER_INTERFACE))
        columns[:, :, _ROTATION] = -skew(turned.moment) @ weighted_arms @ turned.spin
        columns[:, :, _FORCE] = self._weights[:, None, None] * np.eye(3)
        columns[:, :, _MOMENT] = -weighted_arms
        block = np.zeros((2 * PER_INTERFACE, 2 * PER_INTERFACE))

        # Row by row of the residual: the force, the moment J(r)^T m, and the two constraints.
        centre = skew(turned.centre) @ turned.spin
        inertia = turned.inertia()
        # The derivative of m by the arms and by R c, before that of J(r)^T
        by_arms = -skew(turned.force) @ skew(turned.centre) + np.einsum(
            "i,iab,ibc->ac",
            self._weights,
            skew(np.cross(turned.points, turned.moment)),
            skew(turned.arms),
        )
        excess = turned.carried_moment() - wrench[3:]
        block[_ROTATION, _ROTATION] = turned.spin.T @ by_arms @ turned.spin
        block[_ROTATION, _ROTATION] += spin_slope(state.interface[3:], excess)
        block[_TRANSLATION, _FORCE] = block[_FORCE, _TRANSLATION] = -np.eye(3)
        block[_FORCE, _ROTATION] = centre
        block[_ROTATION, _FORCE] = centre.T
        block[_ROTATION, _MOMENT] = turned.spin.T @ inertia
        block[_MOMENT, _ROTATION] = inertia.T @ turned.spin
        return Border(np.zeros_like(columns), columns, block)

    def wrench_columns(self, state: CoupledState) -> np.ndarray:
        """Return the columns of `SectionCoupling.wrench_columns`, shape (12, 6)."""
        columns = np.zeros((2 * PER_INTERFACE, PER_INTERFACE))
        columns[_TRANSLATION, _TRANSLATION] = np.eye(3)
        columns[_ROTATION, _ROTATION] = spin_per_vector(state.interface[3:]).T
        return columns

    def arm_moments(
        self,
        state: CoupledState,
        forces: tuple[np.ndarray, np.ndarray],
        fields: np.ndarray,
        border: np.ndarray,
    ) -> ArmMoments:
        """Return -l c^T - [m]x Q, 3x3 and N·m, Q = sum w (x + u) rho^T, and its derivatives.

        The derivatives are along k inputs, from the fields, (s, 3, k), m, and the border, (12, k).
        """
        force = border[_FORCE]
        moment = skew(border[_MOMENT].T)
        couple = skew(state.multipliers[3:])
        arms = self._weights[:, None] * self._arms
        Q = (self.points + state.nodes).T @ arms
        moved = np.einsum("sik,sj->kij", fields, arms)
        moments = -np.outer(state.multipliers[:3], self._centre) - couple @ Q
        changes = -force.T[:, :, None] * self._centre - moment @ Q - couple @ moved
        second = moment[:, None] @ moved
        second = -(second + second.swapaxes(0, 1))
        return ArmMoments(moments, np.moveaxis(changes, 0, 2), np.moveaxis(second, (0, 1), (2, 3)))

    def _turned(self, state: CoupledState) -> _TurnedSection:
        R_minus_I = rotation_less_identity(state.interface[3:])
        return _TurnedSection(
            weights=self._weights,
            spin=spin_per_vector(state.interface[3:]),
            arms=self._arms + self._arms @ R_minus_I.T,
            centre=self._centre + R_minus_I @ self._centre,
            points=self.points + state.nodes,
            force=state.multipliers[:3],
            moment=state.multipliers[3:],
        )


@dataclass(frozen=True, eq=False)
class _TurnedSection:
    """Quantities of a distributed section at one state, from the interface point."""

    weights: np.ndarray  # shape (s,), of sum 1
    spin: np.ndarray  # shape (3, 3): J(r)
    arms: np.ndarray  # shape (s, 3), m: b_i
    centre: np.ndarray  # shape (3,), m: R c
    points: np.ndarray  # shape (s, 3), m: x_i + u_i
    force: np.ndarray  # shape (3,), N: the multiplier l
    moment: np.ndarray  # shape (3,), N/m: the multiplier m

    def inertia(self) -> np.ndarray:
        """Return sum w (x b^T - (b . x) I), shape (3, 3), m^2."""
        outer = (self.points * self.weights[:, None]).T @ self.arms
        return outer - np.trace(outer) * np.eye(3)

    def carried_moment(self) -> np.ndarray:
        """Return the moment about the interface point that the multipliers balance, (3,), N·m."""
        return -np.cross(self.centre, self.force) + self.inertia() @ self.moment
