"""First-order cells, which lock, and their conversion to cells with midside nodes.

Plain first-order cells lock. A cantilever of 10x10x100 mm with 2x2x10 cells bends by 0.69 (hex8),
0.67 (wedge6) and 0.35 (tet4) of the right displacement (Timoshenko); a bonded block of 40x40x10 mm
with nu = 0.49 and 4x4x2 cells deforms by 0.47, 0.47 and 0.43 of it. Such a part looks healthy, so
these cells are refused. With ``order = 2`` under ``[mesh]`` each edge gets a node in its middle:
the cantilever bends by 0.98 or more, the block deforms by 0.95 or more. Edges stay straight: a
curved surface is better meshed in second order by the mesher itself.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from wrenchbook.fea.mesh.dependents import Dependents
from wrenchbook.fea.mesh.facets import EDGES, FaceFinder, corners_of_cell
from wrenchbook.fea.mesh.mesh import CellBlock, FacetGroup, Mesh
from wrenchbook.fea.spec.problems import BundleProblem

SECOND = {"hex8": "hex20", "tet4": "tet10", "wedge6": "wedge15", "pyramid5": "pyramid13"}
"""Each kind of first-order cell, and the kind with midside nodes that replaces it."""

FIRST = {second: first for first, second in SECOND.items()} | {"hex27": "hex8"}
"""Each kind of second-order cell, and the first-order kind with the same corners."""


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
    edges, middles = _first_order_edges(mesh)
    new = middles < 0
    points = np.concatenate([mesh.points, 0.5 * mesh.points[edges[new]].sum(axis=1)])
    middles[new] = len(mesh.points) + np.arange(int(new.sum()))

    blocks = list(mesh.blocks)
    for i, block in enumerate(blocks):
        if block.kind in SECOND:
            ends = np.sort(block.nodes[:, EDGES[block.kind]].reshape(-1, 2), axis=1)
            added = middles[_find(edges, ends)[0]].reshape(len(block), -1)
            blocks[i] = CellBlock(SECOND[block.kind], np.hstack([block.nodes, added]))

    finder = FaceFinder(tuple(blocks))
    facet_groups = {
        name: FacetGroup(tuple(face for facets in group.blocks for face in finder.find(*facets)[0]))
        for name, group in mesh.facet_groups.items()
    }
    node_groups = {
        name: np.unique(np.concatenate([ids, middles[np.isin(edges, ids).all(axis=1)]]))
        for name, ids in mesh.node_groups.items()
    }
    return replace(
        mesh,
        points=points,
        blocks=tuple(blocks),
        facet_groups=facet_groups,
        node_groups=node_groups,
        dependents=mesh.dependents and Dependents.of(len(points), mesh.dependents.entries),
    )


def _first_order_edges(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Return the edges of first-order cells, (e, 2), pairs of nodes in order, each once.

    The second result, (e,), has the midside node that a second-order cell gives an edge, or -1.
    """
    first_order = [np.empty((0, 2), dtype=np.int64)]
    with_middles = [np.empty((0, 3), dtype=np.int64)]
    for block in mesh.blocks:
        ends = np.sort(block.nodes[:, EDGES[block.kind]], axis=2)
        if block.kind in SECOND:
            first_order.append(ends.reshape(-1, 2))
        else:
            corners = corners_of_cell(block.kind)
            middle = block.nodes[:, corners : corners + ends.shape[1], None]
            with_middles.append(np.concatenate([ends, middle], axis=2).reshape(-1, 3))
    edges = np.unique(np.concatenate(first_order), axis=0)
    known = np.concatenate(with_middles)
    index, is_edge = _find(edges, known[:, :2])
    middles = np.full(len(edges), -1, dtype=np.int64)
    middles[index[is_edge]] = known[is_edge, 2]
    return edges, middles


def _find(pairs: np.ndarray, queries: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of `queries` among sorted unique `pairs`, and whether each is there."""
    if not len(pairs):
        return np.zeros(len(queries), dtype=np.int64), np.zeros(len(queries), dtype=bool)
    base = max(int(pairs.max()), int(queries.max(initial=0))) + 1
    keys, query_keys = pairs @ [base, 1], queries @ [base, 1]
    index = np.minimum(np.searchsorted(keys, query_keys), len(keys) - 1)
    return index, keys[index] == query_keys
