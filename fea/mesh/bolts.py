"""Cuts of bolts: the nodes of a section of the shank are doubled for the cells on its upper side.

Each copy follows its original plus the slip, the displacement of a point that belongs to no cell:
u_copy = u_original + u_slip. Both sides shift along the axis alone, so that the section may be
jagged. The bolt's force pulls the slip against the axis: it is the tension of the shank.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from wrenchbook.fea.mesh.dependents import Dependents, Entries
from wrenchbook.fea.mesh.facets import faces_of, facets_within, triangles_of
from wrenchbook.fea.mesh.groups import missing, no_facets
from wrenchbook.fea.mesh.mesh import CellBlock, FacetBlock, FacetGroup, Mesh
from wrenchbook.fea.mesh.surface import connected
from wrenchbook.fea.spec.problems import BundleProblem, point_text
from wrenchbook.fea.spec.schema import Bolt

_LEVEL = 1e-9  # part of the shank's length: a cell whose middle is in the plane is above it


@dataclass(frozen=True, eq=False)
class BoltCut:
    """A bolt with its cut."""

    key: str  # key in the bundle: ``bolt[0]``
    bolt: Bolt
    nodes: np.ndarray  # shape (k,), int64: nodes of the cut, on its lower side
    slip: int  # the point whose displacement is the shift of the upper side against the lower
    cells: tuple[np.ndarray, ...]  # for each block the indices of the upper cells at the cut
    area: float  # area of the cut, projected on the plane across the axis, m^2

    @property
    def copies(self) -> np.ndarray:
        """The nodes of the upper side, shape (k,), in the order of `nodes`."""
        return self.slip - len(self.nodes) + np.arange(len(self.nodes))

    @property
    def axis(self) -> np.ndarray:
        """Unit vector from the lower to the upper side, shape (3,), in the mesh's axes."""
        return np.array(self.bolt.axis)


def cut_bolts(
    mesh: Mesh, bolts: tuple[Bolt, ...], problems: list[BundleProblem]
) -> tuple[Mesh, tuple[BoltCut, ...]]:
    """Return the mesh with its bolts cut, and the cuts; new points come after the others.

    Groups keep their nodes and facets: at a cut they have those of the lower side.
    """
    cuts: list[BoltCut] = []
    entries = [mesh.dependents.entries] if mesh.dependents is not None else []
    for number, bolt in enumerate(bolts):
        key = f"bolt[{number}]"
        sides = _sides(mesh, bolt, key, problems)
        if sides is None:
            continue
        nodes = sides.nodes
        slip = len(mesh.points) + len(nodes)
        cells = tuple(map(np.flatnonzero, sides.above))
        cut = BoltCut(key, bolt, nodes, slip, cells, sides.area)
        cuts.append(cut)
        ones = np.ones(len(nodes))
        entries.append(Entries(cut.copies, nodes, ones))
        entries.append(Entries(cut.copies, np.full(len(nodes), slip), ones))
        renumbered = np.arange(len(mesh.points))
        renumbered[nodes] = cut.copies
        blocks = tuple(
            CellBlock(block.kind, np.where(above[:, None], renumbered[block.nodes], block.nodes))
            for block, above in zip(mesh.blocks, sides.above, strict=True)
        )
        points = np.vstack([mesh.points, mesh.points[nodes], mesh.points[nodes].mean(axis=0)])
        mesh = replace(mesh, points=points, blocks=blocks)
    if cuts:
        dependents = Dependents.of(len(mesh.points), Entries.concatenate(entries))
        mesh = replace(mesh, dependents=dependents)
    return mesh, tuple(cuts)


class _Sides(NamedTuple):
    """Both sides of a cut through a shank."""

    above: list[np.ndarray]  # shape (m,), bool, of each block: cells above the cut, at it
    nodes: np.ndarray  # shape (k,), int64: nodes of the cut, sorted
    area: float  # of the cut, projected on the plane across the axis, m^2


def _sides(mesh: Mesh, bolt: Bolt, key: str, problems: list[BundleProblem]) -> _Sides | None:
    """Return the sides of a bolt's cut.

    If the shank cannot be cut, the result is None, with a problem at `key`, such as "bolt[0]".
    """
    by_region = bolt.region is not None
    name = bolt.region or bolt.group or ""
    key = f"{key}.{'region' if by_region else 'group'}"
    if by_region and name not in mesh.regions:
        problems.append(missing(key, name, "cell group", [*mesh.regions]))
        return None
    if not by_region and name not in mesh.facet_groups:
        problems.append(no_facets(mesh, key, name))
        return None
    heights = mesh.points @ bolt.axis
    shank = _of_region(mesh, bolt, heights) if by_region else _of_group(mesh, bolt, heights)
    above, nodes = _upper_cells(mesh, shank, heights)
    cells = tuple(
        CellBlock(block.kind, block.nodes[upper])
        for block, upper in zip(mesh.blocks, above, strict=True)
    )
    faces = tuple(FacetBlock(kind, facets) for kind, facets in faces_of(cells).items())
    triangles = triangles_of(facets_within(FacetGroup(faces), nodes))
    message = _why_uncut(mesh, bolt, shank, heights, above, nodes, len(triangles) > 0)
    if message:
        problems.append(BundleProblem(key, message))
        return None
    # The vectors of a face between two upper cells cancel.
    x = mesh.points[triangles]
    vector = 0.5 * np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]).sum(axis=0)
    return _Sides(above, nodes, float(abs(vector @ bolt.axis)))


