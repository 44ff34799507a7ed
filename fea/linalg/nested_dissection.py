"""The order of elimination: a tree of nested substructures.

The cells are cut in two, again and again (`fea.linalg.cut`). A leaf is a few cells; each branch
joins two substructures. A node is eliminated at the lowest substructure that holds all its cells,
so what two halves share goes last and stays small. This needs the cells and their centres only, no
graph of the matrix, and gives dense fronts that LAPACK factorises at full speed
(`fea.linalg.multifrontal`). On a 15,000 unknown plate that is several times faster than SuperLU in
its best ordering, minimum degree on A^T + A.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from wrenchbook.fea.linalg.cut import Cutter, Incidence, incidence

Array = np.ndarray

_LEAF_NODES = 256
"""Of its cells, each counting its own: 12 hex20 or 25 tet10.

Fewer make more fronts, whose calls then take longer than their arithmetic (half of a flange of
tetrahedra at 12); more fill in (the factor holds a fifth more at 32 hex20).
"""


@dataclass(eq=False)
class Substructure:
    """One node of the tree. Positions count unknowns in the order of elimination.

    Attributes
    ----------
    cells
        Shape (c,), int64: indices of the cells of a leaf; empty for a branch.
    start, stop
        The unknowns eliminated here are the positions start .. stop - 1.
    boundary
        Shape (b,), int64: ascending positions of the unknowns handed on to the parent.
    children
        Numbers of the two parts in `Dissection.substructures`; empty for a leaf.
    places
        For each child, shape (b of the child,), int64: where its boundary lies among this one's
        unknowns (eliminated first, then the boundary).
    """

    cells: Array
    children: tuple[int, ...]
    start: int = 0
    stop: int = 0
    boundary: Array = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    places: tuple[Array, ...] = ()

    @property
    def eliminated(self) -> int:
        """How many unknowns are eliminated here."""
        return self.stop - self.start

    def find(self, positions: Array) -> Array:
        """Return where positions lie among the unknowns of this substructure.

        Positions and what is returned are indices of one shape, whichever that is.
        """
        inside = positions < self.stop
        return np.where(
            inside,
            positions - self.start,
            self.eliminated + np.searchsorted(self.boundary, positions),
        )


@dataclass(frozen=True, eq=False)
class Dissection:
    """The tree in the order of elimination, children before parents.

    Attributes
    ----------
    substructures
        All nodes of the tree.
    nodes
        Shape (free nodes,): indices of mesh nodes in the order of elimination.
    positions
        Shape (mesh nodes,): place of each mesh node in that order, -1 for nodes that are not free.
    """

    substructures: tuple[Substructure, ...]
    nodes: Array
    positions: Array

    @property
    def unknowns(self) -> int:
        """Three for each free node."""
        return 3 * self.nodes.size


def dissect(cells: list[Array], centres: Array, free: Array) -> Dissection:
    """Cut a mesh into nested substructures.

    Parameters
    ----------
    cells
        The nodes of each cell.
    centres
        Shape (cells, 3), m: where each cell is.
    free
        Shape (mesh nodes,), bool: the nodes whose displacement is unknown.
    """
    builder = _Builder(cells, free, Cutter(centres))
    builder.cut(np.arange(len(cells)), incidence(cells, free))
    return builder.finish()


class _Builder:
    """Collects substructures bottom up; nodes first, positions when all are known."""

    def __init__(self, cells: list[Array], free: Array, cutter: Cutter) -> None:
        self.cells = cells
        self.cutter = cutter
        self.sizes = np.array([len(nodes) for nodes in cells], dtype=np.int64)
        self.free = free
        self.uses = np.zeros(free.size, dtype=np.int64)
        for nodes in cells:
            self.uses[nodes] += 1
        self.parts: list[Substructure] = []
        self.eliminated: list[Array] = []
        self.boundaries: list[Array] = []

    def cut(self, cells: Array, pairs: Incidence) -> tuple[int, Array, Array]:
        """Add the tree over `cells`; return its number, boundary nodes and their uses in it."""
        if cells.size <= 1 or self.sizes[cells].sum() <= _LEAF_NODES:
            nodes = np.concatenate([self.cells[c] for c in cells]) if cells.size else cells
            return self._add(cells, (), nodes, np.ones(nodes.size, dtype=np.int64))
        first, second = self.cutter.halves(cells, pairs)
        left, left_nodes, left_uses = self.cut(*first)
        right, right_nodes, right_uses = self.cut(*second)
        return self._add(
            cells[:0],
            (left, right),
            np.concatenate([left_nodes, right_nodes]),
            np.concatenate([left_uses, right_uses]),
        )

    def _add(
        self, cells: Array, children: tuple[int, ...], nodes: Array, uses: Array
    ) -> tuple[int, Array, Array]:
        nodes, inverse = np.unique(nodes, return_inverse=True)
        uses = np.bincount(inverse, weights=uses, minlength=nodes.size).astype(np.int64)
        is_free = self.free[nodes]
        nodes, uses = nodes[is_free], uses[is_free]
        complete = uses == self.uses[nodes]
        self.parts.append(Substructure(cells, children))
        self.eliminated.append(nodes[complete])
        self.boundaries.append(nodes[~complete])
        return len(self.parts) - 1, nodes[~complete], uses[~complete]

    def finish(self) -> Dissection:
        order = np.concatenate(self.eliminated)
        positions = np.full(self.free.size, -1, dtype=np.int64)
        positions[order] = np.arange(order.size)
        start = 0
        for part, eliminated, boundary in zip(
            self.parts, self.eliminated, self.boundaries, strict=True
        ):
            part.start, part.stop = start, start + 3 * eliminated.size
            part.boundary = unknowns_of(np.sort(positions[boundary])).ravel()
            start = part.stop
            part.places = tuple(part.find(self.parts[c].boundary) for c in part.children)
        return Dissection(tuple(self.parts), order, positions)


def unknowns_of(nodes: Array) -> Array:
    """Return the three unknowns of each node or position, indices of shapes (...) to (..., 3)."""
    return 3 * nodes[..., None] + np.arange(3)
