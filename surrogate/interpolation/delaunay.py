"""Piecewise linear interpolation over a Delaunay triangulation of up to three dimensions.

Points that span fewer than three dimensions get a triangulation of the plane, an ordered line or
a single point: qhull refuses flat input.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import Delaunay, QhullError

from ..table.rows import Floats
from .hull import nearest_points
from .morton import curve_order

Indices = NDArray[np.intp]

FLAT = 1e-9  # of the points' extent: what lies closer to a plane, a line or a point is in it
ON_HULL = 1e-9  # of the way to the middle: a point that rounding put so far outside is on the hull
SLIVER = 1e-10  # volume over cubed longest edge (or the like) below which a simplex is degenerate
SHEAR = np.eye(3) + 1e-3 * np.array([[0.31, 0.77, -0.53], [0.19, -0.41, 0.97], [-0.61, 0.37, 0.23]])


class ShearedDelaunay(Delaunay):
    """The triangulation of points (n, d) that is Delaunay's once they are sheared."""

    def __init__(self, points: Floats, shear: Floats) -> None:
        super().__init__(points @ shear.T)
        self._shear = shear

    def find_simplex(
        self, xi: ArrayLike, bruteforce: bool = False, tol: Any = None
    ) -> NDArray[np.int32]:
        """Return the simplex of each point (k, d), dimensionless and not sheared, or -1."""
        sheared = np.asarray(xi, dtype=float) @ self._shear.T
        return super().find_simplex(sheared, bruteforce=bruteforce, tol=tol)


