"""Content of a mesh file, and its conversion to a `fea.mesh.mesh.Mesh`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from wrenchbook.fea.mesh.dependents import CircularError, Dependents, Entries
from wrenchbook.fea.mesh.facets import FaceFinder
from wrenchbook.fea.mesh.mapping import right_way_round
from wrenchbook.fea.mesh.mesh import (
    NODES_PER_CELL,
    NODES_PER_FACET,
    CellBlock,
    FacetBlock,
    FacetGroup,
    Mesh,
)
from wrenchbook.fea.spec.problems import MeshFileError, point_text

Block = tuple[str, np.ndarray]

NODES_PER_LINE = {"point1": 1, "line2": 2, "line3": 3}
"""Kinds of cells that only give node groups: a group on an edge or a point of the part."""

_MAX_COORDINATE = 1e50  # largest coordinate: volumes of larger cells overflow


@dataclass(frozen=True, eq=False)
class RawMesh:
    """All contents of a mesh file, in the file's length unit."""

    points: np.ndarray  # shape (n, 3); some may belong to no cell
    # (kind, nodes) of cells, facets and lines, in the order of the file; nodes of shape (m, k),
    # int64.
    blocks: list[Block]
    # For each name, one array of element indices per block, shape (m,), int64
    element_sets: Mapping[str, list[np.ndarray]] = field(default_factory=dict)
    # For each name, the nodes' indices, shape (k,), int64
    node_sets: Mapping[str, np.ndarray] = field(default_factory=dict)
    # Facet groups that the file defines as faces of cells
    facet_sets: Mapping[str, list[Block]] = field(default_factory=dict)
    # Dependent nodes of cells, their masters, and weights
    follow: list[tuple[int, int, float]] = field(default_factory=list)
    # Weights of nodes by the name of their set, in the form of `fea.mesh.mesh.Mesh`
    node_weights: Mapping[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)


def to_mesh(raw: RawMesh, metres: float) -> Mesh:
    """Return the mesh: scaled, one block for each kind, without points that no cell uses.

    metres: the file's length unit in metres.

    Raises MeshFileError if there are no solid cells, some of an unsupported kind, references to
    missing points, or facets in a group that are not faces of a cell.
    """
    _require_solids(raw)
    _require_points(raw)
    solids = [(kind, nodes) for kind, nodes in raw.blocks if kind in NODES_PER_CELL]
    used = np.unique(np.concatenate([nodes.ravel() for _, nodes in solids]))
    number = np.full(len(raw.points), -1, dtype=np.int64)
    number[used] = np.arange(len(used))
    _require_finite(raw.points[used])
    kinds = list(dict.fromkeys(kind for kind, _ in solids))
    cells = {k: number[np.concatenate([b for kind, b in raw.blocks if kind == k])] for k in kinds}
    unique = {kind: _without_twins(nodes) for kind, nodes in cells.items()}

    points = raw.points[used] * metres
    blocks = tuple(
        right_way_round(points, CellBlock(kind, cells[kind][kept_rows]))
        for kind, (kept_rows, _) in unique.items()
    )
    regions = _regions(raw, {kind: new_rows for kind, (_, new_rows) in unique.items()})
    groups = _facet_groups(raw, number, blocks)
    dependents = _dependents(raw, number, points) if raw.follow else None
    node_groups = _node_groups(raw, number)
    number = np.append(number, -1)  # a weight of the node -1 has no node
    weights = {name: (number[nodes], sizes) for name, (nodes, sizes) in raw.node_weights.items()}
    return Mesh(
        points, blocks, regions, groups, node_groups, dependents=dependents, node_weights=weights
    )


def _require_solids(raw: RawMesh) -> None:
    """Refuse cells of an unsupported kind, and a file without solid cells."""
    kinds = [kind for kind, nodes in raw.blocks if len(nodes)]
    known = {*NODES_PER_CELL, *NODES_PER_FACET, *NODES_PER_LINE}
    unknown = sorted({kind for kind in kinds if kind not in known})
    if unknown:
        raise MeshFileError(
            f"has cells of kind {', '.join(unknown)}, which are not supported; mesh with "
            f"{', '.join(NODES_PER_CELL)}"
        )
    if not any(kind in NODES_PER_CELL for kind in kinds):
        there = ", ".join(dict.fromkeys(kinds)) or "no cells at all"
        raise MeshFileError(f"has no solid cells (it has {there}); export the volume mesh too")


def _require_points(raw: RawMesh) -> None:
    """Refuse references to missing points: -1 would otherwise mean the last."""
    users = [(f"{kind} cells", nodes) for kind, nodes in raw.blocks]
    users += [(f'the group "{name}"', nodes) for name, nodes in raw.node_sets.items()]
    for user, numbers in users:
        missing = numbers[(numbers < 0) | (numbers >= len(raw.points))]
        if missing.size:
            raise MeshFileError(
                f"has {user} on point {missing[0]}, but its points are 0 to {len(raw.points) - 1}; "
                "export it again"
            )


