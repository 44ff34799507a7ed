"""The curved cantilever of MacNeal and Harder (1985)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from tests.validation.boxes import box
from tests.validation.clamped import clamped
from tests.validation.finding import Finding, case
from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.solve import Solver

_INNER, _OUTER, _THICKNESS, _MATERIAL = 4.12, 4.32, 0.1, (1e7, 0.25)
_SOURCE = "MacNeal and Harder 1985"
_IN_PLANE, _OUT_OF_PLANE = 0.08734, 0.5022
# A commercial hexahedron of 20 nodes, of the same theory: Altair OptiStruct's OS-V:0710.
_COMMERCIAL = (1.009, 0.946)


def curved(along: int, across: int) -> Mesh:
    """Return a quarter of a ring, clamped at ``x0``, its tip at ``x1``; hex20."""

    def bend(points: NDArray[np.float64]) -> NDArray[np.float64]:
        angle = np.pi / 2 * points[:, 0]
        radius = _INNER + (_OUTER - _INNER) * points[:, 1]
        return np.column_stack(
            [radius * np.sin(angle), radius * np.cos(angle), _THICKNESS * points[:, 2]]
        )

    return box("hex20", (along, across, across), warp=bend)


def tip_deflections(along: int, across: int) -> tuple[float, float]:
    """Return deflections along a unit load at the tip: radial in its plane, and across it."""
    part = clamped(curved(along, across), "x0", "x1", _MATERIAL, coupling="distributed")
    compliance = Solver(part).compliance
    return float(compliance[0, 0]), float(compliance[2, 2])


def thin_beam() -> tuple[float, float]:
    """Return the same deflections of a thin curved beam, by Castigliano's theorem.

    F R^3/(E I) pi/4 in its plane; F R^3 (pi/4/(E I) + (3 pi/4 - 2)/(G J)) across it, with
    Saint-Venant's J = 0.2287 b t^3 of a rectangle of 2:1. The published numbers differ from these
    by 1.4 % and 0.3 %.
    """
    young, poisson = _MATERIAL
    width, cube = _OUTER - _INNER, ((_OUTER + _INNER) / 2) ** 3
    in_plane = cube * np.pi / 4 / (young * _THICKNESS * width**3 / 12)
    bend = young * width * _THICKNESS**3 / 12
    twist = young / (2 * (1 + poisson)) * 0.2287 * width * _THICKNESS**3
    return in_plane, cube * (np.pi / 4 / bend + (3 * np.pi / 4 - 2) / twist)


@case("curved_beam")
def macneal_harder() -> Iterator[Finding]:
    """Curved cantilever of 90 degrees, unit load at the tip, 32 x 3 x 3 cells."""
    results = tip_deflections(32, 3)
    for name, value, expected in zip(
        ("in the plane", "across it"), results, (_IN_PLANE, _OUT_OF_PLANE), strict=True
    ):
        yield Finding(f"deflection along the load, {name}", _SOURCE, expected, value, 0.02)
    for name, value, expected in zip(
        ("in the plane", "across it"), results, thin_beam(), strict=True
    ):
        quantity = f"the same against the thin curved beam, {name}"
        yield Finding(quantity, "Castigliano, bending and torsion", expected, value, 0.01)


@case("curved_beam")
def macneal_harder_coarse() -> Iterator[Finding]:
    """Curved cantilever on the published mesh of 6 x 1 x 1 cells, normalised."""
    results = tip_deflections(6, 1)
    for name, value, expected, theirs in zip(
        ("in the plane", "across it"), results, (_IN_PLANE, _OUT_OF_PLANE), _COMMERCIAL, strict=True
    ):
        quantity = f"deflection over theory, {name}"
        yield Finding(quantity, "a commercial hex20, OS-V:0710", theirs, value / expected, 0.02)
