"""Stresses at the integration points, in the first interface's frame, and yielding by them."""

from __future__ import annotations

import numpy as np

from wrenchbook.fea.assembly.blocks import sorted_cells
from wrenchbook.fea.assembly.body import ElasticBody, gather
from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.mesh.reference_cell import reference_element
from wrenchbook.fea.solution import Solution
from wrenchbook.fea.tensors import COLUMNS, ROWS, von_mises

# K, half the step of a difference by the temperature: its relative error is the square of the
# thermal strain in it, 1e-10.
_HALF_STEP = 0.5


def integration_points(
    component: ComponentModel, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return coordinates and material of each integration point, by `ElasticBody.parts`.

    points: shape (n, 3), m: the mesh's points, in the frame of the result.
    Returns coordinates: shape (p, 3), m, undeformed. materials: shape (p,), int32: index of each
    point's material.
    """
    coordinates, materials = [], []
    cells = sorted_cells(component.mesh, component.materials, component.material_of_cells)
    for block, numbers, of_part, _, _ in cells:
        element = reference_element(block.kind, component.analysis.integration)
        coordinates.append((element.values @ points[block.nodes[of_part]]).reshape(-1, 3))
        materials.append(np.repeat(numbers[of_part], len(element.values)))
    return np.concatenate(coordinates), np.concatenate(materials).astype(np.int32)


def small_stress(body: ElasticBody, fields: np.ndarray, loads: int | None = None) -> np.ndarray:
    """Return the stresses of small displacement fields: xx, yy, zz, xy, xz, yz.

    fields: shape (n, 3, k), m per unit of each input.
    loads: the number of fields before that of one kelvin; None if there is none.
    Returns stresses: shape (p, 6, k), Pa per unit.
    """
    if body.expands and loads is not None:
        before, thermal, after = np.split(fields, [loads, loads + 1], axis=2)
        warm = small_stress(body.at(1.0, finite=False), thermal)
        return np.concatenate([small_stress(body, before), warm, small_stress(body, after)], axis=2)
    stresses = []
    for part, nodes in zip(body.parts, body.cells, strict=True):
        stress = part.small_stresses(np.moveaxis(gather(fields, nodes), -1, 0))
        stresses.append(np.moveaxis(_six(stress), 0, -1))
    return np.concatenate(stresses)


def cauchy_stress(
    body: ElasticBody,
    displacement: np.ndarray,
    tangents: np.ndarray,
    temperature: float,
    loads: int | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the Cauchy stresses of a displaced body, and their change with the inputs.

    displacement: shape (n, 3), m.
    tangents: shape (n, 3, k): its change with the inputs, m per unit of each; k = 0 for the
    stresses alone.
    temperature: K from the reference.
    loads: the number of inputs before the temperature; None where that is no input.
    Returns stresses: shape (p, 6), Pa: xx, yy, zz, xy, xz, yz. changes: shape (p, 6, k), Pa per
    unit of each.
    """
    stresses, changes = [], []
    heated = body.at(temperature)
    for part, nodes in zip(heated.parts, body.cells, strict=True):
        fields = np.moveaxis(gather(tangents, nodes), -1, 0)
        stress, change = part.cauchy_stresses(gather(displacement, nodes), fields)
        stresses.append(_six(stress))
        changes.append(np.moveaxis(_six(change), 0, -1))
    slopes = np.concatenate(changes)
    if body.expands and loads is not None and tangents.shape[2]:
        # The part of the change at a fixed displacement, by a central difference.
        no_fields = tangents[:, :, :0]
        warmer, cooler = (
            cauchy_stress(body, displacement, no_fields, temperature + step)[0]
            for step in (_HALF_STEP, -_HALF_STEP)
        )
        slopes[:, :, loads] += warmer - cooler
    return np.concatenate(stresses), slopes


def stress_of(component: ComponentModel, body: ElasticBody, solution: Solution) -> np.ndarray:
    """Return the stresses of a solution, shape (p, 6), Pa: Cauchy's, or the small-strain ones."""
    nodes = solution.nodes @ component.axes.T
    temperature = component.warming(solution.wrench)
    if not component.analysis.nonlinear:
        return small_stress(body.at(temperature, finite=False), nodes[:, :, None])[:, :, 0]
    return cauchy_stress(body, nodes, np.empty((*nodes.shape, 0)), temperature)[0]


def _six(stress: np.ndarray) -> np.ndarray:
    """Return the six components of stresses (..., cells, points, 3, 3): shape (..., p, 6)."""
    six = stress[..., ROWS, COLUMNS]
    *before, cells, points, _ = six.shape
    return six.reshape(*before, cells * points, 6)


def most_used(component: ComponentModel, body: ElasticBody, fields: np.ndarray) -> np.ndarray:
    """Return the largest part of the yield strength that each unit load uses, shape (k,).

    The von Mises stress is a seminorm, so that of a sum of loads is at most the sum of theirs.

    fields: shape (n, 3, k), m per unit load, in the body's axes.
    """
    strengths = _strengths(component)
    if not np.isfinite(strengths).any():
        return np.zeros(fields.shape[2])
    _, materials = integration_points(component, body.points)
    largest = np.empty(fields.shape[2])
    for load in range(fields.shape[2]):  # in turn, as the stresses take much memory
        stress = small_stress(body, fields[:, :, load : load + 1])[:, :, 0]
        largest[load] = (von_mises(stress) / strengths[materials]).max()
    return largest


def _strengths(component: ComponentModel) -> np.ndarray:
    """Return the yield strength of each material, Pa; infinite if it has none."""
    return np.array([material.yield_strength or np.inf for material in component.materials])


def yielding(component: ComponentModel, body: ElasticBody, solution: Solution) -> str:
    """Return a warning with the part of the volume above its yield strength; empty if none is.

    The von Mises stresses at the integration points decide.
    """
    strengths = _strengths(component)
    if not np.isfinite(strengths).any():
        return ""
    _, materials = integration_points(component, body.points)
    used = von_mises(stress_of(component, body, solution)) / strengths[materials]
    worst = int(used.argmax())
    if not used[worst] > 1.0:
        return ""
    volumes = np.concatenate([part.gradients.weights.ravel() for part in body.parts])
    percent = 100 * volumes[used > 1.0].sum() / volumes.sum()
    material = component.materials[materials[worst]]
    return (
        f"{percent:.3g} % of the part's volume is above its yield strength, up to "
        f'{used[worst]:.3g} times {material.yield_strength:.4g} Pa in "{material.region}". '
        "Yielding is not modelled, so this answer is too stiff. Narrow [range] or strengthen the "
        "part."
    )
