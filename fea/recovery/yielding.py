"""How much of a part is beyond its materials' yield strength in a solve."""

from __future__ import annotations

import numpy as np

from wrenchbook.fea.assembly.body import ElasticBody
from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.element.equivalent_stress import von_mises
from wrenchbook.fea.recovery.stress import places_of, stress_of
from wrenchbook.fea.solution import Solution


def yielding(component: ComponentModel, body: ElasticBody, solution: Solution) -> str:
    """Return which share of the part's volume yields, in words; none if nothing does.

    By the von Mises stress at the integration points. Materials here do not yield, so the answer
    is too stiff beyond that.
    """
    strengths = np.array([one.yield_strength or np.inf for one in component.materials])
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
