"""Facet groups by geometry: the faces of a surface, and the rules by which keys choose facets.

A face is one of the geometry file, or of a mesh file a connected smooth part of its surface.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from dataclasses import replace
from graphlib import CycleError, TopologicalSorter
from itertools import combinations
from typing import Any, NamedTuple, NoReturn

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from wrenchbook.fea.mesh.facets import (
    TRIANGLES,
    Face,
    corners_of,
    group_nodes,
    near_message,
    outer_surface,
)
from wrenchbook.fea.mesh.mesh import FacetBlock, FacetGroup, Mesh
from wrenchbook.fea.spec.mesh_source import FaceSelector
from wrenchbook.fea.spec.problems import BundleError, BundleProblem, point_text

Array = np.ndarray
Point = tuple[float, float, float]

# Cosine of gmsh's usual angle of a feature; nine flats a turn are round.
_SMOOTH = np.cos(np.radians(40))
_FLAT = 2e-3  # rad: roundoff of coordinates in single precision turns facets by less
_EVEN = 1e-4  # part of a face's size: largest deviation of a plane face from its plane
_NEAR = 1e-3  # part of a facet's size, or of a radius: lengths closer than this count as equal
# Part of a facet's size: its triangles deviate less from a round face, at 16 cells a turn.
_EDGE = 2e-2
# Radius over a face's size; a flatter arc does not determine a radius to three digits.
_MAX_RADIUS = 10.0
_ANGLE = 10.0  # degrees: tolerance of `normal` without `angle`
# Part of the side of a square of the chosen area: a thinner wall has two sides in a box.
_THIN = 0.5
_TINY = 1e-300  # replaces a length or an area of 0 in a divisor
_MIN_FIT_POINTS = 6  # one more than the five numbers of a cylinder, so that a misfit shows
_FIT_POINTS = 2000  # points of a face in a fit: enough for these five numbers
_FIT = 1e-12  # relative accuracy of these numbers: roundoff
_FIT_STEPS = 50  # largest number of evaluations of such a fit
# Least square of a radius over a face's size, which roundoff may make negative.
_LEAST_SQUARE = 1e-30
_ACROSS = 0.5  # cosine of a cylinder's axis and a facet's normal: its ends have 1, its side 0
_OPPOSED = -0.99  # cosine of the normals of two sides of a wall: 8 degrees
_ROUNDOFF = 1e-9  # relative: bundles write directions and positions with about as many digits
_ALIGNED = 1 - 1e-6  # cosine of a normal with a plane's: 0.08 degrees
_UNKNOWN = Face(0, "Curved", 0.0, (0.0, 0.0, 0.0), None, None)


class _Restriction(NamedTuple):
    """Facets that a key allows."""

    allowed: Array  # shape (f,), bool
    excess: Array  # shape (f,): distance of each facet from being allowed
    unit: str  # unit and meaning of `excess`


class Surface:
    """The f facets of a mesh's surface, each with the number of its face.

    group, numbers, faces: facets, their faces' numbers, (f,), and these faces, of a geometry file;
    without these, the outer surface and its smooth parts.

    Attributes: `corners` (f, 4) and `triangles` (t, 3) nodes; `owners` (t,) the facet of each
    triangle; `areas` (f,), m^2; unit `normals` and `middles`, m, (f, 3); `sizes` (f,), m.
    """

    def __init__(
        self,
        mesh: Mesh,
        group: FacetGroup | None = None,
        numbers: Array | None = None,
        faces: tuple[Face, ...] = (),
    ) -> None:
        self.mesh = mesh
        self.blocks = (group or outer_surface(mesh.blocks)).blocks
        corners = [n[:, [0, 1, 2, corners_of(kind) - 1]] for kind, n in self.blocks]
        self.corners = np.concatenate(corners)  # shape (f, 4); a triangle has its third twice
        rows = [n[:, TRIANGLES[kind]].reshape(-1, 3) for kind, n in self.blocks]
        self.triangles = np.concatenate(rows)
        each = np.repeat([len(TRIANGLES[k]) for k, _ in self.blocks], [len(n) for n in corners])
        self.owners = np.repeat(np.arange(len(each)), each)  # facet of each triangle
        x = mesh.points[self.triangles]
        self._vectors = 0.5 * np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
        parts = np.linalg.norm(self._vectors, axis=1, keepdims=True)
        self.areas = self._of_facets(parts)[:, 0]
        self.normals = _unit(self._of_facets(self._vectors))
        weight = np.maximum(self.areas, _TINY)[:, None]
        self.middles = self._of_facets(parts * x.mean(axis=1)) / weight
        self.sizes = np.linalg.norm(np.ptp(mesh.points[self.corners], axis=1), axis=1)
        if numbers is None:
            numbers, faces = self._smooth_parts()
        self.numbers = numbers
        self.faces = faces

    def _of_facets(self, values: Array) -> Array:
        """Sum values of triangles, shape (t, k), by facet."""
        columns = [np.bincount(self.owners, column, len(self.corners)) for column in values.T]
        return np.stack(columns, axis=1)

    def group(self, chosen: Array) -> FacetGroup:
        """Return the chosen facets, a mask of shape (f,), as a group."""
        ends = np.cumsum([len(nodes) for _, nodes in self.blocks])
        parts = zip(self.blocks, np.split(chosen, ends[:-1]), strict=True)
        return FacetGroup(tuple(FacetBlock(k, n[part]) for (k, n), part in parts if part.any()))

    def _smooth_pairs(self) -> tuple[Array, Array]:
        """Return pairs of facets with a common edge that is not sharp, (p,) and (p,)."""
        normals = _unit(self._vectors)
        edges = np.sort(self.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        order = np.lexsort(edges.T)
        same = np.concatenate([[False], (np.diff(edges[order], axis=0) == 0).all(axis=1), [False]])
        at = np.flatnonzero(same[1:-1] & ~same[:-2] & ~same[2:])  # edges of two triangles
        facet = order[at] // 3
        neighbour = order[at + 1] // 3
        smooth = np.einsum("ij,ij->i", normals[facet], normals[neighbour]) > _SMOOTH
        return self.owners[facet[smooth]], self.owners[neighbour[smooth]]

    def _smooth_parts(self) -> tuple[Array, tuple[Face, ...]]:
        """Split the surface at sharp edges, and smooth parts that are no cylinder at planes.

        Return the number of each facet's face, (f,), from 1 on, and the faces.
        """
        count, (first, second) = len(self.corners), self._smooth_pairs()

        def parts(joined: Array) -> Array:
            """Return the part of each facet, (f,), if some of the pairs hang together."""
            pair = first[joined], second[joined]
            graph = coo_array((np.ones(len(pair[0])), pair), shape=(count, count))
            return connected_components(graph, directed=False)[1]

        turn = np.linalg.norm(np.cross(self.normals[first], self.normals[second]), axis=1)
        smooth_parts = parts(np.ones(len(turn), dtype=bool))
        flat = parts(turn < _FLAT)
        plane = self._in_planes(smooth_parts, flat)
        split = np.zeros(count, dtype=bool)
        for part in _members(smooth_parts):
            mixed = plane[part].any() and len(np.unique(flat[part])) > 1
            split[part] = mixed and self.cylinder(part) is None
        alike = (plane[first] == plane[second]) & (~plane[first] | (turn < _FLAT))
        members = _members(parts(alike | ~split[first]))
        faces = [self._face(part) for part in members]
        # Numbered by position, so that another mesh of the part has the same numbers.
        centres = np.array([face.centre for face in faces])
        centres = np.round(centres / (_NEAR * np.ptp(self.mesh.points, axis=0).max()))
        ranked = np.lexsort(centres.T[::-1]).tolist()
        numbers = np.zeros(count, dtype=np.int64)
        for number, i in enumerate(ranked, 1):
            numbers[members[i]] = number
        return numbers, tuple(replace(faces[i], number=n) for n, i in enumerate(ranked, 1))

    def _in_planes(self, smooth: Array, flat: Array) -> Array:
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

    def _face(self, members: Array) -> Face:
        """Return the plane, cylinder or curved face of facets, by their indices (k,)."""
        x = self.mesh.points[np.unique(self.corners[members])]
        areas = self.areas[members]
        if not areas.any():
            at = point_text(x.mean(axis=0))
            _refuse("mesh", f"has cells without volume at the surface near {at} m; mesh it again")
        centre = _three(np.average(self.middles[members], axis=0, weights=areas))
        mean = _unit(areas[None] @ self.normals[members])[0]
        face = Face(0, "Curved", float(areas.sum()), centre, None, None)
        if np.ptp(x @ mean) < _EVEN * np.linalg.norm(np.ptp(x, axis=0)):
            return replace(face, kind="Plane", normal=_three(np.round(mean, 12)))
        return self.cylinder(members, face) or face

    def cylinder(self, members: Array, face: Face = _UNKNOWN) -> Face | None:
        """Return `face` with the axis and radius of the cylinder through facets, or None.

        members: indices of the facets, (k,). A radius that `face` already has is kept.
        """
        x = self.mesh.points[np.unique(self.corners[members])]
        middle = x.mean(axis=0)
        size = float(np.linalg.norm(np.ptp(x, axis=0)))
        vectors = self.normals[members] * self.areas[members, None] / size**2
        # First column: the direction square to the normals.
        frame = np.linalg.eigh(vectors.T @ vectors)[1]
        local = (x - middle) @ frame / size
        sample = local[:: max(1, len(x) // _FIT_POINTS)]

        # Imported here, as it takes 50 ms of a solve's start.
        from scipy.optimize import least_squares

        # The axis by the point (0, b, c) and the direction (1, d, e) of the frame; and the radius.
        def misfit(values: Array, at: Array) -> Array:
            """Return distances of points (k, 3) from the cylinder b, c, d, e, radius, (k,)."""
            arms = np.cross(at - [0, *values[:2]], _unit(np.array([[1, *values[2:4]]])))
            return np.linalg.norm(arms, axis=1) - values[4]

        # Start from the circle that fits best across the first direction.
        ones = np.column_stack([2 * sample[:, 1:], np.ones(len(sample))])
        b, c, constant = np.linalg.lstsq(ones, (sample[:, 1:] ** 2).sum(axis=1))[0]
        start = np.array([b, c, 0, 0, np.sqrt(max(constant + b**2 + c**2, _LEAST_SQUARE))])
        if len(sample) < _MIN_FIT_POINTS or np.abs(misfit(start, sample)).max() > start[4]:
            return None
        fit = least_squares(
            misfit, start, args=(sample,), xtol=_FIT, ftol=_FIT, max_nfev=_FIT_STEPS
        ).x
        if fit[4] > _MAX_RADIUS or np.abs(misfit(fit, local)).max() > _NEAR * min(fit[4], 1.0):
            return None
        axis = _unit((frame @ [1, *fit[2:4]])[None])[0]
        axis *= np.sign(axis[np.abs(axis).argmax()])
        point = middle + size * frame @ [0, *fit[:2]]
        point += axis * (axis @ (middle - point))
        radius = face.radius or float(f"{size * fit[4]:.9g}")
        axis = _three(np.round(axis, 9))
        point = _three(point)
        return replace(face, kind="Cylinder", radius=radius, axis=axis, point=point)

    def choose(self, groups: Mapping[str, FaceSelector]) -> Mesh:
        """Return the mesh with facet groups by the keys of ``[mesh.groups.NAME]``.

        Raises BundleError if a key selects nothing, or probably more than intended.
        """
        masks: dict[str, Array] = {}
        problems: list[BundleProblem] = []
        there = {*self.mesh.node_groups, *self.mesh.facet_groups}
        users = {n: {group for group in groups if group == c.inside} for n, c in groups.items()}
        try:
            order = [*TopologicalSorter(users).static_order()]
        except CycleError as error:
            message = f"{' inside '.join(error.args[1])} is circular; remove one inside key"
            _refuse(f"mesh.groups.{error.args[1][0]}.inside", message)
        for name in order:
            where = f"mesh.groups.{name}"
            inside = groups[name].inside
            mask = None
            if name in there:
                message = "the mesh file already has a group of this name; choose another name"
                problems.append(BundleProblem(where, message))
            if inside in groups:
                mask = masks.get(inside or "")
            elif inside is not None:
                mask = self._of_file(inside, f"{where}.inside", problems)
            if inside is not None and mask is None:
                continue  # that group has its own problem
            try:
                masks[name] = self._chosen(groups[name], where, mask)
            except BundleError as error:
                problems += error.problems
        if problems:
            raise BundleError(problems)
        chosen = {name: self.group(masks[name]) for name in groups}
        return replace(self.mesh, facet_groups={**self.mesh.facet_groups, **chosen})

    def _of_file(self, name: str, where: str, problems: list[BundleProblem]) -> Array | None:
        """Return the facets of a group of the mesh file, a mask of shape (f,)."""
        if (group := self.mesh.facet_groups.get(name)) is not None:
            rows = [n[:, : corners_of(kind)].tolist() for kind, n in group.blocks]
            known = {frozenset(row) for block in rows for row in block}
            return np.fromiter((frozenset(row) in known for row in self.corners.tolist()), bool)
        nodes = group_nodes(self.mesh, where, name, problems)
        return np.asarray(np.isin(self.corners, nodes).all(axis=1)) if len(nodes) else None

    def _chosen(self, choice: FaceSelector, where: str, inside: Array | None) -> Array:
        """Return the facets of a group, a mask of shape (f,).

        `inside`: the mask of the group around it.
        """
        if lost := {*choice.faces} - {face.number for face in self.faces}:
            message = f"there is no face {min(lost)}; write numbers from 1 to {len(self.faces)}"
            _refuse(f"{where}.faces", message)
        adding = [np.isin(self.numbers, choice.faces)] if choice.faces else []
        adding += [self.numbers == self._nearest(point, f"{where}.near") for point in choice.near]
        adding += [] if choice.plane is None else [self._in_plane(choice, f"{where}.plane")]
        adding += [] if choice.radius is None else [self._round(choice, f"{where}.radius")]
        chosen = np.any(adding, axis=0) if adding else np.ones(len(self.areas), dtype=bool)
        restrictions: dict[str, _Restriction] = {}
        if choice.box is not None:
            x, (low, high) = self.mesh.points[self.corners], np.array(choice.box)
            outside = np.maximum(low - x, x - high).max(axis=(1, 2))
            inner = outside <= _NEAR * self.sizes
            restrictions["box"] = _Restriction(inner, outside, "m out of it by a corner")
        if choice.normal is not None:
            angles = np.degrees(np.arccos(np.clip(self.normals @ choice.normal, -1, 1)))
            aligned = angles <= (choice.angle or _ANGLE)
            restrictions["normal"] = _Restriction(aligned, angles, "degrees from it")
        if inside is not None:
            apart = np.linalg.norm(self.middles - self.middles[inside].mean(axis=0), axis=1)
            unit = f"m from the middle of {choice.inside}"
            restrictions["inside"] = _Restriction(inside, apart, unit)
        for key, (allowed, excess, unit) in restrictions.items():
            if not (chosen & allowed).any():
                index = np.flatnonzero(chosen)[excess[chosen].argmin()]
                message = (
                    f"keeps none of the {chosen.sum()} facets that the other keys select; the "
                    f"nearest, at {point_text(self.middles[index])} m, is {excess[index]:.3g} "
                    f"{unit}; change one of the keys"
                )
                _refuse(f"{where}.{key}", message)
            chosen &= allowed
        if choice.box is not None and choice.normal is None and not adding:
            self._check_sides(chosen, f"{where}.box")
        return chosen

    def _nearest(self, point: Point, where: str) -> int:
        """Return the number of the face nearest to a point.

        Raises BundleError if none is near, or several are equally near.
        """
        off = np.linalg.norm(self.middles - np.array(point), axis=1)
        limit = (off + self.sizes).min() + _EDGE * self.sizes.max()
        close = (off - self.sizes <= limit)[self.owners]
        owners = self.owners[close]
        normals = _unit(self._vectors[close])
        x = self.mesh.points[self.triangles[close]] - np.array(point)
        edges = np.roll(x, -1, axis=1) - x
        # Above the inside of a triangle it is the distance to its plane, else that to an edge.
        sides = np.einsum("tex,tx->te", np.cross(x, edges), normals)
        along = -np.einsum("tex,tex->te", x, edges) / np.maximum((edges**2).sum(axis=2), _TINY)
        to_edges = np.linalg.norm(x + np.clip(along, 0, 1)[:, :, None] * edges, axis=2).min(axis=1)
        height = np.abs(np.einsum("tx,tx->t", x[:, 0], normals))
        distance = np.where((sides >= 0).all(axis=1), height, to_edges)
        least = distance.min()
        size = self.sizes[owners[distance.argmin()]]
        near = distance <= least + (_EDGE * size if least <= size else 0.0)
        numbers = np.unique(self.numbers[owners[near]]).tolist()
        if message := near_message(point, "face", numbers, least, size):
            _refuse(where, message)
        return numbers[0]

    def _in_plane(self, choice: FaceSelector, where: str) -> Array:
        """Return the facets in the plane of a choice, a mask of shape (f,)."""
        plane = choice.plane
        normal = np.eye(3)["xyz".index(plane)] if isinstance(plane, str) else np.array(plane)
        at = float(normal @ choice.at) if isinstance(choice.at, tuple) else float(choice.at or 0)
        heights = self.mesh.points[self.corners] @ normal - at
        # A facet of a round face that touches the plane is parallel to it too.
        even = [face.number for face in self.faces if face.kind in ("Plane", "Curved")]
        level = np.abs(heights).max(axis=1) <= _NEAR * self.sizes
        level &= np.isin(self.numbers, even)
        if not level.any():
            square = [f for f in self.faces if f.normal and abs(normal @ f.normal) > _ALIGNED]
            positions = sorted({round(float(normal @ face.centre), 9) for face in square})
            listed = ", ".join(f"{place:g}" for place in positions)
            along = plane if isinstance(plane, str) else f"x . {point_text(normal)}"
            remedy = f"choose one at: {listed}" if listed else "none is parallel; use near or faces"
            _refuse(where, f"there is no plane face at {along} = {at:g} m; {remedy}")
        return level

    def _round(self, choice: FaceSelector, where: str) -> Array:
        """Return the facets on a cylinder, or on all of a radius, a mask of shape (f,)."""
        radius = float(choice.radius or 0)
        if choice.cylinder is None:
            radii = {face.number: face.radius for face in self.faces if face.radius is not None}
            chosen = [n for n, other in radii.items() if abs(other - radius) < _NEAR * radius]
            if not chosen:
                listed = ", ".join(dict.fromkeys(f"{r:.6g}" for r in sorted(radii.values())))
                remedy = f"choose one of {listed}" if listed else "none is round; use near or faces"
                _refuse(where, f"there is no cylinder of radius {radius:g} m; {remedy}")
            return np.isin(self.numbers, chosen)
        axis = np.array(choice.cylinder.axis)
        arms = np.cross(self.mesh.points[self.corners] - choice.cylinder.point, axis)
        off = np.abs(np.linalg.norm(arms, axis=2) - radius).max(axis=1)
        on = (off < _NEAR * radius) & (np.abs(self.normals @ axis) < _ACROSS)
        if not on.any():
            message = (
                f"no facet lies on the cylinder of radius {radius:g} m about this axis; the "
                f"nearest is {off.min():.3g} m off, at {point_text(self.middles[off.argmin()])} m; "
                "correct it"
            )
            _refuse(where, message)
        return on

    def _check_sides(self, chosen: Array, where: str) -> None:
        """Refuse a box round both sides of a thin wall."""
        parts = {f: chosen & (self.numbers == f.number) for f in self.faces if f.normal is not None}
        for a, b in combinations([face for face, part in parts.items() if part.any()], 2):
            normal = np.array(a.normal)
            gap = float(normal @ np.subtract(a.centre, b.centre))
            least = min(self.areas[parts[a]].sum(), self.areas[parts[b]].sum())
            if normal @ b.normal < _OPPOSED and 0 < gap < _THIN * np.sqrt(least):
                message = (
                    f"has both sides of a wall {gap:.3g} m thick: {parts[a].sum()} facets of face "
                    f"{a.number} and {parts[b].sum()} of face {b.number}; add normal = "
                    f"{_short(*normal)} for one side, or faces = [{a.number}, {b.number}] for both"
                )
                _refuse(where, message)

    def line(self, face: Face) -> str:
        """Return the TOML that selects a face alone, in the simplest form."""
        members = self.numbers == face.number
        middle = _short(*face.centre)
        at = self.middles[members]
        ways: list[dict[str, Any]] = [  # keys of a `FaceSelector`, the simplest first
            {"near": _short(*at[np.linalg.norm(at - face.centre, axis=1).argmin()])},
            {"faces": [face.number]},
        ]
        if face.radius is not None:
            ways.insert(0, {"radius": float(f"{face.radius:.6g}")})
        if face.normal is not None:
            axis = int(np.abs(face.normal).argmax())
            even = abs(face.normal[axis]) > 1 - _ROUNDOFF
            square = {"plane": "xyz"[axis], "at": middle[axis]}
            ways.insert(0, square if even else {"plane": _short(*face.normal), "at": middle})
        for way in ways:
            text = f"{{{', '.join(f'{key} = {json.dumps(value)}' for key, value in way.items())}}}"
            with contextlib.suppress(BundleError):
                if np.array_equal(self._chosen(FaceSelector(**way), "", None), members):
                    return text
        raise AssertionError(face)  # its number selects it


def _refuse(where: str, message: str) -> NoReturn:
    raise BundleError([BundleProblem(where, message)])


def _unit(vectors: Array) -> Array:
    """Return vectors (k, 3) at length one; zero stays zero."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), _TINY)


def _members(labels: Array) -> list[Array]:
    """Return the indices of each label, from 0 on."""
    order = np.argsort(labels, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(labels[order])) + 1)


def _three(values: Array) -> Point:
    """Return three numbers as plain floats; + 0.0 makes -0.0 a plain 0."""
    return float(values[0]) + 0.0, float(values[1]) + 0.0, float(values[2]) + 0.0


def _short(*values: float) -> list[float]:
    """Round numbers to six digits of the largest."""
    digits = 5 - int(np.floor(np.log10(max(*map(abs, values), 1e-12))))
    return [round(float(value), digits) + 0.0 for value in values]