def _upper_cells(
    mesh: Mesh, shank: _Shank, heights: np.ndarray
) -> tuple[list[np.ndarray], np.ndarray]:
    """Return the cells above a cut that touch it, (m,) bool of each block, and its nodes, (k,)."""
    above = [
        inside & (heights[block.nodes].mean(axis=1) > level)
        for inside, block, level in zip(shank.cells, mesh.blocks, shank.levels, strict=True)
    ]
    below = [inside & ~upper for inside, upper in zip(shank.cells, above, strict=True)]
    nodes = np.intersect1d(_nodes_of(mesh, above), _nodes_of(mesh, below))
    touching = [
        upper & np.isin(block.nodes, nodes).any(axis=1)
        for block, upper in zip(mesh.blocks, above, strict=True)
    ]
    return touching, nodes


def _why_uncut(
    mesh: Mesh,
    bolt: Bolt,
    shank: _Shank,
    heights: np.ndarray,
    above: list[np.ndarray],
    nodes: np.ndarray,
    has_faces: bool,
) -> str:
    """Return the reason for which a shank cannot be cut at these nodes, "" if it can."""
    if not has_faces and bolt.region is None:
        return f'"{bolt.group}" has cells on one side only; name facets inside the shank, across it'
    if not has_faces:
        span = heights[_nodes_of(mesh, shank.cells)]
        level = np.concatenate(shank.levels)[0]
        if span.min() < level < span.max():
            return (
                f"has only one layer of cells at its cut, {level:.4g} m along axis; mesh the shank "
                "with two or more cells along axis, or write point where cells meet"
            )
        return (
            f"has no connected cells on both sides of its cut, {level:.4g} m along axis; "
            f"the region is from {span.min():.4g} to {span.max():.4g} m, so move point into it"
        )
    if bolt.region is None:
        group = mesh.facet_groups[bolt.group or ""].node_ids
        if not np.array_equal(nodes, group):
            return (
                f'"{bolt.group}" does not cut through the shank: cells on both sides share '
                f"{len(nodes)} of its {len(group)} nodes; name all facets across the shank"
            )

    outside = np.intersect1d(nodes, _nodes_of(mesh, [~inside for inside in shank.cells]))
    if outside.size:
        return (
            f"shares {outside.size} nodes of its cut, such as the one at "
            f"{point_text(mesh.points[outside[0]])} m, with cells outside the region, which "
            "support the shank there; move point to where the shank is free"
        )
    shanks = _count_pieces(mesh, above, nodes)
    if shanks > 1:
        return f"has {shanks} separate shanks at its cut; write a [[bolt]] for each"
    return ""


class _Shank(NamedTuple):
    """Cells of a shank, and the cut through it."""

    cells: list[np.ndarray]  # shape (m,), bool, of each block
    levels: list[np.ndarray]  # shape (m,), m, of each block: height of the cut at each cell


def _of_region(mesh: Mesh, bolt: Bolt, heights: np.ndarray) -> _Shank:
    """Return the region's cells, and a plane cut across the axis, by nodes' heights, (n,), m."""
    chosen = [
        np.isin(np.arange(len(block)), cells)
        for block, cells in zip(mesh.blocks, mesh.regions[bolt.region or ""], strict=True)
    ]
    span = heights[_nodes_of(mesh, chosen)]
    level = 0.5 * (span.min() + span.max()) if bolt.point is None else bolt.point @ bolt.axis
    height = level - _LEVEL * np.ptp(span)
    return _Shank(chosen, [np.full(len(block), height) for block in mesh.blocks])


def _of_group(mesh: Mesh, bolt: Bolt, heights: np.ndarray) -> _Shank:
    """Return the cells at the group's facets, and the cut through the group.

    The height is that of the cell's own nodes in the group, which may be curved.
    """
    group = mesh.facet_groups[bolt.group or ""].node_ids
    touched = [np.isin(block.nodes, group) for block in mesh.blocks]
    levels = [
        (touch * heights[block.nodes]).sum(axis=1) / np.maximum(touch.sum(axis=1), 1)
        for touch, block in zip(touched, mesh.blocks, strict=True)
    ]
    return _Shank([touch.sum(axis=1) > 0 for touch in touched], levels)


def _count_pieces(mesh: Mesh, chosen: Sequence[np.ndarray], nodes: np.ndarray) -> int:
    """Return the number of pieces of cells, (m,) bool of each block, connected by some nodes."""
    links = []  # indices of a cell and of a node of it
    first = len(mesh.points)  # indices of cells come after those of nodes
    for block, cells in zip(mesh.blocks, chosen, strict=True):
        cell, corner = np.nonzero(np.isin(block.nodes, nodes) & cells[:, None])
        links.append(np.stack([first + cell, block.nodes[cell, corner]]))
        first += len(block)
    _, ends = np.unique(np.concatenate(links, axis=1), return_inverse=True)
    rows, columns = ends.reshape(2, -1)
    return int(connected(rows, columns, int(ends.max()) + 1).max()) + 1


def _nodes_of(mesh: Mesh, chosen: Sequence[np.ndarray]) -> np.ndarray:
    """Return the nodes of cells, (m,) bool of each block, sorted, (k,)."""
    parts = [block.nodes[cells].ravel() for block, cells in zip(mesh.blocks, chosen, strict=True)]
    return np.unique(np.concatenate(parts))
