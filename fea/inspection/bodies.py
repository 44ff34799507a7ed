"""The rigid bodies a mesh falls into, and the nodes that only look joined."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from wrenchbook.fea.inspection.cells import edge_lengths
from wrenchbook.fea.mesh.facets import FACES, corners_of, outer_surface
from wrenchbook.fea.mesh.mesh import Mesh

Array = np.ndarray

_SAME_PLACE = 1e-2
"""Fraction of the shortest edge within which two nodes count as in one place."""

_OPPOSITE = np.array([(0, 1), (2, 4), (3, 5)])
"""Opposite faces of a hexahedron, in the order of `fea.mesh.facets.FACES`."""


@dataclass(frozen=True, eq=False)
class Bodies:
    """Cells that hang together by whole faces."""

    count: int  # how many bodies there are; numbered from the one with the most cells
    cells: Array  # number of cells of each, shape (count,), int64, dimensionless
    nodes: list[Array]  # the nodes of each, shape (k,), int64: indices, ascending


def bodies_of(mesh: Mesh) -> Bodies:
    """Group the cells that share faces; cells that share only an edge or a point do not join."""
    faces, owners = _faces(mesh)
    total = sum(len(block) for block in mesh.blocks)
    size = total + int(faces.max(initial=-1)) + 1
    graph = coo_array((np.ones(len(faces), dtype=np.int8), (owners, total + faces)), (size, size))
    count, label = connected_components(graph, directed=False)
    label = label[:total]
    sizes = np.bincount(label, minlength=count)
    order = np.argsort(-sizes, kind="stable")
    rank = np.empty(count, dtype=np.int64)
    rank[order] = np.arange(count)
    number = rank[label]
    pairs, first = [], 0
    for block in mesh.blocks:
        bodies = np.repeat(number[first : first + len(block)], block.nodes.shape[1])
        pairs.append(np.column_stack([bodies, block.nodes.ravel()]))
        first += len(block)
    both = np.unique(np.concatenate(pairs), axis=0)
    cuts = np.searchsorted(both[:, 0], np.arange(1, count))
    return Bodies(count, sizes[order], np.split(both[:, 1], cuts))


def _faces(mesh: Mesh) -> tuple[Array, Array]:
    """Return a number for each face of each cell, equal where its corners are, and the cell."""
    corners, owners, first = [], [], 0
    for block in mesh.blocks:
        for face in FACES[block.kind]:
            several = corners_of("tri" if len(face) in (3, 6) else "quad")
            row = np.full((len(block), 4), -1)
            row[:, :several] = block.nodes[:, face[:several]]
            corners.append(np.sort(row, axis=1))
            owners.append(first + np.arange(len(block)))
        first += len(block)
    _, number = np.unique(np.concatenate(corners), axis=0, return_inverse=True)
    return number.ravel(), np.concatenate(owners)


def stacked_singly(mesh: Mesh) -> Array:
    """Return the middles of hex20 cells that follow each other with none at their sides.

    Shape (k, 3), m: two or more in a row, each joined to others along one direction only.
    """
    number, _ = _faces(mesh)
    shared = np.bincount(number)[number] > 1
    first, alone, own, middles = 0, np.zeros(len(number), dtype=bool), [], []
    for block in mesh.blocks:
        faces = slice(first, first + len(FACES[block.kind]) * len(block))
        first = faces.stop
        if block.kind == "hex20":
            joined = shared[faces].reshape(-1, len(block))[_OPPOSITE].any(axis=1)
            single = joined.sum(axis=0) <= 1
            alone[faces] = np.tile(single, len(FACES[block.kind]))
            own.append(number[faces].reshape(-1, len(block))[:, single])
            middles.append(mesh.points[block.nodes[single]].mean(axis=1))
    if not own:
        return np.empty((0, 3))
    times = np.bincount(number[alone], minlength=int(number.max()) + 1)
    return np.concatenate(middles)[(times[np.hstack(own)] > 1).any(axis=0)]


def coincident_nodes(mesh: Mesh) -> Array:
    """Return pairs of surface nodes in one place: joined to the eye only.

    Shape (k, 2), int64: indices of nodes.
    """
    surface = outer_surface(mesh.blocks).node_ids
    shortest = min(float(edge_lengths(mesh.points, b).min()) for b in mesh.blocks if len(b))
    tree = KDTree(mesh.points[surface])
    pairs = tree.query_pairs(_SAME_PLACE * shortest, output_type="ndarray")
    return np.sort(surface[pairs], axis=1) if len(pairs) else np.empty((0, 2), dtype=np.int64)


def gap(mesh: Mesh, nodes: Array, others: Array) -> float:
    """Return the least distance, m, between two sets of nodes, each of shape (k,), int64."""
    tree = KDTree(mesh.points[nodes])
    return float(tree.query(mesh.points[others])[0].min())
