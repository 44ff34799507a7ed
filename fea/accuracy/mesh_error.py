"""The mesh's error at the six unit loads: recovered stresses, and straight edges of round surfaces.

The outputs being the loads, C - C_h of a compliance is the strain energy of the errors of the unit
loads' fields, pair by pair: C_ij - C_h,ij = a(u_i - u_h,i, u_j - u_h,j). The error of a strain or
stress is estimated by smoother ones (Zienkiewicz and Zhu 1987): in each cell those at the solver's
integration points, where they are most exact (Barlow 1976), are continued to the corners by
least squares and averaged there over the cells of one material by volume; what is interpolated
between those corners stands for the exact field. The solver's points and no others: at the 27
points of a hex20 with reduced integration the strains of a thin plate are thirty times too large.

Midside nodes that a first-order mesh is given, here or by another program, lie in the middle of
straight edges. Where the angles between facets of the surface are small they approximate a
round surface, whose normal at a corner is about the mean of the facets' there. An edge of length L
between corners with normals m and n then bows out by L/8 (n - m) . d, d the edge's direction: the
sagitta of a circle to the third order of the angle (Nagata 2005, "Simple local interpolation of
surfaces using normal vectors"). Six to eight cells round can be a polygon as well: they are a
warning, not a part of the bar.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from wrenchbook.fea.assembly.body import gather
from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.mesh.facets import EDGES, corners_of, outer_surface
from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.mesh.reference_cell import node_coordinates, reference_element, tabulate
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.problems import BundleProblem, point_text

Array = np.ndarray

SMOOTH = np.radians(42.0)
"""Largest angle between neighbouring facets of a round surface: at larger angles an edge is an edge
of the part, such as of a chamfer of 45 degrees. Nine cells round a hole are at 40 degrees to each
other, eight at 45; the limit is off both, so that roundoff does not decide.
"""

_COARSE = np.radians(61.0)
"""Largest angle between facets of a possibly round surface: six cells round are at 60 degrees."""

_EQUAL = np.radians(1.0)
"""Largest turn within a flat face, and difference of equal angles: coordinates of five digits turn
facets by less.
"""

_ALONG = np.cos(np.radians(30.0))
"""Cosine of the angle between edges along a polygon: 0 degrees of a prism, 22 of a pyramid whose
six faces lean by 30 degrees; edges across are at 90.
"""

_OFF_CIRCLE = 1e-3
"""Largest difference of the faces' distances from the axis, as a part of their extent: coordinates
of five digits change it by less. In a square bar whose chamfers are 5 % narrower than the sides it
is 0.005.
"""

_LEAST_LEAN = 1e-3
"""Least singular value, over the largest, of the faces' normals: in smaller ones, those of a prism
along its axis, there is only roundoff of coordinates.
"""

_IN_A_ROW = 4
"""Least number of faces of a polygon: half a ring of eight. Three are a side and two chamfers."""

STRAIGHT = 1e-3
"""Part of an edge's length: a midside node nearer to the edge's middle was put there by a program,
in files with few digits too; across a round surface that turns by 0.5 degrees it bows out by as
much.
"""

_PARTS = tuple(0.5**halvings for halvings in range(8))
"""Parts of the bow that are tried in turn: in flat cells the full bow can turn a cell inside out,
and the compliance changes in proportion. A hundredth of a change of 10 % is still a thousand
times the roundoff.
"""


class Roundness(NamedTuple):
    """Effect of bending the edges."""

    # Shape (6 i, k): the compliance with straight edges, less that with curved ones, SI
    change: Array
    angle: float  # the largest angle between facets that count as a round surface, rad


def roundness(solver: Solver) -> Roundness | None:
    """Return the effect of straight edges across round surfaces; None if there are none.

    It costs a linear solve. Only mesh files have it: other meshes are made on their geometry.

    Raises SolveFailed if the curved cells cannot be solved for any part of the bow.
    """
    component = solver.component
    source = component.bundle and component.bundle.mesh
    if not source or source.file is None or source.geometry is not None:
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


def bows_of(mesh: Mesh) -> tuple[Array, float]:
    """Return the motion of each node to the round surface, (n, 3), m, and the largest angle, rad.

    No node moves on a connected surface whose midside nodes are on the geometry: if one is off its
    edge's middle by more than half of what is usual for a bow there.
    """
    bows = np.zeros_like(mesh.points)
    corners, middles = _surface_facets(mesh)
    points = mesh.points[corners]
    facet_normals = _facet_normals(corners, points)
    normals, facet_angle = _corner_normals(corners, points, facet_normals)
    edge = np.roll(points, -1, axis=1) - points
    length = np.linalg.norm(edge, axis=2)
    ahead = np.roll(normals, -1, axis=1)
    sagitta = np.einsum("fsi,fsi->fs", ahead - normals, edge)[:, :, None] / 8
    outward = normals + ahead
    bow = sagitta * outward / np.linalg.norm(outward, axis=2, keepdims=True)
    size = np.linalg.norm(bow, axis=2)
    curved = size > STRAIGHT * length

    # Surfaces on the geometry: the facets of each connected one have the same number.
    offset = _offsets(mesh, corners, middles)
    count = len(corners)
    pairs = np.repeat(np.arange(count), 4), count + corners.ravel()
    graph = coo_array((np.ones(4 * count), pairs), shape=(count + len(bows),) * 2)
    surface = connected_components(graph, directed=False)[1][:count]
    for number in np.unique(surface[curved.any(axis=1)]).tolist():
        on_surface = surface == number
        usual = np.median(
            size[on_surface][curved[on_surface]] / length[on_surface][curved[on_surface]]
        )
        if offset[on_surface].max() > max(STRAIGHT, 0.5 * usual):
            curved[on_surface] = False

    # Of an edge's two facets the one with the larger bow counts: it is the last.
    facet, side = np.nonzero(curved)
    order = np.argsort(size[facet, side])
    facet, side = facet[order], side[order]
    bows[middles[facet, side]] = bow[facet, side]
    largest = float(facet_angle[facet].max(initial=0.0))
    return bows if mesh.dependents is None else mesh.dependents.expanded(bows), largest


class Polygon(NamedTuple):
    """Equal flat faces in a row at equal angles: a polygon, or a round surface of few cells."""

    faces: int
    angle: float  # between neighbours, rad
    at: Array  # a point on an edge between two of them, (3,), m


def polygons_of(mesh: Mesh) -> list[Polygon]:
    """Return the polygons of six to eight faces round in the surface, and halves of eight."""
    corners, middles = _surface_facets(mesh)
    points = mesh.points[corners]
    normals = _facet_normals(corners, points)
    # Pairs of facets at an edge; both sides of a triangle's last corner are the same edge.
    facet, side = np.divmod(np.argsort(middles, axis=None, kind="stable"), 4)
    same = (np.diff(middles[facet, side]) == 0) & (facet[1:] != facet[:-1])
    first = facet[:-1][same]
    second = facet[1:][same]
    side = side[:-1][same]
    turn = np.arccos(np.clip(np.einsum("pi,pi->p", normals[first], normals[second]), -1.0, 1.0))
    flat = turn < _EQUAL
    pairs = first[flat], second[flat]
    graph = coo_array((np.ones(len(pairs[0])), pairs), shape=(len(corners),) * 2)
    face = connected_components(graph, directed=False)[1]
    of = np.unique(face, return_index=True)[1]  # a facet of each face

    # Folds: an edge between each two flat faces at such an angle, without midside nodes off edges.
    straight = _offsets(mesh, corners, middles).max(axis=1) <= STRAIGHT
    fold = np.flatnonzero((turn > SMOOTH) & (turn < _COARSE) & straight[first] & straight[second])
    sides = np.sort(np.stack([face[first[fold]], face[second[fold]]], axis=1), axis=1)
    sides, index = np.unique(sides, axis=0, return_index=True)
    fold = fold[index]
    at, first, second = side[fold], first[fold], second[fold]
    at -= (at == 2) & (corners[first, 2] == corners[first, 3])
    start = points[first, at]
    end = points[first, (at + 1) % 4]
    along = (end - start) / np.linalg.norm(end - start, axis=1, keepdims=True)
    out = np.einsum("ki,ki->k", points[second].mean(axis=1) - start, normals[first])
    angle = turn[fold] * np.sign(out)  # negative at edges that stand out

    # Folds of one face that are alike belong together; those of a polygon touch one circle or cone.
    links = [np.empty((0, 2), dtype=np.int64)]
    fold, column = np.divmod(np.argsort(sides, axis=None, kind="stable"), 2)
    of_face = np.flatnonzero(np.diff(sides[fold, column])) + 1
    for mine in np.split(fold, of_face):
        alike = np.abs(angle[mine, None] - angle[mine]) < _EQUAL
        alike &= np.abs(along[mine] @ along[mine].T) > _ALONG
        links.append(mine[np.argwhere(alike)])
    i, j = np.concatenate(links).T
    graph = coo_array((np.ones(len(i)), (i, j)), shape=(len(sides),) * 2)
    group = connected_components(graph, directed=False)[1]
    polygons = []
    for number in np.flatnonzero(np.bincount(group) >= _IN_A_ROW - 1).tolist():
        mine = np.flatnonzero(group == number)
        faces = np.unique(sides[mine])
        # The distances of the faces' planes from the axis are equal.
        height = np.einsum("ki,ki->k", normals[of[faces]], points[of[faces], 0] - start[mine[0]])
        matrix = np.column_stack([normals[of[faces]], np.ones(len(faces))])
        misfit = height - matrix @ np.linalg.lstsq(matrix, height, rcond=_LEAST_LEAN)[0]
        if len(faces) >= _IN_A_ROW and np.abs(misfit).max() < _OFF_CIRCLE * np.ptp(height):
            polygons.append(Polygon(len(faces), float(np.abs(angle[mine]).mean()), start[mine[0]]))
    return polygons


def polygon_warnings(component: ComponentModel) -> list[BundleProblem]:
    """Return a warning if a mesh file has polygons, which error bars take as the true shape."""
    source = component.bundle and component.bundle.mesh
    if not source or source.file is None or source.geometry is not None:
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


def _offsets(mesh: Mesh, corners: Array, middles: Array) -> Array:
    """Return the midside nodes' distances from the middles of edges over their lengths, (f, 4)."""
    points = mesh.points[corners]
    after = np.roll(points, -1, axis=1)
    height = np.linalg.norm(mesh.points[middles] - 0.5 * (points + after), axis=2)
    if mesh.dependents is not None:  # masters determine the positions of tied nodes
        nodes = np.stack([middles, corners, np.roll(corners, -1, axis=1)])
        height[np.isin(nodes, mesh.dependents.nodes).any(axis=0)] = 0.0
    length = np.linalg.norm(after - points, axis=2)
    # A triangle's side of length zero repeats another side's midside node.
    return np.divide(height, length, out=np.zeros_like(height), where=length > 0)


