"""A trial of the solver: failures, deflection and stress at the full range, first frequency."""

from __future__ import annotations

from typing import Any

import numpy as np

from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.coupling.coupling import each_interface, largest_rotation
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.recovery.stress import integration_points, nodal_masses, small_stress
from wrenchbook.fea.solve import MAX_DEGREES, Solver
from wrenchbook.fea.solver.vibration import Riding
from wrenchbook.fea.spec.problems import BundleError, BundleProblem
from wrenchbook.fea.tensors import von_mises

Array = np.ndarray

_MAX_SECONDS = 60.0  # of the linear solve by its estimate: an upload waits for it, 300 s at most
_MAX_BYTES = 4e9  # of the same; the server's other solvers run at the same time

_STANDARD_GRAVITY = 9.81  # m/s^2

_WHERE = {"locking_material": "material", "inverted_elements": "mesh", "mechanism": "supports"}


def solver_of(component: ComponentModel) -> Solver:
    """Return the solver; raise BundleError with the failure of every solve of the component."""
    try:
        return Solver(component)
    except SolveFailed as failure:
        raise BundleError([_problem(failure)]) from None


def trial(solver: Solver, cost: dict[str, Any]) -> tuple[dict[str, Any], list[BundleProblem]]:
    """Solve six unit loads; return size, mass and deflection, and problems that stop a solve.

    solver: the component's.
    cost: as `fea.check.cost.estimate` has it: what takes too long is not tried.
    Returns result: ``size`` (three numbers, m), ``volume`` (m^3), ``mass`` (kg; None where a
    material tells no density), ``sag``: the interfaces' displacement at no wrench, where
    self-weight or bolts move them; ``deflection``: the largest of each output over the load range
    by the linear compliance, six numbers an interface, m and rad; None where it was not tried or
    ``failed`` (then true). ``by_temperature`` and ``by_acceleration``: the same of these alone,
    where they are inputs. problems: ``mechanism`` and ``ill_conditioned``, with the text of the
    failure.
    """
    points, bundle = solver.component.mesh.points, solver.component.bundle
    component = solver.component
    volumes = np.zeros(len(component.materials))
    for numbers, volume in solver.volumes:
        np.add.at(volumes, numbers, volume)
    densities = [material.density for material in component.materials]
    known = None if None in densities else float(volumes @ np.array(densities, dtype=float))
    size = np.ptp(points, axis=0).tolist()
    result = {"size": size, "volume": float(volumes.sum()), "mass": known, "deflection": None}
    if cost["linear_seconds"] > _MAX_SECONDS or cost["memory_bytes"] > _MAX_BYTES:
        return result, []
    try:
        compliance = solver.linear.compliance
        at_rest = solver.at_rest[0]
    except SolveFailed as failure:
        result["failed"] = True
        return result, [_problem(failure)]
    low, high = bundle.acting.low, bundle.acting.high
    result["deflection"] = largest(compliance, low, high).tolist()
    if component.analysis.gravity is not None or component.analysis.zero == "untightened":
        result["sag"] = at_rest.tolist()
    first = len(bundle.range.low)
    groups = {"by_temperature": slice(first, first + 1), "by_acceleration": slice(-3, None)}
    present = solver.component.temperature is not None, solver.component.accelerated
    for (name, columns), there in zip(groups.items(), present, strict=True):
        if there:
            result[name] = largest(compliance[:, columns], low[columns], high[columns]).tolist()
    return result, []


def largest(compliance: Array, low: Array, high: Array) -> Array:
    """Return max |C w| over a box of inputs, for each output, shape (6 i,), m and rad."""
    ends = np.stack([compliance * low, compliance * high])
    most, least = ends.max(axis=0).sum(axis=1), ends.min(axis=0).sum(axis=1)
    return np.maximum(np.abs(most), np.abs(least))


