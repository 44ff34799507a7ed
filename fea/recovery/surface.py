"""The outer surface of a mesh as triangles, for pictures and simulators."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wrenchbook.fea.mesh.facets import outer_surface
from wrenchbook.fea.mesh.mesh import Mesh

Array = np.ndarray

MOST_VERTICES = 40_000
"""Vertices kept of a surface: a row's field then takes some 2 MB, and JSON of it some 10 MB."""

# Facets as seen from outside; quadratic ones are split through their midside nodes.
_TRIANGLES: dict[str, tuple[tuple[int, int, int], ...]] = {
    "tri3": ((0, 1, 2),),
    "quad4": ((0, 1, 2), (0, 2, 3)),
    "tri6": ((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)),
    "quad8": ((0, 4, 7), (4, 1, 5), (5, 2, 6), (6, 3, 7), (4, 5, 7), (5, 6, 7)),
    "quad9": (
        *((0, 4, 8), (4, 1, 8), (1, 5, 8), (5, 2, 8)),
        *((2, 6, 8), (6, 3, 8), (3, 7, 8), (7, 0, 8)),
    ),
}


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles between some of a mesh's nodes; all are indices.

    Attributes
    ----------
    nodes
        Shape (v,), int64: which node of the mesh each vertex is.
    triangles
        Shape (t, 3), int32: vertices, anticlockwise seen from outside.
    whole
        How many nodes the outer surface has; more than the vertices if it was simplified.
    """

    nodes: Array
    triangles: Array
    whole: int


def surface_of(mesh: Mesh, most: int = MOST_VERTICES) -> Surface:
    """Return the outer surface, simplified if it has more than `most` vertices.

    A simplified surface has fewer vertices, each a node of the mesh where it was, so that its
    displacement is the solver's; triangles that fall together are left out.
    """
    blocks = outer_surface(mesh.blocks).blocks
    triangles = np.concatenate(
        [facets[:, _TRIANGLES[kind]].reshape(-1, 3) for kind, facets in blocks]
    )
    nodes, flat = np.unique(triangles, return_inverse=True)
    triangles, whole = flat.reshape(-1, 3), len(nodes)
    if whole > most:
        # Merge the vertices in each box of a grid into the first of them: vertex clustering
        # (Rossignac and Borrel 1993), of the finest grid that leaves `most`.
        points = mesh.points[nodes]
        span = np.ptp(points, axis=0).max()
        few, many = 1, int(np.sqrt(most)) * 8  # boxes along the longest side
        while few + 1 < many:
            middle = (few + many) // 2
            taken = np.unique(_boxes(points, span / middle), axis=0)
            few, many = (middle, many) if len(taken) <= most else (few, middle)
        _, first, box = np.unique(
            _boxes(points, span / few), axis=0, return_index=True, return_inverse=True
        )
        merged = box.ravel()[triangles]
        corners = np.sort(merged, axis=1)
        flat = (corners[:, 0] == corners[:, 1]) | (corners[:, 1] == corners[:, 2])
        _, once = np.unique(corners, axis=0, return_index=True)
        kept = np.intersect1d(once, np.flatnonzero(~flat))
        used, renumbered = np.unique(merged[kept], return_inverse=True)
        kept, triangles = first[used], renumbered.reshape(-1, 3)
        nodes = nodes[kept]
    return Surface(nodes, triangles.astype(np.int32), whole)


def _boxes(points: Array, size: float) -> Array:
    extent = np.ptp(points, axis=0)
    sizes = np.where(extent > 0, np.minimum(size, 0.75 * extent), size)  # a plate keeps both faces
    return np.floor((points - points.min(axis=0)) / sizes).astype(np.int64)