def _surface_facets(mesh: Mesh) -> tuple[Array, Array]:
    """Return corners and midside nodes of the surface's second-order facets, (f, 4) each.

    A triangle repeats its last corner; its third side, of no length, has the second's midside node.
    """
    empty = np.empty((0, 4), dtype=np.int64)
    corners, middles = [empty], [empty]
    for kind, nodes in outer_surface(mesh.blocks).blocks:
        count = corners_of(kind)
        if nodes.shape[1] >= 2 * count:
            corners.append(nodes[:, np.minimum(np.arange(4), count - 1)])
            sides = [0, 1, 2, 3] if count == 4 else [0, 1, 1, 2]
            middles.append(nodes[:, count : 2 * count][:, sides])
    return np.concatenate(corners), np.concatenate(middles)


def _facet_normals(corners: Array, points: Array) -> Array:
    """Return unit normals of facets, (f, 3); corners, points: as of `_corner_normals`."""
    facet_normals = np.cross(points[:, 2] - points[:, 0], points[:, 3] - points[:, 1])
    triangle = corners[:, 2] == corners[:, 3]
    of_triangle = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    facet_normals[triangle] = of_triangle[triangle]
    return facet_normals / np.linalg.norm(facet_normals, axis=1, keepdims=True)


def _corner_normals(corners: Array, points: Array, facet_normals: Array) -> tuple[Array, Array]:
    """Return the surface's unit normals, (f, 4, 3), and each facet's largest angle, (f,), rad.

    corners, points: shapes (f, 4), of `_surface_facets`, and (f, 4, 3), m. The normal at a facet's
    corner is the mean over facets there at angles below `SMOOTH` to it, by their angles there.
    """
    triangle = corners[:, 2] == corners[:, 3]
    # The facets' angles at their corners, (f, 4), rad; that at a repeated corner is halved.
    before, after = np.roll(points, 1, axis=1), np.roll(points, -1, axis=1)
    before[triangle, 3] = points[triangle, 1]
    after[triangle, 2] = points[triangle, 0]
    back, ahead = before - points, after - points
    cosine = np.einsum("fci,fci->fc", back, ahead)
    size = np.linalg.norm(back, axis=2) * np.linalg.norm(ahead, axis=2)
    angles = np.arccos(np.clip(cosine / np.where(size > 0, size, 1.0), -1.0, 1.0))
    angles[triangle, 2:] /= 2

    facet, corner = np.divmod(np.argsort(corners, axis=None, kind="stable"), 4)
    ends = np.append(np.flatnonzero(np.diff(corners[facet, corner])) + 1, len(facet))
    normals = np.empty_like(points)
    largest = np.zeros(len(corners))
    start = 0
    for end in ends.tolist():  # the facets of one node
        at, of = facet[start:end], corner[start:end]
        cosines = np.clip(facet_normals[at] @ facet_normals[at].T, -1.0, 1.0)
        near = cosines > np.cos(SMOOTH)
        mean = (near * angles[at, of]) @ facet_normals[at]
        normals[at, of] = mean / np.linalg.norm(mean, axis=1, keepdims=True)
        np.maximum.at(largest, at, np.arccos(np.where(near, cosines, 1.0).min(axis=1)))
        start = end
    return normals, largest


