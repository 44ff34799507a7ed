"""Shapes of cells: four measures, each with the worst cell and where it is.

``scaled_jacobian``
    Least over the corners of the volume its three edges span, over that of the ideal cell with
    edges of those lengths: 1 for cubes, regular tetrahedra and right wedges on regular triangles,
    0 for flat cells (the measure of Knupp, "Algebraic mesh quality metrics", 2001).
``jacobian_ratio``
    Least over largest det(dx/dxi) over a cell's nodes and quadrature points: 1 for straight
    parallelepipeds and straight tetrahedra; 0 or less is a cell that folds over, an error.
``aspect_ratio``
    Longest over shortest edge.
``edge_curvature``
    Distance of a midside node from the middle of its edge over the edge's length: 0.1 on a circle
    cut in eight, 0.21 on one cut in four, 0.25 for a node at the quarter point.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from wrenchbook.fea.mesh.facets import EDGES, corners_of_cell
from wrenchbook.fea.mesh.mapping import extreme_determinants
from wrenchbook.fea.mesh.mesh import CellBlock, Mesh
from wrenchbook.fea.mesh.reference_cell import node_coordinates
from wrenchbook.fea.spec.problems import point_text
from wrenchbook.fea.tensors import TINY, determinant

_IDEAL_VOLUME = {"tet": 0.5**0.5, "pyr": 0.5**0.5, "wed": 0.75**0.5, "hex": 1.0}
"""Volume that the three edges of length 1 at a corner of the ideal cell span, by kind of cell."""


@dataclass(frozen=True)
class Measure:
    """One measure of the shape of cells."""

    name: str  # key of the measure in the report
    # From points of shape (n, 3), m, and a block of m cells to the values, shape (m,), no unit
    of: Callable[[np.ndarray, CellBlock], np.ndarray]
    # limit, larger_is_worse: the limit of a bad cell, and on which side of it cells are bad
    limit: float
    larger_is_worse: bool
    description: str  # the description of a bad cell


def scaled_jacobian(points: np.ndarray, block: CellBlock) -> np.ndarray:
    """Return the least scaled Jacobian of each cell's corners, shape (m,)."""
    # For each corner itself and its three neighbours, right-handed.
    coordinates = node_coordinates(block.kind)
    pairs = EDGES[block.kind]
    triples = []
    for corner in range(corners_of_cell(block.kind)):
        ends = [b if a == corner else a for a, b in pairs if corner in (a, b)][:3]
        edges = coordinates[ends] - coordinates[corner]
        triples.append([corner, *(ends if np.linalg.det(edges) > 0 else ends[::-1])])
    at = points[block.nodes]
    triples = np.array(triples)
    edges = at[:, triples[:, 1:]] - at[:, triples[:, :1]]
    volume = determinant(edges)
    length = np.linalg.norm(edges, axis=3).prod(axis=2)
    scaled = np.divide(volume, length, out=np.zeros_like(volume), where=length > 0)
    return np.minimum(scaled.min(axis=1) / _IDEAL_VOLUME[block.kind[:3]], 1.0)


def jacobian_ratio(points: np.ndarray, block: CellBlock) -> np.ndarray:
    """Return the least over the largest determinant of each cell, shape (m,)."""
    least, largest = extreme_determinants(points, block)
    return np.divide(least, largest, out=np.zeros(len(block)), where=largest > 0)


def aspect_ratio(points: np.ndarray, block: CellBlock) -> np.ndarray:
    """Return the longest over the shortest edge of each cell, shape (m,)."""
    lengths = edge_lengths(points, block)
    shortest = np.maximum(lengths.min(axis=1), TINY)
    return lengths.max(axis=1) / shortest


def edge_curvature(points: np.ndarray, block: CellBlock) -> np.ndarray:
    """Return the largest relative offset of a midside node of each cell, shape (m,)."""
    pairs = np.array(EDGES[block.kind])
    corners = corners_of_cell(block.kind)
    if block.nodes.shape[1] < corners + len(pairs):
        return np.zeros(len(block))
    ends = points[block.nodes[:, pairs]]
    middle = points[block.nodes[:, corners : corners + len(pairs)]]
    offset = np.linalg.norm(middle - ends.mean(axis=2), axis=2)
    return (offset / np.maximum(edge_lengths(points, block), TINY)).max(axis=1)


def edge_lengths(points: np.ndarray, block: CellBlock) -> np.ndarray:
    """Return the straight lengths of each cell's edges, shape (m, edges), m."""
    ends = points[block.nodes[:, EDGES[block.kind]]]
    return np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2)


MEASURES = (
    Measure("scaled_jacobian", scaled_jacobian, 0.1, False, "nearly flat at a corner"),
    Measure("jacobian_ratio", jacobian_ratio, 0.1, False, "strongly distorted"),
    Measure("aspect_ratio", aspect_ratio, 50.0, True, "long and thin"),
    Measure("edge_curvature", edge_curvature, 0.25, True, "curved too far along an edge"),
)


def quality(mesh: Mesh) -> dict[str, dict[str, Any]]:
    """Return each measure's worst value, that cell's centre (m), and the number of bad cells."""
    return {measure.name: _worst(mesh, measure) for measure in MEASURES}


def quality_warnings(measured: dict[str, dict[str, Any]]) -> list[str]:
    """Return a sentence for each measure with cells beyond its limit."""
    warnings = []
    for measure in MEASURES:
        worst = measured[measure.name]
        if worst["bad"]:
            warnings.append(
                f"{worst['bad']} cells are {measure.description} ({measure.name.replace('_', ' ')} "
                f"{'over' if measure.larger_is_worse else 'under'} {measure.limit:g}; the worst, a "
                f"{worst['kind']} near {point_text(worst['at'])} m, has {worst['worst']:.3g}); "
                "stresses and stiffness there are not to be trusted"
            )
    return warnings


def _worst(mesh: Mesh, measure: Measure) -> dict[str, Any]:
    """Return a measure's worst value with its cell, and the number of cells beyond its limit."""
    sign = 1.0 if measure.larger_is_worse else -1.0  # times a value: the worst is the largest
    bad = 0
    worst_of_blocks = []
    for block in mesh.blocks:
        values = sign * measure.of(mesh.points, block)
        bad += int((values > sign * measure.limit).sum())
        if len(values):
            cell = int(values.argmax())
            worst_of_blocks.append((float(values[cell]), block.kind, block.nodes[cell]))
    worst, kind, nodes = max(worst_of_blocks, key=lambda entry: entry[0])
    return {
        "worst": sign * worst,
        "at": mesh.points[nodes].mean(axis=0).tolist(),
        "kind": kind,
        "bad": bad,
        "limit": measure.limit,
    }
