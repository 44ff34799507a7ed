"""Bodies of a mesh, connected by faces; stacks of single cells, and coincident nodes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from wrenchbook.fea.mesh.facets import FACES, outer_surface
from wrenchbook.fea.mesh.mesh import Mesh, row_numbers
from wrenchbook.fea.mesh.quality import edge_lengths
from wrenchbook.fea.mesh.surface import connected

_COINCIDENT = 1e-2
"""Fraction of the shortest edge within which two nodes count as coincident."""

_OPPOSITE = np.array([(0, 1), (2, 4), (3, 5)])
"""Opposite faces of a hexahedron, in the order of `fea.mesh.facets.FACES`."""


@dataclass(frozen=True, eq=False)
class Bodies:
    """Groups of cells that are connected by faces."""

    count: int  # number of bodies; numbered from the body with the most cells
    cells: np.ndarray  # number of cells of each body, shape (count,), int64
    nodes: list[np.ndarray]  # the nodes of each body, shape (k,), int64: indices, ascending


def bodies_of(mesh: Mesh) -> Bodies:
    """Group the cells that share faces; cells that share only an edge or a point do not join."""
    # A graph of cells, then faces, with an edge from each cell to each of its faces.
    faces, owners = _faces(mesh)
    total = sum(len(block) for block in mesh.blocks)
    size = total + int(faces.max(initial=-1)) + 1
    label = connected(owners, total + faces, size)[:total]
    count = int(label.max(initial=-1)) + 1

    # Number bodies from the one with the most cells.
    sizes = np.bincount(label, minlength=count)
    order = np.argsort(-sizes, kind="stable")
    rank = np.empty(count, dtype=np.int64)
    rank[order] = np.arange(count)
    number = rank[label]

    # The nodes of each body: pairs of body and node as one number, body * nodes + node.
    pairs = []
    first = 0
    for block in mesh.blocks:
        bodies = np.repeat(number[first : first + len(block)], block.nodes.shape[1])
        pairs.append(bodies * len(mesh.points) + block.nodes.ravel())
        first += len(block)
    bodies, nodes = np.divmod(np.unique(np.concatenate(pairs)), len(mesh.points))
    cuts = np.searchsorted(bodies, np.arange(1, count))
    return Bodies(count, sizes[order], np.split(nodes, cuts))


def _faces(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Return a face number for each face of each cell, equal for equal corners, and the cell."""
    corners = []
    owners = []
    first = 0
    for block in mesh.blocks:
        for face in FACES[block.kind]:
            several = 3 if len(face) in (3, 6) else 4
            row = np.full((len(block), 4), -1)
            row[:, :several] = block.nodes[:, face[:several]]
            corners.append(np.sort(row, axis=1))
            owners.append(first + np.arange(len(block)))
        first += len(block)
    return row_numbers(np.concatenate(corners)), np.concatenate(owners)


def stacked_singly(mesh: Mesh) -> np.ndarray:
    """Return the middles of hex20 cells that are stacked singly, without cells at their sides.

    Shape (k, 3), m. Two or more cells in a row, each joined to others along one direction only, are
    a stack.
    """
    if all(block.kind != "hex20" for block in mesh.blocks):
        return np.empty((0, 3))
    number, _ = _faces(mesh)
    is_shared = np.bincount(number)[number] > 1
    # Cells that are joined to others along one direction at most: their faces, (6, k), and middles.
    first = 0
    single_faces = []
    middles = []
    for block in mesh.blocks:
        faces = slice(first, first + len(FACES[block.kind]) * len(block))
        first = faces.stop
        if block.kind == "hex20":
            joined = is_shared[faces].reshape(-1, len(block))[_OPPOSITE].any(axis=1)
            single = joined.sum(axis=0) <= 1
            single_faces.append(number[faces].reshape(-1, len(block))[:, single])
            middles.append(mesh.points[block.nodes[single]].mean(axis=1))
    # Of these, cells that share a face with another of them.
    faces_of_single = np.hstack(single_faces)
    times = np.bincount(faces_of_single.ravel(), minlength=int(number.max()) + 1)
    return np.concatenate(middles)[(times[faces_of_single] > 1).any(axis=0)]


def coincident_nodes(mesh: Mesh) -> np.ndarray:
    """Return pairs of coincident surface nodes that share no unknowns and do not depend on others.

    Shape (k, 2), int64: indices of nodes.
    """
    surface = outer_surface(mesh.blocks).node_ids
    shortest = min(float(edge_lengths(mesh.points, b).min()) for b in mesh.blocks if len(b))
    tree = KDTree(mesh.points[surface])
    pairs = tree.query_pairs(_COINCIDENT * shortest, output_type="ndarray")
    pairs = np.sort(surface[pairs], axis=1) if len(pairs) else np.empty((0, 2), dtype=np.int64)
    return pairs if mesh.dependents is None else pairs[~mesh.dependents.among(pairs)]


def gap(mesh: Mesh, nodes: np.ndarray, others: np.ndarray) -> float:
    """Return the least distance, m, between two sets of nodes, each of shape (k,), int64."""
    tree = KDTree(mesh.points[nodes])
    return float(tree.query(mesh.points[others])[0].min())
