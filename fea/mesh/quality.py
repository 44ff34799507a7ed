"""Cells that no solver can use: turned inside out, or flat."""

from __future__ import annotations

import numpy as np

from fea.mesh.mesh import CellBlock, Mesh
from fea.mesh.reference_cell import node_places, reference_element
from fea.spec.problems import Problem

Array = np.ndarray


def determinants(points: Array, block: CellBlock) -> Array:
    """Return det(dx/dxi) of each cell at each point of its full quadrature, shape (m, q), m^3."""
    slopes = reference_element(block.kind).slopes
    return np.linalg.det(np.einsum("mad,qai->mqdi", points[block.nodes], slopes, optimize=True))


def volumes(points: Array, block: CellBlock) -> Array:
    """Return the volume of each cell, shape (m,), m^3."""
    return determinants(points, block) @ reference_element(block.kind).weights


def right_way_round(points: Array, block: CellBlock) -> CellBlock:
    """Return the block, renumbered if the file numbers all its cells as seen in a mirror.

    Only a whole block is turned: a few cells inside out among others are a fault of the mesh.
    """
    if not len(block) or not (determinants(points, block) < 0.0).all():
        return block
    places = node_places(block.kind)
    mirrored = places[:, [1, 0, 2]] if block.kind.startswith("tet") else places * [1, 1, -1]
    if not block.kind.startswith("tet"):
        mirrored[:, 2] += 1.0
    distance = np.abs(mirrored[:, None, :] - places[None, :, :]).max(axis=2)
    return CellBlock(block.kind, block.nodes[:, distance.argmin(axis=1)])


def cell_problems(mesh: Mesh) -> list[Problem]:
    """Return a problem for each block with cells that are turned inside out or flat."""
    found = []
    for block in mesh.blocks:
        bad = np.flatnonzero((determinants(mesh.points, block) <= 0.0).any(axis=1))
        if bad.size:
            middle = mesh.points[block.nodes[bad[0]]].mean(axis=0)
            at = ", ".join(f"{place:.6g}" for place in middle)
            message = (
                f"{bad.size} of {len(block)} {block.kind} cells are turned inside out or flat, one "
                f"of them near ({at}) m; mesh that place more finely or move its midside nodes"
            )
            found.append(Problem("mesh", message))
    return found