class Triangulation:
    """A triangulation of scattered points, with one affine barycentric map per simplex.

    Attributes
    ----------
    points : ndarray, shape (n, 3)
    dimension : int
        0 to 3, what the points span.
    simplices : ndarray of int, shape (m, dimension + 1)
        Vertices of each simplex; the last one is its anchor.
    anchors : ndarray, shape (m, 3)
    weights : ndarray, shape (m, dimension, 3)
        `weights[s] @ (x - anchors[s])` are the barycentric coordinates but the last one.
    volumes : ndarray, shape (m,)
        Length, area or volume of each simplex; 1 for a single point.
    degenerate : ndarray of bool, shape (m,)
    neighbours : ndarray of int, shape (m, dimension + 1)
        The simplex across from each vertex, -1 on the hull.
    """

    def __init__(self, points: ArrayLike) -> None:
        """Triangulate distinct points, shape (n, 3), n at least 1."""
        self.points = np.asarray(points, dtype=float).reshape(-1, 3)
        self.origin = self.points[0] if len(self.points) == 1 else self.points.mean(axis=0)
        self._triangulate()
        self.anchors = self.points[self.simplices[:, -1]]
        self._measure()

    def _triangulate(self) -> None:
        dimension, basis = _span(self.points)
        while True:
            self.dimension, self.basis = dimension, basis[:dimension]
            flat = (self.points - self.origin) @ self.basis.T
            off = self.points - self.origin - flat @ self.basis
            extent = float(np.abs(self.points - self.origin).max(initial=0.0))
            self.slack = max(FLAT * max(1.0, extent), 2 * float(np.abs(off).max(initial=0.0)))
            try:
                return self._connect(flat)
            except QhullError:  # flat within qhull's precision, though not within ours
                dimension -= 1
                basis = np.linalg.svd(self.points - self.origin, full_matrices=False)[2]

    def _connect(self, flat: Floats) -> None:
        """Make the simplices and the point location of the flattened points, shape (n, d)."""
        if self.dimension == 0:
            self._find: Callable[[Floats], Indices] = _the_one
            self.simplices = np.zeros((1, 1), dtype=np.intp)
            self.neighbours = np.full((1, 1), -1, dtype=np.intp)
            self.weights = np.zeros((1, 0, 3))
        elif self.dimension == 1:
            self._connect_line(flat[:, 0])
        else:
            self._connect_simplices(flat)

    def _connect_simplices(self, flat: Floats) -> None:
        """Triangulate; in three dimensions the points themselves, so that it is scipy's.

        qhull joins the cells of a grid by flat tetrahedra where their diagonals differ: answers
        would jump there. A slight shear leaves each cell one triangulation only, and barycentric
        coordinates as they are.
        """
        given = self.points if self.dimension == 3 else flat
        self.delaunay = Delaunay(given)
        flattened = int(_flat(given, self.delaunay.simplices).sum())
        if flattened:
            sheared = ShearedDelaunay(given, SHEAR[: self.dimension, : self.dimension])
            if _flat(given, sheared.simplices).sum() < flattened:
                self.delaunay = sheared
        self._find = partial(_find_in_order, self.delaunay)
        self.simplices = self.delaunay.simplices.astype(np.intp)
        self.neighbours = self.delaunay.neighbors.astype(np.intp)
        edges = given[self.simplices[:, :-1]] - given[self.simplices[:, -1:]]
        self.weights = inverses(edges).transpose(0, 2, 1)
        if self.dimension < 3:
            self.weights = self.weights @ self.basis

    def _connect_line(self, along: Floats) -> None:
        order = np.argsort(along)
        stations = along[order]
        self._find = partial(_interval, stations)
        self.simplices = np.stack((order[:-1], order[1:]), axis=1)
        place = np.arange(len(self.simplices))
        self.neighbours = np.stack((place + 1, place - 1), axis=1)
        self.neighbours[-1, 0] = -1
        with np.errstate(divide="ignore", invalid="ignore"):  # no length: marked degenerate
            self.weights = -self.basis[None] / np.diff(stations)[:, None, None]

    def _measure(self) -> None:
        edges = self.points[self.simplices[:, :-1]] - self.anchors[:, None]
        flat = edges @ self.basis.T
        longest = np.sqrt((edges**2).sum(axis=2)).max(axis=1, initial=0.0)
        self.volumes = np.abs(determinants(flat)) / math.factorial(self.dimension)
        finite = np.isfinite(self.weights).reshape(len(edges), -1)
        broken: NDArray[np.bool_] = np.asarray(np.any(~finite, axis=1))
        self.degenerate = broken | (self.volumes < SLIVER * longest**self.dimension)
        if broken.any():
            self.weights = np.where(broken[:, None, None], 0.0, self.weights)

    def locate(self, x: ArrayLike) -> Indices:
        """Return the simplex of each point, shape (k, 3) -> (k,), or -1 outside the hull.

        Points on the hull are inside: what rounding put just outside is looked up again a little
        further in. Points are dimensionless.
        """
        points = np.asarray(x, dtype=float)
        found = self._find_flat(points)
        missed = np.asarray(found < 0)
        if missed.any():
            inward = points[missed] + ON_HULL * (self.origin - points[missed])
            found[missed] = self._find_flat(inward)
        return found

    def _find_flat(self, points: Floats) -> Indices:
        if self.dimension == 3:
            return self._find(points)
        centred = points - self.origin
        flat = centred @ self.basis.T
        off = np.abs(centred - flat @ self.basis).max(axis=1, initial=0.0)
        return np.where(off > self.slack, -1, self._find(flat))

    def flattened(self, x: Floats) -> Floats:
        """Return points in the coordinates of what the points span.

        Shape (k, 3) -> (k, dimension), dimensionless.
        """
        return x if self.dimension == 3 else (x - self.origin) @ self.basis.T

    def holds_direction(self, column: int) -> bool:
        """Return whether a line along a coordinate through zero lies in what the points span."""
        ends = np.zeros((2, 3))
        ends[1, column] = 1.0
        off = ends - self.origin
        off = off - off @ self.basis.T @ self.basis
        return bool((np.abs(off) <= self.slack).all())

    def nearest_on_hull(self, x: Floats) -> tuple[Floats, Indices]:
        """Return the nearest points of the hull, (k, 3), and a simplex that holds each, (k,).

        Parameters
        ----------
        x : ndarray, shape (k, 3), dimensionless
            Points outside the hull.
        """
        if self.dimension == 0:
            return np.tile(self.points[0], (len(x), 1)), np.zeros(len(x), dtype=np.intp)
        # What lies off the plane or line of the points is nearest to its foot there, if the hull
        # holds that.
        place = x if self.dimension == 3 else self.origin + self.flattened(x) @ self.basis
        found = self.locate(place) if self.dimension < 3 else np.full(len(x), -1)
        beyond = np.flatnonzero(found < 0)
        if len(beyond):
            at, facet = nearest_points(self.points[self.hull], place[beyond])
            place = place.copy()
            place[beyond], found[beyond] = at, self.behind_hull[facet]
        return place, found

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

    def gradients_at(self, simplices: Indices, values: Floats) -> Floats:
        """Return the gradients of vertex values (n, q) in some simplices, (k,) -> (k, q, 3).

        They are by dimensionless points, so in the values' unit: m and rad.
        """
        corners = values[self.simplices[simplices]]
        rise = corners[:, :-1] - corners[:, -1:]
        return np.einsum("kdq,kdi->kqi", rise, self.weights[simplices])

    def barycentric(self, simplices: Indices, x: Floats) -> Floats:
        """Return the barycentric coordinates, shape (k, d + 1), of points (k, 3), dimensionless."""
        most = np.einsum("kij,kj->ki", self.weights[simplices], x - self.anchors[simplices])
        return np.concatenate((most, 1 - most.sum(axis=1, keepdims=True)), axis=1)

    def gradients(self, values: Floats) -> Floats:
        """Return the gradient of vertex values (n, q) in each simplex, shape (m, q, 3)."""
        return self.gradients_at(np.arange(len(self.simplices)), values)


