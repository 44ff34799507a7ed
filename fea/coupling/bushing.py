"""Bushings: sections on springs to the ground, next to the interface."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from wrenchbook.fea.coupling.coupling import Border, CoupledState, Coupling

Array = np.ndarray


class Mounted(Coupling):
    """The interface's coupling and those of bushings, which have no wrench but a spring.

    A bushing moves by q = (t, r), r its rotation vector, and stores q^T K q / 2. So its force and
    the moment that works on r are K q, and K is the spring's tangent at any rotation. The border
    has the interface's freedoms, those of the bushings, the displacements of anchors, then all
    multipliers; a state's multipliers are the interface's, then each bushing's q and multipliers.

    Parameters
    ----------
    interface
        Its coupling.
    bushings
        Of each the coupling, all six freedoms active, and the stiffness, shape (6, 6), N/m, N/rad
        and N·m/rad, both in the interface frame.
    anchors
        Shape (a,): nodes that are eliminated last, so that the rest is held even where nothing but
        distributed couplings hold the body.
    """

    def __init__(
        self, interface: Coupling, bushings: Sequence[tuple[Coupling, Array]], anchors: Array
    ) -> None:
        self._parts = [interface, *(coupling for coupling, _ in bushings)]
        self._springs = [stiffness for _, stiffness in bushings]
        self._size, self.active, self._anchors = interface._size, interface.active, anchors
        self.multipliers = sum(part.multipliers for part in self._parts)
        freedoms = np.cumsum([0, *(len(part.active) for part in self._parts), 3 * len(anchors)])
        further = freedoms[-1] + np.cumsum([0, *(part.multipliers for part in self._parts)])
        self.border = int(further[-1])
        self._at = [
            np.concatenate([np.arange(*own), np.arange(*more)])
            for own, more in zip(pairwise(freedoms[:-1]), pairwise(further), strict=True)
        ]
        self._anchored = np.arange(*freedoms[-2:])

    @property
    def tied(self) -> Array:
        """Nodes of rigid sections, and anchors: no unknowns of the body, shape (k,), indices."""
        return np.concatenate([*(part.tied for part in self._parts), self._anchors])

    def start(self) -> CoupledState:
        """Return the undeformed state."""
        still = self._parts[0].start()
        return CoupledState(still.nodes, still.interface, np.zeros(6 + 12 * len(self._springs)))

    def moved(self, state: CoupledState, nodes: Array, border: Array) -> CoupledState:
        """Return the state after a correction, shapes (n, 3), m, and (border,), see `Coupling`."""
        change = nodes.copy()
        change[self._anchors] += border[self._anchored].reshape(-1, 3)
        placed, found = state.nodes, []
        for part, at, own in zip(self._parts, self._at, self._states(state), strict=True):
            after = part.moved(CoupledState(placed, *own), change, border[at])
            placed, change = after.nodes, np.zeros_like(change)
            found += [after.interface, after.multipliers]
        return CoupledState(placed, found[0], np.concatenate(found[1:]))

    def residual(self, state: CoupledState, forces: Array, wrench: Array) -> tuple[Array, Array]:
        """Return what is out of balance, shapes (n, 3) and (border,), as of `Coupling`."""
        nodal, border = forces, np.zeros(self.border)
        for part, at, own, load, spring in self._each(state, wrench):
            nodal, rest = part.residual(own, nodal, load)
            border[at] = rest
            border[at[: len(spring)]] += spring @ own.interface[: len(spring)]
        border[self._anchored] = nodal[self._anchors].ravel()
        return nodal, border

    def bordered(self, state: CoupledState, forces: Array, wrench: Array) -> Border:
        """Return how the border joins the body's tangent, of forces (n, 3), N; see `Coupling`."""
        ties, columns = np.zeros((2, self._size, 3, self.border))
        block = np.zeros((self.border, self.border))
        for part, at, own, load, spring in self._each(state, wrench):
            ties[:, :, at], columns[:, :, at], block[np.ix_(at, at)] = part.bordered(
                own, forces, load
            )
            block[np.ix_(at[: len(spring)], at[: len(spring)])] += spring
        ties[np.repeat(self._anchors, 3), np.tile(range(3), len(self._anchors)), self._anchored] = 1
        pushed = columns[self._anchors].reshape(-1, self.border)
        block[self._anchored] += pushed
        block[:, self._anchored] += pushed.T
        return Border(ties, columns, block)

    def wrench_columns(self, state: CoupledState) -> Array:
        """Return minus the derivative of the border's residual by the wrench, (border, 6)."""
        columns = np.zeros((self.border, 6))
        own = CoupledState(state.nodes, *next(self._states(state)))
        columns[self._at[0]] = self._parts[0].wrench_columns(own)
        return columns

    def spring_energies(self, border: Array) -> Array:
        """Return twice the mutual energies of the springs, (k, k), J, of borders (border, k)."""
        motions = zip(self._springs, (border[at[:6]] for at in self._at[1:]), strict=True)
        return sum((q.T @ K @ q for K, q in motions), np.zeros((border.shape[1],) * 2))

    def spring_energy(self, state: CoupledState) -> float:
        """Return the energy of the springs, J."""
        further = state.multipliers[6:].reshape(-1, 2, 6)[:, 0]
        return 0.5 * sum(float(q @ K @ q) for K, q in zip(self._springs, further, strict=True))

    def _states(self, state: CoupledState) -> Iterator[tuple[Array, Array]]:
        """Yield each part's motion and multipliers, (6,) each."""
        yield state.interface, state.multipliers[:6]
        yield from ((own[0], own[1]) for own in state.multipliers[6:].reshape(-1, 2, 6))

    def _each(
        self, state: CoupledState, wrench: Array
    ) -> Iterator[tuple[Coupling, Array, CoupledState, Array, Array]]:
        springs, loads = [np.empty((0, 0)), *self._springs], [wrench]
        loads += [np.zeros(6)] * len(self._springs)
        parts = zip(self._parts, self._at, self._states(state), loads, springs, strict=True)
        for part, at, own, load, spring in parts:
            yield part, at, CoupledState(state.nodes, *own), load, spring
