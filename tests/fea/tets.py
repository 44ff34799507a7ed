"""Hexahedra cut into tetrahedra, so that one component can be solved with both."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.validation.clamped import attached
from wrenchbook.fea.coupling.section import section_of_facets
from wrenchbook.fea.mesh.mesh import CellBlock, FacetBlock, FacetGroup, Mesh

# The faces of a hexahedron by its corners, counter-clockwise seen from within it.
_FACES = [(0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)]
_EDGES = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]


def in_tets(part):
    """Return a component of hex20 cells with each cut into twelve straight tet10.

    Each face is cut through its lowest node, so that neighbours agree, and joined to a new node in
    the middle of the cell. Facet groups are cut with the cells.
    """
    (block,) = part.mesh.blocks
    corners = block.nodes[:, :8]
    middles = len(part.mesh.points) + np.arange(len(corners))
    points = np.vstack([part.mesh.points, part.mesh.points[corners].mean(axis=1)])
    tets = np.concatenate(
        [np.column_stack([_cut(corners[:, face]), np.repeat(middles, 2)]) for face in _FACES]
    )
    ends = np.sort(tets[:, _EDGES].reshape(-1, 2), axis=1)
    pairs, number = np.unique(ends, axis=0, return_inverse=True)
    between = points[pairs].mean(axis=1)
    cells = np.hstack([tets, len(points) + number.reshape(-1, 6)])
    lookup = {tuple(pair): len(points) + i for i, pair in enumerate(pairs.tolist())}
    groups = {name: _facets(group, lookup) for name, group in part.mesh.facet_groups.items()}
    return _rebuilt(part, np.vstack([points, between]), cells, groups)


def _cut(faces):
    """Cut quadrilaterals (n, 4) through their lowest corner into triangles (2 n, 3)."""
    first = faces.argmin(axis=1)
    order = (first[:, None] + np.arange(4)) % 4
    turned = np.take_along_axis(faces, order, axis=1)
    return turned[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)


def _facets(group, lookup):
    (facets,) = group.blocks
    triangles = _cut(facets.nodes[:, :4])
    sides = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1), axis=-1)
    middles = [[lookup[tuple(side)] for side in three] for three in sides.tolist()]
    return FacetGroup((FacetBlock("tri6", np.hstack([triangles, middles])),))


def _rebuilt(part, points, cells, groups):
    used, numbered = np.unique(cells, return_inverse=True)
    renumber = np.full(len(points), -1)
    renumber[used] = np.arange(len(used))
    own = {
        name: FacetGroup((FacetBlock("tri6", renumber[group.blocks[0].nodes]),))
        for name, group in groups.items()
    }
    mesh = Mesh(points[used], (CellBlock("tet10", numbered.reshape(cells.shape)),), {}, own)
    bundle = part.bundle
    moved = replace(
        part,
        mesh=mesh,
        material_of_cells=(np.zeros(len(cells), dtype=int),),
        fixed_nodes=own[bundle.supports.fixed[0]].node_ids,
    )
    return attached(moved, section=section_of_facets(mesh.points, own[bundle.interface.section]))
