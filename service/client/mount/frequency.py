"""How slowly a component swings with what it carries, by what its server tells."""

from __future__ import annotations

import math
import warnings
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InvalidArgument
from . import options
from .errors import MountWarning

Vector = NDArray[np.float64]


def first_frequency(own: float | None, compliance: Vector | None, carried: Vector | None) -> float:
    """Return a lower bound of the first natural frequency, Hz; infinite where nothing has mass.

    Parameters
    ----------
    own : float or None
        Of the component by itself, Hz; None if it counts as weightless.
    compliance : numpy.ndarray or None
        Shape (6, 6), du/dw, m/N to rad/(N·m).
    carried : numpy.ndarray or None
        Shape (6, 6): mass matrix of the rigid system about the interface point, kg, kg·m, kg·m^2.

    Notes
    -----
    Dunkerley (1894): 1/f^2 = 1/f_own^2 + 1/f_carried^2, with 1/(2 pi f_carried)^2 the largest
    eigenvalue of compliance times mass: exact where one of the two masses is nothing.
    """
    square = 0.0 if own is None else 1.0 / own**2
    if compliance is not None and carried is not None:
        largest = float(np.linalg.eigvals(compliance @ carried).real.max())
        square += (2.0 * math.pi) ** 2 * max(largest, 0.0)
    return math.inf if square == 0.0 else square**-0.5


def mass_matrix(carried: float | ArrayLike) -> Vector:
    """Return a mass, kg, at the interface point, or a matrix (6, 6), kg to kg·m^2, as a matrix.

    Raises
    ------
    ValueError
        If it is neither, not finite, or negative.
    """
    given = np.asarray(carried, dtype=float)
    matrix = np.diag([float(given)] * 3 + [0.0] * 3) if given.ndim == 0 else given
    if matrix.shape != (6, 6) or not np.isfinite(matrix).all() or (np.diag(matrix) < 0.0).any():
        raise InvalidArgument(
            "carried is a mass, kg, or a mass matrix, shape (6, 6), none negative"
        )
    return matrix


def warn_if_ringing(
    source: Any,
    component: str,
    frequency: float | None,
    ramp_time: float | None,
    carried: float | ArrayLike | None,
) -> None:
    """Warn where loads build up, in `ramp_time`, s, too fast; a server may tell the frequency, Hz.

    Raises
    ------
    ValueError
        See `options.warn_of_ringing`; or if `carried`, kg or shape (6, 6), is of no use.
    """
    asks = frequency is None and ramp_time is not None and hasattr(source, "compliance")
    if asks:
        frequency = known_frequency(source, component, carried)
        ramp_time = None if frequency is None else ramp_time
    elif carried is not None:
        raise InvalidArgument("carried= needs a Client, ramp_time= and no natural_frequency=")
    options.warn_of_ringing(component, frequency, ramp_time)


def known_frequency(client: Any, component: str, carried: float | ArrayLike | None) -> float | None:
    """Return the first natural frequency, Hz, that a server's facts tell; None if they do not.

    Warns
    -----
    MountWarning
        If the bundle tells no density and nothing is carried, or the table no compliance yet.
    """
    vibration = client.component(component).get("vibration") or {}
    own = vibration.get("first_frequency")
    matrix = None if carried is None else mass_matrix(carried)
    compliance = None if matrix is None else _compliance(client, component)
    if matrix is not None and compliance is None:
        _warn(
            component,
            "its table holds too few rows for a compliance, so that what it carries "
            "is left out: fill it first",
        )
    frequency = first_frequency(own, compliance, matrix)
    if math.isinf(frequency):
        _warn(
            component,
            "its bundle tells no density, and no mass that it carries is known: give "
            "natural_frequency=, Hz, or carried=, kg",
        )
        return None
    return frequency


def _compliance(client: Any, component: str) -> Vector | None:
    """Return the table's fitted compliance, shape (6, 6), m/N to rad/(N·m); None if unknown."""
    facts = client.compliance(component)
    # At zero load, where there is one: a part that stiffens under load swings slower there.
    matrix = np.array(facts.get("tangent") or facts["matrix"], dtype=float)
    return matrix if np.isfinite(matrix).all() else None


def _warn(component: str, why: str) -> None:
    warnings.warn(
        f"{component}: whether loads build up slowly enough cannot be told. {why}",
        MountWarning,
        stacklevel=5,  # whoever makes the mount
    )
