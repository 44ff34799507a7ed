"""The single answer compiled: displacement, bar and derivative in one walk over the rows.

Optional: without numba the same numbers come from numpy, more slowly. Compiled code is kept beside
this file; where that cannot be written each program compiles once, some seconds. The covariances of
a place's value and slopes with those of all rows are laid out with the rows innermost, so that a
processor's vectors run along them, and meet the weights in one product of matrices.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..jit import COMPILED, compiled
from ..table.rows import Floats
from .correlation import GROUPS, LOADS, PLACES
from .dense import Dense
from .equations import OUTPUTS, Scaling

TERMS = len(GROUPS)


class Tables(NamedTuple):
    """What the compiled answer reads: contiguous, in scaled numbers.

    Few arrays, since each costs a tenth of a microsecond to hand over.

    Attributes
    ----------
    x : ndarray, shape (6, n)
    terms : ndarray, shape (4, 7)
        The covariance's terms: inverse squared lengths, and the weight.
    weights : ndarray, shape (7 n, 6)
        Of all rows' values, then of all their slopes by the first load, and so on.
    coefficients : ndarray, shape (7, 6)
        The mean.
    places : ndarray of int, shape (n, e)
        Each row's neighbourhood: where its equations stand among the 7 n.
    reduce : ndarray, shape (n, e, e)
        Its T; zero beyond its equations.
    unsettled : ndarray, shape (n, e, 7)
        Its TF.
    least : ndarray, shape (n,)
        Smallest sigma squared, but for the mean's; infinite for a row without a neighbourhood.
    mean_covariance : ndarray, shape (7, 7)
    scales : ndarray, shape (5, 6)
        Centre and rate of the loads, which are scaled to (wrench - centre) rate (the rate of a load
        that takes no part is 0); offset, spread, and bar over sigma of the outputs, m and rad.
    floor : float
        Smallest bar, of an answer's size.
    tangent : ndarray, shape (6, 6), SI
        Added to the derivative: the columns of loads that take no part.
    """

    x: Floats
    terms: Floats
    weights: Floats
    coefficients: Floats
    places: NDArray[np.int64]
    reduce: Floats
    unsettled: Floats
    least: Floats
    mean_covariance: Floats
    scales: Floats
    floor: float
    tangent: Floats


def tables_of(
    inside: Dense, scaling: Scaling, conformal: Floats, tangent: Floats, floor: float
) -> Tables | None:
    """Return the tables of a dense kriging, or None where its outputs do not share one factor.

    Shapes: `conformal` (6,), dimensionless; `tangent` (6, 6), SI.
    """
    if len(inside.shares) != 1:
        return None
    share, n = inside.shares[0], len(inside.equations)
    most = max(len(local.places) for local in share.around)
    places, least = np.zeros((n, most), dtype=np.int64), np.full(n, np.inf)
    reduce, unsettled = np.zeros((n, most, most)), np.zeros((n, most, PLACES))
    for row, local in zip(share.factor.rows, share.around, strict=True):
        size = len(local.places)
        at_row, of_row = np.divmod(local.places, PLACES)
        places[row, :size] = of_row * n + at_row
        reduce[row, :size, :size], unsettled[row, :size] = local.T, local.TF
        least[row] = local.least
    rates, weights = inside.held.terms
    rate = np.where(scaling.active, 1 / scaling.half, 0.0)
    bar = conformal * inside.deviation * scaling.spread
    return Tables(
        x=np.ascontiguousarray(inside.equations.x.T),
        terms=np.concatenate((rates, weights[:, None]), axis=1),
        weights=inside.weights.transpose(1, 0, 2).reshape(-1, OUTPUTS).copy(),
        coefficients=np.ascontiguousarray(inside.coefficients),
        places=places,
        reduce=reduce,
        unsettled=unsettled,
        least=least,
        mean_covariance=np.ascontiguousarray(share.factor.mean_covariance),
        scales=np.stack((scaling.centre, rate, scaling.offset, scaling.spread, bar)),
        floor=floor,
        tangent=np.where(scaling.active, 0.0, tangent),
    )


def _place(x, rates, anchored, at, apart):
    """Write the rows' distances by each load (6, n); return the nearest anchor over all loads."""
    distance = np.zeros(x.shape[1])
    for a in range(LOADS):
        for row in range(x.shape[1]):
            apart[a, row] = at[a] - x[a, row]
            distance[row] += rates[a] * apart[a, row] * apart[a, row]
    anchor, closest = 0, np.inf
    for row in range(x.shape[1]):
        if distance[row] < closest and anchored[row] < np.inf:
            closest, anchor = distance[row], row
    return anchor


