"""The mesh as plain arrays: the result of generators and mesh files, and the input of the solver.

All lengths are metres. Nodes within a cell or facet follow the VTK order, which is meshio's as
well: corners first, then the midside nodes in the order of the edges, then (``quad9``, ``hex27``)
face centres and the body centre. The arrays are not copied; treat them as read-only.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from wrenchbook.fea.mesh.deck_content import DeckContent

if TYPE_CHECKING:  # a process that only reads bundles does not import sparse matrices
    from wrenchbook.fea.mesh.dependents import Dependents

NODES_PER_CELL: dict[str, int] = {
    "hex8": 8,
    "hex20": 20,
    "hex27": 27,
    "tet4": 4,
    "tet10": 10,
    "wedge6": 6,
    "wedge15": 15,
    "pyramid5": 5,
    "pyramid13": 13,
}
"""Nodes of each kind of cell."""

NODES_PER_FACET: dict[str, int] = {"quad4": 4, "quad8": 8, "quad9": 9, "tri3": 3, "tri6": 6}
"""Nodes of each kind of facet."""


@dataclass(frozen=True, eq=False)
class CellBlock:
    """Cells of one kind."""

    kind: str  # a key of `NODES_PER_CELL`
    nodes: np.ndarray  # shape (m, k), int64: the nodes of each cell in VTK order

    def __post_init__(self) -> None:
        _require_columns(self.kind, self.nodes, NODES_PER_CELL)

    def __len__(self) -> int:
        return len(self.nodes)


class FacetBlock(NamedTuple):
    """Facets of one kind."""

    kind: str  # a key of `NODES_PER_FACET`
    nodes: np.ndarray  # shape (f, k), int64: indices of the nodes of each facet in VTK order


@dataclass(frozen=True, eq=False)
class FacetGroup:
    """A named part of the surface; each facet lists its nodes, so that no cell is needed."""

    blocks: tuple[FacetBlock, ...]

    def __post_init__(self) -> None:
        for kind, nodes in self.blocks:
            _require_columns(kind, nodes, NODES_PER_FACET)

    @property
    def node_ids(self) -> np.ndarray:
        """Sorted indices of the nodes of the group, each once, shape (k,), int64."""
        return np.unique(np.concatenate([nodes.ravel() for _, nodes in self.blocks]))


@dataclass(frozen=True, eq=False)
class Mesh:
    """Points, cells and the named groups of both."""

    points: np.ndarray  # shape (n, 3), metres
    blocks: tuple[CellBlock, ...]  # the cells; several blocks may have the same kind
    # For each cell group one array of cell indices, shape (m,), int64, per block of `blocks` (empty
    # where the block has none of its cells). Regions may overlap; a cell may be in none.
    regions: Mapping[str, tuple[np.ndarray, ...]] = field(default_factory=dict)
    # Named parts of the surface
    facet_groups: Mapping[str, FacetGroup] = field(default_factory=dict)
    # Named sets of nodes, each of shape (k,), int64
    node_groups: Mapping[str, np.ndarray] = field(default_factory=dict)
    # Other contents of the mesh's input deck; None for other meshes
    deck: DeckContent | None = None
    dependents: Dependents | None = None  # nodes that depend on others
    # Weights that a deck gives to nodes, by their group: nodes, shape (k,), int64, -1 for nodes in
    # no cell, and weights, shape (k,), of any scale. Other nodes of the group have none.
    node_weights: Mapping[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)

    @property
    def unknowns(self) -> int:
        """Degrees of freedom before supports and couplings: three for each used node."""
        used = np.unique(np.concatenate([block.nodes.ravel() for block in self.blocks])).size
        return 3 * int(used - (0 if self.dependents is None else len(self.dependents.nodes)))

    @property
    def cell_counts(self) -> dict[str, int]:
        """Number of cells of each kind, of which there may be several blocks."""
        counts = Counter[str]()
        for block in self.blocks:
            counts[block.kind] += len(block)
        return dict(counts)


def row_numbers(rows: np.ndarray) -> np.ndarray:
    """Return the ranks of rows of indices (or -1), (k, c) to (k,): as `numpy.unique`, faster."""
    numbers = rows[:, 0]
    above = int(rows.max(initial=0)) + 2
    for column in rows.T[1:]:
        numbers = np.unique(numbers * above + column, return_inverse=True)[1]
    return numbers


def _require_columns(kind: str, nodes: np.ndarray, columns: dict[str, int]) -> None:
    if kind not in columns:
        raise ValueError(f"the kind must be one of {', '.join(columns)}, not {kind!r}")
    if nodes.ndim != 2 or nodes.shape[1] != columns[kind]:
        raise ValueError(
            f"{kind} cells need an array of shape (n, {columns[kind]}), not {nodes.shape}"
        )
