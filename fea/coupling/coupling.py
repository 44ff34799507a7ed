"""The coupling of all interfaces, its state, and the border that it adds to the equations."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from wrenchbook.fea.coupling import spring_motion
from wrenchbook.fea.element.cell_state import symmetrised
from wrenchbook.fea.spec.schema import FREEDOMS
from wrenchbook.fea.tensors import rotation, rotation_derivatives, rotation_vector, spin_per_vector

PER_INTERFACE = len(FREEDOMS)
"""Freedoms of one interface: three translations, then a rotation vector."""


def each_interface(vector: np.ndarray) -> np.ndarray:
    """Return displacements or wrenches, shape (6 i,), by interface: (i, 6), in their units."""
    return vector.reshape(-1, PER_INTERFACE)


def largest_rotation(displacement: np.ndarray) -> float:
    """Return the largest rotation, rad, among displacements of shape (6 i,), m and rad."""
    return float(max(np.linalg.norm(interface[3:]) for interface in each_interface(displacement)))


def from_origin(interface: np.ndarray, origin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return displacements (6 i,) relative to those at `origin`, and their derivatives by them.

    The relative rotation is R R0^T. Derivatives: shape (6 i, 6 i).
    """
    moved = interface - origin
    rates = np.eye(len(interface))
    for first in range(PER_INTERFACE // 2, len(interface), PER_INTERFACE):
        turn = slice(first, first + PER_INTERFACE // 2)
        now, zero = interface[turn], origin[turn]
        if zero.any():
            moved[turn] = rotation_vector(rotation(now) @ rotation(zero).T)
            spins = spin_per_vector(moved[turn]), spin_per_vector(now)
            rates[turn, turn] = np.linalg.solve(*spins)
    return moved, rates


@dataclass(frozen=True, eq=False)
class CoupledState:
    """One configuration."""

    nodes: np.ndarray  # shape (n, 3), m: nodal displacements
    # Shape (6 i,), m and rad: translation and rotation vector of each of the i interfaces
    interface: np.ndarray
    # Shape (6 i,), N and N/m: multipliers (l, m) of distributed couplings: node i feels w_i (l + m
    # x b_i). Zero for rigid ones. Those of bushings follow, then the bushings' motions, six each, m
    # and rad.
    multipliers: np.ndarray


class Border(NamedTuple):
    """The border of the body's tangent K at one state.

    With the constraint T, columns c and block d the bordered tangent is [[K, K T + c], [(K T +
    c)^T, T^T K T + d]].
    """

    # Shape (n, 3, border): how nodes that are no unknowns move with the border; dimensionless for
    # translations, m/rad for rotations.
    constraint: np.ndarray
    # Shape (n, 3, border): the border's forces on free nodes, N over the unit of each unknown
    columns: np.ndarray
    # Shape (border, border): J over the units of both unknowns, so N/m, N and N·m for interface
    # freedoms.
    block: np.ndarray


class ArmMoments(NamedTuple):
    """N of an energy R : N, N·m, and its derivatives along k inputs."""

    moments: np.ndarray  # shape (3, 3)
    changes: np.ndarray  # shape (3, 3, k)
    second: np.ndarray  # shape (3, 3, k, k)

    def turned(self, rotation: np.ndarray) -> ArmMoments:
        """Return N Q^T and its derivatives, of the rotation Q, (3, 3)."""
        return ArmMoments(
            np.einsum("xy,zy->xz", self.moments, rotation),
            np.einsum("xyk,zy->xzk", self.changes, rotation),
            np.einsum("xykl,zy->xzkl", self.second, rotation),
        )


class SectionCoupling(ABC):
    """The coupling of one interface to its section: the base class of `Rigid` and `Distributed`.

    All quantities are in the interface's frame, relative to its point: `points` of the section's
    nodes, (s, 3), m, undeformed. States, forces and fields are those of these nodes alone; the
    border is six freedoms, with locked ones, and the `multipliers`.
    """

    multipliers = 0

    def __init__(self, points: np.ndarray) -> None:
        self.points = points

    def node_positions(self, interface: np.ndarray) -> np.ndarray | None:
        """Return the displacements, (s, 3), m, by an interface at (6,), m and rad; None if free."""
        return None

    @abstractmethod
    def residual(
        self, state: CoupledState, forces: np.ndarray, wrench: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the coupling's nodal forces, and the forces out of balance in the border.

        Internal forces have shape (s, 3), N, the wrench (6,), N and N·m; the results (s, 3), N, and
        (6 + multipliers,): N and N·m for interface freedoms, m and m^2 for constraints.
        """

    @abstractmethod
    def bordered(self, state: CoupledState, forces: np.ndarray, wrench: np.ndarray) -> Border:
        """Return the border of the body's tangent.

        Internal forces have shape (s, 3), N, the wrench (6,), N and N·m.
        """

    @abstractmethod
    def wrench_columns(self, state: CoupledState) -> np.ndarray:
        """Return minus the derivative of the border's residual by the wrench.

        Shape (6 + multipliers, 6), dimensionless; rows of constraints are zero.
        """

    @abstractmethod
    def arm_moments(
        self,
        state: CoupledState,
        forces: tuple[np.ndarray, np.ndarray],
        fields: np.ndarray,
        border: np.ndarray,
    ) -> ArmMoments:
        """Return N, 3x3, by which the coupling's energy depends on the rotation matrix R: as R : N.

        forces: Shapes (s, 3), N, and (s, 3, k): internal nodal forces, and their change with k
        inputs.
        fields: shape (s, 3, k), m per unit of each: the nodes' change with the inputs.
        border: shape (6 + multipliers, k): the border's change with them.
        """


class _Attachment(NamedTuple):
    """A section's indices in the body and in the border."""

    section: SectionCoupling
    nodes: np.ndarray  # shape (s,): nodes of the section
    # (3, 3): turns a vector of the body to the interface's axes; None if they are the same.
    rotation: np.ndarray | None
    freedoms: slice  # place of this interface's freedoms among all
    chosen: np.ndarray  # indices of the section's border that are unknowns: locked freedoms are not
    border: np.ndarray  # indices of these in the complete border

    def inwards(self, field: np.ndarray) -> np.ndarray:
        """Return a nodal field (n, 3, ...) of the body at the section: (s, 3, ...), in its axes."""
        local = field[self.nodes]
        if self.rotation is None:
            return local
        return np.einsum("ij,sj...->si...", self.rotation, local)

    def outwards(self, field: np.ndarray) -> np.ndarray:
        """Turn a field of the section, (s, 3) or (s, 3, k), into the body's axes."""
        if self.rotation is None:
            return field
        return np.einsum("ji,sj...->si...", self.rotation, field)


class Coupling:
    """Interfaces and frames: one border of their freedoms, of anchors, and of multipliers.

    Nodes and forces are in the body's frame, displacements and wrenches in the interfaces'.
    Frames have no wrench; springs hold them to the ground or to each other. A bushing moves by q,
    translation and rotation vector, and stores q^T K q / 2: its force, and the moment that works on
    the rotation vector, are K q, and K is its tangent at any rotation. Two frames with a spring
    between them have one point and the same axes: see `fea.coupling.spring_motion`.
    A body that only multipliers hold has no definite stiffness. Three anchors, nodes whose
    components are all in the border, leave a definite stiffness.

    size: number of the body's nodes.
    sections: for each interface its coupling, its section's nodes, shape (s,), and its axes in
    those of the body, shape (3, 3), in rows; None where they are the same. No two share a node.
    active: shape (k,), int64: indices of the interfaces' freedoms that are not locked, ascending.
    anchors: shape (a,), int64: nodes that are in no rigid section.
    frames: number of sections, the last ones, that are frames.
    springs: the indices of one or two sections, and the stiffness, (6, 6), N/m, N/rad and N·m/rad.
    freedoms, motions, border: numbers of unknowns: 6 i of i interfaces; those of the border that
    are motions; all of the border, the multipliers last.
    """

    def __init__(
        self,
        size: int,
        sections: Sequence[tuple[SectionCoupling, np.ndarray, np.ndarray | None]],
        active: np.ndarray,
        anchors: np.ndarray,
        frames: int = 0,
        springs: Sequence[tuple[tuple[int, ...], np.ndarray]] = (),
    ) -> None:
        self.active = active
        self._sprung = PER_INTERFACE * frames
        self.freedoms = PER_INTERFACE * len(sections) - self._sprung
        # The border in its order: active motions of interfaces and all of frames, the anchors'
        # displacements, the sections' multipliers. All sections' motions, and places for their
        # multipliers, are six each in the order of the sections.
        self._moving = np.append(active, self.freedoms + np.arange(self._sprung))
        self.motions = len(self._moving) + 3 * len(anchors)
        self.border = self.motions + sum(section.multipliers for section, _, _ in sections)
        self._anchors = anchors
        self._anchored = np.arange(len(self._moving), self.motions)
        self._size = size
        self._attachments: list[_Attachment] = []
        forced = [np.empty(0, dtype=int)]
        next_multiplier = self.motions
        for number, (section, nodes, axes) in enumerate(sections):
            freedoms = slice(PER_INTERFACE * number, PER_INTERFACE * (number + 1))
            moving = (freedoms.start <= self._moving) & (self._moving < freedoms.stop)
            multipliers = np.arange(section.multipliers)
            chosen = np.append(self._moving[moving] - freedoms.start, PER_INTERFACE + multipliers)
            border = np.append(np.flatnonzero(moving), next_multiplier + multipliers)
            self._attachments.append(_Attachment(section, nodes, axes, freedoms, chosen, border))
            forced.append(freedoms.start + multipliers)
            next_multiplier += section.multipliers
        self._forced = np.concatenate(forced)

        # For each spring the indices of its motions among all, and in the border.
        self._springs: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        for numbers, stiffness in springs:
            ends = [self._attachments[number] for number in numbers]
            at = np.concatenate([np.r_[end.freedoms] for end in ends])
            border = np.concatenate([end.border[:PER_INTERFACE] for end in ends])
            self._springs.append((at, border, stiffness))

    @property
    def constrained(self) -> np.ndarray:
        """Nodes that an interface moves and that are no unknowns, shape (k,), int64, indices."""
        zero = np.zeros(PER_INTERFACE)
        following = [
            attached.nodes
            for attached in self._attachments
            if attached.section.node_positions(zero) is not None
        ]
        return np.concatenate([self._anchors, *following])

    def start(self) -> CoupledState:
        """Return the undeformed state."""
        further = np.zeros(self.freedoms + 2 * self._sprung)
        return CoupledState(np.zeros((self._size, 3)), np.zeros(self.freedoms), further)

    def spring_energy(self, state: CoupledState) -> float:
        """Return the energy of the springs, J."""
        motions, _ = self._unknowns(state)
        parts = [(spring_motion.relative_motion(motions[at])[0], k) for at, _, k in self._springs]
        return float(sum(0.5 * q @ k @ q for q, k in parts))

    def spring_energies(self, border: np.ndarray) -> np.ndarray:
        """Return twice the springs' mutual energies, shape (k, k), J, of motions (border, k)."""
        total = np.zeros((border.shape[1],) * 2)
        for at, where, spring in self._springs:
            motions = spring_motion.relative_motion(np.zeros(len(at)))[1] @ border[where]
            total += motions.T @ spring @ motions
        return total

    def moved(self, state: CoupledState, nodes: np.ndarray, border: np.ndarray) -> CoupledState:
        """Return the state after a correction; rigid sections are placed exactly.

        nodes: shape (n, 3), m: the correction of the free nodes.
        border: shape (border,): the correction of the interface freedoms, m and rad, and
        multipliers, N and N/m.
        """
        motions, multipliers = self._unknowns(state)
        motions[self._moving] += border[: len(self._moving)]
        multipliers[self._forced] += border[self.motions :]
        node_motions = state.nodes + nodes
        node_motions[self._anchors] += border[self._anchored].reshape(-1, 3)
        for attached in self._attachments:
            local = attached.section.node_positions(motions[attached.freedoms])
            if local is not None:
                node_motions[attached.nodes] = attached.outwards(local)
        interface, sprung = np.split(motions, [self.freedoms])
        return CoupledState(node_motions, interface, np.append(multipliers, sprung))

    def residual(
        self, state: CoupledState, forces: np.ndarray, wrench: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the forces out of balance.

        forces: shape (n, 3), N: the internal nodal forces.
        wrench: shape (6 i,), N and N·m.
        Returns nodal: shape (n, 3), N. border: shape (border,): N and N·m for interface freedoms, m
        and m^2 for constraints.
        """
        nodal = forces.copy()
        border = np.zeros(self.border)
        loads = np.append(wrench, np.zeros(self._sprung))
        for attached, local in self._parts(state):
            added, unbalanced = attached.section.residual(
                local, attached.inwards(forces), loads[attached.freedoms]
            )
            nodal[attached.nodes] += attached.outwards(added)
            border[attached.border] = unbalanced[attached.chosen]
        motions, _ = self._unknowns(state)
        for at, where, spring in self._springs:
            q, change = spring_motion.relative_motion(motions[at])
            border[where] += change.T @ (spring @ q)
        border[self._anchored] = nodal[self._anchors].ravel()
        return nodal, border

    def bordered(self, state: CoupledState, forces: np.ndarray, wrench: np.ndarray) -> Border:
        """Return the border of the body's tangent.

        forces: shape (n, 3), N: the internal nodal forces.
        wrench: shape (6 i,), N and N·m.
        """
        # Field by field in memory, for the factorisation.
        constraint, columns = np.moveaxis(np.zeros((2, self.border, self._size, 3)), 1, 3)
        block = np.zeros((self.border, self.border))
        loads = np.append(wrench, np.zeros(self._sprung))
        for attached, local in self._parts(state):
            joined = attached.section.bordered(
                local, attached.inwards(forces), loads[attached.freedoms]
            )
            at = np.ix_(attached.nodes, np.arange(3), attached.border)
            constraint[at] = attached.outwards(joined.constraint[:, :, attached.chosen])
            columns[at] = attached.outwards(joined.columns[:, :, attached.chosen])
            block[np.ix_(attached.border, attached.border)] = joined.block[
                np.ix_(attached.chosen, attached.chosen)
            ]
        motions, _ = self._unknowns(state)
        for at, where, spring in self._springs:
            block[np.ix_(where, where)] += spring_motion.energy_hessian(motions[at], spring)
        pushed = columns[self._anchors].reshape(len(self._anchored), self.border)
        block[self._anchored] += pushed
        block[:, self._anchored] += pushed.T
        constraint[self._anchors[:, None], np.arange(3), self._anchored.reshape(-1, 3)] = 1.0
        return Border(constraint, columns, block)

    def wrench_columns(self, state: CoupledState) -> np.ndarray:
        """Return minus the derivative of the border's residual by the wrench.

        Shape (border, 6 i), dimensionless; rows of constraints are zero.
        """
        columns = np.zeros((self.border, self.freedoms))
        for attached, local in self._parts(state):
            if attached.freedoms.start < self.freedoms:
                columns[attached.border, attached.freedoms] = attached.section.wrench_columns(
                    local
                )[attached.chosen]
        return columns

    def third(
        self,
        state: CoupledState,
        forces: tuple[np.ndarray, np.ndarray],
        fields: np.ndarray,
        border: np.ndarray,
        origin: np.ndarray,
    ) -> np.ndarray:
        """Return the third derivatives of the couplings' energies along k inputs, (k, k, k).

        A section's energy is R : N, with R the interface's rotation and N its `ArmMoments`. Loads
        work on displacements relative to those at an origin: on the vector of R' = R R0^T, so that
        the energy is differentiated as R' : N R0^T. A spring's is `spring_motion`'s.

        state: where the derivatives are taken.
        forces: shapes (n, 3), N, and (n, 3, k): internal nodal forces less dead ones, and their
        change with the inputs at the nodes that are `constrained`.
        fields: shape (n, 3, k), m per unit of each input: change of the nodes with the inputs.
        border: shape (border, k): change of the border's unknowns with the inputs.
        origin: shape (6 i,), m and rad: the interfaces' displacements that count as zero.
        Result: J over the units of three inputs.
        """
        total = np.zeros((border.shape[1],) * 3)
        motions, _ = self._unknowns(state)
        for at, where, spring in self._springs:
            tensor = spring_motion.energy_third_derivatives(motions[at], spring)
            moved = border[where]
            total += np.einsum("ijk,ia,jb,kc->abc", tensor, moved, moved, moved, optimize=True)
        origins = np.append(origin, np.zeros(self._sprung))
        for attached, local in self._parts(state):
            moved = np.zeros((PER_INTERFACE + attached.section.multipliers, border.shape[1]))
            moved[attached.chosen] = border[attached.border]
            acting = attached.inwards(forces[0]), attached.inwards(forces[1])
            moments = attached.section.arm_moments(local, acting, attached.inwards(fields), moved)
            zero = origins[attached.freedoms]
            vector, rates = from_origin(local.interface, zero)
            back = rotation(zero[3:])
            turn = rates[3:, 3:] @ moved[3:PER_INTERFACE]
            total += _third_of_rotation(vector[3:], turn, moments.turned(back))
        return total

    def displacement_rows(self, border: np.ndarray) -> np.ndarray:
        """Pick the interface displacements out of border unknowns: (border, k) -> (6 i, k).

        In m and rad, or both over the unit of a load; locked freedoms are zero.
        """
        rows = np.zeros((self.freedoms, border.shape[1]))
        rows[self.active] = border[: len(self.active)]
        return rows

    def _parts(self, state: CoupledState) -> Iterator[tuple[_Attachment, CoupledState]]:
        """Yield each section with the state of its nodes, in its interface's frame."""
        motions, multipliers = self._unknowns(state)
        for attached in self._attachments:
            nodes = attached.inwards(state.nodes)
            freedoms = attached.freedoms
            yield attached, CoupledState(nodes, motions[freedoms], multipliers[freedoms])

    def _unknowns(self, state: CoupledState) -> tuple[np.ndarray, np.ndarray]:
        """Return copies of the motions and multipliers of interfaces and bushings, six of each."""
        multipliers, sprung = np.split(state.multipliers, [self.freedoms + self._sprung])
        return np.append(state.interface, sprung), multipliers.copy()


def _third_of_rotation(vector: np.ndarray, turned: np.ndarray, arms: ArmMoments) -> np.ndarray:
    """Return the third derivatives of R(r) : N, shape (k, k, k), along changes of r, (3, k).

    By the product rule R_abc : N + sum R_ab : N_c + sum R_a : N_bc; N_abc is zero.
    """
    _, first, second, third = rotation_derivatives(vector)
    once = np.einsum("ixy,xybc,ia->bca", first, arms.second, turned)
    twice = np.einsum("ijxy,xyc,ia,jb->abc", second, arms.changes, turned, turned, optimize=True)
    curvatures = np.einsum("ijkxy,xy->ijk", third, arms.moments)
    thrice = np.einsum("ijk,ia,jb,kc->abc", curvatures, turned, turned, turned, optimize=True)
    return thrice + symmetrised(once + twice)
