"""The isoparametric map of cells: its determinants, folded cells, shape gradients and areas."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.mesh.mesh import CellBlock, FacetGroup, Mesh
from wrenchbook.fea.mesh.reference_cell import node_coordinates, reference_element, tabulate
from wrenchbook.fea.spec.problems import BundleProblem, point_text
from wrenchbook.fea.tensors import determinant

_FLAT = 1e-9  # part of a cell's largest determinant: a smaller one is zero but for roundoff
_MAX_LISTED = 5  # cells in a message: more would hide its remedy


def jacobians(nodes: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Return dx_i/dxi_j of the isoparametric maps of cells or facets, shape (m, q, d, r).

    nodes: shape (m, k, d), m: positions of their nodes.
    slopes: shape (q, k, r): dN_a/dxi_j at q points, of `tabulate` or a `ReferenceElement`.
    """
    return nodes.swapaxes(1, 2)[:, None] @ slopes


def determinants(points: np.ndarray, block: CellBlock) -> np.ndarray:
    """Return det(dx/dxi) of each cell at each point of its full quadrature, shape (m, q), m^3."""
    return determinant(jacobians(points[block.nodes], reference_element(block.kind).slopes))


def extreme_determinants(points: np.ndarray, block: CellBlock) -> tuple[np.ndarray, np.ndarray]:
    """Return the extremes of det(dx/dxi) over the nodes and quadrature points of each cell.

    A cell can fold over at a corner although every quadrature point has a positive determinant; its
    answers are wrong then (5 % for one of 40 cells with two corners swapped).

    points: shape (n, 3), m.
    Returns least, largest: each of shape (m,), m^3: the least, and the largest in size.
    """
    _, slopes = tabulate(block.kind, node_coordinates(block.kind))
    at_nodes = determinant(jacobians(points[block.nodes], slopes))
    at_all = np.concatenate([determinants(points, block), at_nodes], axis=1)
    return at_all.min(axis=1), np.abs(at_all).max(axis=1)


def folded_cells(points: np.ndarray, block: CellBlock) -> np.ndarray:
    """Return the indices, (k,), of cells that are inside out or flat at a node or quadrature point.

    points: shape (n, 3), in m or any other unit.
    """
    least, largest = extreme_determinants(points, block)
    return np.flatnonzero(~(least > _FLAT * largest))


def right_way_round(points: np.ndarray, block: CellBlock) -> CellBlock:
    """Return the block, renumbered if all its cells are mirrored.

    Only a whole block is renumbered: a few mirrored cells among others are an error of the mesh.

    points: shape (n, 3), in m or any other unit.
    """
    if not len(block) or not (determinants(points, block) < 0.0).all():
        return block
    reference = node_coordinates(block.kind)
    if block.kind.startswith(("hex", "wedge")):
        mirrored = reference * [1, 1, -1] + [0, 0, 1]
    else:  # a tetrahedron or pyramid is its own mirror image by x and y exchanged
        mirrored = reference[:, [1, 0, 2]]
    distance = np.abs(mirrored[:, None, :] - reference[None, :, :]).max(axis=2)
    return CellBlock(block.kind, block.nodes[:, distance.argmin(axis=1)])


def cell_problems(mesh: Mesh) -> list[BundleProblem]:
    """Return a problem for each block with cells that are turned inside out or flat."""
    problems = []
    for block in mesh.blocks:
        bad = folded_cells(mesh.points, block)
        if bad.size:
            centre = point_text(mesh.points[block.nodes[bad[0]]].mean(axis=0))
            message = (
                f"{bad.size} of {len(block)} {block.kind} cells are inverted or flat, one "
                f"near {centre} m. Mesh more finely there, with nodes in the format's order and "
                "midside nodes in the middle; write collapsed cells as wedges"
            )
            problems.append(BundleProblem("mesh", message))
    return problems


@dataclass(frozen=True, eq=False)
class Gradients:
    """Gradients and weights of the cells of one block in the undeformed state."""

    slopes: np.ndarray  # shape (cells, points, 3, nodes), 1/m: dN_a/dX_J at each quadrature point
    weights: np.ndarray  # shape (cells, points), m^3: the volume of each point
    # Shape (points, nodes), or (cells, points, nodes) if they differ by cell: the shape functions
    values: np.ndarray

    def of_outer(self, weights: np.ndarray) -> Gradients:
        """Return the gradients by the nodes on which the cells depend; see `Dependents.outer`."""
        return Gradients(self.slopes @ weights[:, None], self.weights, self.values @ weights)


def cell_gradients(points: np.ndarray, block: CellBlock, integration: str) -> Gradients:
    """Map the reference gradients of a block to its cells.

    points: shape (n, 3), m.
    integration: ``"reduced"`` or ``"full"``, for hex20.

    Raises SolveFailed of kind ``inverted_elements`` if the determinant of a cell's map is not
    positive at each node and quadrature point.
    """
    element = reference_element(block.kind, integration)
    bad = folded_cells(points, block)
    if bad.size:
        listed = ", ".join(str(cell) for cell in bad[:_MAX_LISTED])
        raise SolveFailed(
            "inverted_elements",
            f"{bad.size} of {len(block)} {block.kind} cells are inverted or flat (cell numbers "
            f"{listed}{', ...' if bad.size > _MAX_LISTED else ''}).",
        )
    jacobian = jacobians(points[block.nodes], element.slopes)
    weights = determinant(jacobian) * element.weights
    slopes = np.linalg.inv(jacobian).transpose(0, 1, 3, 2) @ element.slopes.transpose(0, 2, 1)
    return Gradients(np.ascontiguousarray(slopes), weights, element.values)


def area_weights(points: np.ndarray, group: FacetGroup) -> tuple[np.ndarray, np.ndarray]:
    """Integrate each node's shape function over a section.

    Returns nodes: shape (k,): the section's nodes, ascending. weights: shape (k,), m^2; their sum
    is the area. Corner nodes of eight-node facets have negative weights.
    """
    nodes = group.node_ids
    weights = np.zeros(nodes.size)
    for kind, facets in group.blocks:
        element = reference_element(kind)
        tangents = jacobians(points[facets], element.slopes)
        area = np.linalg.norm(np.cross(tangents[..., 0], tangents[..., 1]), axis=-1)
        part = (area * element.weights) @ element.values
        weights += np.bincount(
            np.searchsorted(nodes, facets.ravel()), part.ravel(), minlength=nodes.size
        )
    return nodes, weights
