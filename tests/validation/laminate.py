"""Laminated strips of carbon fibre against classical laminate theory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tests.validation.boxes import box
from tests.validation.clamped import clamped
from tests.validation.finding import Finding, case
from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.material import Orthotropic

ALONG, ACROSS, SHEAR, RATIO = 135e9, 10e9, 5e9, 0.3
"""A carbon fibre ply, unidirectional: E1, E2 = E3, G12 = G13 (Pa) and nu12 = nu13."""

RATIO_ACROSS = 0.4
PLY, WIDTH, LENGTH = 0.5e-3, 10e-3, 300e-3  # m
DIVISIONS = (40, 2)

_THEORY = "classical laminate theory, Jones 1999"


@case("material")
def laminated_strips() -> Iterator[Finding]:
    """Laminated strips, 300 x 10 mm of plies of 0.5 mm, clamped, one hex20 a ply."""
    for angles in ((0, 90, 90, 0), (0, 90), (45, -45, -45, 45)):
        compliance = Solver(strip(angles)).compliance
        theory = np.linalg.inv(stiffness(angles)) * LENGTH / WIDTH
        name = "[" + "/".join(map(str, angles)) + "]"
        bending = f"{name}: r_y/M_y, rad/(N·m)"
        yield Finding(bending, _THEORY, theory[3, 3], compliance[4, 4], 5e-3)
        # Pulled, plies at 45 degrees shear against each other within a ply's thickness of the edge.
        tolerance = 2e-2 if 45 in angles else 5e-3
        pulled = f"{name}: u_x/F_x, m/N"
        yield Finding(pulled, _THEORY, theory[0, 0], compliance[0, 0], tolerance)
        if angles != angles[::-1]:
            coupled = f"{name}: u_x/M_y, 1/N"
            yield Finding(coupled, _THEORY, theory[0, 3], compliance[0, 4], 5e-3)


def strip(angles: Sequence[float], divisions: tuple[int, int] = DIVISIONS) -> ComponentModel:
    """Return a strip along x of plies at angles to it, degrees, from the bottom up."""
    lengths = (LENGTH, WIDTH, PLY * len(angles))
    part = clamped(box("hex20", (*divisions, len(angles)), lengths), "x0", "x1", (ALONG, RATIO))
    middles = part.mesh.points[part.mesh.blocks[0].nodes].mean(axis=1)
    number = np.floor(middles[:, 2] / PLY).astype(int)
    return replace(part, materials=tuple(map(ply, angles)), material_of_cells=(number,))


def ply(angle: float) -> Orthotropic:
    """Return a ply with its fibres at an angle, degrees, to x in the plane of x and y."""
    c, s = float(np.cos(np.radians(angle))), float(np.sin(np.radians(angle)))
    return Orthotropic(
        "ply",
        (ALONG, ACROSS, ACROSS),
        (RATIO, RATIO, RATIO_ACROSS),
        (SHEAR, SHEAR, ACROSS / (2 * (1 + RATIO_ACROSS))),
        np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]),
    )


def stiffness(angles: Sequence[float]) -> NDArray[np.float64]:
    """Return A, B and D of a laminate, shape (6, 6): N/m, N and N·m.

    From the plane stress stiffness of each ply, rotated by its angle, over the thickness.
    """
    heights = PLY * (np.arange(len(angles) + 1) - len(angles) / 2)
    total = np.zeros((6, 6))
    for angle, low, high in zip(angles, heights[:-1], heights[1:], strict=True):
        moments = [(high**n - low**n) / n for n in (1, 2, 3)]
        total += np.kron([moments[:2], moments[1:]], _plane_stress(angle))
    return total


def _plane_stress(angle: float) -> NDArray[np.float64]:
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    apart = 1 - RATIO**2 * ACROSS / ALONG
    minor = RATIO * ACROSS / apart
    own = np.array([[ALONG / apart, minor, 0], [minor, ACROSS / apart, 0], [0, 0, SHEAR]])
    # Strains (x, y, 2 xy) seen from the fibres.
    rotation = np.array(
        [[c * c, s * s, s * c], [s * s, c * c, -s * c], [-2 * s * c, 2 * s * c, c * c - s * s]]
    )
    return np.asarray(rotation.T @ own @ rotation)
