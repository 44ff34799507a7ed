"""The deformable body: all cells with their materials, less the nodes that are held."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from fea.assembly.blocks import filled_cells
from fea.linalg.multifrontal import Factor
from fea.linalg.nested_dissection import Dissection, dissect, unknowns_of
from fea.mesh.mesh import Mesh

Array = np.ndarray


class Body:
    """Cells, and the free nodes in their order of elimination.

    Parameters
    ----------
    mesh
        Every point belongs to a cell.
    young, poisson
        For each block of the mesh, shape (cells,): Young's modulus (Pa) and Poisson's ratio.
    free
        Shape (n,), bool: the nodes whose displacement is unknown.
    integration
        ``"reduced"`` or ``"full"``, for hex20.

    Raises
    ------
    SolveFailed
        ``inverted_elements`` or ``locking_material``.
    """

    def __init__(
        self,
        mesh: Mesh,
        young: Sequence[Array],
        poisson: Sequence[Array],
        free: Array,
        integration: str = "reduced",
    ) -> None:
        self.points = mesh.points
        self.free = free
        filled = filled_cells(mesh, young, poisson, integration)
        self.cells = [block.nodes for block, _ in filled]
        self.parts = [stiffness for _, stiffness in filled]

    @property
    def size(self) -> int:
        """Number of nodes."""
        return len(self.points)

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
        """Where the entries of the cells go in the leaves of the dissection."""
        bounds = np.cumsum([0, *(len(block) for block in self.cells)])
        return [
            _Scatter(self.dissection, block, int(first))
            for block, first in zip(self.cells, bounds[:-1], strict=True)
        ]

    def forces(
        self, displacement: Array, step: tuple[Array, Array] | None = None
    ) -> tuple[Array, float, float]:
        """Return the internal nodal forces, the strain energy and the least det F.

        Parameters
        ----------
        displacement
            Shape (n, 3), m.
        step
            The last step of Newton's method, two fields of shape (n, 3), m: see `tangent`.

        Returns
        -------
        forces
            Shape (n, 3), N.
        energy
            J.
        least
            Smallest determinant of the deformation gradient over all quadrature points.
        """
        total, energy, least = np.zeros_like(displacement), 0.0, np.inf
        for part, nodes in zip(self.parts, self.cells, strict=True):
            forces, own_energy, own_least = part.forces(
                gather(displacement, nodes), _gather_pair(step, nodes)
            )
            total += self._sum(forces, nodes)
            energy += own_energy
            least = min(least, own_least)
        return total, energy, least

    def tangent(
        self,
        displacement: Array | None,
        step: tuple[Array, Array] | None = None,
        reuse: Tangent | None = None,
    ) -> Tangent:
        """Return the tangent stiffness.

        Parameters
        ----------
        displacement
            Shape (n, 3), m; None for the undeformed state.
        step
            Of Newton's method, the last one: the displacement it aimed at and the change, both
            linear in the unknowns, shape (n, 3), m. Then the stress in the tangent is the one
            extrapolated linearly from the state before that step: the iteration of Magisano,
            Leonetti and Garcea ("mixed integration points", 2017). Slender parts need several
            times fewer iterations with it, as a large step's false membrane strain no longer
            stiffens the next one. The two tangents agree as the steps vanish.
        reuse
            Gives up its memory to the new one.
        """
        matrices = reuse.matrices if reuse is not None else self._blank()
        for part, nodes, out in zip(self.parts, self.cells, matrices, strict=True):
            moved = None if displacement is None else gather(displacement, nodes)
            part.tangent(moved, _gather_pair(step, nodes), out)
        return Tangent(self, matrices)

    def small_strain_forces(self, fields: Array) -> Array:
        """Return the nodal forces of small displacement fields by way of their stresses.

        More exact than the stiffness matrix times the field: the matrix holds a rigid motion's zero
        force only to roundoff of its entries.

        Parameters
        ----------
        fields
            Shape (n, 3, k), m.

        Returns
        -------
        Array
            Shape (n, 3, k), N.
        """
        total = np.zeros_like(fields)
        for part, nodes in zip(self.parts, self.cells, strict=True):
            forces = part.small_strain_forces(np.moveaxis(gather(fields, nodes), -1, 0))
            for k, own in enumerate(forces):
                total[:, :, k] += self._sum(own, nodes)
        return total

    def strain_energy_products(self, fields: Array) -> Array:
        """Return twice the mutual strain energies of small displacements, from their strains.

        Parameters
        ----------
        fields
            Shape (n, 3, k), m.

        Returns
        -------
        Array
            Shape (k, k), J.
        """
        total = np.zeros((fields.shape[2],) * 2)
        for part, nodes in zip(self.parts, self.cells, strict=True):
            total += part.strain_energy_products(np.moveaxis(gather(fields, nodes), -1, 0))
        return total

    def _blank(self) -> list[Array]:
        return [np.empty((len(part), part.size, part.size)) for part in self.parts]

    def _sum(self, forces: Array, nodes: Array) -> Array:
        unknowns = np.moveaxis(unknowns_of(nodes), 2, 1)
        total = np.bincount(unknowns.ravel(), forces.ravel(), minlength=3 * self.size)
        return total.reshape(-1, 3)


class Tangent:
    """The cells' tangent matrices at one state, and their factor once it is asked for.

    Attributes
    ----------
    matrices
        For each block, shape (cells, size, size), N/m.
    """

    def __init__(self, body: Body, matrices: list[Array]) -> None:
        self._body = body
        self.matrices = matrices

    @cached_property
    def factor(self) -> Factor:
        """The factor over the free nodes."""
        leaves: dict[int, Array] = {}
        diagonal = np.zeros(self._body.dissection.unknowns + 1)
        for scatter, matrices in zip(self._body.scatter, self.matrices, strict=True):
            scatter.add(matrices, leaves, diagonal)
        return Factor(self._body.dissection, leaves, diagonal[:-1])

    @property
    def scaled_norm(self) -> float:
        """Bound of the 1-norm of the matrix scaled to a unit diagonal."""
        scale = np.append(1.0 / np.sqrt(self.factor.diagonal), 0.0)
        sums = np.zeros_like(scale)
        for scatter, matrices in zip(self._body.scatter, self.matrices, strict=True):
            own = (np.abs(matrices) @ scale[scatter.diagonal][..., None])[..., 0]
            sums += np.bincount(scatter.diagonal.ravel(), own.ravel(), minlength=sums.size)
        return float((scale * sums).max(initial=1.0))

    def times(self, fields: Array, nodes: Array) -> Array:
        """Multiply by displacement fields that are zero at all but the given nodes.

        Parameters
        ----------
        fields
            Shape (n, 3, k), m.
        nodes
            Where a field may differ from zero.

        Returns
        -------
        Array
            Shape (n, 3, k), N.
        """
        total = np.zeros_like(fields)
        moved = np.zeros(len(fields), dtype=bool)
        moved[nodes] = True
        for matrices, cells in zip(self.matrices, self._body.cells, strict=True):
            touched = np.flatnonzero(moved[cells].any(axis=1))
            if not touched.size:
                continue
            own = gather(fields, cells[touched])
            forces = matrices[touched] @ own.reshape(
                touched.size, matrices.shape[1], fields.shape[2]
            )
            np.add.at(total, cells[touched], np.moveaxis(forces.reshape(own.shape), 1, 2))
        return total

    def solve(self, loads: Array) -> Array:
        """Solve for nodal loads, shape (n, 3, k), N; what acts on nodes that are held is ignored.

        The displacements have shape (n, 3, k), m, and are zero at nodes that are held.
        """
        order = self._body.dissection.nodes
        found = np.zeros_like(loads)
        columns = loads[order].reshape(3 * order.size, loads.shape[2])
        found[order] = self.factor.solve(columns).reshape(order.size, 3, loads.shape[2])
        return found


class _Scatter:
    """Where the entries of one block's cell matrices go."""

    def __init__(self, dissection: Dissection, nodes: Array, first: int) -> None:
        positions = np.moveaxis(unknowns_of(dissection.positions[nodes]), 2, 1)
        held = np.broadcast_to(dissection.positions[nodes][:, None, :] < 0, positions.shape)
        positions = np.where(held, -1, positions).reshape(len(nodes), -1)
        self.diagonal = np.where(positions < 0, dissection.unknowns, positions)
        self.leaves: list[tuple[int, int, Array, Array]] = []
        for number, part in enumerate(dissection.substructures):
            cells = part.cells[(part.cells >= first) & (part.cells < first + len(nodes))] - first
            if part.children or not cells.size:
                continue
            size = part.eliminated + part.boundary.size
            own = positions[cells]
            local = np.where(own < 0, size, part.find(np.maximum(own, 0)))
            self.leaves.append((number, size + 1, cells, local))

    def add(self, matrices: Array, leaves: dict[int, Array], diagonal: Array) -> None:
        """Add the cells to the leaves' matrices; the last row and column collect held unknowns."""
        entries = np.diagonal(matrices, axis1=1, axis2=2)
        diagonal += np.bincount(self.diagonal.ravel(), entries.ravel(), minlength=diagonal.size)
        for number, size, cells, local in self.leaves:
            flat = local[:, :, None] * size + local[:, None, :]
            matrix = np.bincount(flat.ravel(), matrices[cells].ravel(), minlength=size * size)
            matrix = matrix.reshape(size, size)[:-1, :-1]
            leaves[number] = leaves[number] + matrix if number in leaves else matrix


def gather(fields: Array, nodes: Array) -> Array:
    """Take the values of each cell's nodes: shapes (n, 3, ...) -> (cells, 3, nodes, ...).

    The unit stays what it is, m for displacements; `nodes` are indices, shape (cells, nodes).
    """
    return np.moveaxis(fields[nodes], 2, 1)


def _gather_pair(step: tuple[Array, Array] | None, nodes: Array) -> Array | None:
    return None if step is None else np.stack([gather(fields, nodes) for fields in step])