def _span(points: Floats) -> tuple[int, Floats]:
    """Return what dimension the points span and an orthonormal basis of it, shape (d, 3).

    Coordinates that do not vary are dropped rather than rotated away, so that a planar table is
    triangulated in its own coordinates.
    """
    centred = points - points.mean(axis=0)
    sizes = np.linalg.svd(centred, compute_uv=False)
    dimension = int((sizes > FLAT * sizes[0]).sum()) if sizes[0] > 0 else 0
    varying: NDArray[np.bool_] = np.asarray(
        np.ptp(points, axis=0) > FLAT * max(sizes[0], np.finfo(float).tiny)
    )
    if varying.sum() == dimension:
        return dimension, np.eye(3)[varying]
    return dimension, np.linalg.svd(centred, full_matrices=False)[2]


def _flat(points: Floats, simplices: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Return which simplices of points (n, d) have no volume to speak of, shape (m,)."""
    edges = points[simplices[:, :-1]] - points[simplices[:, -1:]]
    longest = np.sqrt((edges**2).sum(axis=2)).max(axis=1)
    volumes = np.abs(determinants(edges)) / math.factorial(points.shape[1])
    return volumes < SLIVER * longest ** points.shape[1]


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


def _the_one(flat: Floats) -> Indices:
    """Return the one simplex there is for each position, shape (k, 0)."""
    return np.zeros(len(flat), dtype=np.intp)


def _find_in_order(delaunay: Delaunay, flat: Floats) -> Indices:
    """Walk to the points, shape (k, d), in an order that makes the walks short."""
    order = curve_order(flat)
    found = np.empty(len(flat), dtype=np.intp)
    found[order] = delaunay.find_simplex(flat[order])
    return found


def _interval(stations: Floats, flat: Floats) -> Indices:
    """Return which interval of ascending stations each position, shape (k, 1), lies in, or -1."""
    along = flat[:, 0]
    found = np.clip(np.searchsorted(stations, along, side="right") - 1, 0, len(stations) - 2)
    inside = (along >= stations[0]) & (along <= stations[-1])
    return np.where(inside, found, -1)
