"""Boxes of any cell kind, for tests: every node of every kind is a point of one doubled grid."""

from __future__ import annotations

import numpy as np

from wrenchbook.fea.mesh.mesh import CellBlock, FacetBlock, FacetGroup, Mesh
from wrenchbook.fea.mesh.reference_cell import node_coordinates, tabulate

# Nodes of a pyramid as in a mirror that swaps its first two axes.
_MIRRORED = [0, 3, 2, 1, 4, 8, 7, 6, 5, 9, 12, 11, 10]

# Corner cells as doubled reference places: a cube cut into six tetrahedra or two wedges.
_KUHN = [(0, 1, 2), (1, 2, 0), (2, 0, 1), (1, 0, 2), (0, 2, 1), (2, 1, 0)]


def box(kind="hex20", divisions=(2, 2, 2), lengths=(1.0, 1.0, 1.0), warp=None, corners_only=False):
    """Mesh a box with its corner at the origin; `warp` maps points (n, 3) to points (n, 3).

    With `corners_only` only the corners are warped and the other nodes put midway.
    Facet groups: x0, x1, y0, y1, z0, z1.
    """
    divisions = np.asarray(divisions)
    shape = 2 * divisions + 1
    cells, facets = _cells(kind, divisions, shape)
    used, cells_flat = np.unique(cells, return_inverse=True)
    grid = np.stack(np.unravel_index(used, shape), axis=1)
    points = grid / (2 * divisions) * np.asarray(lengths, dtype=float)
    renumber = np.full(shape.prod(), -1)
    renumber[used] = np.arange(used.size)
    groups = {}
    for name, (facet_kind, nodes) in facets(grid, renumber).items():
        groups[name] = FacetGroup((FacetBlock(facet_kind, nodes),))
    if warp is not None:
        points = warp(points)
    block = CellBlock(kind, cells_flat.reshape(cells.shape))
    if corners_only:
        points = _straighten(points, block)
    return Mesh(points, (block,), {"all": (np.arange(len(cells)),)}, groups, {})


def _straighten(points, block):
    corner_kind = {"hex": "hex8", "tet": "tet4", "wed": "wedge6", "pyr": "pyramid5"}[block.kind[:3]]
    values, _ = tabulate(corner_kind, node_coordinates(block.kind))
    corners = points[block.nodes[:, : values.shape[1]]]
    points = points.copy()
    points[block.nodes] = values @ corners
    return points


def _cells(kind, divisions, shape):
    corners = np.stack(np.meshgrid(*[2 * np.arange(n) for n in divisions], indexing="ij"), -1)
    corners = corners.reshape(-1, 3)
    places = np.concatenate(_local(kind)).reshape(-1, len(node_coordinates(kind)), 3)
    places = np.broadcast_to(places, (len(corners), *places.shape))
    if kind.startswith("pyramid"):  # every second cube as in a mirror, so that neighbours meet
        odd = corners // 2 % 2 == 1
        places = np.where(odd[:, None, None], 2 - places, places)
        turned = odd.sum(axis=1) % 2 == 1
        places[turned] = places[turned][:, :, _MIRRORED[: places.shape[2]]]
    nodes = (corners[:, None, None] + places).reshape(-1, places.shape[2], 3)
    ids = np.ravel_multi_index(tuple(np.moveaxis(nodes, -1, 0)), shape)
    return ids, lambda grid, renumber: _facets(kind, divisions, shape, grid, renumber, ids)


def _local(kind):
    """Node places of the cells within one doubled cube, each (nodes, 3) of 0, 1, 2."""
    places = 2 * node_coordinates(kind)
    if kind.startswith("hex"):
        return [places.astype(int)]
    cut = []
    if kind.startswith("pyramid"):  # their apex in one corner, their bases on the other sides
        base = np.array([[2, 0, 0], [0, 0, 2], [0, 2, 0], [-2, 0, 0]])
        local = base[0] + places @ base[1:] / 2
        return [np.roll(local, i, axis=1).astype(int) for i in range(3)]
    if kind.startswith("wedge"):
        for a, b in (((1, 0), (1, 1)), ((1, 1), (0, 1))):
            triangle = np.array([[*a, 0], [*b, 0], [0, 0, 1]])
            cut.append((places @ triangle).astype(int))
        return cut
    for order in _KUHN:
        steps = np.cumsum(np.eye(3, dtype=int)[list(order)], axis=0)
        if np.linalg.det(steps) < 0:
            steps = steps[[0, 2, 1]] if np.linalg.det(steps[[0, 2, 1]]) > 0 else steps
        cut.append((places @ steps).astype(int))
    return cut


def _facets(kind, divisions, shape, grid, renumber, ids):
    """Collect the outer facets by the cells' nodes that lie on each side of the box."""
    groups = {}
    top = shape - 1
    where = np.full((shape.prod(), 3), -1)
    where[renumber >= 0] = grid
    for axis in range(3):
        for end, limit in ((0, 0), (1, top[axis])):
            on_side = where[ids][:, :, axis] == limit
            count = on_side.sum(axis=1)
            facet_kind, size = _facet_kind(kind, count.max())
            rows = [
                _ordered(ids[c][on_side[c]], where, axis, facet_kind)
                for c in np.flatnonzero(count == size)
            ]
            groups[f"{'xyz'[axis]}{end}"] = (facet_kind, renumber[np.array(rows)])
    return groups


def _facet_kind(kind, count):
    if kind.startswith("tet"):
        return ("tri3", 3) if kind == "tet4" else ("tri6", 6)
    if kind.startswith(("wedge", "pyramid")):
        names = {3: "tri3", 4: "quad4", 6: "tri6", 8: "quad8"}
        return names[int(count)], int(count)
    return {"hex8": ("quad4", 4), "hex20": ("quad8", 8), "hex27": ("quad9", 9)}[kind]


def _ordered(nodes, where, axis, facet_kind):
    """Put the nodes of one facet in VTK order by matching the flat places of its kind."""
    flat = np.delete(where[nodes], axis, axis=1).astype(float)
    places = node_coordinates(facet_kind)
    if facet_kind.startswith("quad"):
        low = flat.min(axis=0)
        target = low + 2 * places
    else:
        corners = flat[np.all(flat % 2 == 0, axis=1)]
        target = (
            corners[0]
            + places[:, :1] * (corners[1] - corners[0])
            + places[:, 1:2] * (corners[2] - corners[0])
        )
    return nodes[[int(np.abs(flat - t).sum(axis=1).argmin()) for t in target]]
