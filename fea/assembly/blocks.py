"""Cells with their materials, in parts of one law each, with or without pressure projection."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import product

import numpy as np

from wrenchbook.fea.element.cell_stiffness import CellStiffness
from wrenchbook.fea.element.neo_hookean import NeoHookeanStiffness
from wrenchbook.fea.element.pressure_projection import projects, require_no_locking, volume_modes
from wrenchbook.fea.element.st_venant_kirchhoff import (
    IsotropicStiffness,
    OrthotropicStiffness,
    turned_elasticity,
)
from wrenchbook.fea.mesh.mapping import Gradients, cell_gradients
from wrenchbook.fea.mesh.mesh import CellBlock, Mesh
from wrenchbook.fea.mesh.reference_cell import reference_element
from wrenchbook.fea.spec.material import LAWS, AnyMaterial

# For each law the cells of materials with a Young's modulus and a Poisson's ratio.
_OF_TWO_CONSTANTS = {"isotropic": IsotropicStiffness, "neo-hookean": NeoHookeanStiffness}


def filled_cells(
    mesh: Mesh,
    materials: Sequence[AnyMaterial],
    numbers: Sequence[np.ndarray],
    integration: str,
    axes: np.ndarray | None = None,
    origin: np.ndarray | None = None,
) -> list[tuple[CellBlock, CellStiffness]]:
    """Return the cells in parts of one law each, with their stiffness.

    numbers: for each block of the mesh, shape (cells,): the index of each cell's material.
    integration: ``"reduced"`` or ``"full"``, for hex20.
    axes: shape (3, 3): row i is the mesh's axis i in the bundle's axes; None if they are the same.
    origin: shape (3,), m: origin of the mesh's points, in the bundle's axes.

    Raises SolveFailed of kind ``inverted_elements`` or ``locking_material`` if cells cannot be
    used.
    """
    frame = np.eye(3) if axes is None else axes
    start = np.zeros(3) if origin is None else origin
    filled = []
    for block, number, chosen, law, projected in sorted_cells(mesh, materials, numbers):
        part = CellBlock(block.kind, block.nodes[chosen])
        cell_materials = [materials[i] for i in number[chosen]]
        gradients = cell_gradients(mesh.points, part, integration)
        modes = None
        if projected:
            modes = volume_modes(mesh.points, part, gradients.weights, integration)
        values = reference_element(part.kind, integration).values
        points = values @ mesh.points[part.nodes] @ frame + start
        if mesh.dependents is not None and mesh.dependents.among(part.nodes).any():
            gradients = gradients.of_outer(mesh.dependents.outer(part.nodes)[1])
        filled.append((part, _stiffness(law, gradients, cell_materials, modes, frame, points)))
    return filled


def sorted_cells(
    mesh: Mesh, materials: Sequence[AnyMaterial], numbers: Sequence[np.ndarray]
) -> Iterator[tuple[CellBlock, np.ndarray, np.ndarray, str, bool]]:
    """Yield the parts in their order.

    Each part is the block of its cells with their materials, shape (cells,), the mask of its cells,
    shape (cells,), their law, and whether their volumetric strain is projected. Cells with
    dependent nodes are parts of their own.

    Raises SolveFailed of kind ``locking_material`` if the kind of a cell locks with its material.
    """
    poisson = np.array([material.poisson_ratio for material in materials])
    laws = np.array([LAWS.index(material.law) for material in materials])
    for block, number in zip(mesh.blocks, numbers, strict=True):
        require_no_locking(block, poisson[number])
        for law in np.unique(laws[number]):
            projected = projects(block, poisson[number])
            follows = np.zeros(len(block), dtype=bool)
            if mesh.dependents is not None:
                follows = mesh.dependents.among(block.nodes)
            for is_projected, is_following in product((False, True), repeat=2):
                chosen = (projected == is_projected) & (follows == is_following)
                chosen &= laws[number] == law
                if chosen.any():
                    yield block, number, chosen, LAWS[law], is_projected


def _stiffness(
    law: str,
    gradients: Gradients,
    materials: list[AnyMaterial],
    modes: np.ndarray | None,
    frame: np.ndarray,
    points: np.ndarray,
) -> CellStiffness:
    """Return the cells of one law; `frame` and `points` are as of `_directions`."""
    directions = _directions(materials, frame, points)
    # Thermal strains per kelvin, (cells, points or 1, 3, 3), 1/K; None without expansion.
    if any(material.thermal_expansion is None for material in materials):
        expansion = None
    else:
        expansion = _by_cell(
            (cells, (rows.swapaxes(-1, -2) * np.array(material.thermal_expansion)) @ rows)
            for material, cells, rows in directions
        )
    if law == "orthotropic":
        elasticity = _by_cell(
            (cells, turned_elasticity(material.orthotropic.elasticity, rows))
            for material, cells, rows in directions
            if material.orthotropic is not None
        )
        return OrthotropicStiffness(gradients, elasticity, expansion=expansion)
    young = np.array([material.youngs_modulus for material in materials])
    poisson = np.array([material.poisson_ratio for material in materials])
    shear = young / (2 * (1 + poisson))
    first_lame = 2 * shear * poisson / (1 - 2 * poisson)
    return _OF_TWO_CONSTANTS[law](gradients, first_lame, shear, modes, expansion=expansion)


def _directions(
    materials: list[AnyMaterial], frame: np.ndarray, points: np.ndarray
) -> list[tuple[AnyMaterial, np.ndarray, np.ndarray]]:
    """Return each material, its cells (k,) and its directions there, (k, points or 1, 3, 3).

    frame: the axes of the result, (3, 3). points: the integration points in the bundle's axes,
    (cells, points, 3), m. Directions that are the same at all points of a cell are stored once.
    """
    groups = []
    for chosen in {id(material): material for material in materials}.values():
        cells = np.array([k for k, material in enumerate(materials) if material is chosen])
        orthotropic = chosen.orthotropic
        if orthotropic is None:
            directions = np.broadcast_to(np.eye(3), (len(cells), 1, 3, 3))
        else:
            at = points[cells] if orthotropic.cylinder else points[cells, :1]
            directions = orthotropic.directions(at) @ frame.T
        groups.append((chosen, cells, directions))
    return groups


def _by_cell(parts: Iterable[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Return tensors of some cells each as an array by cell, (cells, points or 1, ...)."""
    parts = list(parts)
    points = max(tensors.shape[1] for _, tensors in parts)
    out = np.empty((sum(len(cells) for cells, _ in parts), points, *parts[0][1].shape[2:]))
    for cells, tensors in parts:
        out[cells] = tensors
    return out
