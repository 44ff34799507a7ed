"""Cells filled with their material: one part for each law, the projected ones by themselves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from wrenchbook.fea.element.cell_stiffness import CellStiffness
from wrenchbook.fea.element.mapping import Gradients, cell_gradients
from wrenchbook.fea.element.neo_hookean import NeoHookeanStiffness
from wrenchbook.fea.element.orthotropic import OrthotropicStiffness, turned_elasticity
from wrenchbook.fea.element.pressure_projection import projects, require_no_locking, volume_modes
from wrenchbook.fea.element.st_venant_kirchhoff import Stiffness
from wrenchbook.fea.mesh.mesh import CellBlock, Mesh
from wrenchbook.fea.spec.schema import LAWS, Material

Array = np.ndarray


def filled_cells(
    mesh: Mesh,
    materials: Sequence[Material],
    numbers: Sequence[Array],
    integration: str,
    axes: Array | None = None,
) -> list[tuple[CellBlock, CellStiffness]]:
    """Return the cells in parts of one law each, with their stiffness.

    Parameters
    ----------
    mesh
        The cells.
    materials
        What they may be made of.
    numbers
        For each block of the mesh, shape (cells,): the index of each cell's material.
    integration
        ``"reduced"`` or ``"full"``, for hex20.
    axes
        Shape (3, 3): row i is the mesh's axis i in those that the bundle is written in; the same
        unless given.

    Raises
    ------
    SolveFailed
        ``inverted_elements`` or ``locking_material``.
    """
    frame = np.eye(3) if axes is None else axes
    filled = []
    for block, number, chosen, law, projected in sorted_cells(mesh, materials, numbers):
        own = CellBlock(block.kind, block.nodes[chosen])
        one_each = [materials[i] for i in number[chosen]]
        gradients = cell_gradients(mesh.points, own, integration)
        modes = None
        if projected:
            modes = volume_modes(mesh.points, own, gradients.weights, integration)
        filled.append((own, _stiffness(law, gradients, one_each, modes, frame)))
    return filled


def sorted_cells(
    mesh: Mesh, materials: Sequence[Material], numbers: Sequence[Array]
) -> Iterator[tuple[CellBlock, Array, Array, str, bool]]:
    """Yield the parts in their order.

    Each is the block it comes from with its cells' materials, shape (cells,), which of its cells,
    shape (cells,), bool (both dimensionless), their law, and whether their volumetric strain is
    projected.

    Raises
    ------
    SolveFailed
        ``locking_material``.
    """
    poisson = np.array([material.poisson_ratio for material in materials])
    laws = np.array([LAWS.index(material.law) for material in materials])
    for block, number in zip(mesh.blocks, numbers, strict=True):
        require_no_locking(block, poisson[number])
        for law in np.unique(laws[number]):
            projected = projects(block, poisson[number])
            for own in (~projected, projected):
                chosen = own & (laws[number] == law)
                if chosen.any():
                    yield block, number, chosen, LAWS[law], own is projected


def _stiffness(
    law: str, gradients: Gradients, materials: list[Material], modes: Array | None, frame: Array
) -> CellStiffness:
    expansion = _expansion(materials, frame)
    if law == "orthotropic":
        elasticities = {id(m): _elasticity(m, frame) for m in materials}
        elasticity = np.array([elasticities[id(m)] for m in materials])
        return OrthotropicStiffness(gradients, elasticity, expansion=expansion)
    kind = NeoHookeanStiffness if law == "neo-hookean" else Stiffness
    young = np.array([material.youngs_modulus for material in materials])
    poisson = np.array([material.poisson_ratio for material in materials])
    return kind(gradients, *_lame(young, poisson), modes, expansion=expansion)


def _expansion(materials: list[Material], frame: Array) -> Array | None:
    """Return thermal strains per kelvin, shape (cells, 1, 3, 3), 1/K; None for none."""
    found = {}
    for one in materials:
        if one.thermal_expansion is None:
            return None
        own = np.eye(3) if one.orthotropic is None else np.array(one.orthotropic.axes) @ frame.T
        found[id(one)] = (own.T * one.thermal_expansion) @ own
    return np.array([found[id(one)] for one in materials])[:, None]


def _elasticity(material: Material, frame: Array) -> Array:
    own = material.orthotropic
    assert own is not None
    return turned_elasticity(own.elasticity, np.array(own.axes) @ frame.T)


def _lame(young: Array, poisson: Array) -> tuple[Array, Array]:
    shear = young / (2 * (1 + poisson))
    return 2 * shear * poisson / (1 - 2 * poisson), shear
