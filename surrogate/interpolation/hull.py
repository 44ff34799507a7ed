"""The nearest point of a convex hull, for many points outside it at once.

Gilbert, Johnson and Keerthi's algorithm (1988, "A fast procedure for computing the distance between
complex objects in three-dimensional space"): of a few vertices of the hull the nearest point is
kept, and the vertex that lies farthest towards the point asked for joins them, until none lies
farther. A point outside has its nearest point on a face, so that three vertices are enough.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from surrogate.table.rows import Floats

MOST_STEPS = 60  # each takes a vertex nearer; some ten are usual
NEARER = 1e-13  # of the squared distances at hand: less is rounding
FLAT = 1e-14  # of squared edges: a triangle or an edge below it is met by its own edges or ends

_SUBSETS = [list(subset) for size in (1, 2, 3) for subset in combinations(range(4), size)]


def nearest_in_hull(vertices: Floats, x: Floats) -> Floats:
    """Return the hull's points nearest to points outside it.

    Parameters
    ----------
    vertices : ndarray, shape (n, 3), dimensionless
        Points whose hull it is, which may be flat, a line or a point.
    x : ndarray, shape (k, 3), dimensionless
        Points outside the hull, or on it.

    Returns
    -------
    ndarray, shape (k, 3), dimensionless
    """
    start = np.argmax(x @ vertices.T - 0.5 * (vertices**2).sum(axis=1), axis=1)
    corners = np.repeat(vertices[start][:, None], 4, axis=1)
    nearest = corners[:, 0].copy()
    going = np.arange(len(x))
    for _ in range(MOST_STEPS):
        to = x[going] - nearest[going]
        farthest = np.argmax(to @ vertices.T, axis=1)
        gain = np.einsum("ki,ki->k", to, vertices[farthest] - nearest[going])
        size = np.einsum("ki,ki->k", to, to) + NEARER
        nearer = gain > NEARER * np.maximum(size, 1.0)
        going, farthest = going[nearer], farthest[nearer]
        if not len(going):
            break
        corners[going, 3] = vertices[farthest]
        found, kept = _nearest_on_faces(corners[going], x[going])
        before = ((x[going] - nearest[going]) ** 2).sum(axis=1)
        after = ((x[going] - found) ** 2).sum(axis=1)
        better = after < before
        going, found, kept = going[better], found[better], kept[better]
        corners[going, :3], nearest[going] = kept, found
    return nearest


def _nearest_on_faces(corners: Floats, x: Floats) -> tuple[Floats, Floats]:
    """Return, of four corners (k, 4, 3), the nearest point (k, 3) and the corners it is between.

    Those are three, (k, 3, 3), some of them repeated where the point is on an edge or a corner.
    """
    least = np.full(len(x), np.inf)
    found, kept = np.empty_like(x), np.empty((len(x), 3, 3))
    for subset in _SUBSETS:
        some = corners[:, subset]
        point, inside = _foot(some, x)
        apart = np.where(inside, ((x - point) ** 2).sum(axis=1), np.inf)
        better = apart < least
        least[better], found[better] = apart[better], point[better]
        padded = [*range(len(subset)), *[0] * (3 - len(subset))]
        kept[better] = some[better][:, padded]
    return found, kept


def _foot(corners: Floats, x: Floats) -> tuple[Floats, np.ndarray]:
    """Return the foot (k, 3) of x on points, lines or planes, and whether it is between corners."""
    base, count = corners[:, 0], corners.shape[1]
    to = x - base
    if count == 1:
        return base, np.ones(len(x), dtype=bool)
    first = corners[:, 1] - base
    a = np.einsum("ki,ki->k", first, first)
    p = np.einsum("ki,ki->k", first, to)
    with np.errstate(divide="ignore", invalid="ignore"):
        if count == 2:
            s = p / a
            return base + s[:, None] * first, (a > 0) & (s >= 0) & (s <= 1)
        second = corners[:, 2] - base
        b = np.einsum("ki,ki->k", first, second)
        c = np.einsum("ki,ki->k", second, second)
        q = np.einsum("ki,ki->k", second, to)
        size = a * c - b * b
        s, t = (c * p - b * q) / size, (a * q - b * p) / size
        inside = (size > FLAT * a * c) & (s >= 0) & (t >= 0) & (s + t <= 1)
        return base + s[:, None] * first + t[:, None] * second, inside
