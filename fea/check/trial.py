"""Trial solves of a check: failures, deflection at the full range, first frequency."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NotRequired, TypedDict

import numpy as np

from wrenchbook.fea.check.cost import Cost
from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.coupling.coupling import PER_INTERFACE, each_interface, largest_rotation
from wrenchbook.fea.equations import nodal_masses
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.solve import MAX_DEGREES, Solver
from wrenchbook.fea.solver.vibration import Riding
from wrenchbook.fea.spec.problems import BundleError, BundleProblem

_MAX_SECONDS = 60.0  # s, estimated time of the linear solve: an upload waits for it, 300 s at most
_MAX_BYTES = 4e9  # bytes, estimated memory of it; the server's other solvers run at the same time

_GRAVITY = 9.81  # m/s^2, as the message proposes

# The key of component.toml to change after a failure of each kind; "mesh" for other kinds.
_KEYS = {"locking_material": "material", "mechanism": "supports"}


_UNITS = (  # the remedy of a deflection that is too large or too small
    "If you did not expect this, check the units: unit of the mesh, youngs_modulus in Pa, force in "
    "N, moment in N·m"
)


class Trial(TypedDict):
    """Size, mass and linear displacements of a component."""

    size: list[float]  # three edges of the box around the mesh, m
    volume: float  # m^3
    mass: float | None  # kg; None where a material has no density
    # The largest of each output over the load range by the linear compliance, six numbers an
    # interface, m and rad; None if it was not computed. Then the largest by single further inputs.
    deflection: list[float] | None
    failed: NotRequired[bool]
    # Displacement at no wrench, if self-weight or bolts move an interface.
    sag: NotRequired[list[float]]
    by_temperature: NotRequired[list[float]]
    by_acceleration: NotRequired[list[float]]


class Oscillation(TypedDict, total=False):
    """First natural oscillation; without keys if nothing has a mass or no mode converged."""

    mass: float | None  # mass of the component, kg; None without any density
    first_frequency: float  # Hz
    motion: list[float]  # motion of the interfaces, six numbers each, m and rad, of length one
    riding_mass: float  # kg
    condensed_mass: list[list[float]]  # shape (6 i, 6 i), kg to kg·m^2


def solver_of(component: ComponentModel) -> Solver:
    """Return the solver of a component.

    Raises BundleError with the failure if every solve of the component would fail.
    """
    try:
        return Solver(component)
    except SolveFailed as failure:
        raise BundleError([_problem(failure)]) from None


def trial(solver: Solver, cost: Cost) -> tuple[Trial, list[BundleProblem]]:
    """Solve for unit inputs; return size, mass and deflection, and problems that prevent a solve.

    cost: estimate of one solve; above `_MAX_SECONDS` or `_MAX_BYTES` nothing is solved. The
    problems are ``mechanism`` and ``ill_conditioned``, with the text of the failure.
    """
    component = solver.component
    volumes = np.zeros(len(component.materials))
    for numbers, volume in solver.volumes:
        np.add.at(volumes, numbers, volume)
    densities = [material.density for material in component.materials]
    result: Trial = {
        "size": np.ptp(component.mesh.points, axis=0).tolist(),
        "volume": float(volumes.sum()),
        "mass": None if None in densities else float(volumes @ np.array(densities, dtype=float)),
        "deflection": None,
    }
    if cost["linear_seconds"] > _MAX_SECONDS or cost["memory_bytes"] > _MAX_BYTES:
        return result, []
    try:
        compliance = solver.linear.compliance
        unloaded = solver.unloaded_displacements[0]
    except SolveFailed as failure:
        result["failed"] = True
        return result, [_problem(failure)]

    def deflection(inputs: slice) -> list[float]:
        acting = component.bundle.acting
        return largest(compliance[:, inputs], acting.low[inputs], acting.high[inputs]).tolist()

    result["deflection"] = deflection(slice(None))
    if component.analysis.gravity is not None or component.analysis.zero == "untightened":
        result["sag"] = unloaded.tolist()
    if component.temperature is not None:  # the first input after the loads
        loads = len(component.bundle.range.low)
        result["by_temperature"] = deflection(slice(loads, loads + 1))
    if component.accelerated:  # the last three inputs
        result["by_acceleration"] = deflection(slice(-3, None))
    return result, []


def largest(compliance: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return max |C w| over a box of inputs, for each output, shape (6 i,), m and rad."""
    at_low, at_high = compliance * low, compliance * high
    highest = np.maximum(at_low, at_high).sum(axis=1)
    lowest = np.minimum(at_low, at_high).sum(axis=1)
    return np.maximum(np.abs(highest), np.abs(lowest))


