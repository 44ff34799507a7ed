"""Body and coupling together: equilibrium, and its linearisation at a state."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fea.assembly.body import Body, Tangent
from fea.assembly.condition import scaled_condition, softest_energy, unheld
from fea.coupling import Coupling, State
from fea.failure import mechanism

Array = np.ndarray

_LEAST_PIVOT = 1e-13
"""Stiffness left by elimination, relative to the diagonal, below which there is only roundoff."""


@dataclass(frozen=True, eq=False)
class Balance:
    """A state and the forces in it under one wrench.

    Attributes
    ----------
    state
        The configuration.
    wrench
        Shape (6,), N and N·m.
    forces
        Shape (n, 3), N: internal nodal forces.
    energy
        Strain energy, J.
    least_stretch
        Smallest determinant of the deformation gradient.
    nodal, border
        What is out of balance, at the free nodes (n, 3) and in the border.
    """

    state: State
    wrench: Array
    forces: Array
    energy: float
    least_stretch: float
    nodal: Array
    border: Array

    @property
    def norm(self) -> float:
        """Euclidean norm of the nodal forces out of balance, N."""
        return float(np.linalg.norm(self.nodal))

    @property
    def scale(self) -> float:
        """Euclidean norm of all nodal forces, those of supports and interface with them, N."""
        return float(np.linalg.norm(self.forces))


class System:
    """The equations of one component.

    Parameters
    ----------
    body
        The cells; its free nodes are those neither fixed nor tied by the coupling.
    coupling
        How the wrench gets in.
    places
        Shape (n, 3), m: where the nodes are in the mesh's own axes, for messages.
    """

    def __init__(self, body: Body, coupling: Coupling, places: Array | None = None) -> None:
        self._places = body.points if places is None else places
        self.body = body
        self.coupling = coupling

    @property
    def unknowns(self) -> int:
        """Free nodal unknowns and interface freedoms."""
        return self.body.dissection.unknowns + len(self.coupling.active)

    def balance(self, state: State, wrench: Array) -> Balance:
        """Weigh the internal forces of a state against a wrench."""
        forces, energy, least = self.body.forces(state.nodes)
        return self._balance(state, wrench, forces, energy, least)

    def reload(self, balance: Balance, wrench: Array) -> Balance:
        """Return the balance of the same state under another wrench."""
        return self._balance(
            balance.state, wrench, balance.forces, balance.energy, balance.least_stretch
        )

    def linearise(
        self,
        balance: Balance,
        step: tuple[Array, Array] | None = None,
        reuse: Linearisation | None = None,
    ) -> Linearisation:
        """Return the tangent at a state; for `step` and `reuse` see `Body.tangent`."""
        if step is not None:
            balance = replace(balance, forces=self.body.forces(balance.state.nodes, step)[0])
        tangent = self.body.tangent(
            balance.state.nodes, step, None if reuse is None else reuse.tangent
        )
        return Linearisation(self, balance, tangent)

    @cached_property
    def undeformed(self) -> Linearisation:
        """The linearisation of the undeformed, unloaded state.

        Raises
        ------
        SolveFailed
            ``mechanism`` if the supports leave a motion free, ``ill_conditioned`` if roundoff
            does.
        """
        start = Linearisation(self, self.balance_at_rest, self.body.tangent(None))
        self._require_held(start)
        return start

    @cached_property
    def condition(self) -> float:
        """Estimated condition of the undeformed body's stiffness, scaled to a unit diagonal."""
        return scaled_condition(self.undeformed.tangent)

    @property
    def balance_at_rest(self) -> Balance:
        """The undeformed, unloaded state."""
        state = self.coupling.start()
        return self._balance(state, np.zeros(6), np.zeros_like(state.nodes), 0.0, 1.0)

    def _balance(
        self, state: State, wrench: Array, forces: Array, energy: float, least: float
    ) -> Balance:
        nodal, border = self.coupling.residual(state, forces, wrench)
        nodal = np.where(self.body.free[:, None], nodal, 0.0)
        return Balance(state, wrench, forces, energy, least, nodal, border)

    def _require_held(self, start: Linearisation) -> None:
        factor = start.tangent.factor
        if factor.pivot_ratio < _LEAST_PIVOT:
            energy = softest_energy(self.body, start.tangent)
            raise unheld(f"Near {self._place(factor.weakest)} m the mesh", energy)
        if not np.isfinite(start.compliance).all():
            raise unheld("The interface", 0.0)
        if start.interface_ratio < _LEAST_PIVOT:
            raise unheld("The interface", start.softest_interface_energy)

    def _place(self, position: int) -> str:
        node = self.body.dissection.nodes[position // 3] if position >= 0 else 0
        return "(" + ", ".join(f"{x:.4g}" for x in self._places[node]) + ")"


class Linearisation:
    """The tangent at one state, bordered by the coupling.

    With the body's stiffness K, the border's columns C and block D, it solves
    [[K, C], [C^T, D]] by the Schur complement S = D - C^T K^-1 C.

    `interface_ratio` is what elimination left of the border's stiffness, relative to its own; near
    roundoff nothing holds the interface.
    """

    def __init__(self, system: System, balance: Balance, tangent: Tangent) -> None:
        self._system = system
        self.state = balance.state
        self.tangent = tangent
        coupling = system.coupling
        self.border = coupling.bordered(balance.state, balance.forces, balance.wrench)
        pushed = tangent.times(self.border.ties, coupling.tied)
        columns = pushed + self.border.columns
        self._columns = np.where(system.body.free[:, None, None], columns, 0.0)
        self._block = contract(self.border.ties, pushed) + self.border.block

    @cached_property
    def _solved(self) -> Array:
        return self.tangent.solve(self._columns)

    @cached_property
    def schur(self) -> Array:
        """The border's condensed stiffness."""
        return self._block - contract(self._columns, self._solved)

    @property
    def interface_ratio(self) -> float:
        """Least eigenvalue of the condensed stiffness, scaled by the border's own diagonal."""
        return self._softest_interface[0]

    @property
    def softest_interface_energy(self) -> float:
        """Strain energy of the interface's softest motion, relative to that of the border alone."""
        border = self._softest_interface[1]
        field = self.border.ties @ border - self._solved @ border
        energy = self._system.body.strain_energy_products(field[:, :, None])[0, 0]
        return float(energy / (border @ (np.diagonal(self._block) * border)))

    @property
    def _softest_interface(self) -> tuple[float, Array]:
        own = np.diagonal(self._block)
        if not own.size or (own <= 0).any():
            return 1.0, np.zeros(own.size)
        scale = 1.0 / np.sqrt(own)
        scaled = self.schur * scale[:, None] * scale
        ratios, motions = np.linalg.eigh(0.5 * (scaled + scaled.T))
        return float(ratios[0]), scale * motions[:, 0]

    @property
    def stable(self) -> bool:
        """Whether every small disturbance costs energy: body and interface both.

        A body that is unstable by itself may be held by its section: then the constraints, and
        nothing else, give the bordered matrix its negative eigenvalues.
        """
        factor, coupling = self.tangent.factor, self._system.coupling
        if factor.definite:
            return self._least_compliance > 0
        constraints = coupling.border - coupling.active.size
        if not constraints or not np.isfinite(self.schur).all():
            return False
        own = np.linalg.eigvalsh(self.schur + self.schur.T)
        return factor.negatives + int((own < 0).sum()) == constraints

    @property
    def _least_compliance(self) -> float:
        """Least eigenvalue of the interface's compliance (to spins), scaled to a unit diagonal."""
        active = self._system.coupling.active
        if not active.size:
            return 1.0
        full = self.wrench_columns.T @ self.border_response
        own = 0.5 * (full + full.T)[np.ix_(active, active)]
        diagonal = np.diagonal(own)
        if (diagonal <= 0).any():
            return -1.0
        scale = 1.0 / np.sqrt(diagonal)
        return float(np.linalg.eigvalsh(own * scale[:, None] * scale)[0])

    def correction(self, balance: Balance) -> tuple[Array, Array]:
        """Return the changes of nodes and border that bring a nearby state into balance."""
        nodes, border = self.solve(balance.nodal[:, :, None], balance.border[:, None])
        return -nodes[:, :, 0], -border[:, 0]

    def solve(self, nodal: Array, border: Array) -> tuple[Array, Array]:
        """Solve the bordered equations for k load cases.

        Parameters
        ----------
        nodal
            Shape (n, 3, k), N.
        border
            Shape (border, k).

        Returns
        -------
        nodes
            Shape (n, 3, k), m: of the free nodes; the others are zero.
        border
            Shape (border, k).
        """
        moved = self.tangent.solve(nodal)
        carried = self._solve_border(border - contract(self._columns, moved))
        return moved - self._solved @ carried, carried

    @cached_property
    def border_response(self) -> Array:
        """Change of the border per change of the wrench, shape (border, 6)."""
        return self._solve_border(self.wrench_columns)

    @property
    def wrench_columns(self) -> Array:
        """Change of the border's load per change of the wrench, none for locked freedoms."""
        coupling = self._system.coupling
        columns = np.zeros((coupling.border, 6))
        columns[:, coupling.active] = coupling.wrench_columns(self.state)[:, coupling.active]
        return columns

    @property
    def compliance(self) -> Array:
        """Change of the interface displacement per change of the wrench, shape (6, 6)."""
        return self._system.coupling.displacement_rows(self.border_response)

    def _solve_border(self, loads: Array) -> Array:
        """Solve with S, its rows and columns scaled to one size: they mix m, rad, N and N·m."""
        scale = np.ones(len(loads))
        for _ in range(3):
            largest = np.abs(self.schur * scale[:, None] * scale).max(axis=1, initial=0.0)
            scale /= np.sqrt(np.where(largest > 0, largest, 1.0))
        try:
            scaled = np.linalg.solve(self.schur * scale[:, None] * scale, scale[:, None] * loads)
        except np.linalg.LinAlgError:
            raise mechanism("The interface can move without any resistance.") from None
        return scale[:, None] * scaled


def contract(first: Array, second: Array) -> Array:
    """Sum over nodes and components: (n, 3, j), (n, 3, k) -> (j, k)."""
    size = 3 * len(first)
    return first.reshape(size, first.shape[2]).T @ second.reshape(size, second.shape[2])
