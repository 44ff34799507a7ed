"""Masses and own weight of a component, node by node."""

from __future__ import annotations

import numpy as np

from wrenchbook.fea.assembly.body import ElasticBody
from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.recovery.stress import places_of

Array = np.ndarray


def material_of_parts(component: ComponentModel, body: ElasticBody) -> list[Array]:
    """Return for each of the body's parts its cells' material numbers, shape (cells,)."""
    materials, first, by_part = places_of(component, body.points)[1], 0, []
    for part in body.parts:
        weights = part.gradients.weights
        by_part.append(materials[first : first + weights.size : weights.shape[1]])
        first += weights.size
    return by_part


def nodal_masses(component: ComponentModel, body: ElasticBody) -> Array:
    """Return the mass that each node carries, shape (n,), kg; without a density it is zero."""
    densities = np.array([material.density or 0.0 for material in component.materials])
    total = np.zeros(body.size)
    numbers = material_of_parts(component, body)
    for part, nodes, number in zip(body.parts, body.cells, numbers, strict=True):
        masses = (densities[number][:, None] * part.gradients.weights) @ part.gradients.values
        total = total + np.bincount(nodes.ravel(), masses.ravel(), minlength=body.size)
    return total


def pull_of(component: ComponentModel, body: ElasticBody) -> Array:
    """Return the nodal forces per unit of acceleration along the mesh's axes, (n, 3, 3), kg.

    They are in the interface frame, as the body is.
    """
    return nodal_masses(component, body)[:, None, None] * component.axes
