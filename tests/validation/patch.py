"""Patch tests of the elements and of the couplings, and what a rigid motion must leave alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tests.validation.boxes import box
from tests.validation.clamped import Warp, attached, clamped
from tests.validation.finding import Finding, case
from wrenchbook.fea.assembly.blocks import filled_cells
from wrenchbook.fea.assembly.body import ElasticBody
from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.material import Material
from wrenchbook.fea.tensors import rotation

KINDS = (
    *("hex8", "hex20", "hex27", "tet4", "tet10"),
    *("wedge6", "wedge15", "pyramid5", "pyramid13"),
)
MATERIAL = (3.0e9, 0.3)
COUPLINGS = ("rigid", "distributed")

_IRONS = "Irons and Razzaque 1972: constant strain is exact"
_ROTATION_VECTOR = np.array([0.4, -0.7, 0.3])
_ROUNDOFF = 1e-10


def distort(amount: float) -> Warp:
    """Return a map that moves the points inside the unit cube, and none of its surface, m."""

    def warp(points: NDArray[np.float64]) -> NDArray[np.float64]:
        bubble = np.prod(np.sin(np.pi * points), axis=1)
        waves = np.cos(np.pi * points @ np.array([[2, 3, 1], [1, 2, 3], [3, 1, 2]]))
        return points + amount * bubble[:, None] * waves

    return warp


def body_of(mesh: Mesh, fixed: NDArray[np.bool_], integration: str = "reduced") -> ElasticBody:
    """Return the body of a mesh of `MATERIAL` whose `fixed` nodes do not move.

    `fixed` has shape (n,), bool, dimensionless.
    """
    numbers = [np.zeros(len(block), dtype=int) for block in mesh.blocks]
    filled = filled_cells(mesh, [Material("all", *MATERIAL)], numbers, integration)
    return ElasticBody(mesh, filled, ~fixed)


def on_the_surface(mesh: Mesh) -> NDArray[np.bool_]:
    """Return which points lie on the surface of the cube of 1 m, shape (n,), bool."""
    from_middle = np.abs(mesh.points - 0.5).max(axis=1)
    return np.asarray(from_middle > 0.5 - 1e-9)


def solve_with_boundary(body: ElasticBody, boundary: NDArray[np.float64]) -> NDArray[np.float64]:
    """Solve for the free nodes with the others displaced as `boundary`, shape (n, 3), m, says."""
    prescribed = np.where(body.free[:, None], 0.0, boundary)
    forces = body.small_strain_forces(prescribed[:, :, None])
    return prescribed - body.tangent(None).solve(forces)[:, :, 0]


def _patch(kind: str) -> Mesh:
    return box(kind, (3, 3, 3), warp=distort(0.05), corners_only=True)


@case("patch")
def constant_strain() -> Iterator[Finding]:
    """Patch test: 27 distorted cubes under a linear displacement of their surface."""
    gradient = np.array([[0.3, -0.2, 0.5], [0.7, 0.1, -0.4], [-0.6, 0.2, 0.9]])
    for kind in KINDS:
        mesh = _patch(kind)
        body = body_of(mesh, on_the_surface(mesh))
        exact = mesh.points @ gradient.T
        gap = np.abs(solve_with_boundary(body, exact) - exact).max() / np.abs(exact).max()
        quantity = f"{kind}: largest error of a displacement within, relative"
        yield Finding(quantity, _IRONS, 0.0, float(gap), _ROUNDOFF, "absolute")


@case("patch")
def large_constant_deformation() -> Iterator[Finding]:
    """Patch test at large deformation: 27 distorted cubes, stretched 10 %, rotated 49 degrees."""
    stretch = np.eye(3) + 0.1 * np.array([[1.0, 0.3, 0.1], [0.2, -0.4, 0.5], [0.6, 0.1, 0.8]])
    gradient = rotation(_ROTATION_VECTOR) @ stretch
    for kind in KINDS:
        mesh = _patch(kind)
        body = body_of(mesh, on_the_surface(mesh))
        forces, _, _ = body.forces(mesh.points @ (gradient - np.eye(3)).T)
        gap = np.abs(forces[body.free]).max() / np.abs(forces).max()
        quantity = f"{kind}: largest nodal force within, relative to the surface's"
        source = "equilibrium of a constant stress"
        yield Finding(quantity, source, 0.0, float(gap), _ROUNDOFF, "absolute")


@case("patch")
def couplings_stretch() -> Iterator[Finding]:
    """Patch test through each coupling: a distorted bar without Poisson's effect, pulled."""
    for coupling in COUPLINGS:
        gaps = []
        for kind in KINDS:
            part = clamped(_patch(kind), "z0", "z1", (MATERIAL[0], 0.0), coupling=coupling)
            gaps.append(abs(Solver(part).compliance[2, 2] * MATERIAL[0] - 1.0))
        quantity = f"{coupling}: u_z/F_z E A/L, worst of {len(KINDS)} kinds"
        yield Finding(quantity, "F L/(E A)", 1.0, 1.0 + max(gaps), _ROUNDOFF)


@case("patch")
def rigid_motion_costs_nothing() -> Iterator[Finding]:
    """Rigid-body invariance: a motion without deformation makes no force."""
    R_minus_I = rotation(_ROTATION_VECTOR) - np.eye(3)
    for kind in KINDS:
        mesh = _patch(kind)
        body = body_of(mesh, on_the_surface(mesh))
        forces, _, _ = body.forces(mesh.points @ R_minus_I.T + [1.0, -2.0, 3.0])
        largest = float(np.abs(forces).max() / MATERIAL[0])
        quantity = f"{kind}: largest nodal force / (E x 1 m²) after 49 degrees and 3.7 m"
        yield Finding(quantity, "objectivity", 0.0, largest, 1e-13, "absolute")


@case("patch")
def turned_component() -> Iterator[Finding]:
    """Rigid-body invariance: a component rotated and moved as a whole answers the same."""
    mesh = box("hex20", (4, 3, 2), (0.3, 0.2, 0.006))
    R, point = rotation(_ROTATION_VECTOR), np.array([0.31, 0.13, 0.05])
    wrench = [300.0, 150.0, -100.0, 4.0, 8.0, 6.0]
    for coupling in COUPLINGS:
        part = clamped(
            mesh, "x0", "x1", (70e9, 0.33), coupling=coupling, nonlinear=True, point=point
        )
        shift = np.array([1.0, -2.0, 3.0])
        moved = attached(
            replace(part, mesh=replace(mesh, points=mesh.points @ R.T + shift)),
            point=R @ point + shift,
            axes=part.axes @ R.T,
        )
        first, second = (Solver(p).solve(wrench).displacement for p in (part, moved))
        gap = float(np.abs(second - first).max() / np.abs(first).max())
        quantity = f"{coupling}, nonlinear: largest change of a displacement, relative"
        yield Finding(quantity, "objectivity", 0.0, gap, 1e-8, "absolute")
