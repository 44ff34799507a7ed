"""Piecewise linear interpolation over a Delaunay triangulation of up to three dimensions.

Points that span fewer than three dimensions get a triangulation of the plane, an ordered line or
a single point: qhull needs points that span its dimension.
"""

from __future__ import annotations

import math
from functools import cached_property
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import Delaunay, KDTree, QhullError

from ..table.rows import Floats

Indices = NDArray[np.intp]

# Part of the points' extent: points closer than this to a plane, a line or a point lie in it.
SPAN_TOLERANCE = 1e-9
ROUNDED = 2e-14  # barycentric coordinate below zero that still counts as inside: some 100 roundings
# Largest number of steps of a walk, which takes some 5 from the simplex of the nearest middle.
STEPS = 64
# Part of the way to the middle: rounding may move points of the hull outside by so much.
ON_HULL = 1e-9
SLIVER = 1e-10  # volume over cubed longest edge (or the like) below which a simplex is degenerate
SHEAR = np.eye(3) + 1e-3 * np.array([[0.31, 0.77, -0.53], [0.19, -0.41, 0.97], [-0.61, 0.37, 0.23]])

# Constants of the order of a batch:
CELLS = 32  # cells a side: three times five bits fit 16, which numpy sorts by radix
MIN_SORTED = 64  # points below which sorting costs more than it saves

# Constant of points beside degenerate simplices:
PAIRS = 200_000  # pairs of points and simplices at once: some 50 MB of numbers

# Constants of slopes at the points:
NEIGHBOURS = {1: 5, 2: 10, 3: 18}  # points of a patch, by dimension: not quite two for each unknown
RIDGE = 1e-10  # part of the patch's size: keeps points on one quadric from a singular fit
NEARER = 0.1  # added to squared distances (of the farthest) before weights are their inverse
CHUNK = 4096  # patches fitted at once: their normal equations fit the cache


