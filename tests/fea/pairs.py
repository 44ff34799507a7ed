"""Blocks on each other that are meshed apart, and components of them whose faces are tied."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.fea.boxes import box
from tests.fea.supports import TABLE
from wrenchbook.fea.bundle.read import bundle_of
from wrenchbook.fea.component import build
from wrenchbook.fea.mesh.mesh import CellBlock, FacetBlock, FacetGroup, Mesh

TIE = {"secondary": "b_z0", "main": "a_z1"}
LARGE, SMALL = (1.0, 1.0, 2.0), (0.6, 0.8, 2.0)
STEEL = {"region": "all", "youngs_modulus": 1e9, "poisson_ratio": 0.3, "density": 1e3}


def together(*meshes):
    """Return meshes as one, with the facet groups a_x0, ... of the first, b_x0, ..., c_x0, ..."""
    blocks, groups, first = [], {}, 0
    for letter, mesh in zip("abc", meshes, strict=False):
        blocks += [CellBlock(block.kind, block.nodes + first) for block in mesh.blocks]
        for name, group in mesh.facet_groups.items():
            facets = tuple(FacetBlock(kind, nodes + first) for kind, nodes in group.blocks)
            groups[f"{letter}_{name}"] = FacetGroup(facets)
        first += len(mesh.points)
    return Mesh(np.concatenate([mesh.points for mesh in meshes]), tuple(blocks), {}, groups)


def merged(mesh):
    """Return a mesh whose coincident nodes are one each."""
    points = mesh.points.round(9)
    _, first, number = np.unique(points, axis=0, return_index=True, return_inverse=True)
    number = number.ravel()
    groups = {
        name: FacetGroup(tuple(FacetBlock(kind, number[nodes]) for kind, nodes in group.blocks))
        for name, group in mesh.facet_groups.items()
    }
    blocks = tuple(CellBlock(block.kind, number[block.nodes]) for block in mesh.blocks)
    return Mesh(mesh.points[first], blocks, {}, groups)


def moved(mesh, shift):
    return replace(mesh, points=mesh.points + np.array(shift))


def pair(kinds=("hex20", "hex20"), gap=0.0, counts=((2, 3, 3), (3, 2, 3)), sizes=(LARGE, SMALL)):
    """Return a large block "a" with a small block "b" on it, in the middle of its top."""
    low, high = (box(*each) for each in zip(kinds, counts, sizes, strict=True))
    return together(low, moved(high, [*(np.subtract(*sizes)[:2] / 2), sizes[0][2] + gap]))


def tied(mesh, *ties, fixed="a_z0", section="b_z1", **tables):
    """Return a component, of `TABLE` but for some tables, with a rigid interface."""
    table = TABLE | {
        "material": [STEEL],
        "supports": {"fixed": [fixed]},
        "interface": {"section": section, "coupling": "rigid"},
        "range": {"force": [2e5, 3e5, 2e6], "moment": [2e5, 3e5, 2e5]},
    }
    return build(bundle_of(table | ({"tie": [*ties]} if ties else {}) | tables, "."), mesh)