def _correlate(term, apart, first, second, across):
    """Add one term's covariance of the values to across; write its two derivatives by q (n,)."""
    for row in range(apart.shape[1]):
        first[row] = 0.0
    for a in range(LOADS):
        if term[a] > 0:
            for row in range(apart.shape[1]):
                first[row] += term[a] * apart[a, row] * apart[a, row]
    for row in range(apart.shape[1]):
        root = np.sqrt(7.0 * first[row])
        decay = np.exp(-root) * term[LOADS]
        across[0, 0, row] += (1 + root + 0.4 * root * root + root * root * root / 15) * decay
        first[row] = -0.7 * (1 + root + root * root / 3) * decay
        second[row] = 49 / 60 * (1 + root) * decay


def _slope(term, apart, first, second, across):
    """Add one term's covariances of slopes to across (7, 7, n)."""
    for a in range(LOADS):
        if term[a] == 0:
            continue
        double = 2 * term[a]
        for row in range(apart.shape[1]):
            across[1 + a, 0, row] += double * first[row] * apart[a, row]
            across[1 + a, 1 + a, row] -= double * first[row]
        for b in range(a + 1):
            if term[b] > 0:
                for row in range(apart.shape[1]):
                    bend = 2 * double * term[b] * second[row]
                    across[1 + a, 1 + b, row] -= bend * apart[a, row] * apart[b, row]


def _mirror(across):
    """Complete across, of which slopes with slopes are symmetric and with values antisymmetric."""
    for a in range(1, PLACES):
        for row in range(across.shape[2]):
            across[0, a, row] = -across[a, 0, row]
        for b in range(a + 1, PLACES):
            for row in range(across.shape[2]):
                across[a, b, row] = across[b, a, row]


def _squared_deviation(tables, anchor, at, across, chosen):
    """Return sigma squared over the process variance, from a row's neighbourhood."""
    for number in range(len(chosen)):
        chosen[number] = across[tables.places[anchor, number]]
    reduced = np.dot(tables.reduce[anchor], chosen)
    explained = np.dot(reduced, tables.unsettled[anchor])
    loose = 0.0
    for a in range(PLACES):
        left = (1.0 if a == 0 else at[a - 1]) - explained[a]
        for b in range(PLACES):
            other = (1.0 if b == 0 else at[b - 1]) - explained[b]
            loose += left * tables.mean_covariance[a, b] * other
    prior = tables.terms[:, LOADS].sum()
    return max(prior - np.dot(reduced, reduced), tables.least[anchor]) + loose


