"""The equations of a component: body, coupling and weight in the interface frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from wrenchbook.fea.assembly.blocks import filled_cells
from wrenchbook.fea.assembly.body import ElasticBody
from wrenchbook.fea.assembly.system import System
from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.coupling import Coupling, Distributed, Rigid
from wrenchbook.fea.recovery.weight import weight_of

Array = np.ndarray


def system_of(component: ComponentModel, active: Array) -> System:
    """Set up the equations in the interface frame, its origin at the interface point."""
    mesh = component.mesh
    mesh = replace(mesh, points=(mesh.points - component.point) @ component.axes.T)
    section = component.section
    coupling: Coupling
    if component.coupling == "rigid":
        coupling = Rigid(mesh.points, section.node_ids, active)
    else:
        coupling = Distributed(mesh.points, section.node_ids, section.weights, active)
    free = np.ones(len(mesh.points), dtype=bool)
    free[component.fixed_nodes] = False
    free[coupling.tied] = False
    materials, numbers = component.materials, component.material_of_cells
    integration = component.analysis.integration
    filled = filled_cells(mesh, materials, numbers, integration, component.axes)
    body = ElasticBody(mesh, filled, free)
    return System(body, coupling, component.mesh.points, weight_of(component, body))
