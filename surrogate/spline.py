"""Polyharmonic splines through scattered values and, where they are known, slopes.

The spline minimises a roughness among all functions that take the values (Duchon 1977, "Splines
minimizing rotation-invariant semi-norms in Sobolev spaces"); with slopes it is their
Hermite-Birkhoff interpolant (Wendland 2005, "Scattered data approximation", chapter 16). It has no
length to tune. What it would say of a row that it does not know follows from the inverse of its
equations, without solving them anew (Rippa 1999, for a block of equations).
"""

from __future__ import annotations

import warnings
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgWarning, lu_factor, lu_solve

from surrogate.table.rows import Floats

MOST = 2600  # equations; solving them takes about two seconds
FLAT = 1e-9
SINGULAR = 1e-16


class Spline:
    """A spline of order 3 (with linear part) or 5 (with quadratic part).

    Attributes
    ----------
    left_out : ndarray, shape (n, q)
        Value less what the spline of the other rows would say there.
    """

    def __init__(
        self, points: Floats, values: Floats, slopes: Floats, order: int, smoothing: float = 0.0
    ) -> None:
        """Fit points (n, d), values (n, q), slopes (n, q, d), NaN where unknown.

        `smoothing` is relative to the kernel's mean size; 0 interpolates.
        """
        self.origin = points.mean(axis=0)
        centred = points - self.origin
        _, sizes, directions = np.linalg.svd(centred, full_matrices=False)
        self.basis = directions[sizes > FLAT * max(float(sizes[0]), FLAT)]
        self.points = centred @ self.basis.T
        slopes = slopes @ self.basis.T
        n, dimension = self.points.shape
        known: NDArray[np.bool_] = np.asarray(np.isfinite(slopes).all(axis=(1, 2)))
        self.used = np.concatenate((np.ones(n, bool), np.tile(known, dimension)))
        self.order, self.degree = order, _degree(order, dimension, int(self.used.sum()))
        kernel = _kernel(self.points, self.points, order, slopes=True)[self.used][:, self.used]
        tail = _polynomial(self.points, self.degree, slopes=True)[self.used]
        if smoothing:
            sign = 1.0 if order == 3 else -1.0
            kernel[np.diag_indices(n)] += sign * smoothing * np.abs(kernel[:n, :n]).mean()
        blank = np.zeros((tail.shape[1], tail.shape[1]))
        count = int(self.used.sum())
        given = np.concatenate((values, slopes.transpose(2, 0, 1).reshape(-1, values.shape[1])))
        target = np.concatenate((given[self.used], np.zeros((tail.shape[1], values.shape[1]))))
        matrix = np.block([[kernel, tail], [tail.T, blank]])
        self.weights, inverse = _solved(matrix, target)
        self.left_out = self._leave_out(inverse[:count, :count], known)

    def _leave_out(self, inverse: Floats, known: NDArray[np.bool_]) -> Floats:
        """Return the errors at rows left out with all that they told, shape (n, q)."""
        n, dimension = self.points.shape
        place = np.cumsum(self.used) - 1
        errors = np.empty((n, self.weights.shape[1]))
        for row in range(n):
            own = [row, *(n + row + n * d for d in range(dimension) if known[row])]
            block = place[own]
            errors[row] = np.linalg.lstsq(
                inverse[np.ix_(block, block)], self.weights[block], rcond=1e-12
            )[0][0]
        return errors

    def at(self, x: Floats) -> Floats:
        """Return the spline's values at points (k, d), shape (k, q)."""
        local = (x - self.origin) @ self.basis.T
        answers = np.empty((len(x), self.weights.shape[1]))
        step = max(1, 2_000_000 // len(self.weights))
        for start in range(0, len(x), step):
            part = local[start : start + step]
            kernel = _kernel_values(part, self.points, self.order)[:, self.used]
            tail = _polynomial(part, self.degree, slopes=False)
            answers[start : start + step] = np.concatenate((kernel, tail), axis=1) @ self.weights
        return answers


def _solved(matrix: Floats, target: Floats) -> tuple[Floats, Floats]:
    """Solve for the weights, refined once, and return the inverse besides.

    The least-squares solution stands in where rows tell a coefficient not at all.
    """
    size = max(float(np.abs(matrix).max()), np.finfo(float).tiny)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LinAlgWarning)
        factors = lu_factor(matrix / size, check_finite=False)
    if np.abs(np.diag(factors[0])).min() < SINGULAR:
        inverse = np.asarray(np.linalg.pinv(matrix), dtype=float)
        return inverse @ target, inverse
    weights = lu_solve(factors, target / size, check_finite=False)
    weights += lu_solve(factors, (target - matrix @ weights) / size, check_finite=False)
    return weights, lu_solve(factors, np.eye(len(matrix)), check_finite=False) / size


def _degree(order: int, dimension: int, equations: int) -> int:
    """Return the degree of the polynomial part that the equations can tell."""
    terms = (dimension + 1) * (dimension + 2) // 2
    if order == 5 and equations >= 2 * terms:
        return 2
    return 1 if equations >= 2 * (dimension + 1) else 0


def _kernel_values(x: Floats, y: Floats, order: int) -> Floats:
    """Return r^p and its derivatives by y at x (k, d), y (n, d), shape (k, n (1 + d))."""
    apart = x[:, None] - y[None]
    square = np.einsum("knd,knd->kn", apart, apart)
    root = np.sqrt(square)
    value = root**3 if order == 3 else square * square * root
    rate = order * (root if order == 3 else square * root)
    slopes = -(rate[..., None] * apart).transpose(0, 2, 1)
    return np.concatenate((value, slopes.reshape(len(x), -1)), axis=1)


def _kernel(x: Floats, y: Floats, order: int, *, slopes: bool) -> Floats:
    """Return the kernel of values and slopes at x with values and slopes at y."""
    rows = _kernel_values(x, y, order)
    if not slopes:
        return rows
    apart = x[:, None] - y[None]
    root = np.sqrt(np.einsum("knd,knd->kn", apart, apart))
    rate = order * root ** (order - 2)
    change = np.zeros_like(root)
    np.divide(order * (order - 2) * root ** (order - 3), np.maximum(root, FLAT), out=change)
    if order == 5:
        change = 15.0 * root
    blocks = [rows]
    dimension = x.shape[1]
    for i in range(dimension):
        second = [
            -((rate if i == j else 0.0) + change * apart[..., i] * apart[..., j])
            for j in range(dimension)
        ]
        blocks.append(np.concatenate([rate * apart[..., i], *second], axis=1))
    return np.concatenate(blocks)


def _polynomial(x: Floats, degree: int, *, slopes: bool) -> Floats:
    """Return the monomials up to a degree at x (k, d), then their derivatives by each input."""
    dimension = x.shape[1]
    terms = [
        list(term)
        for power in range(degree + 1)
        for term in combinations_with_replacement(range(dimension), power)
    ]
    blocks = [np.stack([x[:, term].prod(axis=1) for term in terms], axis=1)]
    for load in range(dimension if slopes else 0):
        block = np.zeros((len(x), len(terms)))
        for place, term in enumerate(terms):
            if load in term:
                rest = list(term)
                rest.remove(load)
                block[:, place] = term.count(load) * x[:, rest].prod(axis=1)
        blocks.append(block)
    return np.concatenate(blocks)
