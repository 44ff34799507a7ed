"""The matrix of a rotation vector."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from .wrenches import Vector


def rotation_matrix(rotation: ArrayLike) -> Vector:
    """Return exp(r), the matrix (3, 3) of a rotation vector (3,), rad.

    Rodrigues' formula, exp(r) = I + sin(a)/a [r] + (1 - cos(a))/a^2 [r]^2 with a = |r| and [r] the
    cross-product matrix; 1 - cos(a) is written 2 sin^2(a/2), which loses no digits when a is small.
    """
    x, y, z = np.asarray(rotation, dtype=float).tolist()
    angle = math.sqrt(x * x + y * y + z * z)
    first, second = sinc(angle), 0.5 * sinc(0.5 * angle) ** 2
    # Element by element: a simulator asks at each of its steps, and numpy's calls would be half.
    return np.array(
        (
            (
                1.0 - second * (y * y + z * z),
                second * x * y - first * z,
                second * x * z + first * y,
            ),
            (
                second * x * y + first * z,
                1.0 - second * (x * x + z * z),
                second * y * z - first * x,
            ),
            (
                second * x * z - first * y,
                second * y * z + first * x,
                1.0 - second * (x * x + y * y),
            ),
        )
    )


def sinc(angle: float) -> float:
    """Return sin(a)/a, 1 at zero; exact in floats for small angles, where sin(a) = a."""
    return math.sin(angle) / angle if angle > 0.0 else 1.0
