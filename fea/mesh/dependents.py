"""Nodes whose displacement is a sum of others': ties of two surfaces, cuts of bolts, equations.

The displacement in a cell with such nodes, sum_a N_a u_a with u_a = sum_j w_aj u_j, is sum_j M_j
u_j with M_j = sum_a w_aj N_a: the cell has other shape functions, on other nodes. Its forces,
tangents, higher derivatives and energies at finite displacements are then computed as those of any
cell. This is the elimination of dependent unknowns, which is exact. Penalties would change the
condition of the equations, and multipliers their definiteness.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components


class CircularError(ValueError):
    """A node depends on itself through others; `node` is its index."""

    def __init__(self, node: int) -> None:
        super().__init__(f"node {node} depends on itself")
        self.node = node


class Entries(NamedTuple):
    """Terms of the displacements of dependent nodes, e of them."""

    nodes: np.ndarray  # shape (e,), int64: the dependent node of each term
    masters: np.ndarray  # shape (e,), int64: the node that moves it
    weights: np.ndarray  # shape (e,): part of the master's displacement

    @classmethod
    def concatenate(cls, parts: Sequence[Entries]) -> Entries:
        """Return all terms of several parts, at least one."""
        return cls(*map(np.concatenate, zip(*parts, strict=True)))


@dataclass(frozen=True, eq=False)
class Dependents:
    """Nodes whose displacements follow from those of other nodes."""

    nodes: np.ndarray  # shape (d,), int64: the dependent nodes, which are no unknowns, ascending
    # Shape (n, n): displacements of all nodes by those of the others; the row of an independent
    # node is that of the identity, the column of a dependent node is empty.
    map: csr_array

    @classmethod
    def of(cls, size: int, entries: Entries) -> Dependents:
        """Return dependents of n = `size` nodes.

        Masters that are dependent themselves are replaced by their masters.

        Raises CircularError if a node depends on itself.
        """
        nodes, masters, weights = entries
        dependent = np.unique(nodes)
        free = np.setdiff1d(np.arange(size), dependent)
        rows, columns = np.append(nodes, free), np.append(masters, free)
        values = np.append(weights, np.ones(len(free)))
        direct = csr_array(coo_array((values, (rows, columns)), (size, size)))
        among = csr_array(direct[dependent][:, dependent])
        among.eliminate_zeros()
        _, part = connected_components(among, connection="strong")
        circular = (np.bincount(part)[part] > 1) | (among.diagonal() != 0)
        if circular.any():
            raise CircularError(int(dependent[circular][0]))
        follow = direct
        while np.isin(follow.indices, dependent).any():  # the longest chain halves
            follow = csr_array(follow @ follow)
            follow.eliminate_zeros()
        return cls(dependent, follow)

    @property
    def entries(self) -> Entries:
        """The terms of all dependent nodes."""
        rows = self.map[self.nodes].tocoo()
        return Entries(self.nodes[rows.row], rows.col, rows.data)

    def of_first(self, size: int) -> Dependents | None:
        """Return the dependents among the first `size` nodes with masters among them, if any."""
        nodes, masters, weights = self.entries
        valid = ~np.isin(nodes, nodes[masters >= size]) & (nodes < size)
        entries = Entries(nodes[valid], masters[valid], weights[valid])
        return Dependents.of(size, entries) if valid.any() else None

    def expanded(self, fields: np.ndarray) -> np.ndarray:
        """Return displacement fields (n, 3, ...), m, with those of the dependent nodes set."""
        return (self.map @ fields.reshape(len(fields), -1)).reshape(fields.shape)

    def among(self, cells: np.ndarray) -> np.ndarray:
        """Return which cells, nodes of shape (m, a), have dependent nodes: (m,), bool."""
        return np.asarray(np.isin(cells, self.nodes).any(axis=1))

    def outer(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the nodes that move cells of nodes (m, a): (m, s), and weights, (m, a, s).

        A cell of fewer outer nodes than others repeats its last, with zero weights.
        """
        rows = [csr_array(self.map[nodes]) for nodes in cells]
        outer = [np.unique(row.indices) for row in rows]
        width = max(len(nodes) for nodes in outer)
        weights = np.zeros((*cells.shape, width))
        for i, (row, nodes) in enumerate(zip(rows, outer, strict=True)):
            weights[i, :, : len(nodes)] = row[:, nodes].toarray()
        padded = [np.pad(nodes, (0, width - len(nodes)), "edge") for nodes in outer]
        return np.array(padded, dtype=np.int64), weights
