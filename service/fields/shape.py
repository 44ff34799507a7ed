"""A deformed surface, its largest stress, and the parts of its error bars (see the README)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from wrenchbook.fea.tensors import von_mises
from wrenchbook.service.contract import Coverage
from wrenchbook.service.fields.record import RowFields, SurfaceGeometry
from wrenchbook.service.library.component import Component
from wrenchbook.surrogate.solver_error import UNKNOWN, SolverError
from wrenchbook.surrogate.table.rows import ROUNDING, Floats

# Part of the largest discretisation error on the surface that is added to a free vertex's error:
# near clamps and edges cells have errors of their own. On six parts 9 of 10 vertices deviate by 3
# to 18 % of the largest error from the motion of the interface; without this term 77 to 99 % of
# vertices are covered, with it 97 % and more (`make bench NAME=surface_error`).
LOCAL = 0.1
# Part of the scaled compliance's largest singular value: smaller values are locked freedoms and
# roundoff.
_SINGULAR = 1e-9

NO_MODES = "no row has how the surface follows its interface; the next solve of this component will"


class ErrorParts(NamedTuple):
    """The parts of the error bars of a surface.

    `by_cause`: ``table``, ``mesh`` and of a linear component ``linearity``, shape (v,), m; None if
    unknown.
    `bases`: ``mesh_basis`` and so on: the origin of an estimate, or the reason of a missing one.
    """

    by_cause: dict[str, Floats | None]
    bases: dict[str, str]

    @property
    def total(self) -> Floats:
        """The error bars, shape (v,), m: the sum of all known parts."""
        return np.sum([bars for bars in self.by_cause.values() if bars is not None], axis=0)

    @property
    def are_complete(self) -> bool:
        """Whether the discretisation error is known; otherwise only the interpolation error is."""
        return self.by_cause.get("mesh") is not None

    def largest(self) -> dict[str, float | str | None]:
        """Return the largest error bar of each cause, m, and the bases."""
        largest = {
            cause: None if bars is None else float(bars.max(initial=0.0))
            for cause, bars in self.by_cause.items()
        }
        return largest | self.bases


def vertex_modes(slopes: Floats, compliance: Floats) -> Floats | None:
    """Return the motion of the vertices per motion of the interface, (v, 3, 6), m/m and m/rad.

    `slopes`, shape (v, 3, 6), m/N and m/(N·m), are the change of the vertices with the wrench,
    `compliance`, shape (6, 6), SI, that of the interface. None if the compliance is unknown.
    """
    if not np.isfinite(compliance).all():
        return None
    size = np.sqrt(np.abs(np.diagonal(compliance)))
    unit = 1.0 / np.where(size > 0, size, 1.0)  # row and column of a locked freedom are zero
    inverse = np.linalg.pinv(compliance * np.outer(unit, unit), rcond=_SINGULAR)
    return slopes @ (inverse * np.outer(unit, unit))


def error_parts(
    interpolation: Floats,
    modes: Floats | None,
    solver: SolverError | None,
    wrench: Floats,
    at_interface: Mapping[str, Sequence[float] | None] | None = None,
) -> ErrorParts:
    """Return the parts of a surface's error bars under a wrench, shape (6,), N and N·m.

    `interpolation` (v,), m: the interpolation error.
    `modes` (v, 3, 6): those of `vertex_modes`.
    `solver`: the solver's error; None if it was never estimated.
    `at_interface`: the solver's error bars of the interface by cause, (6,), m and rad; by default
    those of small loads.
    """
    parts: dict[str, Floats | None] = {"table": interpolation, "mesh": None}
    if solver is None:
        return ErrorParts(parts, {"mesh_basis": UNKNOWN})
    bases = {name: str(text) for name, text in solver.values.items() if name.endswith("_basis")}
    if modes is None:
        return ErrorParts(parts, bases | {"mesh_basis": NO_MODES})
    for cause, bars in (at_interface or solver.parts(wrench.tolist())).items():
        carried = None if bars is None else np.abs(modes) @ np.array(bars)
        parts[cause] = None if carried is None else np.linalg.norm(carried, axis=1)
    mesh = parts["mesh"]
    if mesh is not None:
        free = modes.any(axis=(1, 2))
        parts["mesh"] = mesh + LOCAL * mesh.max(initial=0.0) * free
    return ErrorParts(parts, bases)


class LargestStress(NamedTuple):
    """The largest von Mises stress at the solver's integration points.

    `yields`: whether any part yields; the point is chosen by it. None if unknown, for lack of a
    yield strength or because the error bar reaches across it.
    """

    largest: float  # Pa
    error: float | None  # Pa, 95 % error bar of the interpolation alone
    at: tuple[float, ...]  # (3,), m: the integration point, undeformed, in the interface frame
    region: str  # the region of the material there
    yield_strength: float | None  # Pa; None if its bundle does not state it
    yields: bool | None


@dataclass(frozen=True, eq=False)
class Deformed:
    """A deformed surface, in the undeformed interface frame from its point.

    `error` is the 95 % error bar of the length of each vertex's error, with the solver's own error
    if it is known (`parts`, None until it is added). `source` is ``row``: a solve of this wrench,
    ``rows``: interpolated, or ``linear``: six unit fields. `coverage` and `reason` only refer to
    the interpolation error.
    """

    component: str
    wrench: tuple[float, ...]  # (6,), N and N·m
    geometry: SurfaceGeometry  # undeformed
    displacement: Floats  # (v, 3), m
    error: Floats | None  # (v,), m; None if unknown
    stress: LargestStress | None  # None between rows with too many integration points
    source: Literal["row", "rows", "linear"]
    rows: tuple[int, ...] = ()  # numbers (`seq`) of the rows used
    coverage: Coverage = "covered"
    reason: str = ""
    # (v, 3, 6), m/m and m/rad: motion of vertices by motions of the interface.
    modes: Floats | None = None
    parts: ErrorParts | None = None
    within_tolerance: bool | None = None  # None without a tolerance or a discretisation error

    def without_bars(self, reason: str) -> Deformed:
        """Return the surface outside the rows, where none shows its error: no bars, no verdict."""
        stress = self.stress and self.stress._replace(error=None, yields=None)
        unknown = {"error": None, "parts": None, "within_tolerance": None, "stress": stress}
        return replace(self, coverage="outside", reason=reason, **unknown)


def rounding(displacement: Floats) -> Floats:
    """Return the least error bar, shape (v,), m, of displacements (v, 3), m."""
    return np.full(len(displacement), ROUNDING * np.abs(displacement).max(initial=0.0))


def largest_stress(
    component: Component, geometry: SurfaceGeometry, stress: Floats, error: float | None
) -> LargestStress | None:
    """Return the largest of stresses (p, 6), Pa, or that of the part that yields first.

    Where a part yields, or may yield within the error bar, the point is the one farthest past its
    yield strength. `error` is the error bar of the von Mises stress, Pa.
    """
    if not len(stress):
        return None
    equivalent = von_mises(stress)
    strengths = np.array([component.yield_strengths.get(name, np.inf) for name in geometry.regions])
    strength, bar = strengths[geometry.materials], error or 0.0
    surely, perhaps = (equivalent - bar) / strength, (equivalent + bar) / strength
    deciding = next((part for part in (surely, perhaps) if part.max() >= 1.0), equivalent)
    worst = int(deciding.argmax())
    region = geometry.regions[int(geometry.materials[worst])]
    at = tuple(geometry.places[worst].tolist())
    return _with_yield_strength(component, float(equivalent[worst]), error, at, region)


def stress_of_row(component: Component, row: RowFields) -> LargestStress:
    """Return the largest stress of a row's own solve, at any integration point."""
    at = tuple(float(x) for x in row.meta["at"])
    largest = float(row.meta["largest"])
    stress = _with_yield_strength(component, largest, 0.0, at, str(row.meta["region"]))
    # The row has no other part's largest stress: a weaker part may yield at less than this one.
    weaker = any(strength <= largest for strength in component.yield_strengths.values())
    return stress._replace(yields=None) if weaker and not stress.yields else stress


def _with_yield_strength(
    component: Component, largest: float, error: float | None, at: tuple[float, ...], region: str
) -> LargestStress:
    """Return a stress with its region's yield strength, and whether the stress exceeds it."""
    strength = component.yield_strengths.get(region)
    yields = None
    if strength is not None and error is not None and abs(largest - strength) > error:
        yields = largest > strength
    return LargestStress(largest, error, at, region, strength, yields)