def _answers(tables, wrenches, displacement, bar, derivative):
    """Write displacements and bars (m, 6) and derivatives (m, 6, 6), SI, at wrenches (m, 6)."""
    n, centre, rate = tables.x.shape[1], tables.scales[0], tables.scales[1]
    offset, spread = tables.scales[2], tables.scales[3]
    at, apart, chosen = np.empty(LOADS), np.empty((LOADS, n)), np.empty(tables.places.shape[1])
    first, second, across = np.empty(n), np.empty(n), np.empty((PLACES, PLACES, n))
    for place in range(len(wrenches)):
        for a in range(LOADS):
            at[a] = (wrenches[place, a] - centre[a]) * rate[a]
        across[:] = 0.0
        anchor = _place(tables.x, tables.terms[TERMS - 1], tables.least, at, apart)
        for term in range(TERMS):
            _correlate(tables.terms[term], apart, first, second, across)
            _slope(tables.terms[term], apart, first, second, across)
        _mirror(across)
        told = np.dot(across.reshape(PLACES, PLACES * n), tables.weights) + tables.coefficients
        flat = across[0].reshape(PLACES * n)
        sigma = np.sqrt(_squared_deviation(tables, anchor, at, flat, chosen))
        for q in range(OUTPUTS):
            value = told[0, q]
            for a in range(LOADS):
                value += at[a] * tables.coefficients[1 + a, q]
                slope = told[1 + a, q] * spread[q] * rate[a]
                derivative[place, q, a] = slope + tables.tangent[q, a]
            displacement[place, q] = value * spread[q] + offset[q]
            size = (np.abs(value) + 1.0) * spread[q] + np.abs(offset[q])
            bar[place, q] = max(sigma * tables.scales[4, q], tables.floor * size)


def _covariances(term, apart, first, second, flat):
    """Add one term's covariances of a value with the rows' values and slopes to flat (7, n)."""
    for row in range(apart.shape[1]):
        first[row] = 0.0
    for a in range(LOADS):
        if term[a] > 0:
            for row in range(apart.shape[1]):
                first[row] += term[a] * apart[a, row] * apart[a, row]
    for row in range(apart.shape[1]):
        root = np.sqrt(7.0 * first[row])
        decay = np.exp(-root) * term[LOADS]
        flat[0, row] += (1 + root + 0.4 * root * root + root * root * root / 15) * decay
        second[row] = 1.4 * (1 + root + root * root / 3) * decay
    for a in range(LOADS):
        if term[a] > 0:
            for row in range(apart.shape[1]):
                flat[1 + a, row] += term[a] * second[row] * apart[a, row]


def _values(tables, wrenches, displacement, bar):
    """Write displacements and bars (m, 6), SI, at wrenches (m, 6), without derivatives."""
    n, centre, rate = tables.x.shape[1], tables.scales[0], tables.scales[1]
    offset, spread = tables.scales[2], tables.scales[3]
    at, apart, chosen = np.empty(LOADS), np.empty((LOADS, n)), np.empty(tables.places.shape[1])
    first, second, flat = np.empty(n), np.empty(n), np.empty((PLACES, n))
    for place in range(len(wrenches)):
        for a in range(LOADS):
            at[a] = (wrenches[place, a] - centre[a]) * rate[a]
        flat[:] = 0.0
        anchor = _place(tables.x, tables.terms[TERMS - 1], tables.least, at, apart)
        for term in range(TERMS):
            _covariances(tables.terms[term], apart, first, second, flat)
        own = flat.reshape(PLACES * n)
        told = np.dot(own, tables.weights)
        sigma = np.sqrt(_squared_deviation(tables, anchor, at, own, chosen))
        for q in range(OUTPUTS):
            value = told[q] + tables.coefficients[0, q]
            for a in range(LOADS):
                value += at[a] * tables.coefficients[1 + a, q]
            displacement[place, q] = value * spread[q] + offset[q]
            size = (np.abs(value) + 1.0) * spread[q] + np.abs(offset[q])
            bar[place, q] = max(sigma * tables.scales[4, q], tables.floor * size)


KERNELS = (
    "_place",
    "_correlate",
    "_slope",
    "_mirror",
    "_squared_deviation",
    "_answers",
    "_covariances",
    "_values",
)


def _compile() -> tuple[Callable[..., Any] | None, Callable[..., Any] | None]:
    """Return `_answers` and `_values` compiled, or None twice without numba."""
    if not COMPILED:
        return None, None
    module = globals()
    for name in KERNELS:
        module[name] = compiled(module[name])
    return module["_answers"], module["_values"]


answers, values = _compile()
"""`_answers` and `_values` compiled, or None where numba is not installed."""
