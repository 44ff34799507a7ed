"""The mesh's error at the six unit loads, by recovered stresses.

The outputs being the loads, C - C_h of a compliance is the strain energy of the errors of the unit
loads' fields, pair by pair: C_ij - C_h,ij = a(u_i - u_h,i, u_j - u_h,j). The error of a strain or
stress is estimated by smoother ones (Zienkiewicz and Zhu 1987): in each cell those at the solver's
integration points, where they are most exact (Barlow 1976), are continued to the corners by
least squares and averaged there over the cells of one material by volume; what is interpolated
between those corners stands for the exact field. The solver's points and no others: at the 27
points of a hex20 with reduced integration the strains of a thin plate are thirty times too large.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.spatial import KDTree

from wrenchbook.fea.assembly.body import gather
from wrenchbook.fea.mesh.element_order import FIRST
from wrenchbook.fea.mesh.facets import corners_of_cell
from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.mesh.reference_cell import node_coordinates, reference_element, tabulate
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.tensors import deviator


class _Piece(NamedTuple):
    """Cells of one kind and material."""

    # Shape (2, loads, cells, points, 3, 3): strains and stresses of the unit loads
    fields: np.ndarray
    weights: np.ndarray  # shape (cells, points), m^3
    corners: np.ndarray  # shape (cells, corners), int64: nodes
    functions: np.ndarray  # shape (points, corners): linear shape functions of the corners
    material: int  # index of the material
    # Whether volumetric strains are projected: those at the points then have no meaning
    projected: bool


class RecoveredError(NamedTuple):
    """The mesh's error at unit inputs, by cell."""

    # Shape (k, k), SI, symmetric: the first 6 i rows are displacements of i interfaces
    total: np.ndarray
    cells: np.ndarray  # (k, cells): each cell's part of the diagonal
    centres: np.ndarray  # (cells, 3), m
    sizes: np.ndarray  # (cells,), m: the cells' diameters

    def coarsening(self, other: Mesh) -> np.ndarray:
        """Ratio of another mesh's cell sizes to this mesh's, weighted by each input's error, (k,).

        A mesher that is given twice the size makes smaller cells at short edges.
        """
        blocks = [b.nodes[:, : corners_of_cell(b.kind)] for b in other.blocks]
        centres, sizes = _centres_and_diameters(other.points, blocks)
        ratio = sizes[KDTree(centres).query(self.centres)[1]] / self.sizes
        parts = np.where(self.cells.any(axis=1, keepdims=True), self.cells, 1.0)
        return parts @ ratio / parts.sum(axis=1)


def recovered_error(solver: Solver) -> RecoveredError:
    """Return the estimated error of responses to unit inputs by the mesh.

    A thermal strain is the same in both compared fields, and cancels.

    Raises SolveFailed as `Solver.linear` does.
    """
    pieces = list(_pieces(solver))
    points = solver.component.mesh.points
    # For each material the means of its fields at the nodes, (nodes, 2, loads, 3, 3).
    nodes = len(points)
    totals: dict[int, np.ndarray] = {}
    volumes: dict[int, np.ndarray] = {}
    for piece in pieces:
        loads = piece.fields.shape[1]
        total = totals.setdefault(piece.material, np.zeros((nodes, 2 * loads * 9)))
        volume = volumes.setdefault(piece.material, np.zeros(nodes))
        cell_volumes = piece.weights.sum(axis=1)
        fit = np.linalg.pinv(piece.functions)
        by_cell = piece.fields.transpose(2, 3, 0, 1, 4, 5).reshape(*piece.weights.shape, -1)
        recovered = (fit @ by_cell) * cell_volumes[:, None, None]  # at each cell's corners
        owners = piece.corners.ravel()
        entries = np.ones(owners.size), (owners, np.arange(owners.size))
        sums = coo_array(entries, shape=(nodes, owners.size)).tocsr()
        total += sums @ recovered.reshape(owners.size, -1)
        volume += np.bincount(owners, cell_volumes.repeat(piece.corners.shape[1]), nodes)

    smooth: dict[int, np.ndarray] = {}
    for material, total in totals.items():
        volume = np.where(volumes[material] > 0, volumes[material], 1.0)
        smooth[material] = (total / volume[:, None]).reshape(nodes, 2, -1, 3, 3)
    errors = [_energy(piece, smooth[piece.material]) for piece in pieces]
    total = np.sum([energy for energy, _ in errors], axis=0)
    return RecoveredError(
        0.5 * (total + total.T),
        np.concatenate([cells for _, cells in errors], axis=1),
        *_centres_and_diameters(points, [piece.corners for piece in pieces]),
    )


def _centres_and_diameters(
    points: np.ndarray, blocks: list[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the centres and the largest distances between corners of cells, by their corners."""
    cells = [points[corners] for corners in blocks]
    spans = [np.linalg.norm(cell[:, :, None] - cell[:, None], axis=-1) for cell in cells]
    centres = np.concatenate([cell.mean(axis=1) for cell in cells])
    return centres, np.concatenate([distances.max(axis=(1, 2)) for distances in spans])


def _pieces(solver: Solver) -> Iterator[_Piece]:
    """Yield the cells of each kind and material with the fields of unit loads."""
    component, body = solver.component, solver.body
    unit = solver.linear.fields
    sorts = zip(body.parts, body.cells, body.blocks, solver.volumes, strict=True)
    for part, nodes, block, (numbers, _) in sorts:
        weights = part.gradients.weights
        moved = np.moveaxis(gather(unit, nodes), -1, 0)
        slopes = moved[:, :, None] @ part.gradients.slopes.swapaxes(2, 3)
        strains = 0.5 * (slopes + slopes.swapaxes(-1, -2))
        fields = np.stack([strains, part.small_stresses(moved)])
        functions = _corner_functions(block.kind, component.analysis.integration)
        corners = block.nodes[:, : functions.shape[1]]
        for material in np.unique(numbers).tolist():
            chosen = numbers == material
            yield _Piece(
                fields[:, :, chosen],
                weights[chosen],
                corners[chosen],
                functions,
                material,
                part.projected,
            )


@cache
def _corner_functions(kind: str, integration: str) -> np.ndarray:
    """Return the linear shape functions of a cell's corners at its points, (points, corners)."""
    points = reference_element(kind, integration).values @ node_coordinates(kind)
    return tabulate(FIRST.get(kind, kind), points)[0]


def _energy(piece: _Piece, smooth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return twice the energies (loads, loads) of the fields' differences, and (loads, cells)."""
    cells, corners = piece.corners.shape
    loads = piece.fields.shape[1]
    recovered = piece.functions @ smooth[piece.corners].reshape(cells, corners, -1)
    recovered = recovered.reshape(cells, -1, 2, loads, 3, 3).transpose(2, 3, 0, 1, 4, 5)
    strain, stress = recovered - piece.fields
    if piece.projected:
        strain, stress = deviator(strain), deviator(stress)
    strain = strain * piece.weights[:, :, None, None]
    total = strain.reshape(loads, -1) @ stress.reshape(loads, -1).T
    return total, np.einsum("lcqij,lcqij->lc", strain, stress)
