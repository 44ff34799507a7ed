"""Mesh files with straight edges across round surfaces: their effect, and possibly round polygons.

Midside nodes that a first-order mesh is given, here or by another program, lie in the middle of
straight edges. Where the angles between facets of the surface are small they approximate a
round surface, whose normal at a corner is about the mean of the facets' there. An edge of length L
between corners with normals m and n then bows out by L/8 (n - m) . d, d the edge's direction: the
sagitta of a circle to the third order of the angle (Nagata 2005, "Simple local interpolation of
surfaces using normal vectors"). Six to eight cells round can be a polygon as well: they are a
warning, not a part of the bar.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.mesh.facets import corners_of, outer_surface
from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.mesh.surface import connected, members_of
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.problems import BundleProblem, point_text

SMOOTH = np.radians(42.0)
"""Largest angle between neighbouring facets of a round surface: at larger angles an edge is an edge
of the part, such as of a chamfer of 45 degrees. Nine cells round a hole are at 40 degrees to each
other, eight at 45; the limit is off both, so that roundoff does not decide."""

_COARSE = np.radians(61.0)
"""Largest angle between facets of a possibly round surface: six cells round are at 60 degrees."""

_EQUAL = np.radians(1.0)
"""Largest turn within a flat face, and difference of equal angles: coordinates of five digits turn
facets by less."""

_ALONG = np.cos(np.radians(30.0))
"""Cosine of the angle between edges along a polygon: 0 degrees of a prism, 22 of a pyramid whose
six faces lean by 30 degrees; edges across are at 90."""

_OFF_CIRCLE = 1e-3
"""Largest difference of the faces' distances from the axis, as a part of their extent: coordinates
of five digits change it by less. In a square bar whose chamfers are 5 % narrower than the sides it
is 0.005."""

_MIN_LEAN = 1e-3
"""Least singular value, over the largest, of the faces' normals: in smaller ones, those of a prism
along its axis, there is only roundoff of coordinates."""

_IN_A_ROW = 4
"""Least number of faces of a polygon: half a ring of eight. Three are a side and two chamfers."""

STRAIGHT = 1e-3
"""Part of an edge's length: a midside node nearer to the edge's middle was put there by a program,
in files with few digits too; across a round surface that turns by 0.5 degrees it bows out by as
much."""

_PARTS = tuple(0.5**halvings for halvings in range(8))
"""Parts of the bow that are tried in turn: in flat cells the full bow can turn a cell inside out,
and the compliance changes in proportion. A hundredth of a change of 10 % is still a thousand
times the roundoff."""


class Roundness(NamedTuple):
    """Effect of bending the edges."""

    # Shape (6 i, k): the compliance with straight edges, less that with curved ones, SI
    change: np.ndarray
    angle: float  # the largest angle between facets that count as a round surface, rad


def roundness(solver: Solver) -> Roundness | None:
    """Return the effect of straight edges across round surfaces; None if there are none.

    It costs a linear solve. Only mesh files have it: other meshes are made on their geometry.

    Raises SolveFailed if the curved cells cannot be solved for any part of the bow.
    """
    component = solver.component
    if not _is_of_mesh_file(component):
        return None
    bows, angle = bows_of(component.mesh)
    if not bows.any():
        return None
    for part in _PARTS:
        mesh = replace(component.mesh, points=component.mesh.points + part * bows)
        try:
            curved = Solver(replace(component, mesh=mesh)).linear.compliance
        except SolveFailed:
            if part == _PARTS[-1]:
                raise
            continue
        return Roundness((solver.linear.compliance - curved) / part, angle)
    raise AssertionError("the last part raises")


def _is_of_mesh_file(component: ComponentModel) -> bool:
    """Return whether a component's mesh is that of a file, not made on its geometry."""
    source = component.bundle.mesh
    return source is not None and source.file is not None and source.geometry is None


class _Facets(NamedTuple):
    """The surface's f second-order facets. A triangle repeats its last corner."""

    corners: np.ndarray  # shape (f, 4), int64: nodes
    # Shape (f, 4), int64: midside nodes; a triangle's third side, of no length, has the second's
    middles: np.ndarray
    points: np.ndarray  # shape (f, 4, 3), m: of the corners
    normals: np.ndarray  # shape (f, 3): unit vectors

    @property
    def triangles(self) -> np.ndarray:
        """Which facets are triangles, shape (f,), bool."""
        return np.asarray(self.corners[:, 2] == self.corners[:, 3])


def _surface_facets(mesh: Mesh) -> _Facets:
    """Return the second-order facets of a mesh's surface."""
    empty = np.empty((0, 4), dtype=np.int64)
    corners, middles = [empty], [empty]
    for kind, nodes in outer_surface(mesh.blocks).blocks:
        count = corners_of(kind)
        if nodes.shape[1] >= 2 * count:
            corners.append(nodes[:, np.minimum(np.arange(4), count - 1)])
            sides = [0, 1, 2, 3] if count == 4 else [0, 1, 1, 2]
            middles.append(nodes[:, count : 2 * count][:, sides])
    facets = _Facets(np.concatenate(corners), np.concatenate(middles), empty, empty)
    points = mesh.points[facets.corners]

    normals = np.cross(points[:, 2] - points[:, 0], points[:, 3] - points[:, 1])
    of_triangle = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    normals[facets.triangles] = of_triangle[facets.triangles]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return facets._replace(points=points, normals=normals)