def _require_finite(points: np.ndarray) -> None:
    """Refuse coordinates, (n, 3), that are no numbers or too large."""
    is_huge = ~(np.abs(points) < _MAX_COORDINATE).all(axis=1)
    if is_huge.any():
        at = ", ".join(f"{x:g}" for x in points[is_huge][0])
        raise MeshFileError(
            f"has a point at ({at}); coordinates must be finite and below {_MAX_COORDINATE:g}, so "
            "export it again"
        )


def _regions(raw: RawMesh, new_rows: Mapping[str, np.ndarray]) -> dict[str, tuple[np.ndarray, ...]]:
    """Return each element set as indices of cells within the joined block of their kind.

    new_rows: for each kind the index in the joined block of each of its cells, in the file's order.
    """
    regions = {}
    for name, numbers in raw.element_sets.items():
        chosen: dict[str, list[np.ndarray]] = {kind: [] for kind in new_rows}
        n_before = dict.fromkeys(new_rows, 0)  # cells of the kind in earlier blocks
        for (kind, nodes), rows in zip(raw.blocks, numbers, strict=True):
            if kind in new_rows:
                chosen[kind].append(new_rows[kind][rows + n_before[kind]])
                n_before[kind] += len(nodes)
        region = tuple(np.unique(np.concatenate(parts)) for parts in chosen.values())
        if any(len(cells) for cells in region):
            regions[name] = region
    return regions


def _dependents(raw: RawMesh, number: np.ndarray, points: np.ndarray) -> Dependents:
    """Return the equations of dependent nodes.

    number: the node of the mesh for each node of `raw`, -1 if it is in no cell.
    points: shape (nodes, 3), m.
    """
    nodes, masters, weights = map(np.array, zip(*raw.follow, strict=True))
    try:
        return Dependents.of(len(points), Entries(number[nodes], number[masters], weights))
    except CircularError as error:
        at = point_text(points[error.node])
        message = f"has equations by which the node at {at} m follows itself; remove one of them"
        raise MeshFileError(message) from None


def _without_twins(nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows to keep of cells that may occur twice, and each row's index among these.

    gmsh's 2.2 format writes a cell once for each group it is in; kept twice, it would be twice as
    stiff.
    """
    _, first, twin_of = np.unique(
        np.sort(nodes, axis=1), axis=0, return_index=True, return_inverse=True
    )
    rows = np.sort(first)
    return rows, np.searchsorted(rows, first[twin_of.ravel()])


def _facet_groups(
    raw: RawMesh, number: np.ndarray, blocks: tuple[CellBlock, ...]
) -> dict[str, FacetGroup]:
    """Return the groups of surface elements (gmsh, VTK) and of faces of cells (Abaqus)."""
    chosen = {name: list(parts) for name, parts in raw.facet_sets.items()}
    for name, numbers in raw.element_sets.items():
        pairs = zip(raw.blocks, numbers, strict=True)
        parts = [(k, nodes[c]) for (k, nodes), c in pairs if k in NODES_PER_FACET and len(c)]
        if parts:
            chosen.setdefault(name, []).extend(parts)
    finder = FaceFinder(blocks)
    groups = {}
    for name, facets in chosen.items():
        results = [finder.find(kind, number[nodes]) for kind, nodes in facets]
        lost = sum(missing for _, missing in results)
        if lost:
            raise MeshFileError(
                f'has facets in the group "{name}" that are not faces of a solid cell ({lost} of '
                "them); mesh the surface and the solid together, or leave the group out"
            )
        by_kind: dict[str, list[np.ndarray]] = {}
        for kind, nodes in (face for faces, _ in results for face in faces):
            by_kind.setdefault(kind, []).append(nodes)
        if by_kind:
            parts = [FacetBlock(kind, np.concatenate(nodes)) for kind, nodes in by_kind.items()]
            groups[name] = FacetGroup(tuple(parts))
    return groups


def _node_groups(raw: RawMesh, number: np.ndarray) -> dict[str, np.ndarray]:
    """Return the used nodes of each set; an element set has the nodes of its line elements.

    number: the node of the mesh for each node of `raw`, -1 if it is in no cell.
    """
    groups = {}
    for name, numbers in raw.element_sets.items():
        pairs = zip(raw.blocks, numbers, strict=True)
        on_lines = [nodes[c].ravel() for (kind, nodes), c in pairs if kind in NODES_PER_LINE]
        groups[name] = np.concatenate([np.empty(0, dtype=np.int64), *on_lines])
    for name, nodes in raw.node_sets.items():
        groups[name] = np.concatenate([groups.get(name, np.empty(0, dtype=np.int64)), nodes])
    used = {name: np.unique(number[nodes]) for name, nodes in groups.items()}
    used = {name: nodes[nodes >= 0] for name, nodes in used.items()}
    return {name: nodes for name, nodes in used.items() if len(nodes)}
