"""Tensors in three dimensions: symmetric ones as six numbers, von Mises stress, rotation vectors.

It imports numpy alone, because a web process uses it too.
"""

from __future__ import annotations

import numpy as np

ROWS, COLUMNS = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
"""Indices of the six numbers of a symmetric 3x3 matrix: xx, yy, zz, xy, xz, yz."""

# Terms of exp: at 2 rad, the largest rotation in Newton's method, 2^26 / 26! is below 1e-18.
_DERIVATIVE_TERMS = 30
_FIRST_TERMS = {1: 1.0, 2: 0.5, 3: 1.0 / 6.0}  # 1 / start! of `_series`
_SERIES_TERMS = 12  # terms of sin t / t and similar series: the next is below 1/24! = 2e-24
_SERIES_LIMIT = 1.0  # rad^2, of the squared angle: below it the closed forms cancel
COMPLEX_STEP = 2.0**-100
"""Step of complex differences, rad, m or K: exact to roundoff, as its square vanishes against any
number here; a power of two, so that the division by it has no roundoff."""
TINY = 1e-300
"""Replaces a divisor of 0: smaller than any length, area or motion, and its inverse is finite."""


def skew(vector: np.ndarray) -> np.ndarray:
    """Return the matrices [v]x with [v]x a = v x a: shapes (..., 3) -> (..., 3, 3).

    The matrices have the unit of the vectors: rad, m or N.
    """
    vector = np.asarray(vector)
    matrix = np.zeros((*vector.shape[:-1], 3, 3), dtype=vector.dtype)
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    matrix[..., 0, 1], matrix[..., 0, 2] = -z, y
    matrix[..., 1, 0], matrix[..., 1, 2] = z, -x
    matrix[..., 2, 0], matrix[..., 2, 1] = -y, x
    return matrix


def determinant(matrix: np.ndarray) -> np.ndarray:
    """Return det of matrices, shapes (..., 3, 3) -> (...): in closed form, faster than LAPACK."""
    (a, b, c), (d, e, f), (g, h, i) = np.moveaxis(matrix, (-2, -1), (0, 1))
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)


def rotation(vector: np.ndarray) -> np.ndarray:
    """Return exp([r]x), shape (3, 3), for a rotation vector r (rad)."""
    return np.eye(3, dtype=np.asarray(vector).dtype) + rotation_less_identity(vector)


def rotation_less_identity(vector: np.ndarray) -> np.ndarray:
    """Return exp([r]x) - I, (3, 3), of (3,), rad, without the roundoff of a subtraction."""
    X = skew(vector)
    a, b, _ = _coefficients(vector)
    return a * X + b * (X @ X)


def spin_per_vector(vector: np.ndarray) -> np.ndarray:
    """Return J(r), (3, 3), of (spatial spin) = J(r) (change of r): the left Jacobian of SO(3)."""
    X = skew(vector)
    _, b, c = _coefficients(vector)
    return np.eye(3, dtype=X.dtype) + b * X + c * (X @ X)


def spin_slope(vector: np.ndarray, moment: np.ndarray) -> np.ndarray:
    """Return d(J(r)^T m)/dr for a fixed m, shape (3, 3), by complex steps: exact to roundoff.

    J is that of `spin_per_vector`. The result has the unit of m.
    """
    columns = []
    for axis in range(3):
        shifted = np.asarray(vector, dtype=complex).copy()
        shifted[axis] += 1j * COMPLEX_STEP
        columns.append(np.imag(spin_per_vector(shifted).T @ moment) / COMPLEX_STEP)
    return np.stack(columns, axis=1)


def rotation_derivatives(vector: np.ndarray) -> list[np.ndarray]:
    """Return exp([r]x) and its first three derivatives by r, 1/rad and so on.

    Shapes (3, 3), (3, 3, 3), (3, 3, 3, 3) and (3, 3, 3, 3, 3), the matrix last. They are the series
    sum P_n with P_n = [r]x P_{n-1} / n, differentiated by the product rule.
    """
    X = skew(vector)
    units = skew(np.eye(3))
    terms = [np.eye(3), *(np.zeros((3,) * (order + 2)) for order in (1, 2, 3))]
    sums = [term.copy() for term in terms]
    for n in range(1, _DERIVATIVE_TERMS):
        for order in (3, 2, 1, 0):
            term = X @ terms[order]
            if order:
                inner = units.reshape(3, *[1] * (order - 1), 3, 3) @ terms[order - 1]
                term += sum(np.moveaxis(inner, 0, axis) for axis in range(order))
            terms[order] = term / n
            sums[order] += terms[order]
    return sums


def rotation_vector(matrix: np.ndarray) -> np.ndarray:
    """Return the rotation vector of a rotation by less than half a turn, shape (3,), rad."""
    axial = 0.5 * np.array(
        [matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]]
    )
    sine = float(np.linalg.norm(axial))
    if sine == 0.0:
        return axial
    angle = np.arctan2(sine, (np.trace(matrix) - 1.0) / 2.0)
    return axial * (angle / sine)


def _coefficients(vector: np.ndarray) -> tuple[complex, complex, complex]:
    """Return sin t / t, (1 - cos t) / t^2 and (t - sin t) / t^3 of a rotation vector, (3,), rad.

    These are analytic functions of the square of its angle t.
    """
    square = vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2]
    if abs(square) < _SERIES_LIMIT:
        return _series(square, 1), _series(square, 2), _series(square, 3)
    angle = np.sqrt(square)
    sine, cosine = np.sin(angle), np.cos(angle)
    c = (angle - sine) / (square * angle)
    return sine / angle, (1 - cosine) / square, c


def _series(square: complex, start: int) -> complex:
    """Sum (-1)^k s^k / (2k + start)! over k, for a start of 1 to 3."""
    total = term = _FIRST_TERMS[start]
    for k in range(1, _SERIES_TERMS):
        term = -term * square / ((2 * k + start - 1) * (2 * k + start))
        total = total + term
    return total


def deviator(tensor: np.ndarray) -> np.ndarray:
    """Return tensors less a third of their trace times I, shape (..., 3, 3), in their unit."""
    mean = np.trace(tensor, axis1=-2, axis2=-1) / 3.0
    return tensor - mean[..., None, None] * np.eye(3)


def von_mises(stress: np.ndarray) -> np.ndarray:
    """Return the von Mises stress, shape (...), Pa, of stresses, shape (..., 6), Pa.

    The six components are xx, yy, zz, xy, xz, yz; the result has the unit of the stresses.
    """
    xx, yy, zz, xy, xz, yz = np.moveaxis(stress, -1, 0)
    normal = (xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2
    return np.asarray(np.sqrt(0.5 * normal + 3.0 * (xy**2 + xz**2 + yz**2)))
