"""Which displacements are unknowns: nodes that are free, and those of them that slide."""

from __future__ import annotations

import numpy as np

Array = np.ndarray


class Movable:
    """The free nodes, and the directions in which sliding ones are held.

    A sliding node keeps its three unknowns: in a held direction the stiffness is replaced by a
    number that joins it to nothing, so no other displacement depends on it.

    Parameters
    ----------
    free
        Shape (n,), bool: the nodes whose displacement is unknown.
    held
        Of a component: sliding nodes, shape (k,), and projectors on their held directions, shape
        (k, 3, 3), dimensionless. Those that are not free count for nothing.
    """

    def __init__(self, free: Array, held: tuple[Array, Array]) -> None:
        self.free = free
        chosen = free[held[0]]
        self._nodes, self._held = held[0][chosen], held[1][chosen]
        self._place = np.full(free.size, -1)
        self._place[self._nodes] = np.arange(self._nodes.size)

    def released(self, fields: Array) -> Array:
        """Return fields (n, 3, ...) without what acts on, or moves, held nodes and directions."""
        kept = np.where(self.free.reshape(-1, *[1] * (fields.ndim - 1)), fields, 0.0)
        if self._nodes.size:
            kept[self._nodes] -= np.einsum("nij,nj...->ni...", self._held, kept[self._nodes])
        return kept

    def apart(self, matrices: Array, nodes: Array) -> Array:
        """Return cells' matrices (m, 3 s, 3 s), N/m, of nodes (m, s), with held directions apart.

        A row of a cell's matrix is a component and a node, the node running faster.
        """
        places = self._place[nodes]
        touched = np.flatnonzero((places >= 0).any(axis=1))
        if not touched.size:
            return matrices
        own, size = matrices[touched], matrices.shape[1]
        held = np.zeros((touched.size, 3, nodes.shape[1], 3, nodes.shape[1]))
        cells, corners = np.nonzero(places[touched] >= 0)
        held[cells, :, corners, :, corners] = self._held[places[touched][cells, corners]]
        held = held.reshape(own.shape)
        kept = np.eye(size) - held
        stiffness = np.abs(np.trace(own, axis1=1, axis2=2)) / size
        matrices[touched] = kept @ own @ kept + stiffness[:, None, None] * held
        return matrices
