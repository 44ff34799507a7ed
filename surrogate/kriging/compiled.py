"""The single answer compiled: displacement, bar and derivative in one walk over the rows.

Optional: without numba the same numbers come from numpy, more slowly. Compiled code is kept beside
this file; where that cannot be written each program compiles once, some seconds. The covariances of
a place's value and slopes with those of all rows are laid out with the rows innermost, so that a
processor's vectors run along them. Sums are in a stated order, the one of the FMU's C: both give
the same digits where both have the same exponential.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..jit import COMPILED, compiled
from .correlation import GROUPS, LOADS, PLACES
from .equations import OUTPUTS
from .neighbourhood import TIE

TERMS = len(GROUPS)


def _place(x, rates, anchored, at, apart):
    """Write the rows' distances by each load (6, n); return the nearest anchor over all loads.

    Of those that are equally near the first, as `neighbourhood.Finder` does.
    """
    distance = np.zeros(x.shape[1])
    for a in range(LOADS):
        for row in range(x.shape[1]):
            apart[a, row] = at[a] - x[a, row]
            distance[row] += rates[a] * apart[a, row] * apart[a, row]
    closest = np.inf
    for row in range(x.shape[1]):
        if distance[row] < closest and anchored[row] < np.inf:
            closest = distance[row]
    for row in range(x.shape[1]):
        if distance[row] <= closest + TIE and anchored[row] < np.inf:
            return row
    return 0  # of a place that is not a number


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
    local = tables.number[anchor]
    for place in range(len(chosen)):
        chosen[place] = across[tables.places[local, place]]
    left, spent, loose = np.zeros(PLACES), 0.0, 0.0
    reduced = _reduced(tables.columns[local], chosen)
    for row in range(len(chosen)):
        for a in range(PLACES):
            left[a] += reduced[row] * tables.unsettled[local, row, a]
        spent += reduced[row] * reduced[row]
    for a in range(PLACES):
        left[a] = (1.0 if a == 0 else at[a - 1]) - left[a]
    for a in range(PLACES):
        for b in range(PLACES):
            loose += left[a] * tables.mean_covariance[a, b] * left[b]
    prior = tables.terms[:, LOADS].sum()
    return max(prior - spent, tables.least[anchor]) + loose


def _reduced(columns, chosen):
    """Return T (e, e), given column after column, times covariances (e,).

    Each sum in the order of the columns, four of which are added in one pass along the rows.
    """
    size = len(chosen)
    out, fours = np.zeros(size), size - size % 4
    for j in range(0, fours, 4):
        a, b, c, d = chosen[j], chosen[j + 1], chosen[j + 2], chosen[j + 3]
        for i in range(j, size):
            two = (out[i] + columns[j, i] * a) + columns[j + 1, i] * b
            out[i] = (two + columns[j + 2, i] * c) + columns[j + 3, i] * d
    for j in range(fours, size):
        for i in range(j, size):
            out[i] += columns[j, i] * chosen[j]
    return out


def _weighed(flat, weights):
    """Return the sums of covariances (e,) with the weights (e, 6): one number an output.

    In the rows' order, which is the FMU's too: weights are up to 1e8 times their sum, so that sums
    in another order differ in digits that are told.
    """
    a, b, c, d, e, f = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for place in range(len(flat)):
        own = flat[place]
        a += own * weights[place, 0]
        b += own * weights[place, 1]
        c += own * weights[place, 2]
        d += own * weights[place, 3]
        e += own * weights[place, 4]
        f += own * weights[place, 5]
    return a, b, c, d, e, f


def _is_known(tables, sigma, at):
    """Return whether the error at scaled loads (6,) with a posterior deviation is known."""
    for a in range(LOADS):
        if not tables.span[0, a] <= at[a] <= tables.span[1, a]:
            return False
    return sigma <= tables.sigma[len(tables.sigma) - 1]


def _factor(tables, sigma, q):
    """Return what a deviation is multiplied by for an error bar: as `np.interp`."""
    last = len(tables.factors) - 1
    if sigma >= tables.sigma[last]:
        return tables.factors[last, q]
    if sigma <= tables.sigma[0]:
        return tables.factors[0, q]
    k = 0
    while tables.sigma[k + 1] <= sigma:
        k += 1
    low, width = tables.sigma[k], tables.sigma[k + 1] - tables.sigma[k]
    rise = (tables.factors[k + 1, q] - tables.factors[k, q]) / width
    return rise * (sigma - low) + tables.factors[k, q]


def _answers(tables, wrenches, displacement, bar, derivative):
    """Write displacements and bars (m, 6) and derivatives (m, 6, 6), SI, at wrenches (m, 6)."""
    n, centre, rate = tables.x.shape[1], tables.scales[0], tables.scales[1]
    offset, spread = tables.scales[2], tables.scales[3]
    at, apart, chosen = np.empty(LOADS), np.empty((LOADS, n)), np.empty(tables.places.shape[1])
    first, second, across = np.empty(n), np.empty(n), np.empty((PLACES, PLACES, n))
    told = np.empty((PLACES, OUTPUTS))
    for place in range(len(wrenches)):
        for a in range(LOADS):
            at[a] = (wrenches[place, a] - centre[a]) * rate[a]
        across[:] = 0.0
        anchor = _place(tables.x, tables.terms[TERMS - 1], tables.least, at, apart)
        for term in range(TERMS):
            _correlate(tables.terms[term], apart, first, second, across)
            _slope(tables.terms[term], apart, first, second, across)
        _mirror(across)
        covariances = across.reshape(PLACES, PLACES * n)
        for a in range(PLACES):
            sums = _weighed(covariances[a], tables.weights)
            for q in range(OUTPUTS):
                told[a, q] = sums[q] + tables.coefficients[a, q]
        flat = covariances[0]
        sigma = np.sqrt(_squared_deviation(tables, anchor, at, flat, chosen))
        known = _is_known(tables, sigma, at)
        for q in range(OUTPUTS):
            value = told[0, q]
            for a in range(LOADS):
                value += at[a] * tables.coefficients[1 + a, q]
                slope = told[1 + a, q] * spread[q] * rate[a]
                derivative[place, q, a] = slope + tables.tangent[q, a]
            displacement[place, q] = value * spread[q] + offset[q]
            size = (np.abs(value) + 1.0) * spread[q] + np.abs(offset[q])
            least = max(tables.floor * size, tables.scales[5, q])
            wide = sigma * _factor(tables, sigma, q) * tables.scales[4, q]
            bar[place, q] = max(wide, least) if known else np.nan


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
        told = _weighed(own, tables.weights)
        sigma = np.sqrt(_squared_deviation(tables, anchor, at, own, chosen))
        known = _is_known(tables, sigma, at)
        for q in range(OUTPUTS):
            value = told[q] + tables.coefficients[0, q]
            for a in range(LOADS):
                value += at[a] * tables.coefficients[1 + a, q]
            displacement[place, q] = value * spread[q] + offset[q]
            size = (np.abs(value) + 1.0) * spread[q] + np.abs(offset[q])
            least = max(tables.floor * size, tables.scales[5, q])
            wide = sigma * _factor(tables, sigma, q) * tables.scales[4, q]
            bar[place, q] = max(wide, least) if known else np.nan


def _one(tables, ends, wrench):
    """Return six displacements, six bars, SI, and whether one wrench is beyond the ends (2, 6).

    Numbers in and numbers out: arrays would cost as much as a part of the answer.
    """
    asked, moved, bar = np.empty((1, LOADS)), np.empty((1, OUTPUTS)), np.empty((1, OUTPUTS))
    beyond = 0.0
    for a in range(LOADS):
        asked[0, a] = wrench[a]
        if wrench[a] < ends[0, a] or wrench[a] > ends[1, a]:
            beyond = 1.0
    _values(tables, asked, moved, bar)
    u, b = moved[0], bar[0]
    return u[0], u[1], u[2], u[3], u[4], u[5], b[0], b[1], b[2], b[3], b[4], b[5], beyond


KERNELS = (
    "_place",
    "_correlate",
    "_slope",
    "_mirror",
    "_squared_deviation",
    "_reduced",
    "_weighed",
    "_is_known",
    "_factor",
    "_answers",
    "_covariances",
    "_values",
    "_one",
)

Kernel = Callable[..., Any] | None


def _compile() -> tuple[Kernel, Kernel, Kernel]:
    """Return `_answers`, `_values` and `_one` compiled, or None thrice without numba."""
    if not COMPILED:
        return None, None, None
    module = globals()
    for name in KERNELS:
        module[name] = compiled(module[name])
    return module["_answers"], module["_values"], module["_one"]


answers, values, one = _compile()
"""`_answers`, `_values` and `_one` compiled, or None where numba is not installed."""
