"""Rotation vectors: to a matrix, to a quaternion."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Vector = NDArray[np.float64]


def rotation_matrix(rotation: ArrayLike) -> Vector:
    """Return exp(r), the matrix of a rotation vector.

    Parameters
    ----------
    rotation : array_like
        Shape (3,), rad: the axis times the angle.

    Returns
    -------
    numpy.ndarray
        Shape (3, 3), orthogonal.

    Notes
    -----
    Rodrigues' formula, exp(r) = I + sin(a)/a [r] + (1 - cos(a))/a^2 [r]^2 with a = |r| and [r] the
    cross-product matrix; 1 - cos(a) is written 2 sin^2(a/2), which loses no digits when a is small.
    """
    x, y, z = (float(part) for part in np.asarray(rotation, dtype=float))
    angle = math.sqrt(x * x + y * y + z * z)
    first, second = _sinc(angle), 0.5 * _sinc(0.5 * angle) ** 2
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + first * cross + second * (cross @ cross)


def quaternion(rotation: ArrayLike) -> Vector:
    """Return the unit quaternion (w, x, y, z) of a rotation vector, shape (3,), rad.

    MuJoCo and Drake order it so; ROS and PyBullet write (x, y, z, w): see `conventions`.
    """
    vector = np.asarray(rotation, dtype=float)
    angle = math.sqrt(float(vector @ vector))
    return np.concatenate([[math.cos(0.5 * angle)], 0.5 * _sinc(0.5 * angle) * vector])


def _sinc(angle: float) -> float:
    """Return sin(a)/a, 1 at zero; exact in floats for small angles, where sin(a) = a."""
    return math.sin(angle) / angle if angle > 0.0 else 1.0