class Triangulation:
    """A triangulation of scattered points, with one affine barycentric map per simplex.

    `points` (n, 3).
    `dimension`: 0 to 3, the dimension that the points span.
    `simplices` (m, dimension + 1): vertices of each simplex; the last one is its anchor.
    `anchors` (m, 3): positions of the anchors.
    `weights` (m, dimension, 3): `weights[s] @ (x - anchors[s])` are the barycentric coordinates but
    the last one.
    `volumes` (m,): length, area or volume of each simplex; 1 for a single point.
    `degenerate` (m,): whether each simplex has (almost) no volume.
    `neighbours` (m, dimension + 1): the simplex across from each vertex, -1 on the hull.
    """

    def __init__(self, points: ArrayLike) -> None:
        """Triangulate distinct points, shape (n, 3), n at least 1."""
        self.points = np.asarray(points, dtype=float).reshape(-1, 3)
        self.origin = self.points[0] if len(self.points) == 1 else self.points.mean(axis=0)
        self._triangulate()
        self.anchors = self.points[self.simplices[:, -1]]
        edges = self.points[self.simplices[:, :-1]] - self.anchors[:, None]
        self.volumes = np.abs(determinants(edges @ self.basis.T)) / math.factorial(self.dimension)
        finite = np.isfinite(self.weights).reshape(len(edges), -1)
        broken: NDArray[np.bool_] = np.asarray(np.any(~finite, axis=1))
        self.degenerate = broken | _is_sliver(edges, self.volumes)
        if broken.any():
            self.weights = np.where(broken[:, None, None], 0.0, self.weights)

    def _triangulate(self) -> None:
        """Set the simplices, with a lower dimension if qhull calls the points flat."""
        dimension, basis = _span(self.points)
        while True:
            self.dimension = dimension
            self.basis = basis[:dimension]
            local = (self.points - self.origin) @ self.basis.T
            off = self.points - self.origin - local @ self.basis
            extent = float(np.abs(self.points - self.origin).max(initial=0.0))
            self.slack = max(
                SPAN_TOLERANCE * max(1.0, extent), 2 * float(np.abs(off).max(initial=0.0))
            )
            try:
                return self._connect(local)
            # The points span a lower dimension within qhull's precision, though not within
            # `SPAN_TOLERANCE`.
            except QhullError:
                dimension -= 1
                basis = np.linalg.svd(self.points - self.origin, full_matrices=False)[2]

    def _connect(self, local: Floats) -> None:
        """Make the simplices of the points, shape (n, d), in the coordinates of their span."""
        if self.dimension == 0:
            self.simplices = np.zeros((1, 1), dtype=np.intp)
            self.neighbours = np.full((1, 1), -1, dtype=np.intp)
            self.weights = np.zeros((1, 0, 3))
        elif self.dimension == 1:
            order = np.argsort(local[:, 0])
            self.simplices = np.stack((order[:-1], order[1:]), axis=1)
            index = np.arange(len(self.simplices))
            self.neighbours = np.stack((index + 1, index - 1), axis=1)
            self.neighbours[-1, 0] = -1
            with np.errstate(divide="ignore", invalid="ignore"):  # no length: marked degenerate
                self.weights = -self.basis[None] / np.diff(local[order, 0])[:, None, None]
        else:
            # In three dimensions the points themselves, so that the result is scipy's.
            points = self.points if self.dimension == 3 else local
            delaunay = Delaunay(points)
            # qhull joins the cells of a grid by slivers where their diagonals differ: answers would
            # jump there. After a slight shear each cell has one triangulation only, and barycentric
            # coordinates are unchanged.
            slivers = _count_slivers(points, delaunay.simplices)
            if slivers:
                sheared = Delaunay(points @ SHEAR[: self.dimension, : self.dimension].T)
                if _count_slivers(points, sheared.simplices) < slivers:
                    delaunay = sheared
            self.simplices = delaunay.simplices.astype(np.intp)
            self.neighbours = delaunay.neighbors.astype(np.intp)
            edges = points[self.simplices[:, :-1]] - points[self.simplices[:, -1:]]
            self.weights = inverses(edges).transpose(0, 2, 1)
            if self.dimension < 3:
                with np.errstate(invalid="ignore"):  # no area: marked degenerate
                    self.weights = self.weights @ self.basis

    def locate(self, x: ArrayLike) -> Indices:
        """Return the simplex of each point, shape (k, 3) -> (k,), or -1 outside the hull.

        Points on the hull are inside: those that rounding put just outside are located again a
        little further in. Points are dimensionless.
        """
        points = np.asarray(x, dtype=float)
        simplices = self._walk(points)
        outside = np.asarray(simplices < 0)
        if outside.any():
            inward = points[outside] + ON_HULL * (self.origin - points[outside])
            simplices[outside] = self._walk(inward)
        return simplices

    def _walk(self, points: Floats) -> Indices:
        """Walk from the simplex with the nearest middle, each time over the face before the point.

        In a Delaunay triangulation such a walk never returns to a simplex (Devillers, Pion and
        Teillaud 2002, "Walking in a triangulation").
        """
        centred = points - self.origin
        off = np.abs(centred - centred @ self.basis.T @ self.basis).max(axis=1, initial=0.0)
        simplices = np.asarray(self._middles.query(points)[1], dtype=np.intp)
        walking = np.arange(len(points))
        lost = []
        for _ in range(STEPS):
            parts = self.barycentric(simplices[walking], points[walking])
            behind, least = parts.argmin(axis=1), parts.min(axis=1)
            degenerate = self.degenerate[simplices[walking]]
            lost.append(walking[degenerate])  # their barycentric coordinates have no direction
            goes_on = ~degenerate & (least < -ROUNDED)
            walking, behind = walking[goes_on], behind[goes_on]
            simplices[walking] = self.neighbours[simplices[walking], behind]
            walking = walking[simplices[walking] >= 0]
        beside = np.concatenate((*lost, walking))
        simplices[beside] = self._compared(points[beside])
        return np.where(off > self.slack, -1, simplices)

    def _compared(self, points: Floats) -> Indices:
        """Return the regular simplex that holds each point (k, 3) best, of all; -1 if none."""
        simplices = np.full(len(points), -1)
        largest = np.full(len(points), -ROUNDED)
        for radius, members, middles in self._by_size:
            count = middles.query_ball_point(points, radius, return_length=True)
            held = np.flatnonzero(count)
            ends = np.flatnonzero(np.diff(np.cumsum(count[held]) // PAIRS)) + 1
            for part in np.split(held, ends) if len(held) else ():
                near = middles.query_ball_point(points[part], radius)
                owner = np.repeat(part, count[part])
                candidates = members[np.concatenate(near)]
                least = self.barycentric(candidates, points[owner]).min(axis=1)
                order = np.lexsort((least, owner))  # the last of each point is the best
                order = order[np.diff(owner[order], append=len(points)) > 0]
                better = order[least[order] >= largest[owner[order]]]
                simplices[owner[better]], largest[owner[better]] = candidates[better], least[better]
        return simplices

    @cached_property
    def _by_size(self) -> list[tuple[float, Indices, KDTree]]:
        """Group regular simplices by a power of 2 of the farthest corner's distance.

        A point in a simplex is nearer to its middle than the farthest corner, so few simplices of a
        size can hold it.
        """
        members = np.flatnonzero(~self.degenerate)
        corners = self.points[self.simplices[members]]
        middles = corners.mean(axis=1)
        radius = np.sqrt(((corners - middles[:, None]) ** 2).sum(axis=2)).max(axis=1)
        size = np.frexp(radius)[1]
        return [
            (float(np.ldexp(1 + ON_HULL, k)), members[size == k], KDTree(middles[size == k]))
            for k in np.unique(size).tolist()
        ]

    @cached_property
    def _middles(self) -> KDTree:
        return KDTree(self.points[self.simplices].mean(axis=1))

    def local_coordinates(self, x: Floats) -> Floats:
        """Return points in the coordinates of the points' span.

        Shape (k, 3) -> (k, dimension), dimensionless.
        """
        return x if self.dimension == 3 else (x - self.origin) @ self.basis.T

    def holds_direction(self, column: int) -> bool:
        """Return whether a line along a coordinate through zero lies in the points' span."""
        ends = np.zeros((2, 3))
        ends[1, column] = 1.0
        off = ends - self.origin
        off = off - off @ self.basis.T @ self.basis
        return bool((np.abs(off) <= self.slack).all())

    @cached_property
    def hull(self) -> Indices:
        """The vertices of each facet of the hull: indices of points, shape (f, dimension)."""
        owner, across = np.nonzero(self.neighbours < 0)
        keep = np.ones((len(owner), self.dimension + 1), dtype=bool)
        keep[np.arange(len(owner)), across] = False
        return self.simplices[owner][keep].reshape(len(owner), self.dimension)

    @cached_property
    def behind_hull(self) -> Indices:
        """The index of the simplex behind each facet of the hull, shape (f,)."""
        return np.nonzero(self.neighbours < 0)[0]

    def barycentric(self, simplices: Indices, x: Floats) -> Floats:
        """Return the barycentric coordinates, shape (k, d + 1), of points (k, 3), dimensionless."""
        first = np.einsum("kij,kj->ki", self.weights[simplices], x - self.anchors[simplices])
        return np.concatenate((first, 1 - first.sum(axis=1, keepdims=True)), axis=1)

    def gradients(self, values: Floats) -> Floats:
        """Return the gradient of vertex values (n, q) in each simplex, shape (m, q, 3)."""
        corners = values[self.simplices]
        return np.einsum("kdq,kdi->kqi", corners[:, :-1] - corners[:, -1:], self.weights)


def _span(points: Floats) -> tuple[int, Floats]:
    """Return the dimension that the points span and an orthonormal basis of it, shape (d, 3).

    Coordinates that do not vary are dropped rather than rotated away, so that a planar table is
    triangulated in the coordinates that vary.
    """
    centred = points - points.mean(axis=0)
    sizes = np.linalg.svd(centred, compute_uv=False)
    dimension = int((sizes > SPAN_TOLERANCE * sizes[0]).sum()) if sizes[0] > 0 else 0
    varying: NDArray[np.bool_] = np.asarray(
        np.ptp(points, axis=0) > SPAN_TOLERANCE * max(sizes[0], np.finfo(float).tiny)
    )
    if varying.sum() == dimension:
        return dimension, np.eye(3)[varying]
    return dimension, np.linalg.svd(centred, full_matrices=False)[2]


def _count_slivers(points: Floats, simplices: NDArray[np.int32]) -> int:
    """Return how many simplices of points (n, d) are degenerate."""
    edges = points[simplices[:, :-1]] - points[simplices[:, -1:]]
    volumes = np.abs(determinants(edges)) / math.factorial(points.shape[1])
    return int(_is_sliver(edges, volumes).sum())


def _is_sliver(edges: Floats, volumes: Floats) -> NDArray[np.bool_]:
    """Return which simplices have almost no volume, by their d edges at the anchor, (m, d, k)."""
    # The longest edge at the anchor is at least half of the longest.
    longest = np.sqrt((edges**2).sum(axis=2)).max(axis=1, initial=0.0)
    return volumes < SLIVER * longest ** edges.shape[1]


def determinants(edges: Floats) -> Floats:
    """Return the determinants of matrices (m, d, d), d at most 3, shape (m,)."""
    if edges.shape[1] < 3:
        return np.linalg.det(edges)
    a, b, c = edges[:, 0], edges[:, 1], edges[:, 2]
    return (a * np.cross(b, c)).sum(axis=1)


def inverses(edges: Floats) -> Floats:
    """Return the inverses of matrices (m, d, d), d 2 or 3, by cofactors; not finite if singular."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        over = 1.0 / determinants(edges)[:, None, None]
        if edges.shape[1] == 2:
            a, b, c, d = edges[:, 0, 0], edges[:, 0, 1], edges[:, 1, 0], edges[:, 1, 1]
            return np.stack((d, -b, -c, a), axis=1).reshape(-1, 2, 2) * over
        a, b, c = edges[:, 0], edges[:, 1], edges[:, 2]
        return np.stack((np.cross(b, c), np.cross(c, a), np.cross(a, b)), axis=2) * over


def curve_order(x: Floats) -> NDArray[np.intp]:
    """Return the order of points (k, d), d at most 3, along a Morton curve over their box.

    The order of Morton, "A computer oriented geodetic data base" (1966): the bits of the
    coordinates, interleaved. Points are dimensionless.
    """
    if len(x) < MIN_SORTED or x.shape[1] == 0:
        return np.arange(len(x))
    key = np.zeros(len(x), dtype=np.uint16)
    for dimension, column in enumerate(x.T):  # by columns, which is fast in numpy
        low, high = column.min(), column.max()
        if high > low:
            cells = (column - low) * (CELLS * (1 - 1e-9) / (high - low))
            key |= _SPREAD.take(cells.astype(np.intp)) << np.uint16(dimension)
    return np.argsort(key, kind="stable")


# Each cell number with two zero bits between its bits.
_SPREAD = np.bitwise_or.reduce(
    [((np.arange(CELLS, dtype=np.uint16) >> bit) & 1) << (3 * bit) for bit in range(5)]
).astype(np.uint16)


def recovered_slopes(triangulation: Triangulation, values: Floats) -> Floats:
    """Return slopes (n, q, 3) of a quadratic fitted through each point's neighbours.

    The point itself is left out. Where there are too few points for a quadratic, the slope is the
    mean of the adjacent simplices. Points are dimensionless, so that slopes are in the unit of the
    values (n, q): m and rad.
    """
    dimension = triangulation.dimension
    n = len(values)
    neighbours = NEIGHBOURS.get(dimension, 0)
    if not neighbours or n <= neighbours:
        return mean_slopes(triangulation, values)
    slopes = np.empty((n, values.shape[1], 3))
    local = triangulation.local_coordinates(triangulation.points)
    nearest = KDTree(local).query(local, k=neighbours + 1)
    distances = np.asarray(nearest[0])[:, 1:]
    near = np.asarray(nearest[1], dtype=np.intp)[:, 1:]
    for start in range(0, n, CHUNK):
        part = slice(start, start + CHUNK)
        delta = local[near[part]] - local[part, None]
        rise = values[near[part]] - values[part, None]
        slope = _quadratics(delta, distances[part], rise)
        slopes[part] = np.einsum("niq,ij->nqj", slope, triangulation.basis)
    return slopes


def _quadratics(delta: Floats, distances: Floats, rise: Floats) -> Floats:
    """Return slopes (n, d, q) of quadratics through rises (n, k, q)."""
    dimension = delta.shape[2]
    radius = np.maximum(distances[:, -1], np.finfo(float).tiny)
    delta = delta / radius[:, None, None]
    squares = list(combinations_with_replacement(range(dimension), 2))
    second = np.stack([delta[..., i] * delta[..., j] for i, j in squares], axis=-1)
    terms = np.concatenate((np.ones((*delta.shape[:2], 1)), delta, second), axis=-1)
    weighed = terms / (NEARER + (distances / radius[:, None]) ** 2)[..., None]
    normal = weighed.transpose(0, 2, 1) @ terms
    normal += RIDGE * terms.shape[1] * np.eye(terms.shape[-1])
    fitted = np.linalg.solve(normal, weighed.transpose(0, 2, 1) @ rise)
    return fitted[:, 1 : 1 + dimension] / radius[:, None, None]


def mean_slopes(triangulation: Triangulation, values: Floats) -> Floats:
    """Return slopes (n, q, 3) as the mean of the simplices that meet at each point, by volume.

    A degenerate simplex has no slope and does not count. Points are dimensionless, so that slopes
    are in the unit of the values (n, q): m and rad.
    """
    weight = np.where(triangulation.degenerate, 0.0, triangulation.volumes)
    weighted = weight[:, None, None] * triangulation.gradients(values)
    total = np.zeros((len(values), values.shape[1], 3))
    size = np.zeros(len(values))
    for corner in triangulation.simplices.T:
        np.add.at(total, corner, weighted)
        np.add.at(size, corner, weight)
    return total / np.maximum(size, np.finfo(float).tiny)[:, None, None]
