"""The base class of the couplings, the state that they move and the border that they add."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class CoupledState:
    """One configuration.

    Attributes
    ----------
    nodes
        Shape (n, 3), m: nodal displacements.
    interface
        Shape (6,), m and rad: translation and rotation vector of the interface.
    multipliers
        Shape (6,), N and N/m: a distributed coupling's; node i feels w_i (l + m x b_i). Zero in a
        rigid one. With bushings each one's own motion and multipliers follow.
    """

    nodes: Array
    interface: Array
    multipliers: Array


class Border(NamedTuple):
    """How the border joins the body's tangent K at one state.

    With ties T, columns c and block d the whole tangent is
    [[K, K T + c], [(K T + c)^T, T^T K T + d]].

    Attributes
    ----------
    ties
        Shape (n, 3, border): how nodes that are no unknowns move with the border; dimensionless for
        translations, m/rad for rotations.
    columns
        Shape (n, 3, border): the border's forces on free nodes, N over the unit of each unknown.
    block
        Shape (border, border): J over the units of both unknowns, so N/m, N and N·m for interface
        freedoms.
    """

    ties: Array
    columns: Array
    block: Array


class Coupling(ABC):
    """Base class of the couplings.

    Parameters
    ----------
    points
        Shape (n, 3), m, measured from the interface point.
    nodes
        Shape (k,): the section's nodes.
    active
        Shape (k,), int64: indices of the interface freedoms that are not locked, ascending.
    """

    multipliers = 0
    """Number of multipliers; the border unknowns are the active freedoms and these."""

    def __init__(self, points: Array, nodes: Array, active: Array) -> None:
        self.active = active
        self.border = len(active) + self.multipliers
        self._size = len(points)
        self._nodes = nodes

    @property
    def tied(self) -> Array:
        """Nodes that follow the interface and are no unknowns, shape (k,), int64, indices."""
        return self._nodes[:0]

    def start(self) -> CoupledState:
        """Return the undeformed state."""
        return CoupledState(np.zeros((self._size, 3)), np.zeros(6), np.zeros(6))

    def spring_energies(self, border: Array) -> Array | float:
        """Return twice the mutual energies of springs in the coupling, shape (k, k), J.

        Borders have shape (border, k).
        """
        return 0.0

    def spring_energy(self, state: CoupledState) -> float:
        """Return the energy of springs in the coupling, J."""
        return 0.0

    @abstractmethod
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

    @abstractmethod
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

    @abstractmethod
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

    @abstractmethod
    def wrench_columns(self, state: CoupledState) -> Array:
        """Return minus the derivative of the border's residual by the wrench.

        Shape (border, 6), dimensionless; rows of constraints are zero.
        """

    def displacement_rows(self, border: Array) -> Array:
        """Pick the interface displacement out of border unknowns: (border, k) -> (6, k).

        In m and rad, or both over the unit of a load; locked freedoms are zero.
        """
        rows = np.zeros((6, border.shape[1]))
        rows[self.active] = border[: len(self.active)]
        return rows
