"""The linearly implicit law of the joint: the wrench of a stiff part over one step.

With K the part's stiffness, A the inverse effective mass of the relative freedoms and v the
relative velocity that the bodies would have after the step without the part,

    (I + dt C A) w' = w + C v,    C = sum over modes of (dt theta omega^2 + 2 zeta omega),

over the modes of K against A, with theta = clip(1 - 0.5 / (omega dt)^2, 0, 1). Soft modes are
explicit, so that symplectic Euler keeps their energy; stiff ones are implicit and stable for any K.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InvalidArgument

Vector = NDArray[np.float64]

# (omega dt)^2 up to which a mode is explicit: symplectic Euler is stable up to 4, and at 0.5 its
# frequency is still within 2 %.
EXPLICIT = 0.5
TINY = 1e-30  # of a mode's (omega dt)^2: avoids a division by zero, and is explicit anyway


def rate(stiffness: Vector, inverse_mass: Vector, dt: float, damping: ArrayLike) -> Vector:
    """Return C, the change of the wrench with the velocity, shape (n, n), N·s/m to N·m·s/rad.

    Parameters
    ----------
    stiffness : numpy.ndarray
        Change of the wrench with the displacement, shape (n, n), N/m to N·m/rad, symmetric.
    inverse_mass : numpy.ndarray
        The relative acceleration by a unit load between the two bodies, shape (n, n), 1/kg to
        1/(kg·m^2), symmetric and positive definite.
    dt : float
        The step, s.
    damping : float or numpy.ndarray
        Share of critical damping of the modes; shape (n,) for that of each freedom, which a mode
        has in the ratio of its energy in them.

    Raises
    ------
    InvalidArgument
        If the inverse mass is not positive definite.
    """
    try:
        half = np.linalg.cholesky(inverse_mass)
    except np.linalg.LinAlgError:
        raise InvalidArgument(
            "the inverse effective mass of the joint is not positive definite: a freedom between "
            "base and tip moves no mass"
        ) from None
    squares, modes = np.linalg.eigh(half.T @ stiffness @ half)
    squares = np.maximum(squares, 0.0)  # rounding, or a part that buckles
    theta = np.clip(1.0 - EXPLICIT / np.maximum(squares * dt * dt, TINY), 0.0, 1.0)
    back = np.linalg.solve(half.T, modes)
    ratio = _of_modes(damping, half @ modes, stiffness, squares)
    return (back * (dt * theta * squares + 2.0 * ratio * np.sqrt(squares))) @ back.T


def _of_modes(
    damping: ArrayLike, shapes: Vector, stiffness: Vector, squares: Vector
) -> Vector | float:
    """Return the damping ratio of each mode, a column of `shapes`, by its strain energy."""
    shares = np.asarray(damping, dtype=float)
    if shares.ndim == 0 or (shares == shares[0]).all():
        return float(shares.flat[0])
    energies = shapes * (stiffness @ shapes)
    return shares @ energies / np.maximum(squares, TINY)
