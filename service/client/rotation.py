"""Rotation matrices: of a rotation vector, and of a pose."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from .errors import InvalidArgument
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


_SINGLE_PRECISION = 1e-6  # of a pose; the displacement is exact to the square of it


def checked_pose(R0: ArrayLike, p0: ArrayLike) -> tuple[Vector, Vector]:
    """Return a pose, axes as columns (3, 3) and point (3,), m; InvalidArgument if it is none."""
    try:
        axes, point = np.array(R0, dtype=float), np.array(p0, dtype=float)
    except (TypeError, ValueError):
        raise InvalidArgument(f"R0 and p0 must be numbers, not {R0!r} and {p0!r}") from None
    if axes.shape != (3, 3) or point.shape != (3,):
        raise InvalidArgument(
            f"R0 must have shape (3, 3) and p0 (3,), not {axes.shape} and {point.shape}"
        )
    if not (np.isfinite(axes).all() and np.isfinite(point).all()):
        raise InvalidArgument(f"R0 and p0 must be finite, not {axes.tolist()} and {point.tolist()}")
    skew = np.abs(axes.T @ axes - np.eye(3)).max()
    if skew > _SINGLE_PRECISION or np.linalg.det(axes) < 0.0:
        raise InvalidArgument(
            "R0 must be a right-handed rotation matrix, whose columns are the axes of the "
            "undeformed interface frame"
        )
    return axes, point


def sinc(angle: float) -> float:
    """Return sin(a)/a of an angle a of 0 or more, rad; exact for small angles, where sin(a) = a."""
    return math.sin(angle) / angle if angle > 0.0 else 1.0
