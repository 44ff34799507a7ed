"""Plates: an annular plate in closed form, and the shipped plate against CalculiX."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from tests.validation.calculix import same_mesh
from tests.validation.clamped import attached, clamped, shipped
from tests.validation.finding import Finding, case
from wrenchbook.fea.mesh.generators import PlaneMesh, quadratic, ring_quads, sweep
from wrenchbook.fea.mesh.mesh import FacetBlock, FacetGroup, Mesh
from wrenchbook.fea.solve import Solver

WRENCH = (1e3, 500.0, -5e3, 300.0, -200.0, 100.0)
_OUTER, _INNER, _THICKNESS, _MATERIAL = 0.2, 0.05, 0.002, (70e9, 0.33)


def annulus(rings: int, around: int) -> Mesh:
    """Return an annular plate of two layers, with facet groups ``rim`` and ``boss``; hex20.

    A clamped wall also holds the plate's thickness, which is not in plate theory: the first and
    last ring are as narrow as the plate is thick, so that this does not reach further.
    """
    angles = 2 * np.pi * np.arange(around) / around
    first, last = _INNER + _THICKNESS, _OUTER - _THICKNESS
    between = first * (last / first) ** (np.arange(rings - 1) / (rings - 2))
    radii = np.concatenate([[_INNER], between, [_OUTER]])
    unit = np.column_stack([np.cos(angles), np.sin(angles)])
    rows = np.arange((rings + 1) * around).reshape(rings + 1, around)
    quads = np.concatenate([ring_quads(rows[i], rows[i + 1]) for i in range(rings)])
    section = quadratic((radii[:, None, None] * unit).reshape(-1, 2), quads)
    _bend(section)
    plate = sweep(section, 2, lambda flat, part: np.column_stack([flat, _THICKNESS * (part - 0.5)]))
    walls = _split(plate.points, plate.side())
    return Mesh(plate.points, (plate.cells,), facet_groups=walls)


def _bend(section: PlaneMesh) -> None:
    """Move the middles of arcs out to their circles; those of spokes are on theirs already."""
    corners, middles = section.quads[:, :4], section.quads[:, 4:]
    radius = np.linalg.norm(section.points, axis=1)
    target = 0.5 * (radius[corners] + radius[np.roll(corners, -1, axis=1)])
    factor = np.ones(len(radius))
    factor[middles] = target / radius[middles]
    section.points[:] *= factor[:, None]


def _split(points: NDArray[np.float64], wall: FacetGroup) -> dict[str, FacetGroup]:
    (block,) = wall.blocks
    radius = np.linalg.norm(points[block.nodes[:, 0], :2], axis=1)
    outer = radius > 0.5 * (_INNER + _OUTER)
    return {
        name: FacetGroup((FacetBlock(block.kind, block.nodes[chosen]),))
        for name, chosen in (("rim", outer), ("boss", ~outer))
    }


def annular_compliance() -> tuple[float, float]:
    """Return u_z/F_z and r_x/M_x of a thin annular plate, clamped outside, on a rigid boss.

    Kirchhoff's plate (Timoshenko and Woinowsky-Krieger, articles 17 and 63): under F the
    deflection is F/(8 pi D) r^2 ln r + A + B r^2 + C ln r, under M it is
    (A r + B r^3 + C / r - M/(4 pi D) r ln r) sin(phi); the constants are those of the clamped rim
    and the rigid boss. To the first belongs the shear F ln(a/b) / (2 pi k G h), k = 5/6.
    """
    young, poisson = _MATERIAL
    a, b = _OUTER, _INNER
    rigidity = young * _THICKNESS**3 / (12 * (1 - poisson**2))
    k = 1 / (8 * np.pi * rigidity)
    slope = [0.0, 2 * a, 1 / a], [0.0, 2 * b, 1 / b]
    own = k * a * (2 * np.log(a) + 1), k * b * (2 * np.log(b) + 1)
    A, B, C = np.linalg.solve(
        [[1.0, a**2, np.log(a)], *slope], [-k * a**2 * np.log(a), -own[0], -own[1]]
    )
    axial = k * b**2 * np.log(b) + A + B * b**2 + C * np.log(b)
    shear = young / (2 * (1 + poisson))
    axial += np.log(a / b) / (2 * np.pi * 5 / 6 * shear * _THICKNESS)
    k = -1 / (4 * np.pi * rigidity)
    # The last row: deflection over radius equals slope at the boss, which tilts as one.
    A, B, C = np.linalg.solve(
        [[a, a**3, 1 / a], [1.0, 3 * a**2, -1 / a**2], [0.0, 2 * b**2, -2 / b**2]],
        [-k * a * np.log(a), -k * (np.log(a) + 1), -k],
    )
    tilting = k * np.log(b) + A + B * b**2 + C / b**2
    return float(axial), float(tilting)


@case("plate")
def annular_plate() -> Iterator[Finding]:
    """Annular plate, 200:50:2 mm, clamped outside, with a rigid boss."""
    part = clamped(annulus(10, 32), "rim", "boss", _MATERIAL)
    compliance = Solver(part).compliance
    axial, tilting = annular_compliance()
    source = "Timoshenko and Woinowsky-Krieger"
    yield Finding("u_z/F_z, m/N", source, axial, float(compliance[2, 2]), 5e-3)
    yield Finding("r_x/M_x, rad/(N·m)", source, tilting, float(compliance[3, 3]), 5e-3)


@case("plate")
def calculix() -> Iterator[Finding]:
    """Shipped thin plate, clamped at its corners, on the same mesh as CalculiX."""
    part = shipped("plate_thin")
    rigid = attached(part, coupling="rigid")
    yield from same_mesh("[1e3, 500, -5e3, 300, -200, 100] N, N·m", part, WRENCH, nonlinear=False)
    for nonlinear in (False, True):
        yield from same_mesh("the same wrench", rigid, WRENCH, nonlinear=nonlinear)
