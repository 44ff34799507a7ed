"""The equations of a component: body, couplings, supports and weight in the interface frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from wrenchbook.fea.assembly.blocks import filled_cells
from wrenchbook.fea.assembly.body import ElasticBody
from wrenchbook.fea.assembly.system import System
from wrenchbook.fea.component import AttachedInterface, ComponentModel
from wrenchbook.fea.coupling import Coupling, Distributed, Rigid
from wrenchbook.fea.coupling.coupling import SectionCoupling
from wrenchbook.fea.element.cell_stiffness import CellStiffness
from wrenchbook.fea.mesh.mesh import CellBlock
from wrenchbook.fea.mesh.reference_cell import reference_element
from wrenchbook.fea.recovery.weight import pull_of
from wrenchbook.fea.spec.schema import FREEDOMS

Array = np.ndarray


def system_of(component: ComponentModel, active: Array) -> System:
    """Set up the equations in the first interface's frame, its origin at that interface's point.

    `active` has shape (k,): indices of the freedoms that are not locked, dimensionless.
    """
    mesh = component.mesh
    mesh = replace(mesh, points=(mesh.points - component.point) @ component.axes.T)
    every = [*component.interfaces, *(one for one, _ in component.bushings)]
    sections = [_section(component, one) for one in every]
    springs = [stiffness for _, stiffness in component.bushings]
    coupling = Coupling(len(mesh.points), sections, active, _anchors(component), springs)
    free = np.ones(len(mesh.points), dtype=bool)
    free[component.fixed_nodes] = False
    free[coupling.tied] = False
    materials, numbers = component.materials, component.material_of_cells
    integration = component.analysis.integration
    frame = component.axes, component.point
    filled = filled_cells(mesh, materials, numbers, integration, *frame)
    if component.warmth is not None:
        warmth = component.warmth
        filled = [(block, _warmed(block, part, warmth, integration)) for block, part in filled]
    nodes, held = component.sliding
    body = ElasticBody(mesh, filled, free, (nodes, component.axes @ held @ component.axes.T))
    gravity, weight, pull = component.analysis.gravity, None, None
    if gravity is not None or component.accelerated:
        pull = pull_of(component, body)
        weight = None if gravity is None else pull @ np.array(gravity)
    pull = pull if component.accelerated else None
    return System(body, coupling, component.mesh.points, weight, pull)


def _warmed(
    block: CellBlock, cells: CellStiffness, warmth: Array, integration: str
) -> CellStiffness:
    """Return cells that expand by the part of the temperature's rise at each point, (nodes,)."""
    values = reference_element(block.kind, integration).values
    assert cells.expansion is not None
    part = warmth[block.nodes] @ values.T
    return replace(cells, expansion=part[:, :, None, None] * cells.expansion)


def _section(
    component: ComponentModel, own: AttachedInterface
) -> tuple[SectionCoupling, Array, Array | None]:
    """Return an interface's coupling, its nodes, and its axes in the body's if they differ."""
    nodes = own.section.node_ids
    places = ((component.mesh.points - own.point) @ own.axes.T)[nodes]
    rigid = own.coupling == "rigid"
    coupling = Rigid(places) if rigid else Distributed(places, own.section.weights)
    same = np.array_equal(own.axes, component.axes)
    return coupling, nodes, None if same else own.axes @ component.axes.T


def _anchors(component: ComponentModel) -> Array:
    """Return three nodes far apart of each section whose mean alone may hold the part."""
    found = [np.empty(0, dtype=np.int64)]
    held = [one for one in component.interfaces if one.locked == FREEDOMS]
    held = [] if component.fixed_nodes.size else held
    for own in (*held, *(one for one, _ in component.bushings)):
        if own.coupling == "distributed":
            nodes = np.setdiff1d(own.section.node_ids, component.sliding[0])
            arms = component.mesh.points[nodes] - component.mesh.points[nodes].mean(axis=0)
            first = int(np.linalg.norm(arms, axis=1).argmax())
            away = arms - arms[first]
            second = int(np.linalg.norm(away, axis=1).argmax())
            third = int(np.linalg.norm(np.cross(away, away[second]), axis=1).argmax())
            found.append(nodes[[first, second, third]])
    return np.concatenate(found)
