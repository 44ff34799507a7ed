"""Rotation matrices: of a rotation vector, and of a pose."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from .errors import InvalidArgument
from .wrenches import Vector, floats_of


def rotation_matrix(rotation: ArrayLike) -> Vector:
    """Return exp(r), the matrix (3, 3) of a rotation vector (3,), rad.

    Rodrigues' formula, exp(r) = I + sin(a)/a [r] + (1 - cos(a))/a^2 [r]^2 with a = |r| and [r] the
    cross-product matrix; 1 - cos(a) is written 2 sin^2(a/2), which loses no digits when a is small.
    """
    x, y, z = np.asarray(rotation, dtype=float).tolist()
    angle = math.sqrt(x * x + y * y + z * z)
    s = sinc(angle)  # sin(a) / a
    c = 0.5 * sinc(0.5 * angle) ** 2  # (1 - cos(a)) / a^2
    # Element by element: every step of a simulator computes it, and numpy's calls would take half
    # of its time.
    return np.array(
        (
            (1.0 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y),
            (c * x * y + s * z, 1.0 - c * (x * x + z * z), c * y * z - s * x),
            (c * x * z - s * y, c * y * z + s * x, 1.0 - c * (x * x + y * y)),
        )
    )


# Largest error of another program's rotation matrix, which often is float32; the displacement is
# exact to its square.
SINGLE_PRECISION = 1e-6


def checked_rotation(name: str, matrix: ArrayLike) -> Vector:
    """Return a rotation matrix (3, 3), dimensionless; raises InvalidArgument if it is none."""
    axes = floats_of(name, matrix, (3, 3))
    skew = float(np.abs(axes.T @ axes - np.eye(3)).max())
    determinant = np.linalg.det(axes)
    if skew > SINGLE_PRECISION or determinant < 0.0:
        raise InvalidArgument(
            f"{name} must be a right-handed rotation matrix with the frame's axes as columns, but "
            f"{name}^T {name} differs from the identity by {skew:.3g} (at most "
            f"{SINGLE_PRECISION:g}), and the determinant is {determinant:.3g}. From a quaternion q "
            "(x, y, z, w) make it with scipy: Rotation.from_quat(q).as_matrix()"
        )
    return axes


def checked_pose(R0: ArrayLike, p0: ArrayLike) -> tuple[Vector, Vector]:
    """Return a pose, axes (3, 3) and point (3,), m; raises InvalidArgument if it is none."""
    return checked_rotation("R0", R0), floats_of("p0", p0, (3,))


def sinc(angle: float) -> float:
    """Return sin(a)/a of an angle a of 0 or more, rad; exact for small angles, where sin(a) = a."""
    return math.sin(angle) / angle if angle > 0.0 else 1.0
