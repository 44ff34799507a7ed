"""Nearly incompressible materials: cells that project their volumetric strain, and the functions.

With Poisson's ratio near 1/2 the first Lame constant is thousands of times the shear modulus, and
cells whose shape functions cannot keep their volume at every quadrature point lock: they are too
stiff by any factor, without any warning. The cure is a pressure of fewer functions than points,
discontinuous between cells and condensed in each: tr(E) in the energy is replaced by its L2
projection onto those functions (Hughes, "Generalization of selective integration procedures to
anisotropic and nonlinear media", 1980). The unknowns stay displacements and the stiffness positive
definite.

The linear functions are those of the point in space, not of the reference coordinates: that keeps
the order of convergence on distorted cells (Boffi and Gastaldi, "On the quadrilateral Q2-P1 element
for the Stokes problem", 2002).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wrenchbook.fea.element.cell_stiffness import CellStiffness
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.mesh.mesh import CellBlock
from wrenchbook.fea.mesh.reference_cell import reference_element

NEARLY_INCOMPRESSIBLE = 0.4
"""Poisson's ratio above which the volumetric strain is projected."""

PROJECTED = frozenset({"hex20", "hex27"})
"""Kinds of cells that project, onto four pressure functions: 1 and the coordinates."""

_ROUNDOFF = 1e-9
"""Rounding of a Poisson's ratio: a computed ratio of 0.49 is still at its limit."""

LARGEST_RATIO = {
    "hex8": 0.4,
    "tet4": 0.4,
    "wedge6": 0.4,
    "pyramid5": 0.4,
    "pyramid13": 0.45,
    "tet10": 0.45,
    "wedge15": 0.45,
    "hex20": 0.49,
    "hex27": 0.5,
}
"""Largest Poisson's ratio of each kind of cell.

Measured on bonded blocks of 4x4x2 cells (1:2 and 1:10): up to here the error is at most five times
that at 0.3. A constant pressure would let tet10 and hex20 go further on a thick block, but makes a
flat layer up to twice too soft. At 0.4999 hex27 misses by 0.4 to 2.5 % (the corners of the bond are
singular), hex20 by 10 % with the projection, and full integration of any kind by 20 to 28 %.
"""


def require_no_locking(block: CellBlock, poisson: np.ndarray) -> None:
    """Refuse cells that would lock, by their Poisson's ratios, shape (cells,), dimensionless.

    Raises SolveFailed of kind ``locking_material`` if a cell would lock.
    """
    limit = LARGEST_RATIO[block.kind]
    bad = poisson > limit + _ROUNDOFF
    if bad.any():
        raise SolveFailed(
            "locking_material",
            f"{int(bad.sum())} {block.kind} cells have a material with Poisson's ratio "
            f"{poisson.max():.12g}; such cells lock (are far too stiff) above {limit:g}.",
        )


def projects(block: CellBlock, poisson: np.ndarray) -> np.ndarray:
    """Return for each cell whether its volumetric strain is projected, shape (cells,), bool.

    Poisson's ratios have shape (cells,) and are dimensionless.
    """
    return (poisson > NEARLY_INCOMPRESSIBLE + _ROUNDOFF) & (block.kind in PROJECTED)


def pressure_notes(parts: Sequence[CellStiffness]) -> tuple[str, ...]:
    """Return notes for an engineer on the cells that project their volumetric strain."""
    cells = sum(len(part) for part in parts if part.projected)
    if not cells:
        return ()
    return (
        f"{cells} cells have a nearly incompressible material (Poisson's ratio over "
        f"{NEARLY_INCOMPRESSIBLE:g}). A separate pressure keeps them from locking; nothing is to "
        "be done.",
    )


def volume_modes(
    points: np.ndarray, block: CellBlock, weights: np.ndarray, integration: str
) -> np.ndarray:
    """Return the functions onto which the volumetric strain of each cell is projected.

    points: shape (n, 3), m.
    block: cells of a kind in `PROJECTED`.
    weights: shape (cells, points), m^3, from `fea.mesh.reference_cell`.
    integration: ``"reduced"`` or ``"full"``.
    Result: shape (cells, points, modes), m^1.5: w_p q_pi with sum_p w_p q_pi q_pj = delta_ij.
    """
    element = reference_element(block.kind, integration)
    coordinates = element.values @ points[block.nodes]
    coordinates -= coordinates.mean(axis=1, keepdims=True)
    coordinates /= np.abs(coordinates).max(axis=(1, 2), keepdims=True)
    functions = np.concatenate([np.ones_like(coordinates[..., :1]), coordinates], axis=-1)
    root = np.sqrt(weights)[..., None]
    orthonormal, _ = np.linalg.qr(root * functions)
    return np.ascontiguousarray(root * orthonormal)
