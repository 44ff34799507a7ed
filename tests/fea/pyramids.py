"""A box of hexahedra, pyramids and tetrahedra that meet face to face, for tests."""

import numpy as np

from tests.fea.boxes import box
from wrenchbook.fea.mesh.element_order import second_order
from wrenchbook.fea.mesh.facets import FACES, facets_within, outer_surface
from wrenchbook.fea.mesh.mesh import CellBlock, Mesh


def mixed(divisions=(3, 3, 3), lengths=(1.0, 1.0, 1.0), warp=None, order=2):
    """Mesh a box; every second hexahedron is six pyramids, of which outer ones are tetrahedra."""
    mesh = box("hex8", divisions, lengths, warp)
    cells = mesh.blocks[0].nodes
    split = np.indices(divisions).sum(axis=0).ravel() % 2 == 0
    faces = np.sort(cells[:, FACES["hex8"]].reshape(-1, 4), axis=1)
    _, number, times = np.unique(faces, axis=0, return_inverse=True, return_counts=True)
    outer = (times[number.ravel()] == 1).reshape(-1, 6)
    points, pyramids, tets = [*mesh.points], [], []
    for cell, sides in zip(cells[split], outer[split], strict=True):
        points.append(mesh.points[cell].mean(axis=0))
        for face, alone in zip(FACES["hex8"], sides, strict=True):
            a, b, c, d = cell[[*face[::-1]]]
            apex = len(points) - 1
            tets += [[a, b, c, apex], [a, c, d, apex]] if alone else []
            pyramids += [] if alone else [[a, b, c, d, apex]]
    kinds = ("hex8", cells[~split]), ("pyramid5", np.array(pyramids)), ("tet4", np.array(tets))
    blocks = tuple(CellBlock(*each) for each in kinds)
    ends = {f"x{i}": np.flatnonzero(mesh.points[:, 0] == i * lengths[0]) for i in (0, 1)}
    groups = {name: facets_within(outer_surface(blocks), ids) for name, ids in ends.items()}
    both = Mesh(np.array(points), blocks, facet_groups=groups)
    return second_order(both) if order == 2 else both