# First-order cell with the same corners, by the first letters of a kind.
_FIRST_ORDER = {"hex": "hex8", "tet": "tet4", "wed": "wedge6", "pyr": "pyramid5"}


class _Piece(NamedTuple):
    """Cells of one kind and material."""

    fields: Array  # shape (2, loads, cells, points, 3, 3): strains and stresses of the unit loads
    weights: Array  # shape (cells, points), m^3
    corners: Array  # shape (cells, corners), int64: nodes
    functions: Array  # shape (points, corners): linear shape functions of the corners
    material: int  # index of the material
    # Whether volumetric strains are projected: those at the points then have no meaning
    projected: bool


class RecoveredError(NamedTuple):
    """The mesh's error at unit inputs, by cell."""

    # Shape (k, k), SI, symmetric: the first 6 i rows are displacements of i interfaces
    total: Array
    # cells, centres, sizes: each cell's part of the diagonal, (k, cells), its centre, (cells, 3),
    # and diameter, m.
    cells: Array
    centres: Array
    sizes: Array

    def coarsening(self, other: Mesh) -> Array:
        """Ratio of another mesh's cell sizes to this mesh's, weighted by each input's error, (k,).

        A mesher that is given twice the size makes smaller cells at short edges.
        """
        blocks = [b.nodes[:, : int(np.max(EDGES[b.kind])) + 1] for b in other.blocks]
        centres, sizes = _centres_and_diameters(other.points, blocks)
        ratio = sizes[KDTree(centres).query(self.centres)[1]] / self.sizes
        parts = np.where(self.cells.any(axis=1, keepdims=True), self.cells, 1.0)
        return parts @ ratio / parts.sum(axis=1)


