"""The helical spring of the coupling paper (SIMULTECH 2017) against rod theory and CalculiX."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tests.validation.calculix import same_mesh
from tests.validation.clamped import attached, shipped
from tests.validation.finding import Finding, case
from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.solve import Solver

FORCES = (1.0, 2.0, 4.0, 6.0, 8.0, 10.0)
"""Axial loads, N, over the paper's range of 0 to 10 N."""

_ROD = "Love 1944, article 271: thin rod"
_PAPER = "SIMULTECH 2017, section 6"

PRINTED_14 = (
    (0.5, 1.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 14.0, 16.0, 17.0),
    (
        0.114644,
        0.231012,
        0.468932,
        0.965555,
        1.49,
        2.042393,
        2.622861,
        3.231529,
        3.868521,
        4.533959,
        4.877383,
    ),
)
"""Equation 14 of the paper as printed: shortening, mm, and rotation, degrees (from its radians)."""


@dataclass(frozen=True)
class Rod:
    """A helical spring as a thin inextensible rod, one end clamped, the other free to rotate.

    Attributes
    ----------
    wire, mean
        Diameters of the wire and of the helix, m.
    turns
        Active turns.
    height
        Free length, m.
    young, poisson
        Pa, and Poisson's ratio.
    """

    wire: float
    mean: float
    turns: float
    height: float
    young: float
    poisson: float

    @property
    def length(self) -> float:
        """Length of the wire, m."""
        return float(np.hypot(np.pi * self.turns * self.mean, self.height))

    @property
    def torsion(self) -> float:
        """Torsional stiffness G J of the wire, N·m^2."""
        return self.young / (2 * (1 + self.poisson)) * np.pi * self.wire**4 / 32

    def pressed(self, shortening: float) -> tuple[float, float]:
        """Return force (N) and rotation of the free end (rad) at a shortening (m).

        With pitch angle g, sin g = (H - s)/L, and a = G J/(E I) = 1/(1 + nu), no axial moment at
        the free end (Love, A Treatise on the Mathematical Theory of Elasticity, article 271):
        rotation t = 2 pi n (1 - (cos g0 cos g + a sin g0 sin g)/(cos^2 g + a sin^2 g)),
        F = G J (2 pi n sin g0 - (2 pi n - t) sin g)/(L r cos g), r = L cos g/(2 pi n - t).
        """
        a = 1 / (1 + self.poisson)
        whole = 2 * np.pi * self.turns
        sin0, sin = self.height / self.length, (self.height - shortening) / self.length
        cos0, cos = np.sqrt(1 - sin0**2), np.sqrt(1 - sin**2)
        rotation = whole * (1 - (cos0 * cos + a * sin0 * sin) / (cos**2 + a * sin**2))
        left = whole - rotation
        radius = self.length * cos / left
        force = self.torsion * (whole * sin0 - left * sin) / (self.length * radius * cos)
        return float(force), float(rotation)


def rod_of(part: ComponentModel) -> Rod:
    """Return the rod that the shipped spring is made of."""
    source = part.bundle.mesh
    if source is None or source.parameters is None:
        raise ValueError("the spring has no parameters")
    size, material = source.parameters, part.materials[0]
    return Rod(
        size["wire_diameter"],
        size["mean_diameter"],
        size["active_turns"],
        size["free_length"],
        material.youngs_modulus,
        material.poisson_ratio,
    )


@case("spring")
def small_load() -> Iterator[Finding]:
    """Shipped spring: its stiffness at no load, the upper end free to rotate."""
    part = shipped("spring")
    theory = rod_of(part).pressed(1e-7)[0] / 1e-7
    computed = 1 / float(Solver(part).compliance[2, 2])
    yield Finding("k, N/m", _ROD, theory, computed, 5e-3)
    yield Finding("k, N/m (the paper: 582 ± 1 by finite elements)", _PAPER, 582.0, computed)


@case("spring")
def pressed() -> Iterator[Finding]:
    """Shipped spring, nonlinear, at the shortening found under each load."""
    part = shipped("spring")
    rod, solver = rod_of(part), Solver(part)
    for load in FORCES:
        result = solver.solve([0, 0, -load, 0, 0, 0]).displacement
        force, rotation = rod.pressed(-result[2])
        computed = float(-np.degrees(result[5]))
        at = f"at {-1e3 * result[2]:.2f} mm"
        yield Finding(f"force {at}, N", _ROD, force, load, 5e-3)
        yield Finding(f"rotation {at}, degrees", _ROD, float(np.degrees(rotation)), computed, 1e-2)
        if -1e3 * result[2] <= PRINTED_14[0][-1]:
            printed = float(np.interp(-1e3 * result[2], *PRINTED_14))
            yield Finding(f"rotation {at}, degrees", f"{_PAPER}, equation 14", printed, computed)


@case("spring")
def calculix() -> Iterator[Finding]:
    """Shipped spring on the same mesh as CalculiX."""
    part = shipped("spring")
    for load in (1.0, 10.0):
        wrench = [0.0, 0.0, -load, 0.0, 0.0, 0.0]
        yield from same_mesh(f"{load:g} N", part, wrench, nonlinear=False)
    free = attached(part, locked=())
    wrench = [0.1, -0.1, -1.0, 1e-3, 2e-3, -1e-3]
    yield from same_mesh("1 N, no guide, all six loads", free, wrench, nonlinear=False)
    coarse = shipped("spring", cells_per_turn=12)
    for load in (1.0, 10.0):
        wrench = [0.0, 0.0, -load, 0.0, 0.0, 0.0]
        yield from same_mesh(f"{load:g} N, 12 cells a turn", coarse, wrench, nonlinear=True)
