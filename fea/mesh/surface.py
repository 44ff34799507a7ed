"""The facets of a mesh's surface, and its faces: planes, cylinders and curved ones.

A face is one of the geometry file, or of a mesh file a connected smooth part of its surface.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from wrenchbook.fea.mesh.facets import TRIANGLES, Face, corners_of, outer_surface, triangles_of
from wrenchbook.fea.mesh.mesh import FacetBlock, FacetGroup, Mesh
from wrenchbook.fea.spec.problems import BundleError, BundleProblem, point_text
from wrenchbook.fea.tensors import TINY

Point = tuple[float, float, float]

NEAR = 1e-3
"""Part of a facet's size, or of a radius: lengths closer than this count as equal."""

# Cosine of gmsh's usual angle of a feature; nine flats a turn are round.
_SMOOTH = np.cos(np.radians(40))
_FLAT = 2e-3  # rad: roundoff of coordinates in single precision turns facets by less
_EVEN = 1e-4  # part of a face's size: largest deviation of a plane face from its plane
# Radius over a face's size; a flatter arc does not determine a radius to three digits.
_MAX_RADIUS = 10.0
_MIN_FIT_POINTS = 6  # one more than the five numbers of a cylinder, so that a misfit shows
_FIT_POINTS = 2000  # points of a face in a fit: enough for these five numbers
_FIT = 1e-12  # relative accuracy of these numbers: roundoff
_FIT_STEPS = 50  # largest number of evaluations of such a fit
# Least square of a radius over a face's size, which roundoff may make negative.
_MIN_SQUARE = 1e-30
_UNKNOWN = Face(0, "Curved", 0.0, (0.0, 0.0, 0.0), None, None)


