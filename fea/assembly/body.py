"""The deformable body: all cells with their materials, and the free nodes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from copy import copy
from functools import cached_property
from typing import NamedTuple

import numpy as np

from wrenchbook.fea.element.cell_state import CellState
from wrenchbook.fea.element.cell_stiffness import CellStiffness
from wrenchbook.fea.linalg.multifrontal import MultifrontalFactor, NotDefinite
from wrenchbook.fea.linalg.nested_dissection import Dissection, dissect, unknowns_of
from wrenchbook.fea.mesh.mesh import CellBlock, Mesh
from wrenchbook.fea.tensors import TINY

_AT_A_TIME = 256
"""Cells whose matrices are in memory at once."""

_FIELDS_AT_A_TIME = 1024
"""Cells whose six nodal fields are in memory at once: 1.5 to 3 MB (23 MB for 8,100 cells)."""

SINGLE_NUMBERS = 30e6
"""Least size of a factor of the undeformed body in single precision: 0.24 GB in double precision.

A solve then takes 0.55 to 0.7 of the memory and 0.6 to 1.0 of the time; a smaller factor saves no
time.
"""

_SINGLE_STEPS = 6  # steps of refinement by the stresses; each leaves 1e-5 to 1e-2 of the error
_SINGLE_ERROR = 1e-13  # relative error of a solve in double precision on the same parts

_STEP = 0.05  # K: the difference's error is the square of its thermal strain


class Movable:
    """The free nodes, and the directions in which sliding ones are held.

    A sliding node keeps its three unknowns: in a held direction its stiffness is replaced by a
    number without coupling, so that no other displacement depends on it.

    free: shape (n,), bool: the nodes whose displacement is unknown.
    held: sliding nodes of a component, shape (k,), and projectors on their held directions, shape
    (k, 3, 3), dimensionless. Nodes among them that are not free are ignored.
    """

    def __init__(self, free: np.ndarray, held: tuple[np.ndarray, np.ndarray]) -> None:
        self.free = free
        chosen = free[held[0]]
        self._nodes, self._held = held[0][chosen], held[1][chosen]
        self._held_index = np.full(free.size, -1)
        self._held_index[self._nodes] = np.arange(self._nodes.size)

    def released(self, fields: np.ndarray) -> np.ndarray:
        """Return fields (n, 3, ...) with zeros at nodes and in directions that are held."""
        free = np.where(self.free.reshape(-1, *[1] * (fields.ndim - 1)), fields, 0.0)
        if self._nodes.size:
            free[self._nodes] -= np.einsum("nij,nj...->ni...", self._held, free[self._nodes])
        return free

    def decoupled(self, matrices: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        """Return cells' matrices (m, 3 s, 3 s), N/m, of nodes (m, s), held directions decoupled.

        Rows of a cell's matrix are ordered by component, then node.
        """
        held_index = self._held_index[nodes]
        touched = np.flatnonzero((held_index >= 0).any(axis=1))
        if not touched.size:
            return matrices
        local = matrices[touched]
        size = matrices.shape[1]
        held = np.zeros((touched.size, 3, nodes.shape[1], 3, nodes.shape[1]))
        cells, corners = np.nonzero(held_index[touched] >= 0)
        held[cells, :, corners, :, corners] = self._held[held_index[touched][cells, corners]]
        held = held.reshape(local.shape)
        free = np.eye(size) - held
        stiffness = np.abs(np.trace(local, axis1=1, axis2=2)) / size
        matrices[touched] = free @ local @ free + stiffness[:, None, None] * held
        return matrices


class ElasticBody:
    """Cells, and the free nodes in their order of elimination.

    mesh: every point belongs to a cell.
    filled: its cells with their material, see `fea.assembly.blocks.filled_cells`.
    free: shape (n,), bool: the nodes whose displacement is unknown; dependent ones are not free.
    held: the nodes that slide, see `Movable`.
    blocks, cells: the nodes of each part's cells, and the nodes that move them, which differ where
    nodes depend on others. Displacements of dependent nodes are ignored, and no force acts on them.
    """

    def __init__(
        self,
        mesh: Mesh,
        filled: Sequence[tuple[CellBlock, CellStiffness]],
        free: np.ndarray,
        held: tuple[np.ndarray, np.ndarray] = (np.empty(0, dtype=np.int64), np.empty((0, 3, 3))),
    ) -> None:
        self.points = mesh.points
        self.dependents = mesh.dependents
        if self.dependents is not None:
            free = free.copy()
            free[self.dependents.nodes] = False
        self.free = free
        self.held = held
        self.movable = Movable(free, held)
        self.blocks = [block for block, _ in filled]
        self.parts = [stiffness for _, stiffness in filled]
        self.cells = [block.nodes for block in self.blocks]
        for i, nodes in enumerate(self.cells):
            if self.dependents is not None and self.dependents.among(nodes).any():
                self.cells[i] = self.dependents.outer(nodes)[0]

    def with_slips(self) -> ElasticBody:
        """Return the same body with the slips of bolts free."""
        other = copy(self)
        other.free = self.free | self.slips
        other.movable = Movable(other.free, self.held)
        for of_free in ("dissection", "scatter", "_leaf_cells"):
            other.__dict__.pop(of_free, None)
        return other

    @property
    def slips(self) -> np.ndarray:
        """Which points belong to no cell, shape (n,), bool: the slips of bolts."""
        slips = np.ones(self.size, dtype=bool)
        for block in self.blocks:
            slips[block.nodes] = False
        return slips

    def expanded(self, fields: np.ndarray) -> np.ndarray:
        """Return fields (n, 3, ...), m, with the displacements of dependent nodes."""
        return fields if self.dependents is None else self.dependents.expanded(fields)

    @property
    def size(self) -> int:
        """Number of nodes."""
        return len(self.points)

    @property
    def expands(self) -> bool:
        """Whether the temperature is an input."""
        return self.parts[0].expansion is not None

    def at(self, temperature: complex, finite: bool = True) -> ElasticBody:
        """Return the body at a temperature, K from the reference; see `CellStiffness.at`."""
        if not self.expands:
            return self
        _ = self.dissection, self.scatter  # computed once for both bodies
        other = copy(self)
        other.parts = [part.at(temperature, finite) for part in self.parts]
        return other

    def thermal_rates(
        self, displacement: np.ndarray, temperature: float = 0.0
    ) -> tuple[np.ndarray, float]:
        """Return the change per kelvin at a displacement, shape (n, 3), m, and a temperature, K.

        The results are the changes of the internal forces, shape (n, 3), N/K, and of the strain
        energy, J/K, by differences which leave out 1e-12 of them.
        """
        ends = (self.at(temperature + step).forces(displacement) for step in (_STEP, -_STEP))
        (forces, energy, _), (others, other, _) = ends
        return (forces - others) / (2 * _STEP), (energy - other) / (2 * _STEP)

    @cached_property
    def extent(self) -> float:
        """Diagonal of the box around the body, m."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0)))

    @cached_property
    def dissection(self) -> Dissection:
        """The order of elimination of the free nodes."""
        cells = [nodes for block in self.cells for nodes in block]
        centres = np.concatenate([self.points[block].mean(axis=1) for block in self.cells])
        return dissect(cells, centres, self.free)

    @cached_property
    def scatter(self) -> list[_Scatter]:
        """The destination of the cells' entries in the leaves of the dissection."""
        bounds = np.cumsum([0, *(len(block) for block in self.cells)])
        return [
            _Scatter(self.dissection, block, int(first))
            for block, first in zip(self.cells, bounds[:-1], strict=True)
        ]

    def leaves_from(self, number: int) -> list[int]:
        """Return the indices of leaves from `number` on that are computed together."""
        leaves, cells_before = self._leaf_cells
        first = int(np.searchsorted(leaves, number))
        last = int(np.searchsorted(cells_before, cells_before[first] + _AT_A_TIME))
        return leaves[first : max(last, first + 1)].tolist()

    @cached_property
    def _leaf_cells(self) -> tuple[np.ndarray, np.ndarray]:
        """The indices of the leaves, and the number of cells in the leaves before each."""
        parts = self.dissection.substructures
        numbers = np.array([i for i, part in enumerate(parts) if not part.children], dtype=int)
        starts = np.cumsum([0, *(parts[i].cells.size for i in numbers)])
        return numbers, starts[:-1]

    def forces(
        self, displacement: np.ndarray, step: tuple[np.ndarray, np.ndarray] | None = None
    ) -> tuple[np.ndarray, float, float]:
        """Return the internal nodal forces, the strain energy and the least det F.

        displacement: shape (n, 3), m.
        step: the last step of Newton's method, two fields of shape (n, 3), m: see `tangent`.
        Returns forces: shape (n, 3), N. energy: J. least: the smallest determinant of the
        deformation gradient over all quadrature points.
        """
        total = np.zeros_like(displacement)
        energy = 0.0
        least = np.inf
        for part, nodes in zip(self.parts, self.cells, strict=True):
            forces, part_energy, part_least = part.forces(
                gather(displacement, nodes), _gather_pair(step, nodes)
            )
            total += self._sum(forces, nodes)
            energy += part_energy
            least = min(least, part_least)
        return total, energy, least

    def tangent(
        self, displacement: np.ndarray | None, step: tuple[np.ndarray, np.ndarray] | None = None
    ) -> Tangent:
        """Return the tangent stiffness.

        displacement: shape (n, 3), m; None for the undeformed state.
        step: the last step of Newton's method: the displacement at which it aimed and the change,
        both linear in the unknowns, shape (n, 3), m. Then the stress in the tangent is that
        extrapolated linearly from the state before that step: the iteration of Magisano, Leonetti
        and Garcea ("mixed integration points", 2017). Slender parts need several times fewer
        iterations with it, as a large step's false membrane strain no longer stiffens the next. The
        two tangents agree as the steps vanish.
        """
        return Tangent(self, displacement, step)

    def small_strain_forces(self, fields: np.ndarray) -> np.ndarray:
        """Return the nodal forces of small displacement fields by way of their stresses.

        They are more exact than the stiffness matrix times the field: the matrix gives a rigid
        motion's zero force only to roundoff of its entries.

        fields: shape (n, 3, k), m.
        Result: shape (n, 3, k), N.
        """
        total = np.zeros_like(fields)
        for part, nodes in zip(self.parts, self.cells, strict=True):
            for first in range(0, len(nodes), _FIELDS_AT_A_TIME):
                local = nodes[first : first + _FIELDS_AT_A_TIME]
                moved = np.moveaxis(gather(fields, local), -1, 0)
                for k, forces in enumerate(part.small_strain_forces(moved, first)):
                    total[:, :, k] += self._sum(forces, local)
        return total

    def strain_energy_products(self, fields: np.ndarray) -> np.ndarray:
        """Return twice the mutual strain energies of small displacements, from their strains.

        fields: shape (n, 3, k), m.
        Result: shape (k, k), J.
        """
        total = np.zeros((fields.shape[2],) * 2)
        for part, nodes in zip(self.parts, self.cells, strict=True):
            for first in range(0, len(nodes), _FIELDS_AT_A_TIME):
                moved = np.moveaxis(gather(fields, nodes[first : first + _FIELDS_AT_A_TIME]), -1, 0)
                total += part.strain_energy_products(moved, first)
        return total

    def derivatives(
        self,
        of: Callable[[CellState, np.ndarray], np.ndarray],
        displacement: np.ndarray,
        fields: np.ndarray,
    ) -> np.ndarray:
        """Return the strain energy's derivatives along fields, (k, k) or (k, k, k), J.

        of: `CellState.second` or `CellState.third`.
        displacement: shape (n, 3), m.
        fields: shape (n, 3, k), m.
        """
        total = 0.0
        for part, nodes in zip(self.parts, self.cells, strict=True):
            for chunk in part.chunks():
                moved = np.moveaxis(gather(fields, nodes[chunk]), -1, 0)
                total = total + of(part.state(chunk, gather(displacement, nodes[chunk])), moved)
        return np.asarray(total)

    def _sum(self, forces: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        unknowns = np.moveaxis(unknowns_of(nodes), 2, 1)
        total = np.bincount(unknowns.ravel(), forces.ravel(), minlength=3 * self.size)
        return total.reshape(-1, 3)


class Tangent:
    """The tangent at one state, factorised at first use.

    The cells' matrices are made when they are needed and deleted after that: all at once they take
    nearly as much memory as the factor.
    """

    def __init__(
        self,
        body: ElasticBody,
        displacement: np.ndarray | None,
        step: tuple[np.ndarray, np.ndarray] | None,
    ) -> None:
        self._body = body
        self._single = displacement is None and body.dissection.numbers > SINGLE_NUMBERS
        self._displacement = displacement
        self._step = step
        self._ready: dict[int, np.ndarray] = {}

    @property
    def matrices(self) -> list[np.ndarray]:
        """All cells' matrices, for each block shape (cells, size, size), N/m."""
        return [self._cells(i, np.arange(len(part))) for i, part in enumerate(self._body.parts)]

    @cached_property
    def factor(self) -> MultifrontalFactor:
        """The factor over the free nodes."""
        if self._single:
            try:
                return MultifrontalFactor(self._body.dissection, self._leaf_matrix, single=True)
            except NotDefinite:
                self._single = False
        return MultifrontalFactor(self._body.dissection, self._leaf_matrix)

    def release(self) -> None:
        """Free the factor's memory; the next use factorises again."""
        self.__dict__.pop("factor", None)

    @property
    def scaled_norm(self) -> float:
        """Bound of the 1-norm of the matrix scaled to a unit diagonal."""
        scale = np.append(1.0 / np.sqrt(self.factor.diagonal), 0.0)
        sums = np.zeros_like(scale)
        for number, scatter in enumerate(self._body.scatter):
            for cells in _batches(np.arange(len(scatter.diagonal))):
                unknowns = scatter.diagonal[cells]
                sizes = self._cells(number, cells)
                scaled = (np.abs(sizes, out=sizes) @ scale[unknowns][..., None])[..., 0]
                sums += np.bincount(unknowns.ravel(), scaled.ravel(), minlength=sums.size)
        return float((scale * sums).max(initial=1.0))

    def _cells(self, number: int, cells: np.ndarray) -> np.ndarray:
        """Return the matrices of some cells of a block, shape (k, size, size), N/m."""
        nodes = self._body.cells[number][cells]
        moved = None if self._displacement is None else gather(self._displacement, nodes)
        matrices = self._body.parts[number].tangent(moved, _gather_pair(self._step, nodes), cells)
        return self._body.movable.decoupled(matrices, nodes)

    def _leaf_matrix(self, number: int) -> np.ndarray:
        """Return the matrix of one leaf; those of a few leaves are computed at once."""
        if number not in self._ready:
            self._ready.clear()  # remains of a factorisation that failed
            leaves = self._body.leaves_from(number)
            for block, scatter in enumerate(self._body.scatter):
                entries = {leaf: scatter.leaves[leaf] for leaf in leaves if leaf in scatter.leaves}
                if not entries:
                    continue
                cells = [entry.cells for entry in entries.values()]
                matrices = self._cells(block, np.concatenate(cells))
                ends = np.cumsum([len(of_leaf) for of_leaf in cells])[:-1]
                parts = np.split(matrices, ends)
                for (leaf, entry), part in zip(entries.items(), parts, strict=True):
                    total = entry.sum(part)
                    self._ready[leaf] = self._ready[leaf] + total if leaf in self._ready else total
        return self._ready.pop(number)

    def times(self, fields: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        """Multiply by displacement fields that are zero at all but the given nodes.

        For other fields the product is right at the given nodes alone.

        fields: shape (n, 3, k), m.
        nodes: indices of the nodes where a field may differ from zero.
        Result: shape (n, 3, k), N.
        """
        total = np.zeros_like(fields)
        moved = np.zeros(len(fields), dtype=bool)
        moved[nodes] = True
        for number, cells in enumerate(self._body.cells):
            for touched in _batches(np.flatnonzero(moved[cells].any(axis=1))):
                local = gather(fields, cells[touched])
                matrices = self._cells(number, touched)
                forces = matrices @ local.reshape(*matrices.shape[:2], fields.shape[2])
                np.add.at(total, cells[touched], np.moveaxis(forces.reshape(local.shape), 1, 2))
        return total

    def solve(self, loads: np.ndarray, rough: bool = False) -> np.ndarray:
        """Solve for nodal loads, shape (n, 3, k), N; loads on fixed nodes are ignored.

        The displacements have shape (n, 3, k), m, and are zero at fixed nodes. With `rough` they
        may have errors of 1e-2.
        """
        order = self._body.dissection.nodes
        displacements = np.zeros_like(loads)
        columns = self._body.movable.released(loads)[order].reshape(3 * order.size, loads.shape[2])
        if not columns.any():  # as at rest: then no factor is needed
            return displacements
        displacements[order] = self.factor.solve(columns).reshape(order.size, 3, loads.shape[2])
        if rough or not self._single:
            return displacements
        largest = np.abs(displacements).max(axis=(0, 1), initial=TINY)
        before = 1.0
        for _ in range(_SINGLE_STEPS):
            change = self.solve(loads - self._body.small_strain_forces(displacements), rough=True)
            displacements += change
            size = float((np.abs(change).max(axis=(0, 1)) / largest).max())
            if size * size / before < _SINGLE_ERROR:  # estimate of the next change
                return displacements
            before = size
        self._single = False  # the refinement does not converge
        self.release()
        return self.solve(loads)


class _Scatter:
    """The destination of one block's cell matrices in the leaves."""

    def __init__(self, dissection: Dissection, nodes: np.ndarray, first: int) -> None:
        positions = np.moveaxis(unknowns_of(dissection.positions[nodes]), 2, 1)
        fixed = np.broadcast_to(dissection.positions[nodes][:, None, :] < 0, positions.shape)
        positions = np.where(fixed, -1, positions).reshape(len(nodes), -1)
        self.diagonal = np.where(positions < 0, dissection.unknowns, positions)
        self.leaves: dict[int, _Leaf] = {}
        for number, part in enumerate(dissection.substructures):
            cells = part.cells[(part.cells >= first) & (part.cells < first + len(nodes))] - first
            if part.children or not cells.size:
                continue
            size = part.eliminated + part.boundary.size
            columns = positions[cells]
            local = np.where(columns < 0, size, part.find(np.maximum(columns, 0)))
            self.leaves[number] = _Leaf(cells, local, size)


class _Leaf(NamedTuple):
    """Cells of one block in a leaf, and the positions of their unknowns in its matrix."""

    cells: np.ndarray
    local: np.ndarray
    size: int

    def sum(self, matrices: np.ndarray) -> np.ndarray:
        """Add up the cells' matrices; a last row and column collect fixed unknowns, cut off."""
        width = self.size + 1
        flat = self.local[:, :, None] * width + self.local[:, None, :]
        matrix = np.bincount(flat.ravel(), matrices.ravel(), minlength=width * width)
        return matrix.reshape(width, width)[:-1, :-1]


def _batches(cells: np.ndarray) -> Iterator[np.ndarray]:
    for first in range(0, len(cells), _AT_A_TIME):
        yield cells[first : first + _AT_A_TIME]


def gather(fields: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Return the values of each cell's nodes: shapes (n, 3, ...) -> (cells, 3, nodes, ...).

    The values keep their unit, m for displacements; `nodes` are indices, shape (cells, nodes).
    """
    return np.moveaxis(fields[nodes], 2, 1)


def _gather_pair(
    step: tuple[np.ndarray, np.ndarray] | None, nodes: np.ndarray
) -> np.ndarray | None:
    return None if step is None else np.stack([gather(fields, nodes) for fields in step])
