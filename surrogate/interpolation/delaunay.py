"""Piecewise linear interpolation over a Delaunay triangulation of up to three dimensions.

Points that span fewer than three dimensions get a triangulation of the plane, an ordered line or
a single point: qhull refuses flat input.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import Delaunay, KDTree, QhullError

from surrogate.interpolation.morton import curve_order
from surrogate.table.rows import Floats

Indices = NDArray[np.intp]

FLAT = 1e-9  # of the points' extent: what lies closer to a plane, a line or a point is in it
SLIVER = 1e-10  # volume over cubed longest edge (or the like) below which a simplex is degenerate
INWARD = 2e-9  # of the way to the middle: what lies 1e-9 of the range beyond the hull is on it
SHEAR = np.eye(3) + 1e-3 * np.array([[0.31, 0.77, -0.53], [0.19, -0.41, 0.97], [-0.61, 0.37, 0.23]])


class ShearedDelaunay(Delaunay):
    """The triangulation of points (n, d) that is Delaunay's once they are sheared."""

    def __init__(self, points: Floats, shear: Floats) -> None:
        super().__init__(points @ shear.T)
        self._shear = shear

    def find_simplex(
        self, xi: ArrayLike, bruteforce: bool = False, tol: Any = None
    ) -> NDArray[np.int32]:
        """Return the simplex of each point (k, d), not sheared, or -1."""
        sheared = np.asarray(xi, dtype=float) @ self._shear.T
        return super().find_simplex(sheared, bruteforce=bruteforce, tol=tol)


class Interpolant:
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
            self._find: Callable[[Floats], Indices] = lambda x: np.zeros(len(x), dtype=np.intp)
            self.simplices = np.zeros((1, 1), dtype=np.intp)
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
        maps = self.delaunay.transform[:, : self.dimension]
        flattened = _flat_count(given, self.delaunay)
        if flattened:
            shear = SHEAR[: self.dimension, : self.dimension]
            sheared = ShearedDelaunay(given, shear)
            if _flat_count(given, sheared) < flattened:
                self.delaunay, maps = sheared, sheared.transform[:, : self.dimension] @ shear
        self._find = self._find_in_order
        self.simplices = self.delaunay.simplices.astype(np.intp)
        self.weights = maps if self.dimension == 3 else maps @ self.basis

    def _connect_line(self, along: Floats) -> None:
        order = np.argsort(along)
        stations = along[order]
        self._find = lambda x: _interval(stations, x[:, 0])
        self.simplices = np.stack((order[:-1], order[1:]), axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):  # no length: marked degenerate
            self.weights = -self.basis[None] / np.diff(stations)[:, None, None]

    def _measure(self) -> None:
        edges = self.points[self.simplices[:, :-1]] - self.anchors[:, None]
        flat = edges @ self.basis.T
        longest = np.sqrt((edges**2).sum(axis=2)).max(axis=1, initial=0.0)
        self.volumes = np.abs(np.linalg.det(flat)) / math.factorial(self.dimension)
        finite = np.isfinite(self.weights).reshape(len(edges), -1)
        broken: NDArray[np.bool_] = np.asarray(np.any(~finite, axis=1))
        self.degenerate = broken | (self.volumes < SLIVER * longest**self.dimension)
        if broken.any():
            self.weights = np.where(broken[:, None, None], 0.0, self.weights)

    def locate(self, x: ArrayLike) -> Indices:
        """Return the simplex of each point, shape (k, 3) -> (k,), or -1 outside the hull.

        Points on the hull are inside, and so is what lies 1e-9 of the range beyond it: what is
        found just outside is looked up again a little further in.
        """
        points = np.asarray(x, dtype=float)
        found = self._find_flat(points)
        missed = np.asarray(found < 0)
        if missed.any():
            inward = points[missed] + INWARD * (self.origin - points[missed])
            found[missed] = self._find_flat(inward)
        return found

    def _find_in_order(self, flat: Floats) -> Indices:
        """Walk to the points, shape (k, d), in an order that makes the walks short."""
        order = curve_order(flat)
        found = np.empty(len(flat), dtype=np.intp)
        found[order] = self.delaunay.find_simplex(flat[order])
        return found

    def _find_flat(self, points: Floats) -> Indices:
        if self.dimension == 3:
            return self._find(points)
        centred = points - self.origin
        flat = centred @ self.basis.T
        off = np.abs(centred - flat @ self.basis).max(axis=1, initial=0.0)
        return np.where(off > self.slack, -1, self._find(flat))

    def nearest(self, x: ArrayLike) -> Indices:
        """Return the point nearest to each of some others, shape (k, 3) -> (k,)."""
        return np.asarray(self._tree.query(x)[1], dtype=np.intp)

    @cached_property
    def _tree(self) -> KDTree:
        return KDTree(self.points)

    def barycentric(self, simplices: Indices, x: Floats) -> Floats:
        """Return the barycentric coordinates, shape (k, d + 1), of points (k, 3)."""
        most = np.einsum("kij,kj->ki", self.weights[simplices], x - self.anchors[simplices])
        return np.concatenate((most, 1 - most.sum(axis=1, keepdims=True)), axis=1)

    def gradients(self, values: Floats) -> Floats:
        """Return the gradient of vertex values (n, q) in each simplex, shape (m, q, 3)."""
        rise = values[self.simplices[:, :-1]] - values[self.simplices[:, -1:]]
        return np.einsum("mdq,mdi->mqi", rise, self.weights)

    def bubbles(self, simplices: Indices, x: Floats) -> Floats:
        """Return the mean squared distance to the vertices, barycentrically weighted, shape (k,).

        Linear interpolation of a function of constant curvature c errs by c/2 times this.
        """
        apart = self.points[self.simplices[simplices]] - x[:, None]
        return ((apart**2).sum(axis=2) * self.barycentric(simplices, x)).sum(axis=1)


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


def _flat_count(points: Floats, delaunay: Delaunay) -> int:
    """Return how many simplices of points (n, d) have no volume to speak of."""
    edges = points[delaunay.simplices[:, :-1]] - points[delaunay.simplices[:, -1:]]
    longest = np.sqrt((edges**2).sum(axis=2)).max(axis=1)
    volumes = np.abs(np.linalg.det(edges)) / math.factorial(points.shape[1])
    return int((volumes < SLIVER * longest ** points.shape[1]).sum())


def _interval(stations: Floats, along: Floats) -> Indices:
    """Return which interval of ascending stations each position lies in, or -1."""
    found = np.clip(np.searchsorted(stations, along, side="right") - 1, 0, len(stations) - 2)
    inside = (along >= stations[0]) & (along <= stations[-1])
    return np.where(inside, found, -1)