def deflection_warnings(
    component: ComponentModel, deflection: list[float] | None
) -> list[BundleProblem]:
    """Return warnings where the full load range moves the part by nothing, or by too much."""
    if deflection is None:
        return []
    moved, problems = np.array(deflection), []
    degrees = float(np.degrees(largest_rotation(moved)))
    if degrees > MAX_DEGREES:
        message = (
            f"rotates the interface by {degrees:.3g} degrees at the full range (linear estimate), "
            f"but solves of more than {MAX_DEGREES:g} degrees are refused; narrow [range]. {_UNITS}"
        )
        problems.append(BundleProblem("range", message))
    limit = component.bundle.tolerance
    if limit is None:
        return problems
    both = each_interface(moved)
    allowed = np.repeat([limit.translation, limit.rotation], 3)
    free = component.active
    if free.size and (both <= allowed).ravel()[free].all():
        message = (
            f"moves the interface by at most {both[:, :3].max():.2g} m and {both[:, 3:].max():.2g} "
            f"rad, less than the tolerance, so the part is practically rigid. {_UNITS}"
        )
        problems.append(BundleProblem("range", message))
    return problems


_UNITS = (
    "If you did not expect this, check the units: unit of the mesh, youngs_modulus in Pa, force in "
    "N, moment in N·m"
)


def _problem(failure: SolveFailed) -> BundleProblem:
    where = _WHERE.get(failure.kind, "mesh")
    return BundleProblem(
        where, f"every solve would fail ({failure.kind}): {failure.message} {failure.remedy}"
    )


def frequency(solver: Solver, riding: Riding | None) -> tuple[dict[str, Any], list[BundleProblem]]:
    """Return mass and first natural frequency of the component, and warnings.

    solver: of the component; its materials without a density weigh nothing.
    riding: the rigid mass on the interface; None for none.
    Returns vibration: ``mass`` (kg, of the component; None without any density),
    ``first_frequency`` (Hz), ``motion`` of the interfaces (6 numbers each, m and rad, of length
    one), ``riding_mass`` (kg), ``condensed_mass`` to the interfaces (6 x 6 each, kg to kg·m^2);
    empty where neither bundle nor argument tells a mass, or no frequency was found. warnings: Why
    not, or that some materials count as weightless.
    """
    component = solver.component
    without_density = [
        material.region for material in component.materials if material.density is None
    ]
    if riding is None and len(without_density) == len(component.materials):
        return {}, []
    carried = riding or Riding.of()
    warnings = []
    if without_density:
        names = ", ".join(f'"{name}"' for name in without_density)
        message = f"has no density for {names}, whose mass counts as 0; write it in kg/m^3"
        warnings.append(BundleProblem("material", message))
    try:
        vibration = solver.vibration(carried)
    except (ValueError, SolveFailed) as error:
        return {}, [*warnings, BundleProblem("material", f"no natural frequency: {error}")]
    result = {
        "mass": vibration.mass if len(without_density) < len(component.materials) else None,
        "first_frequency": vibration.frequency,
        "motion": vibration.interface.tolist(),
        "riding_mass": carried.mass,
        "condensed_mass": vibration.condensed.tolist(),
    }
    return result, warnings


def sag_per_gravity(solver: Solver) -> Array:
    """Return the interface's displacement by gravity, (6, 3), m and rad over m/s^2, first order.

    By reciprocity: the work of the weight on the fields of the unit loads. Gravity is in the
    interface frame; materials without a density weigh nothing.
    """
    masses = nodal_masses(solver.component, solver.body)
    return np.einsum("n,nji->ij", masses, solver.linear.fields)


def weight_warnings(solver: Solver) -> list[BundleProblem]:
    """Return a warning where self-weight without ``gravity`` moves more than the tolerance."""
    component = solver.component
    limit = component.bundle.tolerance
    known = all(material.density is not None for material in component.materials)
    if component.analysis.gravity or component.accelerated or limit is None or not known:
        return []
    by_gravity = _STANDARD_GRAVITY * sag_per_gravity(solver)
    moved, turned = (np.linalg.svd(half)[1][0] for half in (by_gravity[:3], by_gravity[3:]))
    if moved <= limit.translation and turned <= limit.rotation:
        return []
    direction = np.linalg.svd(by_gravity[:3])[2][0] @ component.axes
    down = -np.sign(direction[np.abs(direction).argmax()]) * direction * _STANDARD_GRAVITY
    gravity = ", ".join(f"{number + 0.0:.3g}" for number in np.round(down, 6))
    message = (
        "is missing, so answers leave out self-weight, which moves the interface by up to "
        f"{moved:.2g} m and {turned:.2g} rad under [{gravity}] m/s^2: more than the tolerance. "
        "Write gravity = [0, 0, -9.81] under [analysis]; for a part that rotates use "
        "[inputs.acceleration]"
    )
    return [BundleProblem("analysis.gravity", message)]