def bows_of(mesh: Mesh) -> tuple[np.ndarray, float]:
    """Return the motion of each node to the round surface, (n, 3), m, and the largest angle, rad.

    No node moves on a connected surface whose midside nodes are on the geometry: if one is off its
    edge's middle by more than half of what is usual for a bow there.
    """
    bows = np.zeros_like(mesh.points)
    facets = _surface_facets(mesh)
    normals, facet_angle = _corner_normals(facets)
    edge = np.roll(facets.points, -1, axis=1) - facets.points
    length = np.linalg.norm(edge, axis=2)
    ahead = np.roll(normals, -1, axis=1)
    sagitta = np.einsum("fsi,fsi->fs", ahead - normals, edge)[:, :, None] / 8
    outward = normals + ahead
    bow = sagitta * outward / np.linalg.norm(outward, axis=2, keepdims=True)
    size = np.linalg.norm(bow, axis=2)
    curved = size > STRAIGHT * length

    # Surfaces on the geometry: facets with common corners are one surface.
    offset = _offsets(mesh, facets)
    count = len(facets.corners)
    facet = np.repeat(np.arange(count), 4)
    surface = connected(facet, count + facets.corners.ravel(), count + len(bows))[:count]
    for members in members_of(surface):
        edges = curved[members]
        if edges.any():
            usual = np.median(size[members][edges] / length[members][edges])
            curved[members] &= offset[members].max() <= max(STRAIGHT, 0.5 * usual)

    # Of an edge's two facets the one with the larger bow counts: it is the last.
    facet, side = np.nonzero(curved)
    order = np.argsort(size[facet, side])
    facet, side = facet[order], side[order]
    bows[facets.middles[facet, side]] = bow[facet, side]
    largest = float(facet_angle[facet].max(initial=0.0))
    return bows if mesh.dependents is None else mesh.dependents.expanded(bows), largest


def _offsets(mesh: Mesh, facets: _Facets) -> np.ndarray:
    """Return the midside nodes' distances from the middles of edges over their lengths, (f, 4)."""
    after = np.roll(facets.points, -1, axis=1)
    height = np.linalg.norm(mesh.points[facets.middles] - 0.5 * (facets.points + after), axis=2)
    if mesh.dependents is not None:  # masters determine the positions of tied nodes
        nodes = np.stack([facets.middles, facets.corners, np.roll(facets.corners, -1, axis=1)])
        height[np.isin(nodes, mesh.dependents.nodes).any(axis=0)] = 0.0
    length = np.linalg.norm(after - facets.points, axis=2)
    # A triangle's side of length zero repeats another side's midside node.
    return np.divide(height, length, out=np.zeros_like(height), where=length > 0)


def _corner_normals(facets: _Facets) -> tuple[np.ndarray, np.ndarray]:
    """Return the surface's unit normals, (f, 4, 3), and each facet's largest angle, (f,), rad.

    The normal at a facet's corner is the mean over facets there at angles below `SMOOTH` to it, by
    their angles there.
    """
    points, triangles = facets.points, facets.triangles
    # The facets' angles at their corners, (f, 4), rad; that at a repeated corner is halved.
    before, after = np.roll(points, 1, axis=1), np.roll(points, -1, axis=1)
    before[triangles, 3] = points[triangles, 1]
    after[triangles, 2] = points[triangles, 0]
    back, ahead = before - points, after - points
    cosine = np.einsum("fci,fci->fc", back, ahead)
    size = np.linalg.norm(back, axis=2) * np.linalg.norm(ahead, axis=2)
    angles = np.arccos(np.clip(cosine / np.where(size > 0, size, 1.0), -1.0, 1.0))
    angles[triangles, 2:] /= 2

    normals = np.empty_like(points)
    largest = np.zeros(len(points))
    for corners_at_node in members_of(facets.corners.ravel()):
        facet, corner = np.divmod(corners_at_node, 4)
        cosines = np.clip(facets.normals[facet] @ facets.normals[facet].T, -1.0, 1.0)
        near = cosines > np.cos(SMOOTH)
        mean = (near * angles[facet, corner]) @ facets.normals[facet]
        normals[facet, corner] = mean / np.linalg.norm(mean, axis=1, keepdims=True)
        np.maximum.at(largest, facet, np.arccos(np.where(near, cosines, 1.0).min(axis=1)))
    return normals, largest


class Polygon(NamedTuple):
    """Equal flat faces in a row at equal angles: a polygon, or a round surface of few cells."""

    faces: int
    angle: float  # between neighbours, rad
    at: np.ndarray  # a point on an edge between two of them, (3,), m


