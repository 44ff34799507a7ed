"""The tangent at one state, bordered by the coupling: corrections, compliance and stability."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from wrenchbook.fea.assembly.body import ElasticBody, Tangent
from wrenchbook.fea.coupling import CoupledState, Coupling
from wrenchbook.fea.failure import SolveFailed


@dataclass(frozen=True, eq=False)
class Balance:
    """A state and the forces in it under one wrench."""

    state: CoupledState  # the displaced state
    # Shape (k,): the inputs, N and N·m of i interfaces; then the temperature, K from the reference,
    # if the body expands, and the accelerations that are inputs, m/s^2.
    wrench: np.ndarray
    forces: np.ndarray  # shape (n, 3), N: internal nodal forces, less weight and acceleration
    energy: float  # strain energy, J
    least_stretch: float  # smallest determinant of the deformation gradient
    # nodal, border: the residuals: shape (n, 3), N, at the free nodes, zero at others; and
    # shape (border,), N and N·m for interface freedoms, m and m^2 for constraints.
    nodal: np.ndarray
    border: np.ndarray
    # Norm of the nodal forces, N, and energy, J, of the temperature in a body held everywhere
    thermal: tuple[float, float] = (0.0, 0.0)

    @property
    def norm(self) -> float:
        """Euclidean norm of the nodal forces out of balance, N."""
        return float(np.linalg.norm(self.nodal))

    @property
    def scale(self) -> float:
        """Euclidean norm of all nodal forces, also of supports, interface and temperature, N."""
        return float(np.linalg.norm(self.forces)) + self.thermal[0]


class Linearisation:
    """The tangent at one state, bordered by the coupling.

    With the body's stiffness K, the border's columns C and block D, it solves [[K, C], [C^T, D]] by
    the Schur complement S = D - C^T K^-1 C.

    `interface_ratio` is the border's stiffness after elimination, relative to its stiffness before;
    near roundoff nothing holds the interface.
    """

    def __init__(
        self,
        body: ElasticBody,
        coupling: Coupling,
        balance: Balance,
        tangent: Tangent,
        body_force: np.ndarray,
    ) -> None:
        self._body = body
        self._coupling = coupling
        self.state = balance.state
        self.tangent = tangent
        self._body_force = body_force
        first = coupling.n_freedoms
        loads, self._temperature, _ = np.split(balance.wrench, [first, first + body.expands])
        self.border = coupling.bordered(balance.state, balance.forces, loads)
        pushed = tangent.times(self.border.constraint, coupling.constrained)
        columns = pushed + self.border.columns
        self._columns = body.movable.released(columns)
        self._block = contract(self.border.constraint, pushed) + self.border.block

    @cached_property
    def _solved(self) -> np.ndarray:
        """K^-1 C, shape (n, 3, border)."""
        return self.tangent.solve(self._columns)

    def release(self) -> None:
        """Free the factor's memory; `compliance`, `nodal_response` and `conjugate_rate` stay.

        The next `solve` with nodal loads makes the factor again.
        """
        _ = self.border_response
        self.tangent.release()

    @cached_property
    def schur(self) -> np.ndarray:
        """The border's condensed stiffness, shape (border, border), N/m, N, N·m by its unknowns."""
        return self._block - contract(self._columns, self._solved)

    @property
    def interface_ratio(self) -> float:
        """Least eigenvalue of the condensed stiffness, scaled by the border's diagonal."""
        return self._softest_interface[0]

    @property
    def softest_interface_energy(self) -> float:
        """Strain energy of the interface's softest motion, relative to that of the border alone."""
        border = self._softest_interface[1]
        field = self.border.constraint @ border - self._solved @ border
        energy = self._body.strain_energy_products(field[:, :, None])[0, 0]
        energy += self._coupling.spring_energies(border[:, None])[0, 0]
        return float(energy / (border @ (np.diagonal(self._block) * border)))

    @property
    def _softest_interface(self) -> tuple[float, np.ndarray]:
        """`interface_ratio` and the border's motion, shape (border,), that has it."""
        diagonal = np.diagonal(self._block)
        if not diagonal.size or (diagonal <= 0).any():
            return 1.0, np.zeros(diagonal.size)
        scale = 1.0 / np.sqrt(diagonal)
        scaled = self.schur * scale[:, None] * scale
        ratios, motions = np.linalg.eigh(0.5 * (scaled + scaled.T))
        return float(ratios[0]), scale * motions[:, 0]

    @property
    def stable(self) -> bool:
        """Whether every small disturbance of body and interface costs energy.

        A body that is unstable by itself may be stable with its section: then the constraints, and
        nothing else, give the bordered matrix its negative eigenvalues.
        """
        factor, coupling = self.tangent.factor, self._coupling
        if factor.definite and coupling.n_motions == coupling.active.size:
            return self._least_compliance > 0
        constraints = coupling.n_border - coupling.n_motions
        if not (constraints or factor.definite) or not np.isfinite(self.schur).all():
            return False
        scale = self._border_scale
        eigenvalues = np.linalg.eigvalsh((self.schur + self.schur.T) * scale[:, None] * scale)
        return factor.negatives + int((eigenvalues < 0).sum()) == constraints

    @property
    def _least_compliance(self) -> float:
        """Least eigenvalue of the interface's compliance (by spins), scaled to a unit diagonal."""
        active = self._coupling.active
        if not active.size:
            return 1.0
        compliance = (self.wrench_columns.T @ self.border_response)[np.ix_(active, active)]
        compliance = 0.5 * (compliance + compliance.T)
        diagonal = np.diagonal(compliance)
        if (diagonal <= 0).any():
            return -1.0
        scale = 1.0 / np.sqrt(diagonal)
        return float(np.linalg.eigvalsh(compliance * scale[:, None] * scale)[0])

    def correction(self, balance: Balance) -> tuple[np.ndarray, np.ndarray]:
        """Return the changes that bring a nearby state into balance.

        Returns nodes: shape (n, 3), m: of the free nodes; the others are zero. border: shape
        (border,): of interface freedoms, m and rad, and of multipliers, N and N/m.
        """
        nodes, border = self.solve(balance.nodal[:, :, None], balance.border[:, None])
        return -nodes[:, :, 0], -border[:, 0]

    def solve(
        self, nodal: np.ndarray, border: np.ndarray, rough: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        """Solve the bordered equations for k load cases, `rough` as of `Tangent.solve`.

        nodal: shape (n, 3, k), N.
        border: shape (border, k): N and N·m for interface freedoms, m and m^2 for constraints.
        Returns nodes: shape (n, 3, k), m: of the free nodes; the others are zero. border: shape
        (border, k).
        """
        moved = self.tangent.solve(nodal, rough)
        carried = self._solve_border(border - contract(self._columns, moved))
        return moved - self._solved @ carried, carried

    @cached_property
    def load_columns(self) -> tuple[np.ndarray, np.ndarray]:
        """Change of the loads of free nodes, (n, 3, k), and border, (border, k), with the inputs.

        The inputs are those of `Balance.wrench`.
        """
        nodal = np.zeros((self._body.size, 3, self._coupling.n_freedoms))
        border = self.wrench_columns
        further = self.further
        if not further.shape[2]:
            return nodal, border
        released = self._body.movable.released(further)
        border = np.hstack([border, contract(self.border.constraint, further)])
        return np.concatenate([nodal, released], axis=2), border

    @cached_property
    def further(self) -> np.ndarray:
        """Change of nodal forces with the inputs after the loads, (n, 3, k - 6 i), N/K and kg."""
        if not self._body.expands:
            return self._body_force
        thermal = self._body.thermal_rates(self.state.nodes, *self._temperature)[0][:, :, None]
        return np.concatenate([-thermal, self._body_force], axis=2)

    @cached_property
    def _free_response(self) -> np.ndarray:
        """Change of the free nodes by the further inputs, border fixed, (n, 3, k - 6 i), m/unit."""
        return self.tangent.solve(self.load_columns[0][:, :, self._coupling.n_freedoms :])

    @cached_property
    def border_response(self) -> np.ndarray:
        """Change of the border per change of the inputs, shape (border, k), m/N and its like."""
        loads = self.wrench_columns
        if self.further.shape[2]:
            loads = self.load_columns[1].copy()
            loads[:, self._coupling.n_freedoms :] -= contract(self._columns, self._free_response)
        return self._solve_border(loads)

    @property
    def nodal_response(self) -> np.ndarray:
        """Change of all nodes per change of the inputs, shape (n, 3, k), m per unit of each."""
        moved = (self.border.constraint - self._solved) @ self.border_response
        if self.further.shape[2]:
            moved[:, :, self._coupling.n_freedoms :] += self._free_response
        return moved

    def conjugate_rate(self, change: np.ndarray) -> np.ndarray:
        """Return the change of each input's conjugate quantity by a change of inputs, both (k,).

        Loads do work on translations and spins, m and rad, the temperature on the negative change
        of the strain energy per kelvin, J/K, and accelerations on moments of mass, kg·m.
        """
        nodal, border = self.load_columns
        rates = border.T @ (self.border_response @ change)
        if self.further.shape[2]:
            rates += contract(nodal, (self.nodal_response @ change)[:, :, None])[:, 0]
        return rates

    @property
    def wrench_columns(self) -> np.ndarray:
        """Change of the border's load per change of the wrench, shape (border, 6 i), dimensionless.

        Columns of locked freedoms are zero.
        """
        active = self._coupling.active
        all_columns = self._coupling.wrench_columns(self.state)
        columns = np.zeros_like(all_columns)
        columns[:, active] = all_columns[:, active]
        return columns

    @property
    def compliance(self) -> np.ndarray:
        """Change of the interface displacements per change of the inputs.

        Shape (6 i, k): m and rad per N, N·m, K and m/s^2.
        """
        return self._coupling.displacement_rows(self.border_response)

    def _solve_border(self, loads: np.ndarray) -> np.ndarray:
        """Solve with S, its rows and columns scaled to unit size: they mix m, rad, N and N·m."""
        scale = self._border_scale
        try:
            scaled = np.linalg.solve(self.schur * scale[:, None] * scale, scale[:, None] * loads)
        except np.linalg.LinAlgError:
            raise SolveFailed(
                "mechanism", "The interface can move without any resistance."
            ) from None
        return scale[:, None] * scaled

    @cached_property
    def _border_scale(self) -> np.ndarray:
        """Scales, (border,), with largest entries of S near 1 in each row (Ruiz 2001)."""
        scale = np.ones(len(self.schur))
        for _ in range(3):
            largest = np.abs(self.schur * scale[:, None] * scale).max(axis=1, initial=0.0)
            scale /= np.sqrt(np.where(largest > 0, largest, 1.0))
        return scale


def contract(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Sum over nodes and components: shapes (n, 3, j), (n, 3, k) -> (j, k).

    The unit is the product of the two units, such as J for forces, N, and displacements, m.
    """
    size = 3 * len(first)
    return first.reshape(size, first.shape[2]).T @ second.reshape(size, second.shape[2])
