"""Slopes at the rows, and what they tell about the error of interpolating linearly.

With the slope g_i of the response at each vertex v_i of a simplex, the blend

    u(x) = sum_i lambda_i (u_i + 1/2 g_i (x - v_i))

is exact for quadratics: linear interpolation of a quadratic errs by half of what the vertices'
first-order expansions, blended by their barycentric weights, add to it (the whole of it would err
by as much to the other side). So its second part, the *bend*, is a third-order estimate of the
error of linear interpolation. As x - v_i is a sum of edges, it is

    bend(x) = 1/2 sum_{i<j} lambda_i lambda_j (g_i - g_j) (v_j - v_i)

Slopes come from FEA solves as their tangent compliance. Where no row has one they are recovered
from a quadratic fitted through the neighbours (as in Zienkiewicz and Zhu 1992, patch recovery).
"""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np
from scipy.spatial import KDTree

from surrogate.interpolation.delaunay import Indices, Interpolant
from surrogate.table.rows import Floats

NEIGHBOURS = {1: 4, 2: 9, 3: 16}  # of a fitted quadratic, by dimension: not quite two per unknown
RIDGE = 1e-10


def row_slopes(interpolant: Interpolant, values: Floats, tangent: Floats) -> Floats:
    """Return the slopes of values (n, q) at the points, shape (n, q, 3).

    Those known from `tangent`, shape (n, q, 3); those recovered from neighbours if no row has a
    tangent; NaN where there is neither.
    """
    if np.isfinite(tangent).all(axis=(1, 2)).any():
        return tangent
    return _recovered(interpolant, values)


def edge_bends(interpolant: Interpolant, slopes: Floats) -> Floats:
    """Return (g_i - g_j) (v_j - v_i) / 2 of each simplex' edges i < j, shape (m, edges, q).

    A vertex without a slope takes that of the simplex' linear interpolation, which bends nothing;
    the caller passes slopes with that taken off, so that 0 stands for it.
    """
    simplices, points = interpolant.simplices, interpolant.points
    first, second = np.triu_indices(simplices.shape[1], 1)
    edges = points[simplices[:, second]] - points[simplices[:, first]]
    differ = slopes[:, first] - slopes[:, second]
    return 0.5 * np.einsum("meqi,mei->meq", differ, edges)


def simplex_slopes(interpolant: Interpolant, values: Floats, slopes: Floats) -> Floats:
    """Return each vertex' slope less its simplex' own, shape (m, d + 1, q, 3); 0 where unknown."""
    own = interpolant.gradients(values)
    return np.nan_to_num(slopes[interpolant.simplices] - own[:, None])


def _recovered(interpolant: Interpolant, values: Floats) -> Floats:
    """Return slopes of quadratics fitted through each point and its neighbours, (n, q, 3)."""
    dimension, n = interpolant.dimension, len(values)
    slopes = np.full((n, values.shape[1], 3), np.nan)
    wanted = NEIGHBOURS.get(dimension, 0)
    if not wanted or n <= wanted:
        return slopes
    flat = (interpolant.points - interpolant.origin) @ interpolant.basis.T
    found = KDTree(flat).query(flat, k=wanted + 1)
    far, near = np.asarray(found[0])[:, 1:], np.asarray(found[1], dtype=np.intp)[:, 1:]
    reach = np.maximum(far[:, -1], np.finfo(float).tiny)
    apart = (flat[near] - flat[:, None]) / reach[:, None, None]
    squares = list(combinations_with_replacement(range(dimension), 2))
    second = np.stack([apart[..., i] * apart[..., j] for i, j in squares], axis=-1)
    weight = 1 / (0.1 + (far / reach[:, None]) ** 2)
    terms = np.concatenate((apart, second), axis=-1)
    told = weight[..., None] * terms
    normal = np.einsum("nki,nkj->nij", told, terms) + RIDGE * wanted * np.eye(terms.shape[-1])
    rise = values[near] - values[:, None]
    fitted = np.linalg.solve(normal, np.einsum("nki,nkq->niq", told, rise))[:, :dimension]
    fitted = fitted / reach[:, None, None]
    return np.einsum("niq,ij->nqj", fitted, interpolant.basis)


def bends_at(shares: Floats, edges: Floats) -> Floats:
    """Return the bends (k, q) at barycentric coordinates (k, d + 1), edge bends (k, edges, q)."""
    first, second = np.triu_indices(shares.shape[1], 1)
    return np.einsum("ke,keq->kq", shares[:, first] * shares[:, second], edges)


def quadratic_maps(interpolant: Interpolant, edges: Floats) -> tuple[Floats, Floats]:
    """Return Q (m, q, 3, 3) and l (m, q, 3) such that the bend is dx Q dx + l dx.

    dx is counted from the simplex' anchor, its last vertex, whose barycentric coordinate is one
    less the others'.
    """
    weights = interpolant.weights
    count, width = interpolant.simplices.shape
    maps = np.concatenate((weights, -weights.sum(axis=1, keepdims=True)), axis=1)
    constant = np.zeros((count, width))
    constant[:, -1] = 1.0
    first, second = np.triu_indices(width, 1)
    square = np.einsum("meq,mei,mej->mqij", edges, maps[:, first], maps[:, second])
    line = np.einsum("meq,mei,me->mqi", edges, maps[:, first], constant[:, second])
    return square, line


def bend_of(
    interpolant: Interpolant, values: Floats, tangent: Floats, found: Indices, shares: Floats
) -> Floats:
    """Return the bends (k, q) in simplices (k,) at barycentric coordinates (k, d + 1)."""
    slopes = row_slopes(interpolant, values, tangent)
    edges = edge_bends(interpolant, simplex_slopes(interpolant, values, slopes))
    return bends_at(shares, edges[found])