def recovered_error(solver: Solver) -> RecoveredError:
    """Return the estimated error of responses to unit inputs by the mesh.

    A thermal strain is the same in both compared fields, and cancels.

    Raises SolveFailed as `Solver.linear` does.
    """
    pieces = list(_pieces(solver))
    points = solver.component.mesh.points
    # For each material the means of its fields at the nodes, (nodes, 2, loads, 3, 3).
    nodes = len(points)
    totals: dict[int, Array] = {}
    volumes: dict[int, Array] = {}
    for piece in pieces:
        loads = piece.fields.shape[1]
        total = totals.setdefault(piece.material, np.zeros((nodes, 2 * loads * 9)))
        volume = volumes.setdefault(piece.material, np.zeros(nodes))
        volumes_of_cells = piece.weights.sum(axis=1)
        fit = np.linalg.pinv(piece.functions)
        cells, points_per_cell = piece.weights.shape
        by_cell = piece.fields.transpose(2, 3, 0, 1, 4, 5).reshape(cells, points_per_cell, -1)
        recovered = (fit @ by_cell) * volumes_of_cells[:, None, None]  # at each cell's corners
        count = piece.corners.size
        entries = (np.ones(count), (piece.corners.ravel(), np.arange(count)))
        total += coo_array(entries, shape=(nodes, count)).tocsr() @ recovered.reshape(
            piece.corners.size, -1
        )
        volume += np.bincount(
            piece.corners.ravel(),
            np.repeat(volumes_of_cells, piece.corners.shape[1]),
            minlength=nodes,
        )
    smooth = {
        material: (
            total / np.where(volumes[material] > 0, volumes[material], 1.0)[:, None]
        ).reshape(nodes, 2, -1, 3, 3)
        for material, total in totals.items()
    }
    errors = [_energy(piece, smooth[piece.material]) for piece in pieces]
    total = np.sum([energy for energy, _ in errors], axis=0)
    return RecoveredError(
        0.5 * (total + total.T),
        np.concatenate([cells for _, cells in errors], axis=1),
        *_centres_and_diameters(points, [piece.corners for piece in pieces]),
    )


