"""A coarser or finer mesh: from its generator or geometry with another size, or by halving cells.

Each cell becomes eight, each facet four. The new nodes lie on the cell's isoparametric map, so
curved edges keep their shape and the finer mesh holds every field of the coarser mesh.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple, cast

import numpy as np
from annotated_types import Ge

from wrenchbook.fea.mesh.element_order import FIRST
from wrenchbook.fea.mesh.facets import FaceFinder
from wrenchbook.fea.mesh.mesh import CellBlock, FacetBlock, FacetGroup, Mesh
from wrenchbook.fea.mesh.reference_cell import node_coordinates, tabulate
from wrenchbook.fea.spec.keys import extra_of, keys_of
from wrenchbook.fea.spec.mesh_source import Generator, GeometryFile
from wrenchbook.fea.spec.problems import BundleError, BundleProblem
from wrenchbook.fea.spec.schema import Bundle


def refined(bundle: Bundle, factor: float) -> Bundle | None:
    """Return `bundle` with cells `factor` times as small along each direction.

    factor: above 1 finer, below 1 coarser.
    Result: None for a mesh file, which cannot be meshed anew. The fingerprint stays that of the
    original, so solutions of the result must not become rows of the table.
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
    counts = {}
    for name, info in keys_of(type(mesh)).items():
        if extra_of(info).get("unit") == "cells":
            fewest = next(cast("int", bound.ge) for bound in info.metadata if isinstance(bound, Ge))
            counts[name] = max(fewest, math.floor(mesh.parameters[name] * factor + 0.5))
    return replace(bundle, mesh=replace(mesh, **counts))


# The first-order cell or facet with the same corners as each second-order one.
_CORNERS = {**FIRST, "quad8": "quad4", "quad9": "quad4", "tri6": "tri3"}

# Children of a triangle and a tetrahedron by their corners: two equal digits are a corner of the
# parent, two different ones the middle between two corners. The octahedron within a tetrahedron is
# cut along 02-13 (Bey 1995).
_OF_TRIANGLE = ("00 01 02", "01 11 12", "02 12 22", "01 12 02")
_OF_TETRAHEDRON = (
    *("00 01 02 03", "01 11 12 13", "02 12 22 23", "03 13 23 33"),
    *("01 02 03 13", "01 12 02 13", "02 23 03 13", "02 12 23 13"),
)

_DENOMINATOR = 64
"""Denominator of the corners' weights: nodes of children lie at quarters along three directions,
4^3."""

# Largest rounding of a shape function at a point of a pattern, where it is a multiple of 1/64.
_ROUNDOFF = 1e-9


class _Pattern(NamedTuple):
    """The children of one kind of cell or facet: their nodes are points in the parent."""

    children: np.ndarray  # shape (children, nodes): indices of points
    # Shape (corners, points), uint64: linear weights of the parent's corners at each point, times
    # `_DENOMINATOR`. Adjacent cells have the same weights at a common point.
    weights: np.ndarray
    values: np.ndarray  # shape (points, nodes): the parent's shape functions


@cache
def _pattern(kind: str) -> _Pattern:
    """Return the children of a kind of cell or facet."""
    linear = _CORNERS.get(kind, kind)
    inside = tabulate(linear, node_coordinates(kind))[0]
    nodes = np.array([inside @ corners for corners in _children(linear)])
    points, numbers = np.unique(nodes.reshape(-1, nodes.shape[2]), axis=0, return_inverse=True)
    weights = np.rint(_DENOMINATOR * tabulate(linear, points)[0].T).astype(np.uint64)
    return _Pattern(numbers.reshape(nodes.shape[:2]), weights, tabulate(kind, points)[0])


def _children(linear: str) -> list[np.ndarray]:
    """Return the corners of each child, shape (corners, dimension), in the parent's coordinates."""
    points = node_coordinates(linear)
    if linear in ("hex8", "quad4"):
        return [0.5 * (points + corner) for corner in points]
    if linear == "wedge6":
        layers = 0.5 * (points[[0, 3], 2])
        triangles = [_between(points[:3, :2], pattern) for pattern in _OF_TRIANGLE]
        return [
            np.vstack([np.column_stack([corners, np.full(3, z)]) for z in (low, low + 0.5)])
            for low in layers
            for corners in triangles
        ]
    patterns = _OF_TRIANGLE if linear == "tri3" else _OF_TETRAHEDRON
    return [_between(points, pattern) for pattern in patterns]


def _between(points: np.ndarray, pattern: str) -> np.ndarray:
    """Return the corners of one child, as a pattern such as "00 01 02" names them."""
    return np.array([0.5 * (points[int(a)] + points[int(b)]) for a, b in pattern.split()])


