"""How the rigid side holds the section of the deformable body.

A coupling adds a few unknowns, the *border*, to the body's free nodes: the interface displacement
(and multipliers). The body's stiffness stays sparse and positive definite; the border is eliminated
last, by its Schur complement, which is also where the 6x6 tangent compliance comes from.

All vectors are in the undeformed interface frame, its origin at the interface point.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from fea.coupling.distributed import Distributed
from fea.coupling.rigid import Rigid
from fea.coupling.state import Border, State

Array = np.ndarray

__all__ = ["Border", "Coupling", "Distributed", "Rigid", "State"]


class Coupling(Protocol):
    """What the analyses ask of a coupling."""

    active: Array
    """Indices of the interface freedoms that are not locked."""
    border: int
    """Number of border unknowns."""

    @property
    def tied(self) -> Array:
        """Nodes that follow the interface and are no unknowns of their own."""
        ...

    def start(self) -> State:
        """Return the undeformed state."""
        ...

    def moved(self, state: State, nodes: Array, border: Array) -> State:
        """Return the state after a correction of the nodes, shape (n, 3), and the border."""
        ...

    def residual(self, state: State, forces: Array, wrench: Array) -> tuple[Array, Array]:
        """Return what is out of balance: at the nodes, shape (n, 3), and in the border."""
        ...

    def bordered(self, state: State, forces: Array, wrench: Array) -> Border:
        """Return how the border joins the body's tangent."""
        ...

    def wrench_columns(self, state: State) -> Array:
        """Return minus the derivative of the border's residual by the wrench, (border, 6)."""
        ...

    def displacement_rows(self, border: Array) -> Array:
        """Pick the interface displacement out of border unknowns: (border, k) -> (6, k)."""
        ...
