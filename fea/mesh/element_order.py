"""First-order cells, which lock, and their conversion to cells with midside nodes.

Plain first-order cells lock. A cantilever of 10x10x100 mm with 2x2x10 cells bends by 0.69 (hex8),
0.67 (wedge6) and 0.35 (tet4) of the right displacement (Timoshenko); a bonded block of 40x40x10 mm
with nu = 0.49 and 4x4x2 cells deforms by 0.47, 0.47 and 0.43 of it. Such a part looks healthy, so
these cells are refused. With ``order = 2`` under ``[mesh]`` each edge gets a node in its middle:
the cantilever bends by 0.98 or more, the block deforms by 0.95 or more. Edges stay straight: a
curved surface is better meshed in second order by the mesher itself.
"""

from __future__ import annotations

import numpy as np

from wrenchbook.fea.mesh.dependents import Dependents
from wrenchbook.fea.mesh.facets import EDGES, FaceFinder
from wrenchbook.fea.mesh.mesh import CellBlock, FacetBlock, FacetGroup, Mesh
from wrenchbook.fea.spec.problems import BundleProblem

Array = np.ndarray

SECOND = {"hex8": "hex20", "tet4": "tet10", "wedge6": "wedge15", "pyramid5": "pyramid13"}
"""Each kind of first-order cell, and the kind with midside nodes that replaces it."""


def first_order_problems(mesh: Mesh) -> list[BundleProblem]:
    """Return a problem if there are first-order cells."""
    counts = [f"{len(b)} {b.kind}" for b in mesh.blocks if b.kind in SECOND and len(b)]
    if not counts:
        return []
    message = (
        f"{' and '.join(counts)} cells are of first order, up to several times too stiff in "
        "bending. Mesh in second order (gmsh: Mesh.ElementOrder = 2; Abaqus: C3D20R, C3D10), or "
        "write order = 2 under [mesh], for straight edges"
    )
    return [BundleProblem("mesh", message)]


def second_order(mesh: Mesh) -> Mesh:
    """Return the mesh with a node in the middle of each edge of its first-order cells.

    Cells of second order stay as they are, and an edge that they share keeps its node. A facet
    group gets the faces of the new cells, a node group the nodes of edges whose ends are both in
    it.
    """
    # The edges of the first-order cells as sorted pairs, and their middle nodes or -1.
    unknown = [np.empty((0, 2), dtype=np.int64)]
    known = [np.empty((0, 3), dtype=np.int64)]
    for block in mesh.blocks:
        edges = block.nodes[:, EDGES[block.kind]]
        if block.kind in SECOND:
            unknown.append(np.sort(edges.reshape(-1, 2), axis=1))
        else:
            corners = int(np.max(EDGES[block.kind])) + 1
            middle = block.nodes[:, corners : corners + edges.shape[1], None]
            ends = np.sort(edges, axis=2)
            known.append(np.concatenate([ends, middle], axis=2).reshape(-1, 3))
    pairs = np.unique(np.concatenate(unknown), axis=0)
    middles = np.full(len(pairs), -1, dtype=np.int64)
    there = np.concatenate(known)
    index, is_known = _find(pairs, there[:, :2])
    middles[index[is_known]] = there[is_known, 2]
    new = middles < 0
    points = np.concatenate([mesh.points, 0.5 * mesh.points[pairs[new]].sum(axis=1)])
    middles[new] = len(mesh.points) + np.arange(int(new.sum()))
    raised = list(mesh.blocks)
    for i, block in enumerate(mesh.blocks):
        if block.kind in SECOND:
            edges = np.sort(block.nodes[:, EDGES[block.kind]].reshape(-1, 2), axis=1)
            added = middles[_find(pairs, edges)[0]].reshape(len(block), -1)
            raised[i] = CellBlock(SECOND[block.kind], np.hstack([block.nodes, added]))
    blocks = tuple(raised)
    finder = FaceFinder(blocks)
    groups = {}
    for name, group in mesh.facet_groups.items():
        faces = [face for kind, nodes in group.blocks for face in finder.find(kind, nodes)[0]]
        groups[name] = FacetGroup(tuple(FacetBlock(kind, nodes) for kind, nodes in faces))
    return Mesh(
        points,
        blocks,
        mesh.regions,
        groups,
        {
            name: np.unique(np.concatenate([ids, middles[np.isin(pairs, ids).all(axis=1)]]))
            for name, ids in mesh.node_groups.items()
        },
        mesh.deck,
        mesh.dependents and Dependents.of(len(points), mesh.dependents.entries),
        mesh.node_weights,
    )


def _find(pairs: Array, queries: Array) -> tuple[Array, Array]:
    """Return the indices of `queries` among sorted unique `pairs`, and whether each is there."""
    if not len(pairs):
        return np.zeros(len(queries), dtype=np.int64), np.zeros(len(queries), dtype=bool)
    base = max(int(pairs.max()), int(queries.max(initial=0))) + 1
    keys, query_keys = pairs @ [base, 1], queries @ [base, 1]
    index = np.minimum(np.searchsorted(keys, query_keys), len(keys) - 1)
    return index, keys[index] == query_keys
