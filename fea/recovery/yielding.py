"""How much of a part is beyond its materials' yield strength in a solve."""

from __future__ import annotations

import numpy as np

from wrenchbook.fea.assembly.body import ElasticBody
from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.element.equivalent_stress import von_mises
from wrenchbook.fea.recovery.stress import places_of, small_stress, stress_of
from wrenchbook.fea.solution import Solution

Array = np.ndarray


def most_used(component: ComponentModel, body: ElasticBody, fields: Array) -> Array:
    """Return the largest shares of the yield strength under unit loads (k,), each of one over it.

    `fields` has shape (n, 3, k), m over each unit, in the body's axes. The von Mises stress is a
    seminorm, so that of a sum of loads is at most the sum of theirs (triangle inequality).
    """
    if not np.isfinite(_strengths(component)).any():
        return np.zeros(fields.shape[2])
    strengths = _strengths(component)[places_of(component, body.points)[1]]
    parts = np.split(fields, fields.shape[2], axis=2)  # one at a time: stresses take much memory
    used = [(von_mises(small_stress(body, one)[:, :, 0]) / strengths).max() for one in parts]
    return np.array(used)


def _strengths(component: ComponentModel) -> Array:
    return np.array([one.yield_strength or np.inf for one in component.materials])


def yielding(component: ComponentModel, body: ElasticBody, solution: Solution) -> str:
    """Return which share of the part's volume yields, in words; none if nothing does.

    By the von Mises stress at the integration points. Materials here do not yield, so the answer
    is too stiff beyond that.
    """
    strengths = _strengths(component)
    if not np.isfinite(strengths).any():
        return ""
    materials = places_of(component, body.points)[1]
    used = von_mises(stress_of(component, body, solution)) / strengths[materials]
    worst = int(used.argmax())
    if not used[worst] > 1.0:
        return ""
    volumes = np.concatenate([part.gradients.weights.ravel() for part in body.parts])
    share = 100 * volumes[used > 1.0].sum() / volumes.sum()
    material = component.materials[materials[worst]]
    return (
        f"{share:.2g} % of the part's volume is beyond its yield strength at this wrench, up to "
        f"{used[worst]:.3g} times that of {material.region} ({material.yield_strength:.4g} Pa): "
        "materials here do not yield, so the answer is too stiff."
    )
