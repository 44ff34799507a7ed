"""The bar against beam theory, reciprocity, and large rotation."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tests.validation.boxes import box
from tests.validation.clamped import attached, clamped, shipped
from tests.validation.finding import Finding, case
from wrenchbook.fea.solve import Solver

_NAMES = ("u_x", "u_y", "u_z", "r_x", "r_y", "r_z")
_LOADS = ("F_x", "F_y", "F_z", "M_x", "M_y", "M_z")


def beam_compliance(
    length: float, width: float, height: float, young: float, poisson: float
) -> dict[tuple[int, int], float]:
    """Return a clamped beam's compliance at its tip, by entry of the 6x6 (axis along x).

    Timoshenko's beam with Cowper's shear coefficient (1966) of a solid rectangle,
    10 (1 + nu) / (12 + 11 nu), and Saint-Venant's torsion (Timoshenko and Goodier, article 109).

    Parameters
    ----------
    length, width, height
        Along x, y and z, m.
    young, poisson
        Pa, and Poisson's ratio.
    """
    area, shear = width * height, young / (2 * (1 + poisson))
    bend_y, bend_z = young * width * height**3 / 12, young * height * width**3 / 12
    give = length / (10 * (1 + poisson) / (12 + 11 * poisson) * shear * area)
    thin, thick = sorted((width, height))
    terms = sum(np.tanh(n * np.pi * thick / (2 * thin)) / n**5 for n in (1, 3, 5, 7))
    torsion = shear * thick * thin**3 / 3 * (1 - 192 * thin / (np.pi**5 * thick) * terms)
    return {
        (0, 0): length / (young * area),
        (1, 1): length**3 / (3 * bend_z) + give,
        (2, 2): length**3 / (3 * bend_y) + give,
        (3, 3): length / torsion,
        (4, 4): length / bend_y,
        (5, 5): length / bend_z,
        (1, 5): length**2 / (2 * bend_z),
        (2, 4): -(length**2) / (2 * bend_y),
    }


@case("bar")
def timoshenko() -> Iterator[Finding]:
    """Shipped bar: each entry of the compliance that beam theory knows."""
    part = shipped("bar")
    material, extent = part.materials[0], np.ptp(part.mesh.points, axis=0)
    length, width, height = extent.tolist()
    theory = beam_compliance(length, width, height, material.youngs_modulus, material.poisson_ratio)
    compliance = Solver(part).compliance
    for (i, j), expected in theory.items():
        quantity = f"{_NAMES[i]}/{_LOADS[j]}, SI"
        source = "Saint-Venant torsion" if i == 3 else "Timoshenko beam, Cowper 1966"
        yield Finding(quantity, source, expected, float(compliance[i, j]), 5e-3)


@case("bar")
def betti() -> Iterator[Finding]:
    """Reciprocity: work of one wrench on another's displacement, before anything is symmetrised."""
    for name in ("bar", "plate", "plate_thin", "spring"):
        part = shipped(name)
        for coupling in ("rigid", "distributed"):
            linear = Solver(attached(part, coupling=coupling)).linear
            largest = max(linear.asymmetry, linear.energy_gap)
            quantity = f"{name}, {coupling}: asymmetry, and gap to the strain energies, relative"
            source = "Betti 1872, Clapeyron"
            yield Finding(quantity, source, 0.0, largest, 1e-9, "absolute")


@case("bar")
def circle() -> Iterator[Finding]:
    """Large rotation: a strip of 1 m x 10 mm x 10 mm under an end moment bends into an arc."""
    young, angle = 70e9, np.radians(19.0)
    mesh = box("hex20", (2, 2, 32), (0.01, 0.01, 1.0))
    part = clamped(mesh, "z0", "z1", (young, 0.0), coupling="distributed", nonlinear=True)
    moment = young * 0.01**4 / 12 * angle
    result = Solver(part).solve([0, 0, 0, 0, moment, 0]).displacement
    expected = ((1 - np.cos(angle)) / angle, np.sin(angle) / angle - 1, angle)
    for place, value in zip((0, 2, 4), expected, strict=True):
        unit = "m" if place < 3 else "rad"
        quantity = f"{_NAMES[place]} at 19 degrees, {unit}"
        yield Finding(quantity, "circular arc, Euler", value, float(result[place]), 5e-4)
