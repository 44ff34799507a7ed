"""Linear analysis: unit loads at each interface, one factorisation, the compliance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wrenchbook.fea.assembly.linearisation import Linearisation, contract
from wrenchbook.fea.assembly.system import ROUNDOFF, System
from wrenchbook.fea.failure import SolveFailed

# Largest number of corrections: one is enough for all but extreme parts, and each costs a solve.
_MAX_CORRECTIONS = 4
_SMALL = 1e-7  # relative size of a correction, whose own error is about its square
_MAX_ERROR = 1e-6
"""Largest relative asymmetry, energy gap and roundoff of a compliance: six digits of an answer."""


@dataclass(frozen=True, eq=False)
class LinearResponse:
    """The complete response of a linear component."""

    # Shape (6 i, k) for the k inputs of `Balance.wrench`: displacement = compliance @ inputs; m and
    # rad per N, N·m, K and m/s^2. That of the loads is symmetric. Locked freedoms are zero.
    compliance: np.ndarray
    # Shape (k, k): twice the energies of pairs of unit inputs, from the strains: of loads equal to
    # `compliance` but for roundoff, and in its units; J/K^2. With self-weight (k + 1, k + 1), the
    # last that of the weight, J.
    energies: np.ndarray
    # Shape (n, 3, k): nodal displacements per unit of each input, m per N, N·m, K and m/s^2
    fields: np.ndarray
    # asymmetry, energy_gap: measured before `compliance` was made symmetric, and its
    # difference from `energies`: both relative to sqrt(C_ii C_jj).
    asymmetry: float
    energy_gap: float
    # Shape (n, 3), m: nodal displacements under self-weight; zero without self-weight
    sag: np.ndarray
    # Shape (6 i,), m and rad: the interfaces' displacements under self-weight.
    sag_displacement: np.ndarray


def linear_response(system: System) -> LinearResponse:
    """Solve for six unit loads at each interface.

    The condition number alone does not decide: that of a plate of 1:100 is 1e11, and the
    corrections bring its answer to full accuracy.

    Raises SolveFailed of kind ``mechanism`` if the supports leave a motion free, and of kind
    ``ill_conditioned`` if the compliance is not symmetric, or not equal to its strain energies, by
    more than 1e-6, or corrections do not become small.
    """
    fields, border, correction = _unit_solutions(system, system.undeformed)
    condition = system.condition
    displacements = system.coupling.displacement_rows(border)
    loads = system.coupling.n_freedoms
    compliance = displacements[:, :loads]
    scale = np.sqrt(np.abs(np.diagonal(compliance)))
    scale = np.where(scale > 0, scale, 1.0)
    unit = 1.0 / np.outer(scale, scale)
    energies = system.body.strain_energy_products(fields) + system.coupling.spring_energies(border)

    asymmetry = float(np.abs((compliance - compliance.T) * unit).max())
    energy_gap = float(np.abs((compliance - energies[:loads, :loads]) * unit).max())
    if not max(asymmetry, energy_gap, condition * ROUNDOFF * correction) < _MAX_ERROR:
        raise SolveFailed(
            "ill_conditioned",
            f"Roundoff limits this solve: the compliance is symmetric to {asymmetry:.1e} and equal "
            f"to its strain energies to {energy_gap:.1e}, where {_MAX_ERROR:.0e} is required. The "
            f"last correction was {correction:.1e}, the scaled condition number is about "
            f"{condition:.0e}.",
        )

    compliance = 0.5 * (compliance + compliance.T)
    inputs = system.n_inputs
    if inputs > loads:
        compliance = np.hstack([compliance, displacements[:, loads:inputs]])
    if system.body.expands:
        rates, square = system.thermal_at_rest
        conjugate = contract(rates[:, :, None], fields)[0]
        energies[loads] += conjugate
        energies[:, loads] += conjugate
        energies[loads, loads] += 2 * square

    fields = system.body.expanded(fields)
    sag = fields[:, :, inputs:].sum(axis=2)
    moved = displacements[:, inputs:].sum(axis=1)
    fields = fields[:, :, :inputs]
    return LinearResponse(compliance, energies, fields, asymmetry, energy_gap, sag, moved)


def _unit_solutions(system: System, start: Linearisation) -> tuple[np.ndarray, np.ndarray, float]:
    """Return nodal fields, (n, 3, k), border, (border, k), and the size of the last correction.

    The k columns are the unit inputs, and self-weight last. Iterative refinement: the residual
    comes from the stresses, which on slender parts are exact to a few digits more than the
    stiffness matrix.
    """
    acting, loads = start.load_columns
    border = start.border
    if system.weight is not None:
        weight = system.weight[:, :, None]
        acting = np.concatenate([acting, system.body.movable.released(weight)], axis=2)
        loads = np.hstack([loads, contract(border.constraint, weight)])

    nodes, moved = start.solve(acting, loads)
    size = 0.0
    first = system.coupling.n_freedoms
    for _ in range(_MAX_CORRECTIONS):
        fields = nodes + border.constraint @ moved
        forces = system.body.small_strain_forces(fields)
        nodal = system.body.movable.released(forces + border.columns @ moved) - acting
        border_residual = contract(border.constraint, forces) + contract(border.columns, nodes)
        border_residual += border.block @ moved - loads
        more_nodes, more = start.solve(nodal, border_residual, rough=True)
        nodes, moved = nodes - more_nodes, moved - more
        size = max(
            _relative(more_nodes[..., group], nodes[..., group])
            for group in (slice(first), *range(first, nodes.shape[2]))
        )
        if size <= _SMALL:
            break
    return nodes + border.constraint @ moved, moved, size


def _relative(change: np.ndarray, fields: np.ndarray) -> float:
    largest = np.abs(fields).max(initial=0.0)
    return float(np.abs(change).max(initial=0.0) / largest) if largest > 0 else 0.0
