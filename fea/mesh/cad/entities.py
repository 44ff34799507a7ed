"""The faces and bodies of a geometry file, numbered so that a bundle can name them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from wrenchbook.fea.mesh.facets import Face

METRES = 1e-3
"""gmsh works in mm here: its geometry kernel's tolerances are absolute and made for mm."""


@dataclass(frozen=True)
class Solid:
    """One solid body: its number, volume (m^3) and centre of mass (m)."""

    number: int
    volume: float
    centre: tuple[float, float, float]


def bodies_of(gmsh: Any) -> tuple[Solid, ...]:
    """Return the solid bodies of the open file."""
    return tuple(
        Solid(
            number,
            gmsh.model.occ.getMass(3, number) * METRES**3,
            _metres(gmsh.model.occ.getCenterOfMass(3, number)),
        )
        for _, number in gmsh.model.getEntities(3)
    )


def faces_of(gmsh: Any) -> tuple[Face, ...]:
    """Return the faces of the bodies of the open file."""
    bounding = {
        tag
        for _, body in gmsh.model.getEntities(3)
        for _, tag in gmsh.model.getBoundary([(3, body)], oriented=False)
    }
    return tuple(_face(gmsh, number) for number in sorted(bounding))


def _face(gmsh: Any, number: int) -> Face:
    """Return a face of the open file by gmsh's number."""
    # Older versions of gmsh only have getType.
    type_of = getattr(gmsh.model, "getEntityType", None) or gmsh.model.getType
    kind = type_of(2, number)
    radius = None
    if kind == "Cylinder":  # the inverse of its larger principal curvature
        middle = _middle(gmsh, number)
        largest, smallest, _, _ = gmsh.model.getPrincipalCurvatures(number, middle)
        radius = METRES / max(abs(float(largest[0])), abs(float(smallest[0])))
    return Face(
        number,
        kind,
        gmsh.model.occ.getMass(2, number) * METRES**2,
        _metres(gmsh.model.occ.getCenterOfMass(2, number)),
        _outward(gmsh, number) if kind == "Plane" else None,
        radius,
    )


def _metres(point: Any) -> tuple[float, float, float]:
    """Return a point of gmsh, mm, in m."""
    x, y, z = (float(coordinate) * METRES for coordinate in point)
    return x, y, z


def _middle(gmsh: Any, number: int) -> list[float]:
    """Return the middle of a face's ranges of parameters."""
    low, high = gmsh.model.getParametrizationBounds(2, number)
    return [0.5 * (a + b) for a, b in zip(low, high, strict=True)]


def _outward(gmsh: Any, number: int) -> tuple[float, float, float]:
    """Return a plane's unit normal, away from its body (the first one where two share it)."""
    normal = np.array(gmsh.model.getNormal(number, _middle(gmsh, number)))
    inside = _point_on(gmsh, number)
    body = int(gmsh.model.getAdjacencies(2, number)[0][0])
    # Small against the body behind the face.
    step = 1e-4 * np.sqrt(gmsh.model.occ.getMass(2, number))
    if gmsh.model.isInside(3, body, (inside + step * normal).tolist()):
        normal = -normal
    x, y, z = (round(float(component), 12) + 0.0 for component in normal)  # + 0.0: no -0.0
    return x, y, z


def _point_on(gmsh: Any, number: int) -> np.ndarray:
    """Return a point within the edges of a face (its centre may lie in a hole), mm."""
    low, high = gmsh.model.getParametrizationBounds(2, number)
    for fraction in _FRACTIONS:
        parameters = [a + s * (b - a) for a, b, s in zip(low, high, fraction, strict=True)]
        if gmsh.model.isInside(2, number, parameters, parametric=True):
            return np.array(gmsh.model.getValue(2, number, parameters))
    return np.array(gmsh.model.occ.getCenterOfMass(2, number))


# The middle, then points that fill the square evenly: additive recurrence of the plastic number
# (Roberts 2018, "The unreasonable effectiveness of quasirandom sequences").
_FRACTIONS = [((0.5 + 0.7548776662 * i) % 1, (0.5 + 0.5698402910 * i) % 1) for i in range(200)]
