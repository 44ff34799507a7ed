"""Orthotropic elasticity: nine engineering constants, and what no material can have."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

Array = np.ndarray
Three = tuple[float, float, float]

MOST_ISOTROPIC_RATIO = 0.4
"""Of `Orthotropic.isotropic_ratio`: the least at which any kind of cells locks."""


@dataclass(frozen=True)
class Orthotropic:
    """Constants in three directions square to each other."""

    youngs_moduli: Three  # E1, E2, E3, Pa
    # nu12, nu13, nu23: strain across over strain along, less, when pulled along the first of the
    # two directions; nu21 = nu12 E2 / E1.
    poisson_ratios: Three
    shear_moduli: Three  # G12, G13, G23, Pa
    # The directions 1, 2 and 3 in the mesh's axes, orthonormal and right-handed
    axes: tuple[Three, Three, Three]
    # A point, m, and a unit direction of the axis about which 1, 2 and 3 are radial,
    # circumferential and axial, in the mesh's axes; None where `axes` are everywhere the same.
    cylinder: tuple[Three, Three] | None = None

    def directions(self, places: Array) -> Array:
        """Return the directions 1, 2 and 3 at places (..., 3), m: shape (..., 3, 3), in rows.

        Places and directions are in the mesh's axes. On the axis itself any radial one will do.
        """
        if self.cylinder is None:
            return np.broadcast_to(np.array(self.axes), (*places.shape[:-1], 3, 3))
        point, axial = np.array(self.cylinder)
        off = places - point
        off = off - (off @ axial)[..., None] * axial
        size = np.linalg.norm(off, axis=-1, keepdims=True)
        any_radial = np.cross(axial, np.eye(3)[np.abs(axial).argmin()])
        radial = np.where(size > 0, off / np.where(size > 0, size, 1.0), any_radial)
        radial = radial / np.linalg.norm(radial, axis=-1, keepdims=True)
        around = np.cross(axial, radial)
        return np.stack([radial, around, np.broadcast_to(axial, radial.shape)], axis=-2)

    @property
    def elasticity(self) -> Array:
        """Stresses (11, 22, 33, 12, 13, 23) by strains, the shears 2 E_ij: shape (6, 6), Pa."""
        matrix = np.diag([0.0, 0.0, 0.0, *self.shear_moduli])
        matrix[:3, :3] = np.linalg.inv(self._compliance)
        return 0.5 * (matrix + matrix.T)

    @property
    def stable(self) -> bool:
        """Whether every strain costs energy (Lempriere 1968)."""
        # Scaled to a unit diagonal, or a modulus of 1e11 next to one of 1e6 would decide it.
        scale = np.sqrt(np.array(self.youngs_moduli))
        return bool(np.linalg.eigvalsh(self._compliance * np.outer(scale, scale))[0] > 1e-9)

    @property
    def isotropic_ratio(self) -> float:
        """Poisson's ratio of the isotropic material nearest to it (Voigt's mean of directions)."""
        matrix = self.elasticity
        pulls, shears = np.trace(matrix[:3, :3]), np.trace(matrix[3:, 3:])
        across = matrix[0, 1] + matrix[0, 2] + matrix[1, 2]
        bulk, shear = (pulls + 2 * across) / 9, (pulls - across + 3 * shears) / 15
        return float((3 * bulk - 2 * shear) / (6 * bulk + 2 * shear))

    @property
    def _compliance(self) -> Array:
        e1, e2, e3 = self.youngs_moduli
        nu12, nu13, nu23 = self.poisson_ratios
        return np.array(
            [
                [1 / e1, -nu12 / e1, -nu13 / e1],
                [-nu12 / e1, 1 / e2, -nu23 / e2],
                [-nu13 / e1, -nu23 / e2, 1 / e3],
            ]
        )