def deflection_warnings(
    component: ComponentModel, deflection: list[float] | None
) -> Iterator[BundleProblem]:
    """Yield warnings if the full load range moves the part too much or too little.

    deflection: shape (6 i,), m and rad; None for no warning.
    """
    if deflection is None:
        return
    displacement = np.array(deflection)
    degrees = float(np.degrees(largest_rotation(displacement)))
    if degrees > MAX_DEGREES:
        has_several = len(component.interfaces) > 1
        place = "the range of its [[interface]]" if has_several else "[range]"
        message = (
            f"rotates the interface by {degrees:.3g} degrees at the full range (linear estimate), "
            f"but solves of more than {MAX_DEGREES:g} degrees are refused; narrow {place}. {_UNITS}"
        )
        yield BundleProblem("range", message)

    limit = component.bundle.tolerance
    if limit is None:
        return
    largest_angle = np.radians(MAX_DEGREES)
    if limit.rotation > largest_angle:
        message = (
            f"is {limit.rotation:g} rad, but solves end at {largest_angle:.3g} rad "
            f"({MAX_DEGREES:g} degrees), so it accepts every answer; if it is in degrees, convert "
            "it to rad"
        )
        yield BundleProblem("tolerance.rotation", message)
    by_interface = each_interface(displacement)
    allowed = np.repeat([limit.translation, limit.rotation], 3)
    free = component.active
    if free.size and (by_interface <= allowed).ravel()[free].all():
        translation, rotation = by_interface[:, :3].max(), by_interface[:, 3:].max()
        message = (
            f"moves the interface by at most {translation:.2g} m and {rotation:.2g} rad, less than "
            f"the tolerance, so the part is practically rigid. {_UNITS}"
        )
        yield BundleProblem("range", message)


def _problem(failure: SolveFailed) -> BundleProblem:
    message = f"every solve would fail ({failure.kind}): {failure.message} {failure.remedy}"
    return BundleProblem(_KEYS.get(failure.kind, "mesh"), message)


def frequency(solver: Solver, riding: Riding | None) -> tuple[Oscillation, list[BundleProblem]]:
    """Return the first natural oscillation of a component, and warnings.

    riding: the rigid mass on the interface; None for none.
    The warnings give the reason of a missing frequency, and materials without a density.
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
        message = f"has no density for {names}, whose mass counts as 0; write density, in kg/m^3"
        warnings.append(BundleProblem("material", message))

    try:
        vibration = solver.vibration(carried)
    except SolveFailed as failure:
        why = f"the natural frequency is unknown: {failure.message} {failure.remedy}"
        return {}, [*warnings, BundleProblem(_KEYS.get(failure.kind, "mesh"), why)]
    except ValueError as error:
        where = "material" if riding is None else "interface"
        why = f"the natural frequency is unknown: {error}"
        return {}, [*warnings, BundleProblem(where, why)]
    result: Oscillation = {
        "mass": vibration.mass if len(without_density) < len(component.materials) else None,
        "first_frequency": vibration.frequency,
        "motion": vibration.interface.tolist(),
        "riding_mass": carried.mass,
        "condensed_mass": vibration.condensed.tolist(),
    }
    return result, warnings


def sag_per_gravity(solver: Solver) -> np.ndarray:
    """Return the linear displacement of the interfaces by gravity, (6 i, 3), m and rad per m/s^2.

    By reciprocity it is the work of the weight on the fields of the unit loads. Gravity is in the
    frame of the first interface; materials without a density weigh nothing.
    """
    masses = nodal_masses(solver.component, solver.body)
    loads = len(solver.compliance)
    return np.einsum("n,nji->ij", masses, solver.linear.fields[:, :, :loads])


def weight_warnings(solver: Solver) -> list[BundleProblem]:
    """Return a warning if self-weight exceeds the tolerance in a bundle without ``gravity``."""
    component = solver.component
    limit = component.bundle.tolerance
    is_known = all(material.density is not None for material in component.materials)
    if component.analysis.gravity or component.accelerated or limit is None or not is_known:
        return []
    # The worst direction of gravity of each interface is that of the largest singular value.
    by_gravity = _GRAVITY * sag_per_gravity(solver).reshape(-1, PER_INTERFACE, 3)
    _, translations, directions = np.linalg.svd(by_gravity[:, :3])
    _, rotations, _ = np.linalg.svd(by_gravity[:, 3:])
    translation, rotation = translations.max(), rotations.max()
    if translation <= limit.translation and rotation <= limit.rotation:
        return []
    direction = directions[translations[:, 0].argmax(), 0] @ component.axes
    # Both signs are as bad; the largest component is written as pointing down.
    down = -np.sign(direction[np.abs(direction).argmax()]) * direction * _GRAVITY
    gravity = ", ".join(f"{number + 0.0:.3g}" for number in np.round(down, 6))
    message = (
        f"is missing: self-weight moves an interface by up to {translation:.2g} m and "
        f"{rotation:.2g} rad (worst under [{gravity}] m/s^2), more than the tolerance. Write "
        "gravity = [0, 0, -9.81] under [analysis], or [inputs.acceleration] for a rotating part"
    )
    return [BundleProblem("analysis.gravity", message)]