def polygons_of(mesh: Mesh) -> list[Polygon]:
    """Return the polygons of six to eight faces round in the surface, and halves of eight."""
    facets = _surface_facets(mesh)
    face, folds = _folds(mesh, facets)

    # Folds of one face that are alike belong together; those of a polygon touch one circle or cone.
    links = [np.empty((0, 2), dtype=np.int64)]
    for sides_of_face in members_of(folds.faces.ravel()):
        fold = sides_of_face // 2
        alike = np.abs(folds.angle[fold, None] - folds.angle[fold]) < _EQUAL
        alike &= np.abs(folds.along[fold] @ folds.along[fold].T) > _ALONG
        links.append(fold[np.argwhere(alike)])
    first, second = np.concatenate(links).T
    row = connected(first, second, len(folds.angle))

    facet_of = np.unique(face, return_index=True)[1]  # a facet of each face
    polygons = []
    for fold in members_of(row):
        faces = np.unique(folds.faces[fold])
        if len(fold) < _IN_A_ROW - 1 or len(faces) < _IN_A_ROW:
            continue
        # The distances of the faces' planes from the axis are equal.
        at = folds.start[fold[0]]
        normals, points = facets.normals[facet_of[faces]], facets.points[facet_of[faces], 0]
        height = np.einsum("ki,ki->k", normals, points - at)
        matrix = np.column_stack([normals, np.ones(len(faces))])
        misfit = height - matrix @ np.linalg.lstsq(matrix, height, rcond=_MIN_LEAN)[0]
        if np.abs(misfit).max() < _OFF_CIRCLE * np.ptp(height):
            polygons.append(Polygon(len(faces), float(np.abs(folds.angle[fold]).mean()), at))
    return polygons


class _Folds(NamedTuple):
    """Edges between two flat faces each at the angle of a polygon, k of them."""

    faces: np.ndarray  # shape (k, 2), int64: numbers of both faces, ascending
    start: np.ndarray  # shape (k, 3), m: an end of the edge
    along: np.ndarray  # shape (k, 3): unit vectors from there to the other end
    angle: np.ndarray  # shape (k,), rad: between the faces, negative where the edge stands out


def _folds(mesh: Mesh, facets: _Facets) -> tuple[np.ndarray, _Folds]:
    """Return the number of each facet's flat face, (f,), and the folds between these."""
    # Pairs of facets at an edge; both sides of a triangle's last corner are the same edge.
    facet, side = np.divmod(np.argsort(facets.middles, axis=None, kind="stable"), 4)
    same = (np.diff(facets.middles[facet, side]) == 0) & (facet[1:] != facet[:-1])
    first, second, side = facet[:-1][same], facet[1:][same], side[:-1][same]
    cosine = np.einsum("pi,pi->p", facets.normals[first], facets.normals[second])
    turn = np.arccos(np.clip(cosine, -1.0, 1.0))
    flat = turn < _EQUAL
    face = connected(first[flat], second[flat], len(facets.corners))

    # An edge for each two faces at such an angle, without midside nodes off edges.
    straight = _offsets(mesh, facets).max(axis=1) <= STRAIGHT
    fold = np.flatnonzero((turn > SMOOTH) & (turn < _COARSE) & straight[first] & straight[second])
    faces = np.sort(np.stack([face[first[fold]], face[second[fold]]], axis=1), axis=1)
    faces, index = np.unique(faces, axis=0, return_index=True)
    fold = fold[index]

    corner, first, second = side[fold], first[fold], second[fold]
    corner -= (corner == 2) & facets.triangles[first]
    start = facets.points[first, corner]
    end = facets.points[first, (corner + 1) % 4]
    along = (end - start) / np.linalg.norm(end - start, axis=1, keepdims=True)
    towards = facets.points[second].mean(axis=1) - start
    out = np.einsum("ki,ki->k", towards, facets.normals[first])
    return face, _Folds(faces, start, along, turn[fold] * np.sign(out))


def polygon_warnings(component: ComponentModel) -> list[BundleProblem]:
    """Return a warning if a mesh file has polygons, which error bars take as the true shape."""
    if not _is_of_mesh_file(component):
        return []
    polygons = polygons_of(component.uncut_mesh)
    if not polygons:
        return []
    faces, angle, at = polygons[0]
    more = f" ({len(polygons)} such surfaces)" if len(polygons) > 1 else ""
    # Second moments of a circle and of the polygon in it.
    soft = 6 * angle / (np.sin(angle) * (2 + np.cos(angle))) / 2 - 1
    message = (
        f"has {faces} equal flat faces in a row, {np.degrees(angle):.3g} degrees a turn, near "
        f"{point_text(at)} m{more}. If the part is round there, error bars lack the effect of its "
        f"straight edges: a bar is {100 * soft:.2g} % too soft in bending. Mesh it with 9 or more "
        "cells round, or with midside nodes on the geometry; for a true polygon, ignore this"
    )
    return [BundleProblem("mesh.file", message)]
