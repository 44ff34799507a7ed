"""Body and coupling together: equilibrium, its linearisation at a state, and its condition."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from wrenchbook.fea.assembly.body import ElasticBody, Tangent
from wrenchbook.fea.assembly.linearisation import Balance, Linearisation
from wrenchbook.fea.coupling import CoupledState, Coupling
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.spec.problems import point_text

_MIN_PIVOT = 1e-13
"""Stiffness left by elimination, relative to the diagonal, below which there is only roundoff."""


class System:
    """The equations of one component.

    body: the cells; its free nodes are those neither fixed nor constrained by the coupling.
    coupling: the interfaces and bushings.
    points: shape (n, 3), m: the nodes' coordinates in the mesh's axes, for messages.
    weight: shape (n, 3), N: the nodal forces of self-weight; None without.
    preload: shape (n, 3), N: the forces of bolts on their slips; None without.
    body_force: shape (n, 3, p), N: nodal forces per unit of each input acceleration; None without.
    All these keep their direction: `Balance.forces` are the internal forces less these.
    """

    def __init__(
        self,
        body: ElasticBody,
        coupling: Coupling,
        points: np.ndarray | None = None,
        weight: np.ndarray | None = None,
        body_force: np.ndarray | None = None,
        preload: np.ndarray | None = None,
    ) -> None:
        self._points = body.points if points is None else points
        self.body = body
        self.coupling = coupling
        self.weight = weight
        self.preload = preload
        self.body_force = np.zeros((body.size, 3, 0)) if body_force is None else body_force

    @property
    def n_inputs(self) -> int:
        """Number of inputs: six loads an interface, the temperature if any, accelerations."""
        return self.coupling.n_freedoms + self.body.expands + self.body_force.shape[2]

    def temperature(self, inputs: np.ndarray) -> float:
        """Return the temperature among inputs, shape (k,), K from the reference."""
        return float(inputs[self.coupling.n_freedoms]) if self.body.expands else 0.0

    @property
    def unknowns(self) -> int:
        """Free nodal unknowns and freedoms of interfaces and bushings."""
        return self.body.dissection.unknowns + self.coupling.n_motions

    def balance(self, state: CoupledState, wrench: np.ndarray) -> Balance:
        """Return the residual of a state under inputs, shape (k,): see `Balance.wrench`."""
        forces, energy, least = self._forces(state.nodes, wrench)
        energy += self.coupling.spring_energy(state)
        return self._balance(state, wrench, forces, energy, least)

    def _forces(
        self,
        nodes: np.ndarray,
        wrench: np.ndarray,
        step: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> tuple[np.ndarray, float, float]:
        forces, energy, least = self.body.at(self.temperature(wrench)).forces(nodes, step)
        return forces - self.dead_forces(wrench), energy, least

    def dead_forces(self, inputs: np.ndarray) -> np.ndarray:
        """Return the nodal forces of weight, bolts and acceleration, (n, 3), N, of inputs (k,)."""
        forces = self.body_force @ inputs[self.coupling.n_freedoms + self.body.expands :]
        for constant in (self.weight, self.preload):
            forces = forces if constant is None else forces + constant
        return forces

    def reload(self, balance: Balance, wrench: np.ndarray) -> Balance:
        """Return the balance of the same state under other inputs, shape (k,)."""
        first = self.coupling.n_freedoms
        if (wrench[first:] != balance.wrench[first:]).any():
            return self.balance(balance.state, wrench)
        return self._balance(
            balance.state, wrench, balance.forces, balance.energy, balance.least_stretch
        )

    def linearise(
        self, balance: Balance, step: tuple[np.ndarray, np.ndarray] | None = None
    ) -> Linearisation:
        """Return the tangent at a state.

        step: the last step of Newton's method, two fields of shape (n, 3), m: see
        `ElasticBody.tangent`.
        """
        body = self.body.at(self.temperature(balance.wrench))
        if step is not None:
            balance = replace(
                balance, forces=self._forces(balance.state.nodes, balance.wrench, step)[0]
            )
        tangent = body.tangent(balance.state.nodes, step)
        return Linearisation(self.body, self.coupling, balance, tangent, self.body_force)

    @cached_property
    def undeformed(self) -> Linearisation:
        """The linearisation of the undeformed, unloaded state.

        Raises SolveFailed of kind ``mechanism`` if the supports leave a motion free, and of kind
        ``ill_conditioned`` if the stiffness is singular to roundoff.
        """
        tangent = self.body.tangent(None)
        start = Linearisation(
            self.body, self.coupling, self.balance_at_rest, tangent, self.body_force
        )
        if start.tangent.factor.pivot_ratio < _MIN_PIVOT:
            energy = softest_energy(self.body, start.tangent)
            weakest = start.tangent.factor.weakest
            node = self.body.dissection.nodes[weakest // 3] if weakest >= 0 else 0
            raise unheld(f"Near {point_text(self._points[node])} m the mesh", energy)
        if not np.isfinite(start.compliance).all():
            raise unheld("The interface", 0.0)
        if start.interface_ratio < _MIN_PIVOT:
            raise unheld("The interface", start.softest_interface_energy)
        self._condition = scaled_condition(start.tangent)  # uses the factor before its release
        return start

    @property
    def condition(self) -> float:
        """Estimated condition of the undeformed body's stiffness, scaled to a unit diagonal."""
        _ = self.undeformed
        return self._condition

    @property
    def balance_at_rest(self) -> Balance:
        """The undeformed, unloaded state."""
        state = self.coupling.start()
        return self._balance(state, np.zeros(self.n_inputs), np.zeros_like(state.nodes), 0.0, 1.0)

    def thermal_energy(self, balance: Balance) -> float:
        """Return the strain energy less that of the same displacement without temperature, J."""
        if not self.body.expands:
            return 0.0
        cold = balance.wrench.copy()
        cold[self.coupling.n_freedoms] = 0.0
        return balance.energy - self.balance(balance.state, cold).energy

    @cached_property
    def thermal_at_rest(self) -> tuple[np.ndarray, float]:
        """Internal forces, (n, 3), N/K, and energy, J/K², by temperature in the undeformed body."""
        undeformed = np.zeros((self.body.size, 3))
        return self.body.thermal_rates(undeformed)[0], self._per_kelvin[1]

    @cached_property
    def _per_kelvin(self) -> tuple[float, float]:
        """`Balance.thermal` of one kelvin: norm, N, and energy, J, which grows with the square."""
        forces, energy, _ = self.body.at(1.0, finite=False).forces(np.zeros((self.body.size, 3)))
        return float(np.linalg.norm(forces)), energy

    def _balance(
        self,
        state: CoupledState,
        wrench: np.ndarray,
        forces: np.ndarray,
        energy: float,
        least: float,
    ) -> Balance:
        """Return the residual of a state.

        forces: shape (n, 3), N: internal nodal forces. energy: J. least: least det F.
        """
        nodal, border = self.coupling.residual(state, forces, wrench[: self.coupling.n_freedoms])
        nodal = self.body.movable.released(nodal)
        thermal = (0.0, 0.0)
        temperature = self.temperature(wrench)
        if temperature:
            norm, energy_per_kelvin = self._per_kelvin
            thermal = abs(temperature) * norm, temperature**2 * energy_per_kelvin
        return Balance(state, wrench, forces, energy, least, nodal, border, thermal)


