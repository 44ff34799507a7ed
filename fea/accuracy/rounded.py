"""Effect of straight edges across a round surface: the same cells, their edges bent.

Midside nodes that a first-order mesh is given, here or by another program, lie in the middle of
straight edges. Where the facets of the surface turn little from one to the next they approximate a
round one, whose normal at a corner is about the mean of the facets' there. An edge of length L
between corners with normals m and n then bows out by L/8 (n - m) . d, d the edge's direction: the
sagitta of a circle to the third order of the turn (Nagata 2005, "Simple local interpolation of
surfaces using normal vectors").
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.mesh.facets import corners_of, outer_surface
from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.solve import Solver

Array = np.ndarray

SMOOTH = np.radians(40.0)
"""Turn between neighbouring facets from which an edge is one of the part; nine cells round a hole
turn by 40 degrees each."""

STRAIGHT = 1e-3
"""Of an edge's length: a midside node nearer to its middle has been put there, in files with few
digits too; across a round surface that turns by 0.5 degrees it bows out by as much."""

_PARTS = (1.0, 0.5, 0.25, 0.125)
"""Of the bow, in turn: in flat cells the whole one can turn a cell inside out, and the compliance
changes in proportion."""


class Roundness(NamedTuple):
    """Effect of bending the edges."""

    # Shape (6 i, k): the compliance with straight edges, less that with bent ones, in its units
    change: Array
    turn: float  # the largest turn from facet to facet that was taken for a round surface, rad


def roundness(solver: Solver) -> Roundness | None:
    """Return the effect of straight edges across round surfaces; None if there are none.

    It costs a linear solve. Of mesh files alone: other meshes are made on their geometry.

    Raises SolveFailed if the bent cells cannot be solved however little they are bent.
    """
    component = solver.component
    source = component.bundle and component.bundle.mesh
    if not source or source.file is None or source.geometry is not None:
        return None
    bows, turn = bows_of(component.mesh)
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
        return Roundness((solver.linear.compliance - curved) / part, turn)
    raise AssertionError("the last part raises")


def bows_of(mesh: Mesh) -> tuple[Array, float]:
    """Return how far each node moves to the round surface, (n, 3), m, and the largest turn, rad.

    None moves if any midside node of the surface is off its edge's middle: then they are where the
    geometry has them.
    """
    bows, largest = np.zeros_like(mesh.points), 0.0
    # The surface's facets with midside nodes: corners and those nodes, each (f, 4). A triangle's
    # last corner stands twice, and so it has a side of no length.
    corners, middles = [], []
    for kind, nodes in outer_surface(mesh.blocks).blocks:
        count = corners_of(kind)
        if nodes.shape[1] < 2 * count:
            continue
        places = np.minimum(np.arange(4), count - 1)
        corners.append(nodes[:, places])
        # The side from the last corner to the first is the last; a triangle's third has no length.
        sides = np.array([0, 1, 2, 3] if count == 4 else [0, 1, 1, 2])
        middles.append(nodes[:, count : 2 * count][:, sides])
    empty = np.empty((0, 4), dtype=np.int64)
    corners, middles = np.concatenate([empty, *corners]), np.concatenate([empty, *middles])
    points = mesh.points[corners]
    # The surface's normal at each facet's corners, (f, 4, 3), and the facet's largest turn: the
    # mean of the normals of the facets there that turn little from this one, by their angles there.
    normal = np.cross(points[:, 2] - points[:, 0], points[:, 3] - points[:, 1])
    triangle = corners[:, 2] == corners[:, 3]
    of_triangle = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    normal[triangle] = of_triangle[triangle]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    # The angles of facets at their corners, (f, 4), rad; a repeated corner's is halved.
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
    normals, turn, start = np.empty_like(points), np.zeros(len(corners)), 0
    for end in ends.tolist():
        at, of = facet[start:end], corner[start:end]
        cosines = np.clip(normal[at] @ normal[at].T, -1.0, 1.0)
        near = cosines > np.cos(SMOOTH)
        mean = (near * angles[at, of]) @ normal[at]
        normals[at, of] = mean / np.linalg.norm(mean, axis=1, keepdims=True)
        np.maximum.at(turn, at, np.arccos(np.where(near, cosines, 1.0).min(axis=1)))
        start = end
    for side in range(corners.shape[1]):
        ends = [side, (side + 1) % corners.shape[1]]
        way = points[:, ends[1]] - points[:, ends[0]]
        length = np.linalg.norm(way, axis=1, keepdims=True)
        first, second = normals[:, ends[0]], normals[:, ends[1]]
        rise = np.einsum("fi,fi->f", second - first, way)[:, None] / 8
        outward = first + second
        bow = rise * outward / np.linalg.norm(outward, axis=1, keepdims=True)
        apart = np.linalg.norm(mesh.points[middles[:, side]] - points[:, ends].mean(axis=1), axis=1)
        if (apart > STRAIGHT * length[:, 0]).any():
            return np.zeros_like(bows), 0.0
        size = np.linalg.norm(bow, axis=1)
        curved = np.flatnonzero(size > STRAIGHT * length[:, 0])
        # Of the facets at an edge that which bends it most counts.
        curved = curved[np.argsort(size[curved])]
        nodes = middles[curved, side]
        curved = curved[size[curved] > np.linalg.norm(bows[nodes], axis=1)]
        bows[middles[curved, side]] = bow[curved]
        largest = max(largest, float(turn[curved].max(initial=0.0)))
    return bows, largest
