"""Cells filled with their material, the nearly incompressible ones by themselves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fea.element.mapping import cell_gradients
from fea.element.pressure_projection import projects, require_no_locking, volume_modes
from fea.element.st_venant_kirchhoff import Stiffness
from fea.mesh.mesh import CellBlock, Mesh

Array = np.ndarray


def filled_cells(
    mesh: Mesh, young: Sequence[Array], poisson: Sequence[Array], integration: str
) -> list[tuple[CellBlock, Stiffness]]:
    """Return the cells of each block with their stiffness; a block of both sorts is split.

    Parameters
    ----------
    mesh
        The cells.
    young, poisson
        For each block of the mesh, shape (cells,): Young's modulus (Pa) and Poisson's ratio.
    integration
        ``"reduced"`` or ``"full"``, for hex20.

    Raises
    ------
    SolveFailed
        ``inverted_elements`` or ``locking_material``.
    """
    filled = []
    for block, E, nu in zip(mesh.blocks, young, poisson, strict=True):
        require_no_locking(block, nu)
        projected = projects(block, nu)
        for chosen in (~projected, projected):
            if chosen.any():
                own = CellBlock(block.kind, block.nodes[chosen])
                gradients = cell_gradients(mesh.points, own, integration)
                stiffness = Stiffness(gradients, *_lame(E[chosen], nu[chosen]))
                if chosen is projected:
                    modes = volume_modes(mesh.points, own, gradients.weights, integration)
                    stiffness = replace(stiffness, volume_modes=modes)
                filled.append((own, stiffness))
    return filled


def _lame(young: Array, poisson: Array) -> tuple[Array, Array]:
    shear = young / (2 * (1 + poisson))
    return 2 * shear * poisson / (1 - 2 * poisson), shear
