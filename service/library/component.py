"""A component for the service: its data, the report of its check, and its errors."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from wrenchbook.fea.bundle.read import FILE_NAME, Bundle, read_bundle
from wrenchbook.fea.spec.schema import FREEDOMS
from wrenchbook.service.contract import MOMENT_POINT
from wrenchbook.surrogate.table.rows import LoadRange, Tolerance, acting
from wrenchbook.surrogate.table.space import PER_INTERFACE, Input, Space, space_of

HANGING = (
    "relative to the unloaded part without its weight, the geometry of its mesh: at zero load it "
    "is the sag under gravity"
)
UNLOADED = "relative to the part without loads"
TIGHTENED = "relative to the part as its bolts are tightened, without other loads and its weight"
UNTIGHTENED = (
    "relative to the part before its bolts are tightened, the geometry of its mesh: at zero load "
    "it is the displacement by their preload, and the sag under gravity if there is any"
)

CHECK_FILE = "check.json"  # file in a bundle: findings of its check at the upload
MAX_QUOTED = 64  # characters of a requested name in a message: no component has more
MAX_NAMES = 20  # names in a message: those most like the requested one, if there are more

FileStamp = tuple[tuple[int, int] | None, ...]


# Arrays have no single truth value; a component that is read again is another one.
@dataclass(frozen=True, eq=False)
class Component:
    """One component for the service; the mesh stays with the solver.

    Its fingerprint was read from `files` when they had the `stamp` (see `file_stamp`). `idle` are
    the loads that act on a locked freedom of an interface. `yield_strengths`, Pa, are those stated
    in the bundle, by the material's region. `mesh` is the table of component.toml whose file has
    the mesh; for decks only if the mesh reader knows the format.
    """

    name: str
    title: str
    folder: Path
    fingerprint: str
    has_fea: bool
    linear: bool
    load_range: LoadRange
    tolerance: Tolerance | None
    shipped: bool
    files: tuple[Path, ...] = ()
    stamp: FileStamp = ()
    idle: tuple[int, ...] = ()
    yield_strengths: Mapping[str, float] = field(default_factory=dict)
    mesh: Literal["mesh", "deck"] | None = None

    def acting(self, wrenches: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return wrenches, shape (..., 6), N and N·m, without the loads on locked freedoms.

        No answer depends on these loads: the guide takes them, and the compliance's columns for
        them are zero. So they are in no job's key and no row, and never exceed the range. Tables
        leave them out by themselves.
        """
        return acting(wrenches, self.idle)

    @property
    def acting_range(self) -> LoadRange:
        """The load range, N and N·m, with loads on locked freedoms at 0.

        A design must not vary these loads: it would have several wrenches of which the queue keeps
        one.
        """
        if not self.idle:
            return self.load_range
        low, high = self.acting(self.load_range.low), self.acting(self.load_range.high)
        return LoadRange(low, high, self.space)

    @property
    def space(self) -> Space:
        """The inputs and outputs of its table."""
        return self.load_range.space

    def is_as_read(self) -> bool:
        """Return whether no file has changed since it was read; takes microseconds."""
        return file_stamp(self.files) == self.stamp


def file_stamp(files: Iterable[Path]) -> FileStamp:
    """Return time of change (ns) and size (bytes) of each file, None for a missing file."""
    stamps: list[tuple[int, int] | None] = []
    for path in files:
        try:
            status = os.stat(path)  # noqa: PTH116 (half the time of Path.stat; for each query)
            stamps.append((status.st_mtime_ns, status.st_size))
        except OSError:
            stamps.append(None)
    return tuple(stamps)


class UnknownComponentError(KeyError):
    """No component has that name; the error has the existing names."""

    def __init__(self, name: str, known: list[str]) -> None:
        super().__init__(name)
        self.name = name
        self.known = known

    def __str__(self) -> str:
        name = self.name[:MAX_QUOTED]
        listed = self.known
        if len(listed) > MAX_NAMES:
            listed = get_close_matches(name, listed, MAX_NAMES, 0.0)
        known = ", ".join(listed) or "none yet"
        if more := len(self.known) - len(listed):
            known += f" and {more} more (GET /v1/components)"
        return f"There is no component {name!r}. The library has: {known}."


class ComponentExistsError(ValueError):
    """A component of that name exists already; nothing was changed."""


class BrokenComponentError(UnknownComponentError):
    """The component's folder exists but cannot be used; the error has the reason."""

    def __init__(self, name: str, known: list[str], reason: str) -> None:
        super().__init__(name, known)
        self.reason = reason

    def __str__(self) -> str:
        return (
            f"The component {self.name!r} is in the library but cannot be used: {self.reason}. "
            "Repair the files in its folder; the server then reads them again."
        )


class OneWrenchError(ValueError):
    """The call is for components whose only input is one wrench."""


def require_single_wrench(name: str, space: Space) -> None:
    """Raise OneWrenchError unless a component has one interface and no further inputs."""
    if not space.is_default:
        raise OneWrenchError(
            f"{name!r} has the inputs {', '.join(space.input_names)}, but this call accepts one "
            f"wrench only. Use POST /v1/components/{name}/displacement or .../displacements."
        )


class LibraryUnavailableError(OSError):
    """The component could not be written to the disk; nothing was added."""


