"""Slopes at the points of a table, by which answers go on from the hull outwards.

Slopes come from solves as their tangent compliance. Where no row has one they are recovered from a
quadratic fitted through the neighbours (as in Zienkiewicz and Zhu 1992, patch recovery).
"""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np
from scipy.spatial import KDTree

from ..table.rows import Floats
from .delaunay import Triangulation

NEIGHBOURS = {1: 5, 2: 10, 3: 18}  # of a patch, by dimension: not quite two for each unknown
RIDGE = 1e-10  # of the patch's own size: keeps points on one quadric from a singular fit
NEARER = 0.1  # added to squared distances (of the farthest) before weights are their inverse
CHUNK = 4096  # patches fitted at once: their normal equations fit the cache


def recovered_slopes(triangulation: Triangulation, values: Floats) -> Floats:
    """Return slopes (n, q, 3) of a quadratic fitted through each point's neighbours.

    The point itself is left out. Where there are too few points for a quadratic, the slope is the
    mean of the simplices around. Points are dimensionless, so that slopes are in the unit of the
    values (n, q): m and rad.
    """
    dimension, n = triangulation.dimension, len(values)
    neighbours = NEIGHBOURS.get(dimension, 0)
    if not neighbours or n <= neighbours:
        return mean_slopes(triangulation, values)
    slopes = np.empty((n, values.shape[1], 3))
    flat = triangulation.flattened(triangulation.points)
    found = KDTree(flat).query(flat, k=neighbours + 1)
    far, near = np.asarray(found[0])[:, 1:], np.asarray(found[1], dtype=np.intp)[:, 1:]
    for start in range(0, n, CHUNK):
        some = slice(start, start + CHUNK)
        apart = flat[near[some]] - flat[some, None]
        rise = values[near[some]] - values[some, None]
        slope = _quadratics(apart, far[some], rise)
        slopes[some] = np.einsum("niq,ij->nqj", slope, triangulation.basis)
    return slopes


def _quadratics(apart: Floats, far: Floats, rise: Floats) -> Floats:
    """Return slopes (n, d, q) of quadratics through rises (n, k, q)."""
    dimension = apart.shape[2]
    reach = np.maximum(far[:, -1], np.finfo(float).tiny)
    apart = apart / reach[:, None, None]
    squares = list(combinations_with_replacement(range(dimension), 2))
    second = np.stack([apart[..., i] * apart[..., j] for i, j in squares], axis=-1)
    terms = np.concatenate((np.ones((*apart.shape[:2], 1)), apart, second), axis=-1)
    weighed = terms / (NEARER + (far / reach[:, None]) ** 2)[..., None]
    normal = weighed.transpose(0, 2, 1) @ terms
    normal += RIDGE * terms.shape[1] * np.eye(terms.shape[-1])
    fitted = np.linalg.solve(normal, weighed.transpose(0, 2, 1) @ rise)
    return fitted[:, 1 : 1 + dimension] / reach[:, None, None]


def mean_slopes(triangulation: Triangulation, values: Floats) -> Floats:
    """Return slopes (n, q, 3) as the mean of the simplices that meet at each point, by volume.

    A flat simplex has no slope and no say. Points are dimensionless, so that slopes are in the unit
    of the values (n, q): m and rad.
    """
    weight = np.where(triangulation.degenerate, 0.0, triangulation.volumes)
    own = weight[:, None, None] * triangulation.gradients(values)
    around, size = np.zeros((len(values), values.shape[1], 3)), np.zeros(len(values))
    for corner in triangulation.simplices.T:
        np.add.at(around, corner, own)
        np.add.at(size, corner, weight)
    return around / np.maximum(size, np.finfo(float).tiny)[:, None, None]
