"""Orthotropic and neo-Hookean components on the same mesh as CalculiX."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tests.validation.boxes import box
from tests.validation.calculix import same_mesh
from tests.validation.clamped import clamped
from tests.validation.finding import Finding, case
from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.spec.material import Cylinder, Material, Orthotropic
from wrenchbook.fea.tensors import rotation

_X, _Y, _Z = rotation(np.array([0.3, -0.8, 0.5])).tolist()
CARBON = Orthotropic(
    "all", (135e9, 10e9, 9e9), (0.3, 0.32, 0.45), (5e9, 4.8e9, 3.2e9), np.array([_X, _Y, _Z])
)
"""Carbon fibre with nine different constants, its directions askew to every axis."""

TURN = rotation(np.array([0.4, -0.2, 0.7]))
CENTRE = (0.3, -0.1, 0.2)
_AXIAL = TURN[:, 2].tolist()
WOUND = Orthotropic(
    "all",
    (9e9, 135e9, 10e9),
    (0.02, 0.4, 0.3),
    (5e9, 3.2e9, 4.8e9),
    cylinder=Cylinder(CENTRE, (_AXIAL[0], _AXIAL[1], _AXIAL[2])),
)
"""Carbon fibre wound round an axis askew: radial, circumferential, axial."""

TIP_LOAD = (90.0, -60.0, 270.0, 9.0, -7.5, 3.6)
SQUEEZE = (250.0, -100.0, -900.0, 0.5, 1.0, 0.8)
"""N and N·m: compresses the block of rubber by a tenth and shears it by a quarter."""


@case("material")
def orthotropic_same_mesh() -> Iterator[Finding]:
    """Orthotropic bar, 50 x 20 x 400 mm, nine constants askew, on the same mesh as CalculiX."""
    for kind in ("hex20", "tet10"):
        part = orthotropic_beam(kind)
        for nonlinear in (False, True):
            yield from same_mesh(kind, part, TIP_LOAD, nonlinear=nonlinear)


@case("material")
def rubber_same_mesh() -> Iterator[Finding]:
    """Bonded block of rubber, 50 x 50 x 40 mm, squeezed askew, on the same mesh as CalculiX."""
    for kind, ratio in (("hex20", 0.4), ("tet10", 0.45)):
        part = rubber_block(kind, ratio)
        for nonlinear in (False, True):
            name = f"{kind}, Poisson's ratio {ratio:g}"
            yield from same_mesh(name, part, SQUEEZE, nonlinear=nonlinear)


@case("material")
def wound_tube_same_mesh() -> Iterator[Finding]:
    """Half a wound tube, 40 mm round, 5 mm thick, 200 mm long, on the same mesh as CalculiX."""
    for nonlinear in (False, True):
        yield from same_mesh("hex20", wound_tube(), TIP_LOAD, nonlinear=nonlinear)


def wound_tube(divisions: tuple[int, int, int] = (1, 8, 5)) -> ComponentModel:
    """Return half a tube of `WOUND`, its axis and its interface askew."""

    def bent(points: NDArray[np.float64]) -> NDArray[np.float64]:
        radius, angle = 0.015 + 0.005 * points[:, 0], np.pi * points[:, 1]
        places = [radius * np.cos(angle), radius * np.sin(angle), 0.2 * points[:, 2]]
        return np.stack(places, axis=1) @ TURN.T + CENTRE

    axes = rotation(np.array([0.2, 0.1, -0.4]))
    part = clamped(box("hex20", divisions, warp=bent), "z0", "z1", (1.0, 0.0), axes=axes)
    return replace(part, materials=(WOUND,))


def orthotropic_beam(kind: str, divisions: tuple[int, int, int] = (2, 2, 5)) -> ComponentModel:
    """Return a bar of `CARBON`, its interface rotated too."""
    axes = rotation(np.array([0.2, 0.1, -0.4]))
    mesh = box(kind, divisions, (0.05, 0.02, 0.4))
    part = clamped(mesh, "z0", "z1", (1.0, 0.0), axes=axes)
    return replace(part, materials=(CARBON,))


def rubber_block(
    kind: str, ratio: float, divisions: tuple[int, int, int] = (2, 2, 2)
) -> ComponentModel:
    """Return a block of neo-Hookean rubber of 3 MPa between rigid plates."""
    part = clamped(box(kind, divisions, (0.05, 0.05, 0.04)), "z0", "z1", (1.0, 0.0))
    return replace(part, materials=(Material("all", 3e6, ratio, law="neo-hookean"),))
