"""A coarser or finer mesh: made again from a generator or geometry, or its cells halved.

Each cell becomes eight, each facet four. The new nodes lie on the cell's isoparametric map, so
curved edges keep their shape and the finer mesh holds every field of the coarser mesh.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np

from wrenchbook.fea.mesh.element_order import SECOND
from wrenchbook.fea.mesh.facets import FaceFinder
from wrenchbook.fea.mesh.mesh import CellBlock, FacetBlock, FacetGroup, Mesh
from wrenchbook.fea.mesh.reference_cell import node_coordinates, tabulate
from wrenchbook.fea.spec.mesh_source import Generator, GeometryFile
from wrenchbook.fea.spec.problems import BundleError, BundleProblem
from wrenchbook.fea.spec.schema import Bundle

Array = np.ndarray

# The counts of cells that a finer mesh multiplies, by generator.
_COUNTS = {
    "bar": ("cells_along", "cells_across"),
    "plate": ("cells", "rings", "corner_cells", "layers"),
    "spring": ("cells_per_turn", "core"),
}


def refined(bundle: Bundle, factor: float) -> Bundle | None:
    """Return `bundle` with cells `factor` times as small along each direction.

    factor: Above 1 finer, below 1 coarser.
    Result: None if the mesh is a file, which only its author can refine. The fingerprint is that of
    the original: what is solved with it must not become a row.
    """
    mesh = bundle.mesh
    if mesh is None:
        return None
    if isinstance(mesh, GeometryFile):
        circle = max(3, round(mesh.circle * factor))
        curvature = mesh.curvature and max(3, round(mesh.curvature * factor))
        finer = replace(mesh, curvature=curvature).sized(mesh.size / factor, circle)
        return replace(bundle, mesh=finer)
    if not isinstance(mesh, Generator):
        return None
    counts = {
        name: max(1, math.floor(mesh.parameters[name] * factor + 0.5))
        for name in _COUNTS[mesh.generator]
    }
    return replace(bundle, mesh=replace(mesh, **counts))


# The cell, or facet, of first order with the same corners as one of second order.
_CORNERS = {second: first for first, second in SECOND.items()}
_CORNERS |= {"hex27": "hex8", "quad8": "quad4", "quad9": "quad4", "tri6": "tri3"}

# Children of a triangle and a tetrahedron by corners: two equal digits for a corner, two others for
# the middle between them. The octahedron within a tetrahedron is cut along 02-13 (Bey 1995).
_OF_TRIANGLE = ("00 01 02", "01 11 12", "02 12 22", "01 12 02")
_OF_TETRAHEDRON = (
    *("00 01 02 03", "01 11 12 13", "02 12 22 23", "03 13 23 33"),
    *("01 02 03 13", "01 12 02 13", "02 23 03 13", "02 12 23 13"),
)

_DENOMINATOR = 64
"""Parts of the corners' weights: nodes of children lie at quarters along three directions."""


class _Pattern(NamedTuple):
    """How one kind splits."""

    children: Array  # shape (children, nodes): indices of points
    # Shape (corners, points), uint64: of the corners at each point, in parts of `_DENOMINATOR`. Two
    # cells that meet have the same corners' weights at a common point.
    weights: Array
    values: Array  # shape (points, nodes): the parent's shape functions


@cache
def _pattern(kind: str) -> _Pattern:
    linear = _CORNERS.get(kind, kind)
    inside = tabulate(linear, node_coordinates(kind))[0]
    every = np.array([inside @ corners for corners in _children(linear)])
    points, numbers = np.unique(every.reshape(-1, every.shape[2]), axis=0, return_inverse=True)
    weights = np.rint(_DENOMINATOR * tabulate(linear, points)[0].T).astype(np.uint64)
    return _Pattern(numbers.reshape(every.shape[:2]), weights, tabulate(kind, points)[0])


def _children(linear: str) -> list[Array]:
    """Return the corners of each child, shape (corners, dimension), in the parent's coordinates."""
    points = node_coordinates(linear)
    if linear in ("hex8", "quad4"):
        return [0.5 * (points + corner) for corner in points]
    if linear == "wedge6":
        layers = 0.5 * (points[[0, 3], 2])
        flat = [_between(points[:3, :2], patterns) for patterns in _OF_TRIANGLE]
        return [
            np.vstack([np.column_stack([three, np.full(3, z)]) for z in (low, low + 0.5)])
            for low in layers
            for three in flat
        ]
    patterns = _OF_TRIANGLE if linear == "tri3" else _OF_TETRAHEDRON
    return [_between(points, word) for word in patterns]


