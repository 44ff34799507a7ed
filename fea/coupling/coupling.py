"""The coupling of all interfaces, its state, and the border that it adds to the equations."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

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


def rotations_in(size: int) -> list[slice]:
    """Return the places of the rotation vectors, or moments, among `size` = 6 i displacements."""
    return [slice(end - 3, end) for end in range(PER_INTERFACE, size + 1, PER_INTERFACE)]


def largest_rotation(displacement: np.ndarray) -> float:
    """Return the largest rotation, rad, among displacements of shape (6 i,), m and rad."""
    return float(max(np.linalg.norm(interface[3:]) for interface in each_interface(displacement)))


def from_origin(interface: np.ndarray, origin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return displacements (6 i,) relative to those at `origin`, and their derivatives by them.

    The relative rotation is R R0^T. Derivatives: shape (6 i, 6 i).
    """
    moved = interface - origin
    rates = np.eye(len(interface))
    for turn in rotations_in(len(interface)):
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
    # Shape (6 (i + f),), N and N/m: multipliers (l, m) of the distributed couplings of interfaces,
    # then of frames: node i feels w_i (l + m x b_i). Zero for rigid ones.
    multipliers: np.ndarray
    # Shape (6 f,), m and rad: translation and rotation vector of each of the f frames
    frames: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def motions(self) -> np.ndarray:
        """A copy of the motions of interfaces, then of frames, shape (6 (i + f),), m and rad."""
        return np.append(self.interface, self.frames)


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
    border is six freedoms, with locked ones, and the multipliers.
    """

    n_multipliers: ClassVar = 0
    constrains: ClassVar = False
    """Whether the interface alone places the section's nodes, which are no unknowns then."""

    def __init__(self, points: np.ndarray) -> None:
        self.points = points

    def node_positions(self, interface: np.ndarray) -> np.ndarray | None:
        """Return the displacements, (s, 3), m, by an interface at (6,), if it `constrains` them."""
        return None

    @abstractmethod
    def residual(
        self, state: CoupledState, forces: np.ndarray, wrench: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the coupling's nodal forces, and the forces out of balance in the border.

        Internal forces have shape (s, 3), N, the wrench (6,), N and N·m; the results (s, 3), N, and
        (6 + n_multipliers,): N and N·m for interface freedoms, m and m^2 for constraints.
        """

    @abstractmethod
    def bordered(self, state: CoupledState, forces: np.ndarray, wrench: np.ndarray) -> Border:
        """Return the border of the body's tangent.

        Internal forces have shape (s, 3), N, the wrench (6,), N and N·m.
        """

    @abstractmethod
    def wrench_columns(self, state: CoupledState) -> np.ndarray:
        """Return minus the derivative of the border's residual by the wrench.

        Shape (6 + n_multipliers, 6), dimensionless; rows of constraints are zero.
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
        border: shape (6 + n_multipliers, k): the border's change with them.
        """


class _Attachment(NamedTuple):
    """A section's indices in the body and in the border."""

    section: SectionCoupling
    nodes: np.ndarray  # shape (s,): nodes of the section
    # (3, 3): turns a vector of the body to the interface's axes; None if they are the same.
    rotation: np.ndarray | None
    motions: slice  # this interface's or frame's six motions among all
    unknowns: np.ndarray  # indices in the section's border of all but locked freedoms
    border_indices: np.ndarray  # indices of these in the complete border

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


class _Spring(NamedTuple):
    """A spring from one frame to the ground, or between two."""

    motions: np.ndarray  # shape (6,) or (12,): indices of its frames' motions among all
    border_indices: np.ndarray  # of the same shape: their indices in the border
    stiffness: np.ndarray  # shape (6, 6), N/m, N/rad and N·m/rad


class Coupling:
    """Interfaces and frames: one border of their motions, of anchors, and of multipliers.

    Nodes and forces are in the body's frame, displacements and wrenches in the interfaces'.
    Frames have no wrench; springs hold them to the ground or to each other. A bushing moves by q,
    translation and rotation vector, and stores q^T K q / 2: its force, and the moment that works on
    the rotation vector, are K q, and K is its tangent at any rotation. Two frames with a spring
    between them have one point and the same axes: see `fea.coupling.spring_motion`.
    A body that only multipliers hold has no definite stiffness. Three anchors, nodes whose
    components are all in the border, leave a definite stiffness.

    size: number of the body's nodes.
    sections: for each interface, then each frame, its coupling, its section's nodes, shape (s,),
    and its axes in those of the body, shape (3, 3), in rows; None where they are the same. No two
    share a node.
    active: shape (k,), int64: indices of the interfaces' freedoms that are not locked, ascending.
    anchors: shape (a,), int64: nodes that are in no rigid section.
    n_frames: number of sections, the last ones, that are frames.
    springs: for each the indices of one or two sections, and its stiffness, shape (6, 6), N/m,
    N/rad and N·m/rad.

    Its attributes:
    n_freedoms: 6 i for i interfaces, with locked ones.
    n_motions: unknowns of the border that are displacements, in this order: active freedoms of
    interfaces, all of frames, components of anchors.
    n_border: all unknowns of the border: these, then the sections' multipliers.
    """

    def __init__(
        self,
        size: int,
        sections: Sequence[tuple[SectionCoupling, np.ndarray, np.ndarray | None]],
        active: np.ndarray,
        anchors: np.ndarray,
        n_frames: int = 0,
        springs: Sequence[tuple[tuple[int, ...], np.ndarray]] = (),
    ) -> None:
        self.active = active
        self._n_frame_motions = PER_INTERFACE * n_frames
        self.n_freedoms = PER_INTERFACE * len(sections) - self._n_frame_motions
        self._active_motions = np.append(active, self.n_freedoms + np.arange(self._n_frame_motions))
        self.n_motions = len(self._active_motions) + 3 * len(anchors)
        self.n_border = self.n_motions + sum(section.n_multipliers for section, _, _ in sections)
        self._anchors = anchors
        self._anchored = np.arange(len(self._active_motions), self.n_motions)
        self._size = size

        # A state has six motions and six multipliers of every section; the border has those that
        # are unknowns.
        self._attachments: list[_Attachment] = []
        in_state = [np.empty(0, dtype=int)]  # indices in a state of the border's multipliers
        next_multiplier = self.n_motions
        for number, (section, nodes, axes) in enumerate(sections):
            motions = slice(PER_INTERFACE * number, PER_INTERFACE * (number + 1))
            of_section = np.flatnonzero(self._active_motions // PER_INTERFACE == number)
            multipliers = np.arange(section.n_multipliers)
            freedoms = self._active_motions[of_section] - motions.start
            unknowns = np.append(freedoms, PER_INTERFACE + multipliers)
            border = np.append(of_section, next_multiplier + multipliers)
            self._attachments.append(_Attachment(section, nodes, axes, motions, unknowns, border))
            in_state.append(motions.start + multipliers)
            next_multiplier += section.n_multipliers
        self._multiplier_indices = np.concatenate(in_state)

        self._springs: list[_Spring] = []
        for numbers, stiffness in springs:
            ends = [self._attachments[number] for number in numbers]
            motions = np.concatenate([np.r_[end.motions] for end in ends])
            border = np.concatenate([end.border_indices[:PER_INTERFACE] for end in ends])
            self._springs.append(_Spring(motions, border, stiffness))

    @property
    def constrained(self) -> np.ndarray:
        """Nodes that an interface moves and that are no unknowns, shape (k,), int64, indices."""
        following = [part.nodes for part in self._attachments if part.section.constrains]
        return np.concatenate([self._anchors, *following])

    def start(self) -> CoupledState:
        """Return the undeformed state."""
        interface, frames = np.zeros(self.n_freedoms), np.zeros(self._n_frame_motions)
        multipliers = np.zeros(self.n_freedoms + self._n_frame_motions)
        return CoupledState(np.zeros((self._size, 3)), interface, multipliers, frames)

    def spring_energy(self, state: CoupledState) -> float:
        """Return the energy of the springs, J."""
        energy = 0.0
        for spring in self._springs:
            q, _ = spring_motion.relative_motion(state.motions[spring.motions])
            energy += float(0.5 * q @ spring.stiffness @ q)
        return energy

    def spring_energies(self, border: np.ndarray) -> np.ndarray:
        """Return twice the springs' mutual energies, shape (k, k), J, of motions (border, k)."""
        total = np.zeros((border.shape[1],) * 2)
        for spring in self._springs:
            at_zero = np.zeros(len(spring.motions))
            motions = spring_motion.relative_motion(at_zero)[1] @ border[spring.border_indices]
            total += motions.T @ spring.stiffness @ motions
        return total

    def moved(self, state: CoupledState, nodes: np.ndarray, border: np.ndarray) -> CoupledState:
        """Return the state after a correction; rigid sections are placed exactly.

        nodes: shape (n, 3), m: the correction of the free nodes.
        border: shape (border,): the correction of the border's unknowns, m, rad, N and N/m.
        """
        motions, multipliers = state.motions, state.multipliers.copy()
        motions[self._active_motions] += border[: len(self._active_motions)]
        multipliers[self._multiplier_indices] += border[self.n_motions :]
        node_motions = state.nodes + nodes
        node_motions[self._anchors] += border[self._anchored].reshape(-1, 3)
        for attached in self._attachments:
            local = attached.section.node_positions(motions[attached.motions])
            if local is not None:
                node_motions[attached.nodes] = attached.outwards(local)
        interface, frames = np.split(motions, [self.n_freedoms])
        return CoupledState(node_motions, interface, multipliers, frames)

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
        border = np.zeros(self.n_border)
        loads = np.append(wrench, np.zeros(self._n_frame_motions))
        for attached, local in self._parts(state):
            added, unbalanced = attached.section.residual(
                local, attached.inwards(forces), loads[attached.motions]
            )
            nodal[attached.nodes] += attached.outwards(added)
            border[attached.border_indices] = unbalanced[attached.unknowns]
        for spring in self._springs:
            q, change = spring_motion.relative_motion(state.motions[spring.motions])
            border[spring.border_indices] += change.T @ (spring.stiffness @ q)
        border[self._anchored] = nodal[self._anchors].ravel()
        return nodal, border

    def bordered(self, state: CoupledState, forces: np.ndarray, wrench: np.ndarray) -> Border:
        """Return the border of the body's tangent.

        forces: shape (n, 3), N: the internal nodal forces.
        wrench: shape (6 i,), N and N·m.
        """
        # Field by field in memory, for the factorisation.
        constraint, columns = np.moveaxis(np.zeros((2, self.n_border, self._size, 3)), 1, 3)
        block = np.zeros((self.n_border, self.n_border))
        loads = np.append(wrench, np.zeros(self._n_frame_motions))
        for attached, local in self._parts(state):
            added = attached.section.bordered(
                local, attached.inwards(forces), loads[attached.motions]
            )
            at = np.ix_(attached.nodes, np.arange(3), attached.border_indices)
            constraint[at] = attached.outwards(added.constraint[:, :, attached.unknowns])
            columns[at] = attached.outwards(added.columns[:, :, attached.unknowns])
            block[np.ix_(attached.border_indices, attached.border_indices)] = added.block[
                np.ix_(attached.unknowns, attached.unknowns)
            ]
        for spring in self._springs:
            hessian = spring_motion.energy_hessian(state.motions[spring.motions], spring.stiffness)
            block[np.ix_(spring.border_indices, spring.border_indices)] += hessian
        of_anchors = columns[self._anchors].reshape(len(self._anchored), self.n_border)
        block[self._anchored] += of_anchors
        block[:, self._anchored] += of_anchors.T
        constraint[self._anchors[:, None], np.arange(3), self._anchored.reshape(-1, 3)] = 1.0
        return Border(constraint, columns, block)

    def wrench_columns(self, state: CoupledState) -> np.ndarray:
        """Return minus the derivative of the border's residual by the wrench.

        Shape (border, 6 i), dimensionless; rows of constraints are zero.
        """
        columns = np.zeros((self.n_border, self.n_freedoms))
        for attached, local in self._parts(state):
            if attached.motions.start < self.n_freedoms:
                columns[attached.border_indices, attached.motions] = (
                    attached.section.wrench_columns(local)[attached.unknowns]
                )
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
        for spring in self._springs:
            tensor = spring_motion.energy_third_derivatives(
                state.motions[spring.motions], spring.stiffness
            )
            moved = border[spring.border_indices]
            total += np.einsum("ijk,ia,jb,kc->abc", tensor, moved, moved, moved, optimize=True)
        origins = np.append(origin, np.zeros(self._n_frame_motions))
        for attached, local in self._parts(state):
            moved = np.zeros((PER_INTERFACE + attached.section.n_multipliers, border.shape[1]))
            moved[attached.unknowns] = border[attached.border_indices]
            acting = attached.inwards(forces[0]), attached.inwards(forces[1])
            moments = attached.section.arm_moments(local, acting, attached.inwards(fields), moved)
            zero = origins[attached.motions]
            vector, rates = from_origin(local.interface, zero)
            back = rotation(zero[3:])
            turn = rates[3:, 3:] @ moved[3:PER_INTERFACE]
            total += _third_of_rotation(vector[3:], turn, moments.turned(back))
        return total

    def displacement_rows(self, border: np.ndarray) -> np.ndarray:
        """Pick the interface displacements out of border unknowns: (border, k) -> (6 i, k).

        In m and rad, or both over the unit of a load; locked freedoms are zero.
        """
        rows = np.zeros((self.n_freedoms, border.shape[1]))
        rows[self.active] = border[: len(self.active)]
        return rows

    def _parts(self, state: CoupledState) -> Iterator[tuple[_Attachment, CoupledState]]:
        """Yield each section with the state of its nodes, in its interface's frame."""
        for attached in self._attachments:
            nodes, at = attached.inwards(state.nodes), attached.motions
            yield attached, CoupledState(nodes, state.motions[at], state.multipliers[at])


def _third_of_rotation(vector: np.ndarray, turned: np.ndarray, arms: ArmMoments) -> np.ndarray:
    """Return the third derivatives of R(r) : N, shape (k, k, k), along changes of r, (3, k).

    By the product rule R_abc : N + sum R_ab : N_c + sum R_a : N_bc. N_abc is zero: N of a
    distributed section is bilinear in its multipliers and displacements, and that of a rigid one
    linear in the nodal forces, whose own derivatives are part of the body's.
    """
    _, first, second, third = rotation_derivatives(vector)
    once = np.einsum("ixy,xybc,ia->bca", first, arms.second, turned)
    twice = np.einsum("ijxy,xyc,ia,jb->abc", second, arms.changes, turned, turned, optimize=True)
    curvatures = np.einsum("ijkxy,xy->ijk", third, arms.moments)
    thrice = np.einsum("ijk,ia,jb,kc->abc", curvatures, turned, turned, turned, optimize=True)
    return thrice + symmetrised(once + twice)