def component_of(bundle: Bundle, *, shipped: bool) -> Component:
    """Return the component of a checked bundle."""
    limit, further = bundle.tolerance, bundle.further
    named = [bundle.mesh.file] if bundle.mesh else []
    named += [entry.field for entry in further]
    named += [bundle.deck.file, *bundle.deck.files] if bundle.deck else []
    files = (bundle.folder / FILE_NAME, *(path for path in named if path))

    mesh: Literal["mesh", "deck"] | None = "mesh" if bundle.mesh else None
    if mesh is None and bundle.deck is not None and bundle.deck.file.suffix.lower() == ".inp":
        mesh = "deck"

    scalars = [Input(entry.name, entry.unit, "scalar", zero=entry.reference) for entry in further]
    space = space_of([interface.name for interface in bundle.interfaces] or [""], scalars)
    low = np.append(bundle.range.low, [entry.low for entry in further])
    high = np.append(bundle.range.high, [entry.high for entry in further])
    return Component(
        name=bundle.name,
        title=bundle.title,
        folder=bundle.folder,
        fingerprint=bundle.fingerprint,
        has_fea=bundle.has_fea,
        linear=bundle.analysis is not None and not bundle.analysis.nonlinear,
        load_range=LoadRange(low, high, space),
        tolerance=Tolerance(limit.translation, limit.rotation) if limit else None,
        shipped=shipped,
        files=files,
        stamp=file_stamp(files),
        idle=tuple(
            PER_INTERFACE * number + load
            for number, interface in enumerate(bundle.interfaces)
            for load, freedom in enumerate(FREEDOMS)
            if freedom in interface.locked
        ),
        yield_strengths={
            material.region: material.yield_strength
            for material in bundle.materials
            if material.yield_strength is not None
        },
        mesh=mesh,
    )


def interface_of(component: Component) -> dict[str, Any] | None:
    """Return the interface of a component in SI; None with several, or without finite elements.

    It has ``section``, ``point`` (shape (3,), m; None for the section's area centre until a check
    has computed it), ``axes`` (shape (3, 3), one axis a row), ``coupling``, ``locked`` and
    ``moment``, a text. With self-weight or further inputs ``displacement`` states the zero of
    displacements; with self-weight there is ``gravity`` (shape (3,), m/s^2, in the mesh's axes).
    """
    interfaces = interfaces_of(component)
    return next(iter(interfaces.values())) if len(interfaces) == 1 else None


def interfaces_of(component: Component) -> Mapping[str, dict[str, Any]]:
    """Return each interface of a component by its name; see `interface_of`.

    With several interfaces each also has ``held``: whether it is the reference of all
    displacements.
    """
    return _interfaces(component.folder, component.fingerprint)


def warnings_of(folder: Path) -> list[dict[str, str]]:
    """Return the warnings of the check of a bundle, each ``{"where", "message"}``."""
    return _report(folder).get("warnings", [])


def estimate_of(folder: Path) -> dict[str, Any]:
    """Return the cost of a solve by the check of a bundle (`fea.check.cost`); empty if unknown."""
    estimate = _report(folder).get("estimate")
    return estimate if isinstance(estimate, dict) else {}


def solver_error_of(folder: Path, fingerprint: str) -> dict[str, Any] | None:
    """Return the solver's error that the check of a bundle estimated, if it is of that setup."""
    report = _report(folder)
    error = report.get("solver_error") if report.get("fingerprint") == fingerprint else None
    return error if isinstance(error, dict) and error.get("mesh") is not None else None


def vibration_of(folder: Path, fingerprint: str) -> dict[str, Any] | None:
    """Return mass and first natural frequency from the check of a bundle.

    For the component alone, without carried masses: ``mass`` (kg), ``first_frequency`` (Hz),
    ``motion`` (six numbers, m and rad), ``condensed_mass`` (6 x 6, kg to kg·m^2). None if the
    bundle has no density or no check of this setup is stored.
    """
    report = _report(folder)
    return (report.get("vibration") if report.get("fingerprint") == fingerprint else None) or None


@lru_cache(maxsize=256)
def _interfaces(folder: Path, _fingerprint: str) -> dict[str, dict[str, Any]]:
    """Return the interfaces, read once for each fingerprint: reading a bundle hashes its mesh."""
    bundle, report = read_bundle(folder), _report(folder)
    gravity = bundle.analysis.gravity
    common: dict[str, Any] = {}
    if gravity:
        common = {"gravity": list(gravity), "displacement": HANGING}
    if bundle.bolts:
        preloaded = bundle.analysis.zero == "preloaded"
        common["displacement"] = TIGHTENED if preloaded else UNTIGHTENED
    zeros = [f"{entry.name} {entry.reference:g} {entry.unit}" for entry in bundle.further]
    if zeros:
        common["displacement"] = f"{common.get('displacement', UNLOADED)}, at {', '.join(zeros)}"
    checked = report.get("sections") or [report.get("section", {})]
    points = [section.get("point") for section in checked] + [None] * len(bundle.interfaces)
    return {
        interface.name: {
            "section": interface.section,
            "point": point if interface.point is None else interface.point.tolist(),
            "axes": interface.axes.tolist(),
            "coupling": interface.coupling,
            "locked": list(interface.locked),
            "moment": f"about {MOMENT_POINT}",
            **common,
            **({"held": interface.held} if bundle.others else {}),
        }
        for interface, point in zip(bundle.interfaces, points, strict=False)
        if interface.section  # a measured part has none
    }


def _report(folder: Path) -> dict[str, Any]:
    """Return the stored report; an empty one if no check is stored."""
    try:
        report = json.loads((folder / CHECK_FILE).read_text("utf-8"))
    except (OSError, ValueError):
        return {}
    return report if isinstance(report, dict) else {}
