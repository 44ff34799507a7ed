"""The fields of one solve that are worth keeping: its surface and its stresses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wrenchbook.fea.assembly.body import ElasticBody
from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.element.equivalent_stress import von_mises
from wrenchbook.fea.recovery.stress import cauchy_stress, places_of, small_stress, stress_of
from wrenchbook.fea.recovery.surface import surface_of
from wrenchbook.fea.solution import Solution

Array = np.ndarray

MOST_POINTS = 20_000
"""Integration points whose stresses are kept, some 1.5 MB a row; of more only the largest is."""


@dataclass(frozen=True, eq=False)
class SolveFields:
    """Surface and stresses of one solve, in the undeformed frame of the first interface.

    Attributes
    ----------
    linear
        Whether the slopes are the whole answer: fields = slopes @ inputs, a temperature among them
        from its reference.
    vertices, triangles
        Shape (v, 3), m, undeformed, and (t, 3), int32.
    whole_vertices
        Of the outer surface before it was simplified.
    displacement, displacement_slopes
        Shapes (v, 3), m, and (v, 3, k), m/N, m/(N·m) and m/K: its change with the inputs.
    stress, stress_slopes
        Shapes (p, 6), Pa (Cauchy's: xx, yy, zz, xy, xz, yz), and (p, 6, k), Pa/N, Pa/(N·m), Pa/K;
        p = 0 where there are more points than `MOST_POINTS`.
    places, materials
        Shapes (p, 3), m, undeformed, and (p,), int32, index into `regions`.
    regions
        The materials' regions.
    weight
        Whether the component's own weight acts.
    largest, largest_at, largest_region
        The largest von Mises stress over all integration points, Pa, its place, m, and region.
    """

    linear: bool
    vertices: Array
    triangles: Array
    whole_vertices: int
    displacement: Array
    displacement_slopes: Array
    stress: Array
    stress_slopes: Array
    places: Array
    materials: Array
    regions: tuple[str, ...]
    largest: float
    largest_at: tuple[float, float, float]
    largest_region: str
    weight: bool = False


def fields_of(component: ComponentModel, body: ElasticBody, solution: Solution) -> SolveFields:
    """Return the fields of a solution.

    Parameters
    ----------
    component, body
        What was solved; the body in the interface frame.
    solution
        With its `tangents`.
    """
    linear, axes = not component.analysis.nonlinear, component.axes
    hangs = component.analysis.gravity is not None
    nodes = solution.nodes @ axes.T
    assert solution.tangents is not None
    slopes = np.einsum("ij,njk->nik", axes, solution.tangents)
    places, materials = places_of(component, body.points)
    kept = slice(None) if len(places) <= MOST_POINTS else slice(0)
    stress, changes = _stresses(component, body, solution, slopes, kept)
    regions = tuple(material.region for material in component.materials)
    equivalent = von_mises(stress)
    worst = int(equivalent.argmax())
    surface = surface_of(component.mesh)
    return SolveFields(
        linear=linear,
        vertices=body.points[surface.nodes],
        triangles=surface.triangles,
        whole_vertices=surface.whole,
        displacement=nodes[surface.nodes],
        displacement_slopes=slopes[surface.nodes],
        stress=stress[kept],
        stress_slopes=changes[kept] if kept.stop is None else changes[:0],
        places=places[kept],
        materials=materials[kept],
        regions=regions,
        largest=float(equivalent[worst]),
        largest_at=(float(places[worst, 0]), float(places[worst, 1]), float(places[worst, 2])),
        largest_region=regions[int(materials[worst])],
        weight=hangs,
    )


def _stresses(
    component: ComponentModel, body: ElasticBody, solution: Solution, slopes: Array, kept: slice
) -> tuple[Array, Array]:
    """Return stresses, shape (p, 6), Pa, and their change with the inputs, (p, 6, k)."""
    loads = len(solution.displacement)
    if not component.analysis.nonlinear:
        changes = small_stress(body, slopes, loads)
        if component.analysis.gravity is not None:
            return stress_of(component, body, solution), changes
        return changes @ (solution.wrench - component.at_rest), changes
    # Changes that nobody keeps are not made: they take six times the stresses.
    fields = slopes if kept.stop is None else slopes[:, :, :0]
    nodes, temperature = solution.nodes @ component.axes.T, component.warming(solution.wrench)
    return cauchy_stress(body, nodes, fields, temperature, loads)
