"""A deformed surface and its largest stress, as they are answered."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wrenchbook.fea.element.equivalent_stress import von_mises
from wrenchbook.service.fields.record import Geometry, RowFields
from wrenchbook.service.fields.solver_share import ErrorParts
from wrenchbook.service.library.component import Component

Floats = NDArray[np.float64]

ROUNDING = 1e-12
"""Of the largest displacement: what storing a field and adding up loses at most."""


class Stress(NamedTuple):
    """The largest von Mises stress at the solver's integration points.

    Attributes
    ----------
    largest, error
        Pa, and its 95 % bar, of the table alone; None where nothing tells it.
    at
        Shape (3,), m: the integration point, undeformed, in the interface frame.
    region, yield_strength
        The material there, and what it bears, Pa; None where its bundle does not say it.
    yields
        Whether any part yields, and by it which is named: True, False, or None where it is not
        known, for lack of a yield strength or because the bar reaches across it.
    """

    largest: float
    error: float | None
    at: tuple[float, ...]
    region: str
    yield_strength: float | None
    yields: bool | None


@dataclass(frozen=True, eq=False)
class Deformed:
    """A deformed surface, in the undeformed interface frame from its point.

    Attributes
    ----------
    component, wrench
        Of which it is, under what: six numbers, N and N·m.
    geometry
        The undeformed surface.
    displacement
        Shape (v, 3), m.
    error
        Shape (v,), m: 95 % bar of the length of each vertex's error; None where nothing tells it.
        The solver's own share is in it, as far as it is known: see `parts`.
    stress
        None where no row tells it between rows: the body has too many integration points.
    source
        ``row``: a solve of this wrench; ``rows``: interpolated; ``linear``: six unit fields.
    rows
        Numbers of the rows it is made of.
    coverage, reason
        ``covered``, ``thin`` or ``outside``, and why: of the table's share alone.
    follows
        Shape (v, 3, 6), m/m and m/rad: how vertices follow the interface; None where not known.
    parts
        What `error` is the sum of; None until the solver's share is added, or without bars.
    within_tolerance
        Whether all bars are; None where there is no tolerance, or they are of the table alone.
    """

    component: str
    wrench: tuple[float, ...]
    geometry: Geometry
    displacement: Floats
    error: Floats | None
    stress: Stress | None
    source: str
    rows: tuple[int, ...] = ()
    coverage: str = "covered"
    reason: str = ""
    follows: Floats | None = None
    parts: ErrorParts | None = None
    within_tolerance: bool | None = None


def rounding(displacement: Floats) -> Floats:
    """Return the bar that no vertex is below, shape (v,), m, of displacements (v, 3), m."""
    return np.full(len(displacement), ROUNDING * np.abs(displacement).max(initial=0.0))


def largest_stress(
    component: Component, geometry: Geometry, stress: Floats, error: float | None
) -> Stress | None:
    """Return the largest of stresses (p, 6), Pa, or that of the part that yields first.

    With yield strengths the point named is the one nearest to yielding, or furthest past it.

    Parameters
    ----------
    error
        The bar of the von Mises stress, Pa.
    """
    if not len(stress):
        return None
    equivalent = von_mises(stress)
    strengths = np.array([component.yield_strengths.get(one, np.inf) for one in geometry.regions])
    use = equivalent / strengths[geometry.materials]
    worst = int(use.argmax()) if use.max() >= 1.0 else int(equivalent.argmax())
    region = geometry.regions[int(geometry.materials[worst])]
    at = tuple(geometry.places[worst].tolist())
    return _held(component, float(equivalent[worst]), error, at, region)


def stress_of_row(component: Component, row: RowFields) -> Stress:
    """Return the largest stress that a row's own solve told, at any integration point."""
    at = tuple(float(x) for x in row.meta["at"])
    return _held(component, float(row.meta["largest"]), 0.0, at, str(row.meta["region"]))


def _held(
    component: Component, largest: float, error: float | None, at: tuple[float, ...], region: str
) -> Stress:
    """Hold a stress against its region's yield strength."""
    strength = component.yield_strengths.get(region)
    yields = None
    if strength is not None and error is not None and abs(largest - strength) > error:
        yields = largest > strength
    return Stress(largest, error, at, region, strength, yields)
