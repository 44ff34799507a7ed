"""Rates of convergence: halving the cells divides the error in energy by 2^(2 x order)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from tests.validation.boxes import box
from tests.validation.finding import Finding, case
from tests.validation.patch import body_of, on_the_surface, solve_with_boundary

_ORDER_AND_SIZES = {
    "hex8": (1, (4, 8)),
    "tet4": (1, (4, 8)),
    "wedge6": (1, (4, 8)),
    "hex20": (2, (2, 4)),
    "hex27": (2, (2, 4)),
    "tet10": (2, (2, 4)),
    "wedge15": (2, (2, 4)),
}
_STILL_COARSE = 0.35  # what a rate may lack on meshes as coarse as these


@case("patch")
def energy_converges() -> Iterator[Finding]:
    """Convergence: rate of the energy's error as the cells of a smooth solution are halved."""
    exact = _energy("hex27", 6)
    for kind, (order, sizes) in _ORDER_AND_SIZES.items():
        first, second = (abs(_energy(kind, n) / exact - 1.0) for n in sizes)
        quantity = f"{kind}: log2 of the error's quotient, {sizes[0]}³ to {sizes[1]}³ cells"
        source = "Strang and Fix 1973: twice the order"
        rate = float(np.log2(first / second))
        yield Finding(quantity, source, 2.0 * order, rate, _STILL_COARSE, "at least")


def _energy(kind: str, divisions: int) -> float:
    """Return twice the strain energy, J, of the unit cube whose surface moves harmonically."""
    mesh = box(kind, (divisions,) * 3)
    body = body_of(mesh, on_the_surface(mesh), "full")
    result = solve_with_boundary(body, harmonic_gradient(mesh.points))
    return float(body.strain_energy_products(result[:, :, None])[0, 0])


def harmonic_gradient(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return grad exp(sqrt(2) x) sin(y) sin(z): harmonic, so in balance by itself.

    Shapes (n, 3), m, to (n, 3), m.
    """
    x, y, z = points.T
    a = np.sqrt(2.0)
    growth = np.exp(a * x)
    along = a * growth * np.sin(y) * np.sin(z)
    return np.stack([along, growth * np.cos(y) * np.sin(z), growth * np.sin(y) * np.cos(z)], axis=1)