def _centres_and_diameters(points: Array, blocks: list[Array]) -> tuple[Array, Array]:
    """Return the centres and the largest distances between corners of cells, by their corners."""
    cells = [points[corners] for corners in blocks]
    spans = [np.linalg.norm(cell[:, :, None] - cell[:, None], axis=-1) for cell in cells]
    centres = np.concatenate([cell.mean(axis=1) for cell in cells])
    return centres, np.concatenate([distances.max(axis=(1, 2)) for distances in spans])


def _pieces(solver: Solver) -> Iterator[_Piece]:
    """Yield the cells of each kind and material with the fields of unit loads."""
    component, body = solver.component, solver.body
    unit = solver.linear.fields
    sorts = zip(body.parts, body.cells, body.blocks, solver.volumes, strict=True)
    for part, nodes, block, (numbers, _) in sorts:
        weights = part.gradients.weights
        moved = np.moveaxis(gather(unit, nodes), -1, 0)
        slopes = moved[:, :, None] @ part.gradients.slopes.swapaxes(2, 3)
        strains = 0.5 * (slopes + slopes.swapaxes(-1, -2))
        fields = np.stack([strains, part.small_stresses(moved)])
        functions = _corner_functions(block.kind, component.analysis.integration)
        corners = block.nodes[:, : functions.shape[1]]
        for material in np.unique(numbers).tolist():
            chosen = numbers == material
            yield _Piece(
                fields[:, :, chosen],
                weights[chosen],
                corners[chosen],
                functions,
                material,
                part.projected,
            )


@cache
def _corner_functions(kind: str, integration: str) -> Array:
    """Return the linear shape functions of a cell's corners at its points, (points, corners)."""
    points = reference_element(kind, integration).values @ node_coordinates(kind)
    functions = tabulate(_FIRST_ORDER[kind[:3]], points)[0]
    assert functions.shape[1] == int(np.max(EDGES[kind])) + 1
    return functions


def _energy(piece: _Piece, smooth: Array) -> tuple[Array, Array]:
    """Return twice the energies (loads, loads) of the fields' differences, and (loads, cells)."""
    cells, corners = piece.corners.shape
    loads = piece.fields.shape[1]
    recovered = piece.functions @ smooth[piece.corners].reshape(cells, corners, -1)
    recovered = recovered.reshape(cells, -1, 2, loads, 3, 3).transpose(2, 3, 0, 1, 4, 5)
    strain, stress = recovered - piece.fields
    if piece.projected:
        strain, stress = _deviatoric(strain), _deviatoric(stress)
    strain = strain * piece.weights[:, :, None, None]
    total = strain.reshape(loads, -1) @ stress.reshape(loads, -1).T
    return total, np.einsum("lcqij,lcqij->lc", strain, stress)


def _deviatoric(tensor: Array) -> Array:
    mean = np.trace(tensor, axis1=-2, axis2=-1) / 3.0
    return tensor - mean[..., None, None] * np.eye(3)
