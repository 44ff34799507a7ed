"""The largest stress of each material under the load range, against its yield strength."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.recovery.stress import integration_points, small_stress
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.problems import BundleProblem, point_text
from wrenchbook.fea.tensors import von_mises

_MAX_CORNERS = 4096  # corners of a range: two interfaces' twelve loads take 0.2 s for 30,000 points
_PROBABLY_UNIT = 100.0  # stress over strength: MPa instead of Pa makes 1e6
_STRESS_ROUNDOFF = 1e-9  # relative: roundoff by which a bound may lie below its stress
_FIRST_POINTS = 64  # points with the largest bounds; their stresses exclude most other points


@dataclass(frozen=True)
class LargestStress:
    """Largest von Mises stress of a material's region under the load range."""

    region: str
    largest: float  # Pa
    at: list[float]  # m, in the mesh's axes
    wrench: list[float]  # wrench of all interfaces, N and N·m
    further: dict[str, float]  # values of the further inputs by name
    yield_strength: float | None  # Pa
    first_order: bool  # whether the stress is first order although the component is nonlinear

    def as_json(self) -> dict[str, Any]:
        """Return the entry of the report, with further inputs among the other keys."""
        entry: dict[str, Any] = {}
        for key, value in asdict(self).items():
            entry |= value if key == "further" else {key: value}
        return entry


def strength(solver: Solver, nonlinear: bool) -> tuple[list[LargestStress], list[BundleProblem]]:
    """Return the largest stress of each material with cells under the load range, and warnings.

    Both are empty if no material has a `yield_strength`.

    nonlinear: whether a nonlinear component is solved at the worst corner of the range; otherwise
    its stresses stay first order.
    """
    component = solver.component
    if all(material.yield_strength is None for material in component.materials):
        return [], []
    try:
        stresses = _first_order_stresses(solver)
    except SolveFailed as failure:
        why = f"its stresses are unknown: {failure.message} {failure.remedy}"
        return [], [BundleProblem("material", why)]
    except ValueError as error:
        return [], [BundleProblem("material", f"its largest stress is unknown: {error}")]
    warnings: list[BundleProblem] = []
    if nonlinear and component.analysis.nonlinear:
        warnings += _replace_by_nonlinear(solver, stresses)
    return stresses, [*warnings, *_yielding(component, stresses)]


def _first_order_stresses(solver: Solver) -> list[LargestStress]:
    """Return the largest linear stress of each material that has cells.

    Linear stresses are proportional to the wrench and the von Mises stress is a norm of them, so no
    wrench of the range has a larger stress than the worst corner.

    Raises ValueError if the range has too many corners, SolveFailed as `Solver.unit_stresses`.
    """
    component = solver.component
    corners = component.bundle.acting.corners()
    count = len(component.bundle.range.low)
    limit = _MAX_CORNERS * 2 ** len(component.further)
    if len(corners) > limit:
        end = f"more than {limit}; write 0 as the range of loads that do not act"
        raise ValueError(f"[range] has {len(corners)} corners, {end}")
    unit = solver.unit_stresses()
    loads = corners
    if component.is_preloaded:
        sag = small_stress(solver.body, solver.unloaded_displacements[1][:, :, None])
        unit = np.concatenate((unit, sag), axis=2)
        loads = np.column_stack((corners, np.ones(len(corners))))

    coordinates, numbers = integration_points(component, component.mesh.points)
    stresses = []
    for number in np.unique(numbers):
        points = np.flatnonzero(numbers == number)
        stress, corner, point = _worst(unit[points], loads)
        material = component.materials[number]
        pairs = zip(component.further, corners[corner][count:].tolist(), strict=True)
        largest_stress = LargestStress(
            region=material.region,
            largest=stress,
            at=coordinates[points[point]].tolist(),
            wrench=corners[corner][:count].tolist(),
            further={scalar.name: value + scalar.reference for scalar, value in pairs},
            yield_strength=material.yield_strength,
            first_order=component.analysis.nonlinear,
        )
        stresses.append(largest_stress)
    return stresses


def _worst(unit: np.ndarray, corners: np.ndarray) -> tuple[float, int, int]:
    """Return the largest stress, Pa, and the indices of its corner and point.

    unit: shape (points, 6, k), Pa per unit of the inputs.
    corners: shape (c, k), of the range of the inputs.

    A point's stress is at most the sum of the single loads' stresses (triangle inequality), so only
    points whose sum reaches the stress of some other point are candidates.
    """
    loads = np.abs(corners).max(axis=0)
    bound = sum(load * von_mises(unit[:, :, i]) for i, load in enumerate(loads))
    top = unit[np.argsort(bound)[-_FIRST_POINTS:]]
    reached = max(von_mises(top @ corner).max() for corner in corners)
    points = np.flatnonzero(bound >= (1 - _STRESS_ROUNDOFF) * reached)
    candidates = unit[points]
    worst_so_far = (-1.0, 0, 0)
    for i, corner in enumerate(corners):
        equivalent = von_mises(candidates @ corner)
        worst = int(equivalent.argmax())
        if equivalent[worst] > worst_so_far[0]:
            worst_so_far = float(equivalent[worst]), i, int(points[worst])
    return worst_so_far


def _replace_by_nonlinear(solver: Solver, stresses: list[LargestStress]) -> list[BundleProblem]:
    """Replace the first-order stresses at the worst corners by nonlinear ones."""
    component = solver.component
    regions = [material.region for material in component.materials]
    coordinates, numbers = integration_points(component, component.mesh.points)
    nonlinear = list[LargestStress]()
    for linear in stresses:
        try:
            stress = solver.stresses(solver.solve([*linear.wrench, *linear.further.values()]))
        except SolveFailed as failure:
            loads = ", ".join(f"{load:g}" for load in linear.wrench)
            corner = f"the solve of a corner of [range], ({loads}) in N and N·m, fails"
            message = f"are linear: {corner} ({failure.message} {failure.remedy})"
            return [BundleProblem("stresses", message)]
        equivalent = np.where(numbers == regions.index(linear.region), von_mises(stress), -1.0)
        point = int(equivalent.argmax())
        largest = float(equivalent[point])
        at = coordinates[point].tolist()
        nonlinear.append(replace(linear, largest=largest, at=at, first_order=False))
    stresses[:] = nonlinear  # all or none, as the warning says
    return []


def _yielding(component: ComponentModel, stresses: list[LargestStress]) -> Iterator[BundleProblem]:
    """Yield warnings for materials whose largest stress exceeds their yield strength."""
    for number, material in enumerate(component.materials):
        key = f"material[{number}].yield_strength"
        strength = material.yield_strength
        if strength is None:
            continue
        if material.law == "orthotropic":
            message = (
                "is compared with von Mises stress, which suits isotropic materials only; leave "
                "it out"
            )
            yield BundleProblem(key, message)
        for stress in stresses:
            if stress.region == material.region and stress.largest > strength:
                ratio = stress.largest / strength
                unit = "Check its unit (Pa). " if ratio > _PROBABLY_UNIT else ""
                message = (
                    f"is exceeded at the full range: the stress near {point_text(stress.at)} m is "
                    f"{stress.largest:.4g} Pa, {ratio:.2g} times as high. {unit}The "
                    "solver has no plasticity, so its answers are too stiff. Narrow [range], or "
                    "strengthen the part"
                )
                yield BundleProblem(key, message)
