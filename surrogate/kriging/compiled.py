"""The single answer compiled: value, derivative and sigma in one walk over the rows.

Optional: without numba the same numbers come from numpy, more slowly. Compiled code is kept beside
this file; where that cannot be written each program compiles once, some seconds.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrogate.kriging.correlation import GROUPS, LOADS, PLACES
from surrogate.kriging.dense import Dense
from surrogate.kriging.equations import OUTPUTS, Scaling
from surrogate.rows import Floats

LANES = 8  # six outputs, and two zeros: what fills a processor's vectors
TERMS = len(GROUPS)


class Tables(NamedTuple):
    """What the compiled answer reads: contiguous, in scaled numbers.

    Attributes
    ----------
    x : ndarray, shape (n, 6)
    rates : ndarray, shape (4, 6)
        Inverse squared lengths of the covariance's terms.
    loads : ndarray of int, shape (4, 6)
        Which loads each term sees: its first `counts`, shape (4,).
    term_weights : ndarray, shape (4,)
    weights : ndarray, shape (n, 7, 8)
    coefficients : ndarray, shape (7, 8)
    anchors : ndarray of bool, shape (n,)
        Which rows have a neighbourhood.
    places : ndarray of int, shape (n, e)
        Each row's neighbourhood: places of its equations among 7 n, padded.
    sizes : ndarray of int, shape (n,)
        How many equations it has.
    columns : ndarray, shape (n, e, e)
        Its T by columns: what an equation's covariance adds to the reduced ones.
    terms : ndarray, shape (n, e, 7)
        Its TF.
    least : ndarray, shape (n,)
        Smallest sigma squared, but for the mean's.
    prior : float
        Sigma squared far from all rows, but for the mean's.
    mean_covariance : ndarray, shape (7, 7)
    centre, rate : ndarray, shape (6,)
        Loads are scaled by (wrench - centre) * rate; the rate of a load that takes no part is 0.
    offset, spread : ndarray, shape (6,), m and rad
    bar : ndarray, shape (6,), m and rad
        What sigma over the process variance is multiplied by.
    floor : float
        Smallest bar, of an answer's size.
    tangent : ndarray, shape (6, 6), SI
        Added to the derivative: the columns of loads that take no part.
    """

    x: Floats
    rates: Floats
    loads: NDArray[np.int64]
    counts: NDArray[np.int64]
    term_weights: Floats
    weights: Floats
    coefficients: Floats
    anchors: NDArray[np.bool_]
    places: NDArray[np.int64]
    sizes: NDArray[np.int64]
    columns: Floats
    terms: Floats
    least: Floats
    prior: float
    mean_covariance: Floats
    centre: Floats
    rate: Floats
    offset: Floats
    spread: Floats
    bar: Floats
    floor: float
    tangent: Floats


def tables_of(
    inside: Dense, scaling: Scaling, conformal: Floats, tangent: Floats, floor: float
) -> Tables | None:
    """Return the tables of a dense kriging, or None where its outputs do not share one factor."""
    if len(inside.shares) != 1:
        return None
    share, n = inside.shares[0], len(inside.equations)
    most = max(len(local.places) for local in share.around)
    anchors, places = np.zeros(n, dtype=bool), np.zeros((n, most), dtype=np.int64)
    sizes, least = np.zeros(n, dtype=np.int64), np.zeros(n)
    columns, terms = np.zeros((n, most, most)), np.zeros((n, most, PLACES))
    for row, local in zip(share.factor.rows, share.around, strict=True):
        size = len(local.places)
        anchors[row], sizes[row], places[row, :size] = True, size, local.places
        columns[row, :size, :size], terms[row, :size] = local.T.T, local.TF
        least[row] = local.least
    rates, weights = inside.held.terms
    return Tables(
        x=np.ascontiguousarray(inside.equations.x),
        rates=np.ascontiguousarray(rates),
        loads=np.argsort(rates == 0, axis=1, kind="stable"),
        counts=(rates != 0).sum(axis=1),
        term_weights=weights,
        weights=_in_lanes(inside.weights),
        coefficients=_in_lanes(inside.coefficients),
        anchors=anchors,
        places=places,
        sizes=sizes,
        columns=columns,
        terms=terms,
        least=least,
        prior=float(inside.held.prior[0]),
        mean_covariance=np.ascontiguousarray(share.factor.mean_covariance),
        centre=scaling.centre,
        rate=np.where(scaling.active, 1 / scaling.half, 0.0),
        offset=scaling.offset,
        spread=scaling.spread,
        bar=conformal * inside.deviation * scaling.spread,
        floor=floor,
        tangent=np.where(scaling.active, 0.0, tangent),
    )


def _in_lanes(outputs: Floats) -> Floats:
    """Return an array of six outputs with zeros behind them."""
    return np.concatenate((outputs, np.zeros((*outputs.shape[:-1], LANES - OUTPUTS))), axis=-1)


def _walk(tables, at, across, value, slope):  # pragma: no cover: compiled
    """Sum the covariances times the weights over the rows; return the nearest row.

    Writes value (8,), slope (6 loads, 8 outputs) and the covariances across (n, 7) at a place (6,).
    """
    apart, along = np.empty(LOADS), np.empty(LANES)
    value[:] = tables.coefficients[0]
    for a in range(LOADS):
        slope[a] = tables.coefficients[1 + a]
        value += at[a] * tables.coefficients[1 + a]
    anchor, closest = 0, np.inf
    for row in range(len(tables.x)):
        told, here = tables.weights[row], across[row]
        here[:] = 0.0
        for a in range(LOADS):
            apart[a] = at[a] - tables.x[row, a]
        distance = 0.0
        for term in range(TERMS):
            distance = _term(tables, term, apart, told, here, along, slope)
        if tables.anchors[row] and distance < closest:
            closest, anchor = distance, row
        for place in range(PLACES):
            for q in range(LANES):
                value[q] += here[place] * told[place, q]
    return anchor


def _term(tables, term, apart, told, here, along, slope):  # pragma: no cover: compiled
    """Add what one term of the covariance with one row makes of it; return its distance."""
    distance = 0.0
    for number in range(tables.counts[term]):
        a = tables.loads[term, number]
        distance += tables.rates[term, a] * apart[a] * apart[a]
    root = np.sqrt(7.0 * distance)
    decay = np.exp(-root) * tables.term_weights[term]
    here[0] += (1 + root + 0.4 * root * root + root * root * root / 15) * decay
    first = -0.7 * (1 + root + root * root / 3) * decay
    second = 49 / 60 * (1 + root) * decay
    for q in range(LANES):
        along[q] = first * told[0, q]
    for number in range(tables.counts[term]):
        a = tables.loads[term, number]
        rise = 2 * tables.rates[term, a] * apart[a]
        here[1 + a] -= first * rise
        for q in range(LANES):
            along[q] -= second * rise * told[1 + a, q]
    for number in range(tables.counts[term]):
        a = tables.loads[term, number]
        rise, bend = 2 * tables.rates[term, a] * apart[a], 2 * tables.rates[term, a] * first
        for q in range(LANES):
            slope[a, q] += rise * along[q] - bend * told[1 + a, q]
    return distance


def _squared_deviation(tables, at, across, reduced, anchor):  # pragma: no cover: compiled
    """Return sigma squared over the process variance, from the nearest row's neighbourhood."""
    size, flat = tables.sizes[anchor], across.reshape(-1)
    columns, terms = tables.columns[anchor], tables.terms[anchor]
    reduced[:size] = 0.0
    for column in range(size):
        told = flat[tables.places[anchor, column]]
        source = columns[column]
        for row in range(column, size):
            reduced[row] += source[row] * told
    spent, unsettled = 0.0, np.empty(PLACES)
    unsettled[0] = 1.0
    unsettled[1:] = at
    for row in range(size):
        spent += reduced[row] * reduced[row]
        for place in range(PLACES):
            unsettled[place] -= reduced[row] * terms[row, place]
    loose = 0.0
    for a in range(PLACES):
        for b in range(PLACES):
            loose += unsettled[a] * tables.mean_covariance[a, b] * unsettled[b]
    return max(tables.prior - spent, tables.least[anchor]) + loose


