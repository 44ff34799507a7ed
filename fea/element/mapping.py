"""Shape gradients of real cells: the isoparametric map, done once for each block of cells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wrenchbook.fea.failure import inverted_elements
from wrenchbook.fea.mesh.mesh import CellBlock, FacetGroup
from wrenchbook.fea.mesh.quality import folded_cells
from wrenchbook.fea.mesh.reference_cell import reference_element

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Gradients:
    """Gradients and weights of the cells of one block in the undeformed state."""

    slopes: Array  # shape (cells, points, 3, nodes), 1/m: dN_a/dX_J at each quadrature point
    weights: Array  # shape (cells, points), m^3: the volume that each point stands for
    # Shape (points, nodes), dimensionless: the shape functions at the quadrature points
    values: Array


def cell_gradients(points: Array, block: CellBlock, integration: str) -> Gradients:
    """Map the reference gradients of a block to its cells.

    points: shape (n, 3), m.
    block: the cells.
    integration: ``"reduced"`` or ``"full"``, for hex20.
    Raises SolveFailed: ``inverted_elements`` if the determinant of a cell's map is not positive at
    each node and quadrature point.
    """
    element = reference_element(block.kind, integration)
    jacobian = points[block.nodes].transpose(0, 2, 1)[:, None] @ element.slopes  # dX_i/dxi_j
    determinant = np.linalg.det(jacobian)
    bad = folded_cells(points, block)
    if bad.size:
        listed = ", ".join(str(cell) for cell in bad[:5])
        raise inverted_elements(
            f"{bad.size} of {len(block)} {block.kind} cells are turned inside out or flat "
            f"(cell numbers {listed}{', ...' if bad.size > 5 else ''})."
        )
    inverse = np.linalg.inv(jacobian)
    slopes = inverse.transpose(0, 1, 3, 2) @ element.slopes.transpose(0, 2, 1)
    return Gradients(np.ascontiguousarray(slopes), determinant * element.weights, element.values)


def area_weights(points: Array, group: FacetGroup) -> tuple[Array, Array]:
    """Integrate each node's shape function over a section.

    Returns nodes: shape (k,): the section's nodes, ascending. weights: shape (k,), m^2; their sum
    is the area. Corner nodes of eight-node facets have negative weights.
    """
    nodes = group.node_ids
    weights = np.zeros(nodes.size)
    for kind, facets in group.blocks:
        element = reference_element(kind)
        tangents = points[facets].transpose(0, 2, 1)[:, None] @ element.slopes
        area = np.linalg.norm(np.cross(tangents[..., 0], tangents[..., 1]), axis=-1)
        part = (area * element.weights) @ element.values
        weights += np.bincount(
            np.searchsorted(nodes, facets.ravel()), part.ravel(), minlength=nodes.size
        )
    return nodes, weights
