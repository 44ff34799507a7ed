"""The largest von Mises stress under the full load range, for the report of `wrenchbook check`."""

from __future__ import annotations

from typing import Any

import numpy as np

from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.element.equivalent_stress import von_mises
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.recovery.stress import places_of, small_stress
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.problems import BundleProblem

Array = np.ndarray

_MOST_CORNERS = 4096  # of two interfaces' twelve loads: 0.2 s for 30,000 points
_FIRST_POINTS = 64


def strength(solver: Solver, nonlinear: bool) -> tuple[list[dict[str, Any]], list[BundleProblem]]:
    """Return the largest stress of each material under the load range, and what to know of it.

    To first order stresses are linear in the wrench, and the von Mises stress is a norm of them:
    no wrench of the range has a larger one than the worst of its corners.

    solver: Nothing is made of a component whose bundle tells no `yield_strength`.
    nonlinear: whether a nonlinear component is solved at that corner; else its stresses stay first
    order.
    Returns strength: for each material that has cells: ``region``, ``largest`` (Pa), ``at`` (m, in
    the mesh's axes), ``wrench`` (N and N·m), each further input by its name, ``yield_strength`` (Pa
    or None), ``first_order``. warnings: where a material yields, or von Mises says nothing of it;
    why stresses are first order.
    """
    component = solver.component
    if all(material.yield_strength is None for material in component.materials):
        return [], []
    try:
        # The worst corner of the range for each material that has cells.
        corners, count = component.bundle.acting.corners(), len(component.bundle.range.low)
        if len(corners) > _MOST_CORNERS * 2 ** len(component.further):
            raise ValueError("the range of more than two interfaces has too many corners")
        unit = solver.unit_stresses()
        loads = corners
        if component.analysis.gravity:  # one more load, which is always there
            sag = small_stress(solver.body, solver.linear.sag[:, :, None])
            unit = np.concatenate((unit, sag), axis=2)
            loads = np.column_stack((corners, np.ones(len(corners))))
        places, numbers = places_of(component, component.mesh.points)
        stresses = []
        for number in np.unique(numbers):
            points = np.flatnonzero(numbers == number)
            largest, corner, point = _worst(unit[points], loads)
            material = component.materials[number]
            pairs = zip(component.further, corners[corner][count:].tolist(), strict=True)
            stresses.append(
                {
                    "region": material.region,
                    "largest": largest,
                    "at": places[points[point]].tolist(),
                    "wrench": corners[corner][:count].tolist(),
                    **{scalar.name: value + scalar.reference for scalar, value in pairs},
                    "yield_strength": material.yield_strength,
                    "first_order": component.analysis.nonlinear,
                }
            )
    except SolveFailed as error:
        return [], [BundleProblem("material", f"no stresses: {error}")]
    except ValueError as error:
        return [], [BundleProblem("material", f"no largest stress: {error}")]
    warnings: list[BundleProblem] = []
    if nonlinear and component.analysis.nonlinear:
        warnings += _at_large(component, solver, stresses)
    return stresses, warnings + _yielding(component, stresses)


def _worst(unit: Array, corners: Array) -> tuple[float, int, int]:
    """Return the largest stress, Pa, and the first corner and point (of `unit`) that have it.

    The sum of the loads' own stresses bounds that of all: most points need not be looked at.
    """
    loads = np.abs(corners).max(axis=0)
    bound = sum(load * von_mises(unit[:, :, i]) for i, load in enumerate(loads))
    top = unit[np.argsort(bound)[-_FIRST_POINTS:]]
    least = max(von_mises(top @ corner).max() for corner in corners)
    points = np.flatnonzero(bound >= (1 - 1e-9) * least)
    looked_at, worst_yet = unit[points], (-1.0, 0, 0)
    for i, corner in enumerate(corners):
        equivalent = von_mises(looked_at @ corner)
        worst = int(equivalent.argmax())
        if equivalent[worst] > worst_yet[0]:
            worst_yet = float(equivalent[worst]), i, int(points[worst])
    return worst_yet


def _at_large(
    component: ComponentModel, solver: Solver, stresses: list[dict[str, Any]]
) -> list[BundleProblem]:
    """Put the nonlinear stresses at the worst corners in place of the first-order ones."""
    regions = [material.region for material in component.materials]
    places, numbers = places_of(component, component.mesh.points)
    for row in stresses:
        worst = [*row["wrench"], *(row[scalar.name] for scalar in component.further)]
        try:
            stress = solver.stresses(solver.solve(worst))
        except SolveFailed as error:
            message = f'are of first order: the solve at a corner of [range] fails ("{error}")'
            return [BundleProblem("stresses", message)]
        equivalent = np.where(numbers == regions.index(row["region"]), von_mises(stress), -1.0)
        point = int(equivalent.argmax())
        row |= {
            "largest": float(equivalent[point]),
            "at": places[point].tolist(),
            "first_order": False,
        }
    return []


def _yielding(component: ComponentModel, stresses: list[dict[str, Any]]) -> list[BundleProblem]:
    problems = []
    for number, material in enumerate(component.materials):
        key, strength = f"material[{number}].yield_strength", material.yield_strength
        if strength is None:
            continue
        if material.law == "orthotropic":
            message = "is compared with the von Mises stress, a poor measure for such a material"
            problems.append(BundleProblem(key, message))
        for row in stresses:
            if row["region"] == material.region and row["largest"] > strength:
                message = (
                    f"is exceeded under the full range: {row['largest']:.4g} Pa, "
                    f"{row['largest'] / strength:.2g} times it; materials here do not yield: "
                    "answers there are too stiff. Narrow [range], or strengthen the part"
                )
                problems.append(BundleProblem(key, message))
    return problems