class Surface:
    """The f facets of a mesh's surface, each with the number of its face.

    group, numbers, faces: facets, their faces' numbers, (f,), and these faces, of a geometry file;
    without these, the outer surface and its smooth parts.

    Attributes: `corners` (f, 4) and `triangles` (t, 3) nodes; `owners` (t,) the facet of each
    triangle, and `vectors` (t, 3) its area times its normal, m^2; `areas` (f,), m^2; unit `normals`
    and `middles`, m, (f, 3); `sizes` (f,), m.
    """

    def __init__(
        self,
        mesh: Mesh,
        group: FacetGroup | None = None,
        numbers: np.ndarray | None = None,
        faces: tuple[Face, ...] = (),
    ) -> None:
        self.mesh = mesh
        group = group or outer_surface(mesh.blocks)
        self.blocks = group.blocks
        # A triangle has its third corner twice.
        corners = [nodes[:, [0, 1, 2, corners_of(kind) - 1]] for kind, nodes in self.blocks]
        self.corners = np.concatenate(corners)
        self.triangles = triangles_of(group)
        counts = [np.full(len(nodes), len(TRIANGLES[kind])) for kind, nodes in self.blocks]
        self.owners = np.repeat(np.arange(len(self.corners)), np.concatenate(counts))

        points = mesh.points[self.triangles]
        self.vectors = 0.5 * np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
        parts = np.linalg.norm(self.vectors, axis=1, keepdims=True)
        self.areas = self._of_facets(parts)[:, 0]
        self.normals = unit(self._of_facets(self.vectors))
        weight = np.maximum(self.areas, TINY)[:, None]
        self.middles = self._of_facets(parts * points.mean(axis=1)) / weight
        self.sizes = np.linalg.norm(np.ptp(mesh.points[self.corners], axis=1), axis=1)

        if numbers is None:
            numbers, faces = self._smooth_parts()
        self.numbers = numbers
        self.faces = faces

    def _of_facets(self, values: np.ndarray) -> np.ndarray:
        """Sum values of triangles, shape (t, k), by facet."""
        columns = [np.bincount(self.owners, column, len(self.corners)) for column in values.T]
        return np.stack(columns, axis=1)

    def group(self, chosen: np.ndarray) -> FacetGroup:
        """Return the chosen facets, a mask of shape (f,), as a group."""
        ends = np.cumsum([len(nodes) for _, nodes in self.blocks])
        parts = zip(self.blocks, np.split(chosen, ends[:-1]), strict=True)
        return FacetGroup(tuple(FacetBlock(k, n[part]) for (k, n), part in parts if part.any()))

    def _smooth_pairs(self) -> tuple[np.ndarray, np.ndarray]:
        """Return pairs of facets with a common edge that is not sharp, (p,) and (p,)."""
        normals = unit(self.vectors)
        edges = np.sort(self.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        order = np.lexsort(edges.T)
        same = np.concatenate([[False], (np.diff(edges[order], axis=0) == 0).all(axis=1), [False]])
        at = np.flatnonzero(same[1:-1] & ~same[:-2] & ~same[2:])  # edges of two triangles
        facet = order[at] // 3
        neighbour = order[at + 1] // 3
        smooth = np.einsum("ij,ij->i", normals[facet], normals[neighbour]) > _SMOOTH
        return self.owners[facet[smooth]], self.owners[neighbour[smooth]]

    def _smooth_parts(self) -> tuple[np.ndarray, tuple[Face, ...]]:
        """Split the surface at sharp edges, and smooth parts that are no cylinder at planes.

        Return the number of each facet's face, (f,), from 1 on, and the faces.
        """
        count = len(self.corners)
        first, second = self._smooth_pairs()
        turn = np.linalg.norm(np.cross(self.normals[first], self.normals[second]), axis=1)
        level = turn < _FLAT
        smooth = connected(first, second, count)
        flat = connected(first[level], second[level], count)
        in_plane = self._in_planes(smooth, flat)

        # Smooth parts of planes and others, without a cylinder through all of it, are split.
        split = np.zeros(count, dtype=bool)
        for members in members_of(smooth):
            mixed = in_plane[members].any() and len(np.unique(flat[members])) > 1
            split[members] = mixed and self.cylinder(members) is None
        alike = (in_plane[first] == in_plane[second]) & (~in_plane[first] | level)
        joined = alike | ~split[first]
        parts = members_of(connected(first[joined], second[joined], count))

        # Numbered by position, so that another mesh of the part has the same numbers.
        faces = [self._face(members) for members in parts]
        centres = np.array([face.centre for face in faces])
        centres = np.round(centres / (NEAR * np.ptp(self.mesh.points, axis=0).max()))
        ranked = np.lexsort(centres.T[::-1]).tolist()
        numbers = np.zeros(count, dtype=np.int64)
        for number, i in enumerate(ranked, 1):
            numbers[parts[i]] = number
        return numbers, tuple(replace(faces[i], number=n) for n, i in enumerate(ranked, 1))

    def _in_planes(self, smooth: np.ndarray, flat: np.ndarray) -> np.ndarray:
        """Return which facets are in a plane of more than a strip, a mask of shape (f,).

        smooth, flat: the smooth part and the flat part of each facet, (f,). A plane in a smooth
        part has a node whose facets, two or more, all lie in that plane; a strip of a round face
        has none.
        """
        count = len(self.corners)
        nodes = len(self.mesh.points)
        keys = np.unique(np.arange(count).repeat(4) * nodes + self.corners.ravel())
        facets = keys // nodes
        keys = smooth[facets].astype(np.int64) * nodes + keys % nodes
        _, index, times = np.unique(keys, return_inverse=True, return_counts=True)
        low = np.full(len(times), count)
        high = np.zeros(len(times), dtype=np.int64)
        np.minimum.at(low, index, flat[facets])
        np.maximum.at(high, index, flat[facets])
        return np.asarray(np.isin(flat, low[(low == high) & (times > 1)]))

    def _face(self, members: np.ndarray) -> Face:
        """Return the plane, cylinder or curved face of facets, by their indices (k,)."""
        points = self.mesh.points[np.unique(self.corners[members])]
        areas = self.areas[members]
        if not areas.any():
            at = point_text(points.mean(axis=0))
            message = f"has cells without volume at the surface near {at} m; mesh it again"
            raise BundleError([BundleProblem("mesh", message)])
        centre = _three(np.average(self.middles[members], axis=0, weights=areas))
        mean = unit(areas[None] @ self.normals[members])[0]
        face = Face(0, "Curved", float(areas.sum()), centre, None, None)
        if np.ptp(points @ mean) < _EVEN * np.linalg.norm(np.ptp(points, axis=0)):
            return replace(face, kind="Plane", normal=_three(np.round(mean, 12)))
        return self.cylinder(members, face) or face

    def cylinder(self, members: np.ndarray, face: Face = _UNKNOWN) -> Face | None:
        """Return `face` with the axis and radius of the cylinder through facets, or None.

        members: indices of the facets, (k,). A radius that `face` already has is kept.
        """
        points = self.mesh.points[np.unique(self.corners[members])]
        middle = points.mean(axis=0)
        size = float(np.linalg.norm(np.ptp(points, axis=0)))
        vectors = self.normals[members] * self.areas[members, None] / size**2
        frame = np.linalg.eigh(vectors.T @ vectors)[1]  # first column: square to the normals
        fit = _fitted_cylinder((points - middle) @ frame / size)
        if fit is None:
            return None

        axis = unit((frame @ [1, *fit[2:4]])[None])[0]
        axis *= np.sign(axis[np.abs(axis).argmax()])
        point = middle + size * frame @ [0, *fit[:2]]
        point += axis * (axis @ (middle - point))
        radius = face.radius or float(f"{size * fit[4]:.9g}")
        axis = _three(np.round(axis, 9))
        return replace(face, kind="Cylinder", radius=radius, axis=axis, point=_three(point))


def _fitted_cylinder(points: np.ndarray) -> np.ndarray | None:
    """Return b, c, d, e and the radius of the cylinder through points, or None.

    Its axis has the point (0, b, c) and the direction (1, d, e). points: shape (k, 3), of the size
    1, their axis about the first.
    """
    # Imported here, as it takes 50 ms of a solve's start.
    from scipy.optimize import least_squares

    def misfit(values: np.ndarray, at: np.ndarray) -> np.ndarray:
        """Return the distances of points (k, 3) from a cylinder, (k,)."""
        arms = np.cross(at - [0, *values[:2]], unit(np.array([[1, *values[2:4]]])))
        return np.linalg.norm(arms, axis=1) - values[4]

    # Start from the circle that fits best across the first direction.
    sample = points[:: max(1, len(points) // _FIT_POINTS)]
    columns = np.column_stack([2 * sample[:, 1:], np.ones(len(sample))])
    b, c, constant = np.linalg.lstsq(columns, (sample[:, 1:] ** 2).sum(axis=1))[0]
    start = np.array([b, c, 0, 0, np.sqrt(max(constant + b**2 + c**2, _MIN_SQUARE))])
    if len(sample) < _MIN_FIT_POINTS or np.abs(misfit(start, sample)).max() > start[4]:
        return None
    fit = least_squares(misfit, start, args=(sample,), xtol=_FIT, ftol=_FIT, max_nfev=_FIT_STEPS).x
    if fit[4] > _MAX_RADIUS or np.abs(misfit(fit, points)).max() > NEAR * min(fit[4], 1.0):
        return None
    return fit


def unit(vectors: np.ndarray) -> np.ndarray:
    """Return vectors (k, 3) at length one; zero stays zero."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), TINY)


def connected(first: np.ndarray, second: np.ndarray, count: int) -> np.ndarray:
    """Return the part of each of `count` items, (count,), of which pairs, (p,) each, are joined."""
    graph = coo_array((np.ones(len(first)), (first, second)), shape=(count, count))
    return connected_components(graph, directed=False)[1]


def members_of(labels: np.ndarray) -> list[np.ndarray]:
    """Return the indices of the items of each label, ascending, by ascending labels, (n,)."""
    order = np.argsort(labels, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(labels[order])) + 1)


def _three(values: np.ndarray) -> Point:
    """Return three numbers as plain floats; + 0.0 makes -0.0 a plain 0."""
    return float(values[0]) + 0.0, float(values[1]) + 0.0, float(values[2]) + 0.0
