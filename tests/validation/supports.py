"""Sliding planes and bushings against closed forms and CalculiX."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from tests.validation.boxes import box
from tests.validation.calculix import same_mesh
from tests.validation.clamped import clamped
from tests.validation.finding import Finding, case
from tests.validation.patch import MATERIAL, distort
from wrenchbook.fea.component import AttachedInterface, ComponentModel
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.tensors import rotation, skew

_NONE = np.empty(0, dtype=np.int64)
_AXES = rotation(np.array([0.4, -0.7, 0.3]))
STIFFNESS = np.diag([3e6, 2e6, 5e6, 2e4, 3e4, 1e4]) + 8e2 * np.ones((6, 6))
LOADS = (300.0, -200.0, -900.0, 90.0, 150.0, 60.0)


@case("support")
def sliding_stretch() -> Iterator[Finding]:
    """Patch test on three sliding planes: a distorted cube, pulled, free to grow thinner."""
    for kind in ("hex20", "hex27", "tet10", "wedge15"):
        mesh = box(kind, (3, 3, 3), warp=distort(0.05), corners_only=True)
        held = np.abs(mesh.points) < 1e-12
        nodes = np.flatnonzero(held.any(axis=1))
        part = clamped(mesh, "z0", "z1", MATERIAL, coupling="distributed")
        sliding = nodes, held[nodes][:, :, None] * np.eye(3)
        response = Solver(replace(part, fixed_nodes=_NONE, sliding=sliding)).linear.fields[:, :, 2]
        exact = mesh.points * np.array([-MATERIAL[1], -MATERIAL[1], 1.0]) / MATERIAL[0]
        gap = float(np.abs(response - exact).max() / np.abs(exact).max())
        quantity = f"{kind}: largest error of a displacement, relative"
        yield Finding(quantity, "uniaxial stress", 0.0, gap, 1e-10, "absolute")


@case("support")
def bushing_adds() -> Iterator[Finding]:
    """Bar on an elastic bushing with a full 6x6 stiffness, askew and off its section."""
    part = on_bushing()
    (own, stiffness), arm = part.bushings[0], part.interfaces[0].point - part.bushings[0][0].point
    at_bushing = np.eye(6)
    at_bushing[3:, :3] = skew(arm)
    at_bushing = np.kron(np.eye(2), own.axes) @ at_bushing
    bar = Solver(clamped(part.mesh, "z0", "z1", MATERIAL)).compliance
    exact = bar + at_bushing.T @ np.linalg.solve(stiffness, at_bushing)
    gap = float(np.abs(Solver(part).compliance - exact).max() / np.abs(exact).max())
    quantity = "compliance less those of bar and spring, relative"
    yield Finding(quantity, "springs in series", 0.0, gap, 1e-9, "absolute")
    for nonlinear in (False, True):
        yield from same_mesh("the same", part, LOADS, nonlinear=nonlinear)


def on_bushing() -> ComponentModel:
    """Return a bar of 0.1 x 0.06 x 1 m whose lower end is on a spring."""
    mesh = box("hex20", (2, 2, 6), (0.1, 0.06, 1.0))
    part, lower = clamped(mesh, "z0", "z1", MATERIAL), clamped(mesh, "z1", "z0", MATERIAL)
    point, section = np.array([0.05, 0.02, -0.3]), lower.interfaces[0].section
    own = AttachedInterface("supports.bushing[0]", "", section, point, _AXES, "rigid", ())
    return replace(part, fixed_nodes=_NONE, bushings=((own, STIFFNESS),))
