"""How much of the stiffness roundoff leaves: a condition estimate, and the softest motion."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse.linalg import LinearOperator, onenormest

from wrenchbook.fea.assembly.body import ElasticBody, Tangent
from wrenchbook.fea.failure import SolveFailed, ill_conditioned, mechanism

Array = np.ndarray

ROUNDOFF = float(np.finfo(float).eps)

MECHANISM = 1e-22
"""Strain energy of the softest motion, relative, below which it is the square of roundoff."""

_POWER_STEPS = 3


def scaled_condition(tangent: Tangent) -> float:
    """Estimate the condition of a stiffness matrix scaled to a unit diagonal, in the 1-norm.

    The norm of the inverse is Hager's and Higham's estimate with the factor at hand (Higham,
    "Accuracy and stability of numerical algorithms", chapter 15), hardly ever more than three times
    too small; the norm of the matrix is that of its cells' absolute values, an upper bound.
    Infinite if the matrix is not definite.
    """
    factor = tangent.factor
    if not factor.unknowns:
        return 1.0
    if not factor.definite:
        return np.inf
    scale = np.sqrt(factor.diagonal)

    def inverse(loads: Array) -> Array:
        columns = loads.reshape(factor.unknowns, -1)
        return (scale[:, None] * factor.solve(scale[:, None] * columns)).reshape(loads.shape)

    build: Any = LinearOperator
    both = dict.fromkeys(("matvec", "rmatvec", "matmat", "rmatmat"), inverse)
    inverse_norm: Any = onenormest(build((factor.unknowns,) * 2, **both, dtype=float), t=1)
    return float(inverse_norm) * tangent.scaled_norm


def softest_energy(body: ElasticBody, tangent: Tangent) -> float:
    """Return the strain energy of the softest motion, relative to that of its nodes one by one.

    The motion comes from the factor by inverse iteration, its energy from its strains: those of a
    mechanism are roundoff, so that their energy is the square of it, many digits below that of a
    part that is merely slender.
    """
    factor = tangent.factor
    motion = np.zeros((factor.unknowns, 1))
    motion[factor.weakest] = 1.0
    for _ in range(_POWER_STEPS):
        motion = factor.solve(motion)
        if not np.isfinite(motion).all() or not motion.any():
            return 0.0
        motion /= np.abs(motion).max()
    field = np.zeros((body.size, 3, 1))
    field[body.dissection.nodes] = motion.reshape(-1, 3, 1)
    return float(body.strain_energy_products(field)[0, 0] / (factor.diagonal @ motion[:, 0] ** 2))


def unheld(what: str, energy: float) -> SolveFailed:
    """Name what is wrong if elimination leaves a motion no stiffness.

    what: what moves.
    energy: relative strain energy of that motion.
    """
    if energy < MECHANISM:
        return mechanism(f"{what} can move without any resistance.")
    return ill_conditioned(
        f"{what} can move so easily that what resists is lost in roundoff: {energy:.0e} of the "
        "stiffness around it."
    )