def _answers(tables, wrenches, displacement, bar, derivative):  # pragma: no cover: compiled
    """Write displacements and bars (m, 6) and derivatives (m, 6, 6), SI, at wrenches (m, 6)."""
    across, reduced = np.empty((len(tables.x), PLACES)), np.empty(tables.columns.shape[1])
    at, value, slope = np.empty(LOADS), np.empty(LANES), np.empty((LOADS, LANES))
    for place in range(len(wrenches)):
        for a in range(LOADS):
            at[a] = (wrenches[place, a] - tables.centre[a]) * tables.rate[a]
        anchor = _walk(tables, at, across, value, slope)
        sigma = np.sqrt(_squared_deviation(tables, at, across, reduced, anchor))
        for q in range(OUTPUTS):
            offset, spread = tables.offset[q], tables.spread[q]
            displacement[place, q] = value[q] * spread + offset
            size = (np.abs(value[q]) + 1.0) * spread + np.abs(offset)
            bar[place, q] = max(sigma * tables.bar[q], tables.floor * size)
            for a in range(LOADS):
                change = slope[a, q] * spread * tables.rate[a]
                derivative[place, q, a] = change + tables.tangent[q, a]


def _compile() -> Callable[..., Any] | None:
    """Return `_answers` compiled, or None without numba."""
    if importlib.util.find_spec("numba") is None:
        return None
    import numba

    module = globals()
    for name in ("_term", "_walk", "_squared_deviation", "_answers"):
        try:
            module[name] = numba.njit(cache=True, nogil=True, error_model="numpy")(module[name])
        except RuntimeError:  # no folder for the compiled code can be written
            module[name] = numba.njit(nogil=True, error_model="numpy")(module[name])
    return module["_answers"]


answers = _compile()
"""`_answers` compiled, or None where numba is not installed."""