def _between(points: Array, pattern: str) -> Array:
    return np.array([0.5 * (points[int(a)] + points[int(b)]) for a, b in pattern.split()])


def halved(mesh: Mesh) -> Mesh:
    """Return the mesh with cells of half the size, and its groups.

    A node group gets the new nodes that lie between nodes of it alone: those of a facet or an edge
    all of whose nodes it has.

    Raises BundleError if there are pyramids, which no eight cells of one kind make.
    """
    if any(block.kind.startswith("pyramid") for block in mesh.blocks):
        message = "pyramids cannot be halved; give finer meshes: wrenchbook converge --finer FILE"
        raise BundleError([BundleProblem("mesh", message)])
    # A sum of random 64-bit numbers of the corners names a point, whichever cell it belongs to:
    # of a million points two share a number with a probability of 3e-8.
    names = np.random.default_rng(0).integers(2**64, size=len(mesh.points), dtype=np.uint64)
    parents = [(block.nodes, _pattern(block.kind)) for block in mesh.blocks]
    keys = [_keys(names, nodes, pattern) for nodes, pattern in parents]
    points = [pattern.values @ mesh.points[nodes] for nodes, pattern in parents]
    known, first, number = np.unique(
        np.concatenate([local.ravel() for local in keys]), return_index=True, return_inverse=True
    )
    ends = np.cumsum([local.size for local in keys])[:-1]
    numbers = [
        part.reshape(local.shape) for part, local in zip(np.split(number, ends), keys, strict=True)
    ]
    blocks = tuple(
        CellBlock(block.kind, _nodes(number, pattern))
        for block, number, (_, pattern) in zip(mesh.blocks, numbers, parents, strict=True)
    )
    regions = {
        name: tuple((8 * local[:, None] + np.arange(8)).ravel() for local in cells)
        for name, cells in mesh.regions.items()
    }
    faces = FaceFinder(mesh.blocks)
    facets = {
        name: _split_facets(group, faces, names, known) for name, group in mesh.facet_groups.items()
    }
    sets = {
        name: np.unique(np.concatenate([
            number[_all_of(np.isin(nodes, ids), pattern)]
            for number, (nodes, pattern) in zip(numbers, parents, strict=True)
        ]))
        for name, ids in mesh.node_groups.items()
    }  # fmt: skip
    every = np.concatenate([point.reshape(-1, 3) for point in points])
    same = np.full(len(mesh.points) + 1, -1)  # the last for nodes in no cell
    for number, (nodes, pattern) in zip(numbers, parents, strict=True):
        same[nodes] = number[:, pattern.values.argmax(axis=0)]  # where a shape function is 1
    weights = {name: (same[nodes], sizes) for name, (nodes, sizes) in mesh.node_weights.items()}
    return Mesh(every[first], blocks, regions, facets, sets, mesh.deck, node_weights=weights)


def _keys(names: Array, nodes: Array, pattern: _Pattern) -> Array:
    """Return the names of the points of each cell, (cells, points), uint64."""
    return names[nodes[:, : len(pattern.weights)]] @ pattern.weights


def _nodes(numbers: Array, pattern: _Pattern) -> Array:
    """Return the children's nodes, (8 cells, nodes), a parent's children in a row."""
    return numbers[:, pattern.children].reshape(-1, pattern.children.shape[1])


def _split_facets(group: FacetGroup, faces: FaceFinder, names: Array, known: Array) -> FacetGroup:
    facets = [face for kind, nodes in group.blocks for face in faces.find(kind, nodes)[0]]
    return FacetGroup(
        tuple(
            FacetBlock(kind, _nodes(np.searchsorted(known, _keys(names, local, pattern)), pattern))
            for kind, local, pattern in ((kind, local, _pattern(kind)) for kind, local in facets)
        )
    )


def _all_of(member: Array, pattern: _Pattern) -> Array:
    """Return at which points, (cells, points), all nodes that count are members, (cells, nodes)."""
    counts = np.abs(pattern.values) > 1e-9  # shape functions are multiples of 1/64
    return (~member).astype(int) @ counts.T.astype(int) == 0