ROUNDOFF = float(np.finfo(float).eps)
"""Relative spacing of double precision; times a condition number the relative error of a solve."""

MECHANISM = 1e-22
"""Strain energy of the softest motion, relative, below which it is the square of roundoff."""

_POWER_STEPS = 3  # steps of inverse iteration; a mechanism, far softer than all else, needs one


def scaled_condition(tangent: Tangent) -> float:
    """Estimate the condition of a stiffness matrix scaled to a unit diagonal, in the 1-norm.

    The norm of the inverse is Hager's estimate after its first step, with the factor at hand
    (Higham, "Accuracy and stability of numerical algorithms", chapter 15), hardly ever more than
    three times too small; the norm of the matrix is that of its cells' absolute values, an upper
    bound. Infinite if the matrix is not definite.
    """
    factor = tangent.factor
    if not factor.unknowns:
        return 1.0
    if not factor.definite:
        return np.inf
    scale = np.sqrt(factor.diagonal)

    def inverse(load: np.ndarray) -> np.ndarray:
        return scale * factor.solve((scale * load)[:, None])[:, 0]

    signs = np.where(inverse(np.ones(factor.unknowns)) < 0, -1.0, 1.0)
    column = np.zeros(factor.unknowns)
    column[np.abs(inverse(signs)).argmax()] = 1.0
    return float(np.abs(inverse(column)).sum()) * tangent.scaled_norm


def softest_energy(body: ElasticBody, tangent: Tangent) -> float:
    """Return the strain energy of the softest motion, relative to that of its single nodes.

    The motion comes from the factor by inverse iteration, its energy from its strains. The strains
    of a mechanism are roundoff, so that their energy is its square, many digits below that of a
    part that is merely slender.
    """
    factor = tangent.factor
    motion = np.zeros((factor.unknowns, 1))
    motion[factor.weakest] = 1.0
    for _ in range(_POWER_STEPS):
        # The code below checks for infinite numbers.
        with np.errstate(over="ignore", invalid="ignore"):
            motion = factor.solve(motion)
        if not np.isfinite(motion).all() or not motion.any():
            return 0.0
        motion /= np.abs(motion).max()
    field = np.zeros((body.size, 3, 1))
    field[body.dissection.nodes] = motion.reshape(-1, 3, 1)
    return float(body.strain_energy_products(field)[0, 0] / (factor.diagonal @ motion[:, 0] ** 2))


def unheld(subject: str, energy: float) -> SolveFailed:
    """Return the error of a motion without stiffness after elimination.

    energy: relative strain energy of that motion.
    """
    if energy < MECHANISM:
        return SolveFailed("mechanism", f"{subject} can move without any resistance.")
    return SolveFailed(
        "ill_conditioned",
        f"{subject} has almost no resistance: {energy:.0e} of the stiffness around it, which is "
        "roundoff.",
    )
