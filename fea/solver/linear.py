"""Linear analysis: unit loads at each interface, one factorisation, the compliance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wrenchbook.fea.assembly.condition import ROUNDOFF
from wrenchbook.fea.assembly.linearisation import Linearisation, contract
from wrenchbook.fea.assembly.system import System
from wrenchbook.fea.failure import ill_conditioned

Array = np.ndarray

_MOST_CORRECTIONS = 4
_SMALL = 1e-7  # of a correction; what it leaves is about its square
_ROUNDOFF = 1e-6
"""Asymmetry or energy gap, relative, above which the compliance is not to be trusted."""


@dataclass(frozen=True, eq=False)
class LinearResponse:
    """Everything a linear component can answer.

    Attributes
    ----------
    compliance
        Shape (6 i, 6 i) for i interfaces, symmetric: displacement = compliance @ wrench; m/N,
        rad/N, m/(N·m) and rad/(N·m). Locked freedoms are zero.
    energies
        Shape (6 i, 6 i): twice the energies of pairs of unit loads, from the strains: equal
        to `compliance` but for roundoff, and in its units.
    fields
        Shape (n, 3, 6 i): nodal displacements per unit of each load, m/N and m/(N·m).
    condition
        Estimated condition of the scaled stiffness matrix.
    asymmetry, energy_gap
        What was found before `compliance` was made symmetric, and its difference from `energies`:
        both relative to sqrt(C_ii C_jj).
    sag
        Shape (n, 3), m: nodal displacements under the component's own weight; zero without.
    sag_displacement
        Shape (6,), m and rad: the interface's under it.
    """

    compliance: Array
    energies: Array
    fields: Array
    condition: float
    asymmetry: float
    energy_gap: float
    sag: Array
    sag_displacement: Array


def linear_response(system: System) -> LinearResponse:
    """Solve for six unit loads at each interface.

    Raises
    ------
    SolveFailed
        ``mechanism``; ``ill_conditioned`` if the compliance is not symmetric, or not equal to its
        strain energies, by more than 1e-6, or corrections do not get small. The condition alone
        does not decide: a plate of 1:100 has one of 1e11, and the corrections bring its answer
        to full accuracy.
    """
    fields, border, correction = _refined(system, system.undeformed)
    condition = system.condition
    compliance = system.coupling.displacement_rows(border)
    scale = np.sqrt(np.abs(np.diagonal(compliance)))
    scale = np.where(scale > 0, scale, 1.0)
    unit = 1.0 / np.outer(scale, scale)
    energies = system.body.strain_energy_products(fields) + system.coupling.spring_energies(border)
    asymmetry = float(np.abs((compliance - compliance.T) * unit).max())
    energy_gap = float(np.abs((compliance - energies) * unit).max())
    if not max(asymmetry, energy_gap, condition * ROUNDOFF * correction) < _ROUNDOFF:
        raise ill_conditioned(
            f"The compliance is symmetric to {asymmetry:.1e} and equal to its strain energies to "
            f"{energy_gap:.1e} only, the last correction was {correction:.1e}: the rest is "
            f"roundoff (scaled condition about {condition:.0e})."
        )
    compliance = 0.5 * (compliance + compliance.T)
    sag, moved = _sag(system)
    return LinearResponse(
        compliance, energies, fields, condition, asymmetry, energy_gap, sag, moved
    )


def _sag(system: System) -> tuple[Array, Array]:
    """Return displacements (n, 3), m, and of the interface (6,), m and rad, under the weight."""
    if system.weight is None:
        return np.zeros((system.body.size, 3)), np.zeros(system.coupling.freedoms)
    fields, border, correction = _refined(system, system.undeformed, system.weight[:, :, None])
    if not system.condition * ROUNDOFF * correction < _ROUNDOFF:
        raise ill_conditioned(f"Under the weight the last correction was {correction:.1e}.")
    return fields[:, :, 0], system.coupling.displacement_rows(border)[:, 0]


def _refined(
    system: System, start: Linearisation, weight: Array | None = None
) -> tuple[Array, Array, float]:
    """Return nodal fields and border of the unit loads, and the size of the last correction.

    With `weight`, nodal forces of shape (n, 3, k), N, those of the k weights instead.

    Corrections are made until they are small, relative to the displacement.
    The residual comes from the stresses, which are exact to a few digits more than the stiffness
    matrix on slender parts. One correction is enough but for extreme ones.
    """
    border = start.border
    if weight is None:
        loads = start.wrench_columns
        weight = np.zeros((system.body.size, 3, loads.shape[1]))
    else:
        loads = contract(border.ties, weight)
    nodes, moved = start.solve(system.body.movable.released(weight), loads)
    size = 0.0
    for _ in range(_MOST_CORRECTIONS):
        fields = nodes + border.ties @ moved
        forces = system.body.small_strain_forces(fields)
        nodal = system.body.movable.released(forces - weight + border.columns @ moved)
        rest = contract(border.ties, forces) + contract(border.columns, nodes)
        rest += border.block @ moved - loads
        more_nodes, more = start.solve(nodal, rest)
        nodes, moved = nodes - more_nodes, moved - more
        whole = np.abs(nodes).max(initial=0.0)
        size = float(np.abs(more_nodes).max(initial=0.0) / whole) if whole > 0 else 0.0
        if size <= _SMALL:
            break
    return nodes + border.ties @ moved, moved, size
