"""Second derivatives of displacements: third derivatives of the complementary energy.

No further solve is needed: first-order fields give an energy's third derivatives (the 2n + 1
theorem). fea/README.md derives the formula.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations_with_replacement

import numpy as np

from wrenchbook.fea.assembly.linearisation import Balance, Linearisation, contract
from wrenchbook.fea.assembly.system import System
from wrenchbook.fea.coupling import Coupling
from wrenchbook.fea.coupling.coupling import from_origin, rotations_in
from wrenchbook.fea.element.cell_state import CellState, symmetrised
from wrenchbook.fea.tensors import COMPLEX_STEP, skew, spin_per_vector, spin_slope

MAX_CURVATURE_INPUTS = 8
"""Largest number of inputs whose third derivatives are stored: 120 numbers a row (of 12: 364)."""

_WARMER = 5.0
"""Step of differences by temperature, K.

At fixed displacements energy and forces are polynomials of the temperature but for factors of 1 +
1e-5 / K and powers of these, so differences of fourth order leave out 1e-13 of a derivative.
Differences of second order are not enough: in a slender part 0.999 of a derivative cancels against
others.
"""

_BEND, _JERK = np.array([(-1, 16, -30, 16, -1), (-6, 12, 0, -12, 6)]) / 12
"""Weights of differences of second and third order, from two steps below to two above."""


def packed(tensor: np.ndarray) -> np.ndarray:
    """Return the entries a <= b <= c of a symmetric tensor (k, k, k), in its unit: shape (p,).

    p = k (k + 1) (k + 2) / 6, in the order of `itertools.combinations_with_replacement`.
    """
    indices = np.array(list(combinations_with_replacement(range(len(tensor)), 3)))
    return tensor[tuple(indices.T)]


def load_rates(coupling: Coupling, balance: Balance, compliance: np.ndarray) -> np.ndarray:
    """Return the change of the loads of the energy, (F, mu), with the inputs, shape (k, k).

    mu = J(r)^T M works on the rotation vector r; J is the left Jacobian, M the moment. Further
    inputs are loads as they are. Rows and columns of locked freedoms are those of the identity.
    `compliance` has shape (6 i, k), m and rad over the inputs' units.
    """
    rates = np.eye(len(balance.wrench))
    for rotations in rotations_in(len(compliance)):
        vector = balance.state.interface[rotations]
        rates[rotations, rotations] = spin_per_vector(vector).T
        rates[rotations] += spin_slope(vector, balance.wrench[rotations]) @ compliance[rotations]
    locked = np.setdiff1d(np.arange(coupling.n_freedoms), coupling.active)
    rates[locked], rates[:, locked] = 0.0, 0.0
    rates[locked, locked] = 1.0
    return rates


def third_derivatives(
    system: System, balance: Balance, tangent: Linearisation, origin: np.ndarray | None = None
) -> np.ndarray:
    """Return the third derivatives of the complementary energy by the loads (F, mu).

    balance, tangent: a state in balance, and the tangent there.
    origin: shape (6 i,), m and rad: the zero of displacements; None for no displacement. mu works
    on rotation vectors relative to it.
    Result: shape (k, k, k): m and rad over the units of two inputs where an index is a load's; zero
    where an index is that of a locked freedom.
    """
    state, inputs, coupling = balance.state, balance.wrench, system.coupling
    active = np.append(coupling.active, np.arange(coupling.n_freedoms, len(inputs)))
    tensor = np.zeros((len(inputs),) * 3)
    if not active.size:
        return tensor

    origin = np.zeros(coupling.n_freedoms) if origin is None else origin
    moved, turns = from_origin(state.interface, origin)
    counted = replace(balance, state=replace(state, interface=moved))
    rates = load_rates(coupling, counted, turns @ tangent.compliance)[np.ix_(active, active)]
    per_load = np.linalg.inv(rates)
    fields = tangent.nodal_response[:, :, active] @ per_load
    border = tangent.border_response[:, active] @ per_load

    body = system.body.at(system.temperature(inputs))
    changes = tangent.tangent.times(fields, coupling.constrained)
    changes[:, :, coupling.active.size :] -= tangent.further
    body_part = body.derivatives(CellState.third, state.nodes, fields)
    body_part += coupling.third(state, (balance.forces, changes), fields, border, origin)
    if body.expands:
        body_part += _thermal_part(system, balance, fields)
    tensor[np.ix_(active, active, active)] = -body_part
    return tensor


def _thermal_part(system: System, balance: Balance, fields: np.ndarray) -> np.ndarray:
    """Return the strain energy's third derivatives by the temperature and fields, (k, k, k), J.

    fields: shape (n, 3, k), m over the units of the k active inputs; the temperature is that behind
    the loads.
    """
    nodes = balance.state.nodes
    temperature = system.temperature(balance.wrench)
    warm = system.coupling.active.size  # index of the temperature
    steps = _WARMER * np.arange(-2, 3)
    near = [system.body.at(temperature + step).forces(nodes) for step in steps]
    forces, energies, _ = zip(*near, strict=True)
    warmer = system.body.at(temperature + 1j * COMPLEX_STEP)
    ahead = warmer.derivatives(CellState.second, nodes, fields)

    tensor = np.zeros((fields.shape[2],) * 3)
    tensor[:, :, warm] = np.imag(ahead) / COMPLEX_STEP
    bend = np.tensordot(_BEND / _WARMER**2, forces, 1)
    tensor[warm, warm] += contract(bend[:, :, None], fields)[0]
    tensor = symmetrised(tensor)
    tensor[warm, warm, warm] += _JERK @ energies / _WARMER**3
    return tensor


def second_derivatives_at_rest(system: System) -> np.ndarray:
    """Return the second derivatives of the displacements by the inputs, undeformed and unloaded.

    At no load they are those of the complementary energy, plus the derivatives of mu = M - r x M /
    2 + ... by a moment M and the rotation r of another input.

    Result: shape (6 i, k, k), m and rad over the units of two inputs; symmetric in these.
    """
    tensor = third_derivatives(system, system.balance_at_rest, system.undeformed)
    compliance = system.undeformed.compliance
    second = tensor[: len(compliance)]
    for moments in rotations_in(len(compliance)):
        acting = np.isin(np.arange(moments.start, moments.stop), system.coupling.active)
        # d2 mu / dw_k dM_l, shape (3, k, 3).
        bend = -0.5 * skew(compliance[moments].T).transpose(1, 0, 2) * acting
        change = compliance[:, moments] @ bend.reshape(len(bend), -1)
        change = change.reshape(len(compliance), *bend.shape[1:])
        second[:, :, moments] += change
        second[:, moments] += change.swapaxes(1, 2)
    return second
