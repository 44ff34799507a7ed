"""The mass of the body: consistent, from the shape functions of the displacements."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import coo_array, csr_array

from wrenchbook.fea.mesh.mesh import CellBlock, Mesh
from wrenchbook.fea.mesh.reference_cell import reference_element

Array = np.ndarray


def consistent_mass(mesh: Mesh, density: Sequence[Array]) -> csr_array:
    """Integrate density N_a N_b over all cells.

    It is the same for each of the three components of a displacement, so it stands once.

    Parameters
    ----------
    mesh
        The cells, in any frame.
    density
        For each block of the mesh, shape (cells,), kg/m^3.

    Returns
    -------
    csr_array
        Shape (n, n), kg; the sum of its entries is the whole mass.
    """
    count = len(mesh.points)
    total = csr_array((count, count))
    for block, own in zip(mesh.blocks, density, strict=True):
        entries = _cell_mass(mesh.points, block, own)
        rows = np.repeat(block.nodes, block.nodes.shape[1], axis=1)
        columns = np.tile(block.nodes, (1, block.nodes.shape[1]))
        places = rows.ravel(), columns.ravel()
        total = total + coo_array((entries.ravel(), places), shape=(count, count)).tocsr()
    return csr_array(total)


def _cell_mass(points: Array, block: CellBlock, density: Array) -> Array:
    """Return the mass matrix of each cell, shape (cells, nodes, nodes), kg."""
    element = reference_element(block.kind, "mass")
    jacobian = points[block.nodes].transpose(0, 2, 1)[:, None] @ element.slopes
    weights = np.linalg.det(jacobian) * element.weights * density[:, None]
    products = element.values[:, :, None] * element.values[:, None, :]
    size = block.nodes.shape[1]
    return (weights @ products.reshape(len(products), -1)).reshape(len(block), size, size)
