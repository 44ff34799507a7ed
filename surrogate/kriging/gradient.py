"""The search for hyperparameters, and the derivatives of a covariance by them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.optimize import minimize
from scipy.sparse import csr_array

from ..table.rows import Floats
from .correlation import (
    Hyperparameters,
    derivatives_of_term,
    indices,
    joins,
    order_of,
    positions_of,
)
from .equations import Equations
from .settings import KrigingSettings


def minimised(
    function: Callable[..., tuple[float, Floats]],
    start: Floats,
    bounds: Sequence[tuple[float, float]],
    settings: KrigingSettings,
    *arguments: Any,
) -> tuple[Floats, float]:
    """Return the logarithms of hyperparameters at a minimum, and the minimum.

    `function`: of the logarithms, the `arguments` and the settings; returns value and gradient.
    """
    options = {"maxiter": settings.likelihood_steps, "ftol": settings.likelihood_accuracy}
    search: dict[str, Any] = {"jac": True, "method": "L-BFGS-B", "bounds": bounds}
    run = minimize(function, start, (*arguments, settings), options=options, **search)
    # Rounded, so that the rounding of another unit does not change the result; the likelihood is
    # flat.
    rounded = np.round(run.x, settings.decimals)
    return np.clip(rounded, *np.transpose(bounds)), run.fun  # a bound may have more decimals


def contracted(
    sensitivity: Floats, equations: Equations, hyperparameters: Hyperparameters, nugget: float
) -> Floats:
    """Return the sums of a symmetric matrix (e, e) times the covariance's derivatives, shape (7,).

    The derivatives are by the logarithms of the hyperparameters.
    """
    # Sums of the symmetric matrix over the entries of each derivative.
    n, loads, count = len(equations), equations.loads, equations.n_derivatives
    full = np.zeros((n, count, n, count))
    known = np.flatnonzero(equations.known)
    full.reshape(n * count, n * count)[np.ix_(known, known)] = sensitivity
    first, second = np.triu_indices(n, 1)
    diagonal = np.einsum("ipiq->pq", full)
    diagonal[np.diag_indices(count)] *= 1 + nugget
    pairs = np.concatenate((2 * full[first, :, second], diagonal[None]))
    joined, sign = joins(loads, count, count)
    shape = (int(joined.max()) + 1, joined.size)
    gather = csr_array((sign.ravel(), (joined.ravel(), np.arange(joined.size))), shape=shape)
    parts = gather @ pairs.reshape(len(pairs), -1).T

    delta = np.concatenate((equations.x[first] - equations.x[second], np.zeros((1, loads))))
    delta = np.ascontiguousarray(delta.T)
    order = 2 * order_of(count, loads)
    by_rate = np.zeros(loads)
    by_weight = []
    for rates, weight in zip(*hyperparameters.terms, strict=True):
        chosen = np.flatnonzero(rates)
        columns = parts[list(positions_of(loads, tuple(chosen.tolist()), order))]
        term = delta[chosen], rates[chosen], order, hyperparameters.smoothness
        by_rate[chosen] += weight * _by_rates(columns, *term)
        by_weight.append(weight * sum(map(np.dot, columns, derivatives_of_term(*term))))
    by_weight = by_weight[-len(hyperparameters.weights) :]
    return np.append(by_rate * hyperparameters.inverse_squares, by_weight)


def _by_rates(parts: Floats, delta: Floats, rates: Floats, order: int, smoothness: int) -> Floats:
    """Return sums of parts (k, p) times a term's derivatives by its rates, shape (loads,).

    The derivative by t_a of D_K m(q) is D_K (d_a^2 m'(q)): by the product rule
    d_a^2 D_K m' + 2 k_a d_a D_(K - a) m' + k_a (k_a - 1) D_(K - a - a) m', k_a how often K has a.
    """
    listed = indices(len(rates), order)
    derivatives = dict(
        zip(listed, derivatives_of_term(delta, rates, order, smoothness, 1), strict=True)
    )
    total = sum(part * derivatives[index] for part, index in zip(parts, listed, strict=True))
    once = np.zeros_like(delta)
    twice = np.zeros(len(rates))
    for part, index in zip(parts, listed, strict=True):
        for load in set(index):
            lower_index = list(index)
            count = index.count(load)
            lower_index.remove(load)
            once[load] += count * part * derivatives[tuple(lower_index)]
            if count > 1:
                lower_index.remove(load)
                twice[load] += count * (count - 1) * (part @ derivatives[tuple(lower_index)])
    return (delta**2 * total + 2 * delta * once).sum(axis=1) + twice