_MAX_CORNERS = 4096  # of two interfaces' twelve loads: 0.2 s for 30,000 points
_FIRST_POINTS = 64


def strength(solver: Solver, nonlinear: bool) -> tuple[list[dict[str, Any]], list[BundleProblem]]:
    """Return the largest stress of each material under the load range, and what to know of it.

    To first order stresses are linear in the wrench, and the von Mises stress is a norm of them:
    no wrench of the range has a larger stress than its worst corner.

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
        if len(corners) > _MAX_CORNERS * 2 ** len(component.further):
            raise ValueError("three interfaces or more have too many corners; give one the range 0")
        unit = solver.unit_stresses()
        loads = corners
        if component.analysis.gravity or component.bolts:  # a load that is always there
            sag = small_stress(solver.body, solver.at_rest[1][:, :, None])
            unit = np.concatenate((unit, sag), axis=2)
            loads = np.column_stack((corners, np.ones(len(corners))))
        coordinates, numbers = integration_points(component, component.mesh.points)
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
                    "at": coordinates[points[point]].tolist(),
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
        warnings += _replace_by_nonlinear(component, solver, stresses)
    return stresses, warnings + _yielding(component, stresses)


def _worst(unit: Array, corners: Array) -> tuple[float, int, int]:
    """Return the largest stress, Pa, and the first corner and point (of `unit`) that have it.

    The sum of single loads' stresses bounds that of all: few points are candidates.
    """
    loads = np.abs(corners).max(axis=0)
    bound = sum(load * von_mises(unit[:, :, i]) for i, load in enumerate(loads))
    top = unit[np.argsort(bound)[-_FIRST_POINTS:]]
    least = max(von_mises(top @ corner).max() for corner in corners)
    points = np.flatnonzero(bound >= (1 - 1e-9) * least)
    candidates, worst_so_far = unit[points], (-1.0, 0, 0)
    for i, corner in enumerate(corners):
        equivalent = von_mises(candidates @ corner)
        worst = int(equivalent.argmax())
        if equivalent[worst] > worst_so_far[0]:
            worst_so_far = float(equivalent[worst]), i, int(points[worst])
    return worst_so_far


def _replace_by_nonlinear(
    component: ComponentModel, solver: Solver, stresses: list[dict[str, Any]]
) -> list[BundleProblem]:
    """Put the nonlinear stresses at the worst corners in place of the first-order ones."""
    regions = [material.region for material in component.materials]
    coordinates, numbers = integration_points(component, component.mesh.points)
    for row in stresses:
        worst = [*row["wrench"], *(row[scalar.name] for scalar in component.further)]
        try:
            stress = solver.stresses(solver.solve(worst))
        except SolveFailed as error:
            message = f'are linear: the solve at a corner of [range] fails ("{error}")'
            return [BundleProblem("stresses", message)]
        equivalent = np.where(numbers == regions.index(row["region"]), von_mises(stress), -1.0)
        point = int(equivalent.argmax())
        row |= {
            "largest": float(equivalent[point]),
            "at": coordinates[point].tolist(),
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
            message = "is compared with the von Mises stress, which suits isotropic ones only"
            problems.append(BundleProblem(key, message))
        for row in stresses:
            if row["region"] == material.region and row["largest"] > strength:
                message = (
                    f"is exceeded at the full range: the stress is {row['largest']:.4g} Pa, "
                    f"{row['largest'] / strength:.2g} times as high. The solver has no plasticity, "
                    "so its answers are too stiff. Narrow [range], or strengthen the part"
                )
                problems.append(BundleProblem(key, message))
    return problems
