"""The stored fields of one solve: its surface as triangles, and its stresses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wrenchbook.fea.assembly.body import ElasticBody
from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.mesh.facets import outer_surface, triangles_of
from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.recovery.stress import (
    cauchy_stress,
    integration_points,
    small_stress,
    stress_of,
)
from wrenchbook.fea.solution import Solution
from wrenchbook.fea.tensors import von_mises

MAX_POINTS = 20_000
"""Integration points whose stresses are stored, some 1.5 MB a row; of more only the largest is."""


@dataclass(frozen=True, eq=False)
class SolveFields:
    """Surface and stresses of one solve, in the undeformed frame of the first interface."""

    # Whether the slopes are the complete answer: fields = slopes @ inputs, a temperature among them
    # relative to its reference.
    linear: bool
    vertices: np.ndarray  # shape (v, 3), m, undeformed
    triangles: np.ndarray  # shape (t, 3), int32
    full_vertices: int  # number of vertices of the outer surface before it was simplified
    displacement: np.ndarray  # shape (v, 3), m
    displacement_slopes: np.ndarray  # shape (v, 3, k), m/N, m/(N·m), m/K: change with each input
    # p integration points; p = 0 if there are more than `MAX_POINTS`.
    stress: np.ndarray  # shape (p, 6), Pa, Cauchy's: xx, yy, zz, xy, xz, yz
    stress_slopes: np.ndarray  # shape (p, 6, k), Pa/N, Pa/(N·m), Pa/K
    places: np.ndarray  # shape (p, 3), m, undeformed
    materials: np.ndarray  # shape (p,), int32, index into `regions`
    regions: tuple[str, ...]  # the materials' regions
    largest: float  # von Mises stress over all integration points, Pa
    largest_at: tuple[float, float, float]  # point of the largest value, m
    largest_region: str
    weight: bool = False  # whether self-weight or preload of bolts acts


def fields_of(component: ComponentModel, body: ElasticBody, solution: Solution) -> SolveFields:
    """Return the fields of a solution.

    component, body: the solved component; its body in the interface frame.
    solution: with its `tangents`.
    """
    linear, axes = not component.analysis.nonlinear, component.axes
    nodes = solution.nodes @ axes.T
    assert solution.tangents is not None
    slopes = np.einsum("ij,njk->nik", axes, solution.tangents)
    points, materials = integration_points(component, body.points)
    shown = slice(None) if len(points) <= MAX_POINTS else slice(0)
    stress, changes = _stresses(component, body, solution, slopes, shown)

    regions = tuple(material.region for material in component.materials)
    equivalent = von_mises(stress)
    worst = int(equivalent.argmax())
    surface = shown_surface(component.mesh)
    return SolveFields(
        linear=linear,
        vertices=body.points[surface.nodes],
        triangles=surface.triangles,
        full_vertices=surface.full_count,
        displacement=nodes[surface.nodes],
        displacement_slopes=slopes[surface.nodes],
        stress=stress[shown],
        stress_slopes=changes[shown],
        places=points[shown],
        materials=materials[shown],
        regions=regions,
        largest=float(equivalent[worst]),
        largest_at=(float(points[worst, 0]), float(points[worst, 1]), float(points[worst, 2])),
        largest_region=regions[int(materials[worst])],
        weight=component.is_preloaded,
    )


def _stresses(
    component: ComponentModel,
    body: ElasticBody,
    solution: Solution,
    slopes: np.ndarray,
    shown: slice,
) -> tuple[np.ndarray, np.ndarray]:
    """Return stresses, shape (p, 6), Pa, and their change with the inputs, (p, 6, k)."""
    loads = len(solution.displacement)
    if not component.analysis.nonlinear:
        changes = small_stress(body, slopes, loads)
        if component.is_preloaded:
            return stress_of(component, body, solution), changes
        return changes @ (solution.wrench - component.reference_inputs), changes
    # Changes that are not stored are not computed: they take six times the stresses.
    fields = slopes if shown.stop is None else slopes[:, :, :0]
    nodes = solution.nodes @ component.axes.T
    temperature = component.warming(solution.wrench)
    return cauchy_stress(body, nodes, fields, temperature, loads)


MAX_VERTICES = 40_000
"""Vertices of a stored surface: a row's field then takes some 2 MB, and JSON of it some 10 MB."""


@dataclass(frozen=True, eq=False)
class ShownSurface:
    """Triangles between some of a mesh's nodes; all are indices."""

    nodes: np.ndarray  # shape (v,), int64: the mesh's node of each vertex
    triangles: np.ndarray  # shape (t, 3), int32: vertices, anticlockwise seen from outside
    # Number of nodes of the outer surface; more than the vertices if it was simplified.
    full_count: int


def shown_surface(mesh: Mesh, max_vertices: int = MAX_VERTICES) -> ShownSurface:
    """Return the outer surface, simplified if it has more than `max_vertices`.

    A simplified surface has fewer vertices, each a node of the mesh in its place, so that its
    displacement is the solver's; triangles whose corners are merged are left out.
    """
    nodes, flat = np.unique(triangles_of(outer_surface(mesh.blocks)), return_inverse=True)
    triangles = flat.reshape(-1, 3)
    count = len(nodes)
    if count > max_vertices:
        vertices, triangles = _cluster(mesh.points[nodes], triangles, max_vertices)
        nodes = nodes[vertices]
    return ShownSurface(nodes, triangles.astype(np.int32), count)


def _cluster(
    points: np.ndarray, triangles: np.ndarray, max_vertices: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the remaining points, (v,), and the triangles between these, (t, 3).

    Vertex clustering (Rossignac and Borrel 1993): the points in each box of a grid are merged into
    the first of them, by the finest grid that leaves at most `max_vertices`.
    """
    span = np.ptp(points, axis=0).max()
    few = 1  # boxes along the longest side
    many = int(np.sqrt(max_vertices)) * 8
    while few + 1 < many:
        middle = (few + many) // 2
        boxes = np.unique(_boxes(points, span / middle), axis=0)
        few, many = (middle, many) if len(boxes) <= max_vertices else (few, middle)
    _, first, box = np.unique(
        _boxes(points, span / few), axis=0, return_index=True, return_inverse=True
    )
    merged = box.ravel()[triangles]
    corners = np.sort(merged, axis=1)
    collapsed = (corners[:, 0] == corners[:, 1]) | (corners[:, 1] == corners[:, 2])
    _, distinct = np.unique(corners, axis=0, return_index=True)
    remaining = np.intersect1d(distinct, np.flatnonzero(~collapsed))
    used, renumbered = np.unique(merged[remaining], return_inverse=True)
    return first[used], renumbered.reshape(-1, 3)


def _boxes(points: np.ndarray, size: float) -> np.ndarray:
    extent = np.ptp(points, axis=0)
    sizes = np.where(extent > 0, np.minimum(size, 0.75 * extent), size)  # a plate keeps both faces
    return np.floor((points - points.min(axis=0)) / sizes).astype(np.int64)
