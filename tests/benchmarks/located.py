"""Fields of one mesh at places of another: what a finer mesh says where a coarser one has nodes."""

import numpy as np
from scipy.spatial import cKDTree

from wrenchbook.fea.mesh.reference_cell import node_coordinates, tabulate

NEAR = 24  # cells tried for a place, the nearest first
INSIDE = 1e-6  # of a cell: a place so little outside is in it
STEPS = 12  # of Newton's method; some cells are curved


class Located:
    """Places within a mesh.

    Parameters
    ----------
    mesh : Mesh
    places : ndarray, shape (n, 3), m
        A place outside all cells, by a curved edge's chord, is continued from the nearest cell.
    """

    def __init__(self, mesh, places):
        self._nodes, self._weights = [None] * len(places), [None] * len(places)
        self.outside = np.full(len(places), np.inf)
        for block in mesh.blocks:
            tree = cKDTree(mesh.points[block.nodes].mean(axis=1))
            _, near = tree.query(places, min(NEAR, len(block.nodes)))
            for nearest in near.reshape(len(places), -1).T:
                some = np.flatnonzero(self.outside > INSIDE)
                if len(some):
                    self._try(mesh.points, block.kind, block.nodes[nearest[some]], some, places)

    def _try(self, points, kind, cells, some, places):
        """Take cells, (k, nodes), for some places if these lie less outside of them."""
        weights, outside = within(kind, points[cells], places[some])
        for place in np.flatnonzero(outside < self.outside[some]):
            whole = some[place]
            self.outside[whole] = outside[place]
            self._nodes[whole], self._weights[whole] = cells[place], weights[place]

    def __call__(self, field):
        """Return a nodal field, (nodes, ...), at the places, (n, ...)."""
        pairs = zip(self._weights, self._nodes, strict=True)
        return np.array([np.tensordot(weights, field[nodes], 1) for weights, nodes in pairs])


def within(kind, corners, places):
    """Return shape functions (k, nodes) at places (k, 3), and how far outside these lie, (k,)."""
    xi = np.tile(node_coordinates(kind).mean(axis=0), (len(places), 1))
    for _ in range(STEPS):
        values, slopes = tabulate(kind, xi)
        rest = places - np.einsum("kn,knd->kd", values, corners)
        jacobian = np.einsum("knd,kne->kde", corners, slopes)
        xi = np.clip(xi + np.linalg.solve(jacobian, rest[:, :, None])[:, :, 0], -1.0, 2.0)
    values, _ = tabulate(kind, xi)
    missed = np.abs(places - np.einsum("kn,knd->kd", values, corners)).max(axis=1)
    beyond = xi.sum(axis=1) if kind.startswith("tet") else xi.max(axis=1)
    outside = np.maximum(np.maximum(-xi.min(axis=1), beyond - 1.0), 0.0)
    lost = missed > 1e-6 * np.ptp(corners, axis=1).max(axis=1)
    return values, np.where(lost, 9.0, outside)
