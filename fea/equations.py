"""The equations of a component: its cells, their coupling, weight and the tension of bolts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from wrenchbook.fea.assembly.blocks import filled_cells, sorted_cells
from wrenchbook.fea.assembly.body import ElasticBody
from wrenchbook.fea.assembly.system import System
from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.coupling import Coupling, Distributed, Rigid
from wrenchbook.fea.coupling.coupling import SectionCoupling
from wrenchbook.fea.element.cell_stiffness import CellStiffness
from wrenchbook.fea.mesh.mesh import CellBlock, Mesh
from wrenchbook.fea.mesh.reference_cell import reference_element
from wrenchbook.fea.spec.schema import FREEDOMS


def system_of(component: ComponentModel) -> System:
    """Set up the equations in the first interface's frame, with its point as the origin.

    Raises SolveFailed of kind ``inverted_elements`` or ``locking_material`` if cells cannot be
    used.
    """
    mesh, axes = component.mesh, component.axes
    mesh = replace(mesh, points=(mesh.points - component.interfaces[0].point) @ axes.T)
    coupling = _coupling_of(component)
    free = np.ones(len(mesh.points), dtype=bool)
    free[component.fixed_nodes] = False
    free[coupling.constrained] = False
    preload = np.zeros_like(mesh.points)  # the tension of bolts, on the slips of their cuts
    for bolt in component.bolts:
        free[bolt.slip] = bolt.bolt.keeps == "force"
        preload[bolt.slip] = -bolt.bolt.force * (axes @ bolt.axis)
    nodes, held = component.guided
    body = ElasticBody(mesh, _filled(component, mesh), free, (nodes, axes @ held @ axes.T))

    # Self-weight is constant; the acceleration is an input.
    gravity = component.analysis.gravity
    weight = body_force = None
    if gravity is not None or component.accelerated:
        per_acceleration = nodal_masses(component, body)[:, None, None] * axes
        weight = None if gravity is None else per_acceleration @ np.array(gravity)
        body_force = per_acceleration if component.accelerated else None
    tension = preload if component.bolts else None
    return System(body, coupling, component.mesh.points, weight, body_force, tension)


def _filled(component: ComponentModel, mesh: Mesh) -> list[tuple[CellBlock, CellStiffness]]:
    """Return the cells of `filled_cells`; a field of temperature multiplies their expansion.

    mesh: that of the component in the frame of the equations.
    """
    integration, rise = component.analysis.integration, component.temperature_rise
    cells = component.materials, component.material_of_cells, integration
    filled = filled_cells(mesh, *cells, component.axes, component.interfaces[0].point)
    if rise is None:
        return filled
    warmed = []
    for block, stiffness in filled:
        assert stiffness.expansion is not None
        at_points = rise[block.nodes] @ reference_element(block.kind, integration).values.T
        expansion = at_points[:, :, None, None] * stiffness.expansion
        warmed.append((block, replace(stiffness, expansion=expansion)))
    return warmed


def material_of_parts(component: ComponentModel) -> list[np.ndarray]:
    """Return for each part of `ElasticBody.parts` its cells' material numbers, shape (cells,)."""
    cells = component.materials, component.material_of_cells
    return [numbers[chosen] for _, numbers, chosen, _, _ in sorted_cells(component.mesh, *cells)]


def nodal_masses(component: ComponentModel, body: ElasticBody) -> np.ndarray:
    """Return the mass that each node carries, shape (n,), kg; without a density it is zero."""
    densities = np.array([material.density or 0.0 for material in component.materials])
    total = np.zeros(body.size)
    numbers = material_of_parts(component)
    for part, nodes, number in zip(body.parts, body.cells, numbers, strict=True):
        carried = densities[number][:, None] * part.gradients.weights
        masses = (carried[:, None] @ part.gradients.values)[:, 0]
        total = total + np.bincount(nodes.ravel(), masses.ravel(), minlength=body.size)
    return total


def _coupling_of(component: ComponentModel) -> Coupling:
    """Return the coupling of a component's interfaces and frames, which springs hold."""
    # Each interface's coupling, its nodes, and its axes in the body's if they differ.
    sections: list[tuple[SectionCoupling, np.ndarray, np.ndarray | None]] = []
    for attached in (*component.interfaces, *component.frames):
        nodes = attached.section.node_ids
        points = ((component.mesh.points - attached.point) @ attached.axes.T)[nodes]
        if attached.coupling == "rigid":
            section = Rigid(points)
        else:
            section = Distributed(points, attached.section.weights)
        same = np.array_equal(attached.axes, component.axes)
        sections.append((section, nodes, None if same else attached.axes @ component.axes.T))
    first, n_frames = len(component.interfaces), len(component.frames)
    springs = [
        (tuple(first + frame for frame in ends), stiffness) for ends, stiffness in component.springs
    ]
    size, active = len(component.mesh.points), component.active
    return Coupling(size, sections, active, _anchors(component), n_frames, springs)


def _anchors(component: ComponentModel) -> np.ndarray:
    """Return three distant nodes of each section whose mean may be the only support of the part."""
    anchors = [np.empty(0, dtype=np.int64)]
    held = [interface for interface in component.interfaces if interface.locked == FREEDOMS]
    held = [] if component.fixed_nodes.size else held
    for attached in (*held, *component.frames):
        if attached.coupling == "distributed":
            nodes = np.setdiff1d(attached.section.node_ids, component.sliding[0])
            arms = component.mesh.points[nodes] - component.mesh.points[nodes].mean(axis=0)
            first = int(np.linalg.norm(arms, axis=1).argmax())
            away = arms - arms[first]
            second = int(np.linalg.norm(away, axis=1).argmax())
            third = int(np.linalg.norm(np.cross(away, away[second]), axis=1).argmax())
            anchors.append(nodes[[first, second, third]])
    return np.concatenate(anchors)