@dataclass(frozen=True, eq=False)
class _FinerNodes:
    """Nodes of the finer mesh, and their positions in the cells of the coarse mesh."""

    points: np.ndarray  # shape (nodes, 3), m
    numbers: list[np.ndarray]  # for each block, shape (cells, points of its pattern): nodes
    # corner_keys, keys: the random keys of the coarse nodes, and the finer nodes' sums of them in
    # ascending order, both uint64. The sum is the same in each cell or facet that has the node.
    corner_keys: np.ndarray
    keys: np.ndarray


def halved(mesh: Mesh) -> Mesh:
    """Return the mesh with cells of half the size, and its groups.

    A node group gets the new nodes whose coarse neighbours are all in the group: those of a facet
    or an edge.

    Raises BundleError if the mesh has pyramids, which cannot be divided into eight cells of one
    kind.
    """
    if any(block.kind.startswith("pyramid") for block in mesh.blocks):
        message = "pyramids cannot be halved; give finer meshes: wrenchbook converge --finer FILE"
        raise BundleError([BundleProblem("mesh", message)])
    finer = _finer_nodes(mesh)
    blocks = tuple(
        CellBlock(block.kind, _children_nodes(numbers, _pattern(block.kind)))
        for block, numbers in zip(mesh.blocks, finer.numbers, strict=True)
    )
    regions = {
        name: tuple((8 * local[:, None] + np.arange(8)).ravel() for local in cells)
        for name, cells in mesh.regions.items()
    }
    faces = FaceFinder(mesh.blocks)
    facets = {name: _split_facets(group, faces, finer) for name, group in mesh.facet_groups.items()}
    node_groups = {name: _split_nodes(mesh, ids, finer) for name, ids in mesh.node_groups.items()}

    # Index of each coarse node; the last entry for no node.
    number_of = np.full(len(mesh.points) + 1, -1)
    for block, numbers in zip(mesh.blocks, finer.numbers, strict=True):
        at_nodes = _pattern(block.kind).values.argmax(axis=0)  # points where a shape function is 1
        number_of[block.nodes] = numbers[:, at_nodes]
    weights = {
        name: (number_of[nodes], sizes) for name, (nodes, sizes) in mesh.node_weights.items()
    }
    return Mesh(finer.points, blocks, regions, facets, node_groups, mesh.deck, node_weights=weights)


def _finer_nodes(mesh: Mesh) -> _FinerNodes:
    """Return the points of all cells' patterns, each once however many cells have it."""
    # A point's key is the sum of its corners' random 64-bit numbers times their weights, the same
    # in each cell. Weights of up to 64 leave at least 58 bits of it random: two of a million points
    # have the same key with a probability of at most 2e-6.
    corner_keys = np.random.default_rng(0).integers(2**64, size=len(mesh.points), dtype=np.uint64)
    parents = [(block.nodes, _pattern(block.kind)) for block in mesh.blocks]
    keys = [_point_keys(corner_keys, nodes, pattern) for nodes, pattern in parents]
    points = [(pattern.values @ mesh.points[nodes]).reshape(-1, 3) for nodes, pattern in parents]

    unique_keys, first, number = np.unique(
        np.concatenate([local.ravel() for local in keys]), return_index=True, return_inverse=True
    )
    ends = np.cumsum([local.size for local in keys])[:-1]
    numbers = [
        part.reshape(local.shape) for part, local in zip(np.split(number, ends), keys, strict=True)
    ]
    return _FinerNodes(np.concatenate(points)[first], numbers, corner_keys, unique_keys)


def _point_keys(corner_keys: np.ndarray, nodes: np.ndarray, pattern: _Pattern) -> np.ndarray:
    """Return the keys of the points of cells or facets, shape (cells, points), uint64."""
    return corner_keys[nodes[:, : len(pattern.weights)]] @ pattern.weights


def _children_nodes(numbers: np.ndarray, pattern: _Pattern) -> np.ndarray:
    """Return the children's nodes, (8 cells, nodes), the children of a parent consecutive."""
    return numbers[:, pattern.children].reshape(-1, pattern.children.shape[1])


def _split_facets(group: FacetGroup, faces: FaceFinder, finer: _FinerNodes) -> FacetGroup:
    """Return the four children of each facet of a group."""
    blocks = []
    for kind, nodes in (face for block in group.blocks for face in faces.find(*block)[0]):
        keys = _point_keys(finer.corner_keys, nodes, _pattern(kind))
        numbers = np.searchsorted(finer.keys, keys)
        blocks.append(FacetBlock(kind, _children_nodes(numbers, _pattern(kind))))
    return FacetGroup(tuple(blocks))


def _split_nodes(mesh: Mesh, group: np.ndarray, finer: _FinerNodes) -> np.ndarray:
    """Return the finer nodes, sorted, that depend on nodes of the group only."""
    inside = []
    for block, numbers in zip(mesh.blocks, finer.numbers, strict=True):
        matters = np.abs(_pattern(block.kind).values) > _ROUNDOFF
        outside = ~np.isin(block.nodes, group)
        inside.append(numbers[outside.astype(int) @ matters.T.astype(int) == 0])
    return np.unique(np.concatenate(inside))
