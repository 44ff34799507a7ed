"""The parts of a component bundle, as read and checked; SI units throughout."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from wrenchbook.fea.spec.orthotropic import Orthotropic

Array = np.ndarray

FREEDOMS = ("ux", "uy", "uz", "rx", "ry", "rz")
"""The interface's six degrees of freedom, in the order of the wrench contract."""

COUPLINGS = ("rigid", "distributed")
MOMENTS = ("spatial", "conjugate")
INTEGRATIONS = ("reduced", "full")
LAWS = ("isotropic", "orthotropic", "neo-hookean")

MOST_INPUTS = 18  # that vary, the loads of three interfaces: 2^18 corners of 18 loads are 38 MB

UNITS: Mapping[str, float] = {
    "m": 1.0,
    "dm": 0.1,
    "cm": 1e-2,
    "mm": 1e-3,
    "um": 1e-6,
    "in": 0.0254,
    "ft": 0.3048,
}
"""Length units a mesh file may be in, each in metres."""


GEOMETRY_ENDINGS = (".step", ".stp")
"""Endings of files that hold geometry to be meshed, not a mesh."""


@dataclass(frozen=True)
class Selector:
    """Which faces of a geometry make a group, or which of its bodies make a region.

    A face or body belongs if any of these names it.
    """

    numbers: tuple[int, ...] = ()  # by their numbers in the report of ``wrenchbook check``
    # For each point (x, y, z), m, the face nearest to it, or the body it lies in
    near: tuple[tuple[float, float, float], ...] = ()
    # Axis (0, 1, 2) and coordinate, m: every plane face there. Faces only
    plane: tuple[int, float] | None = None
    radius: float | None = None  # every cylindrical face of that radius, m. Faces only


@dataclass(frozen=True)
class GeometryMeshing:
    """How to mesh a geometry file."""

    size: float  # edge length of the cells, m
    # Least number of cells round a full turn of a curved face; 0 leaves it to `size`
    curvature: int = 0
    # groups, regions: faces that make each facet group, bodies that make each cell group
    groups: Mapping[str, Selector] = field(default_factory=dict)
    regions: Mapping[str, Selector] = field(default_factory=dict)
    # Least number of cells round a full circle, however small; no key of a bundle sets it
    circle: int = 7  # gmsh's own


@dataclass(frozen=True)
class MeshSource:
    """Source of the mesh: a mesh file, a geometry file, or a generator with its parameters."""

    # file, unit: the file (a path within the bundle) and its length unit, a key of `UNITS`; a
    # geometry file holds its own.
    file: Path | None = None
    unit: str = "m"
    geometry: GeometryMeshing | None = None  # how to mesh the file, if it is a geometry file
    # 2 gives the cells of a first-order mesh file their midside nodes; None leaves them
    order: int | None = None
    # generator, parameters: the name of a generator of `fea.mesh.generators` and all its
    # parameters, defaults filled in.
    generator: str | None = None
    parameters: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class Material:
    """An elastic material."""

    region: str  # the cell group it fills; "all" fills every cell that no other material names
    youngs_modulus: float  # Pa; of an orthotropic material its largest
    # Between -1 and 0.5, both excluded; of an orthotropic material that of the nearest isotropic
    # one, which tells cells that would lock.
    poisson_ratio: float
    # kg/m^3; None where the bundle does not give it. Static answers depend on it under gravity and
    # acceleration.
    density: float | None = None
    # Pa, compared with the von Mises stress; None where the bundle does not give it
    yield_strength: float | None = None
    # One of `LAWS`. The constants of "neo-hookean" are those at small strains
    law: str = "isotropic"
    orthotropic: Orthotropic | None = None  # the constants of that law; None for the others
    # 1/K along its three directions, equal but for an orthotropic material; None where the bundle
    # does not give it. It counts only where the temperature is an input.
    thermal_expansion: tuple[float, float, float] | None = None


TEMPERATURE = "temperature"
ACCELERATIONS = ("ax", "ay", "az")
"""Along the mesh's axes."""


@dataclass(frozen=True)
class ScalarInput:
    """An input behind the loads: the uniform temperature, or a component of the acceleration."""

    name: str  # `TEMPERATURE` or one of `ACCELERATIONS`, which follow it
    unit: str  # of the three numbers: degC, K, or m/s^2
    # low, high: the range expected
    low: float
    high: float
    reference: float = 0.0  # where it has no effect
    # A file of temperatures at points, see `fea.mesh.io.temperature_field`; None for the same
    # everywhere.
    field: Path | None = None

    @property
    def key(self) -> str:
        """The table of the bundle that has it."""
        return f"inputs.{TEMPERATURE if self.name == TEMPERATURE else 'acceleration'}"


@dataclass(frozen=True, eq=False)
class Sliding:
    """A facet or node group that does not move along some directions.

    `directions` has shape (d, 3): unit vectors in the mesh's axes.
    """

    group: str
    directions: Array


@dataclass(frozen=True, eq=False)
class Interface:
    """A section where a rigid side is attached."""

    section: str  # a facet group or node group
    # The reference point, shape (3,), m, in the mesh's coordinates; None for the area centre
    point: Array | None
    # Shape (3, 3): row i is the direction of the frame's axis i, orthonormal and right-handed
    axes: Array
    coupling: str  # "rigid" or "distributed"
    locked: tuple[str, ...] = ()  # freedoms that a guide locks, of `FREEDOMS` and in their order
    name: str = ""  # empty where it is the component's only one

    @property
    def held(self) -> bool:
        """Whether it does not move: the others' displacements are relative to it."""
        return self.locked == FREEDOMS


@dataclass(frozen=True, eq=False)
class Bushing:
    """A group on an elastic spring to the ground."""

    hold: Interface  # the group as a section, with the point and the axes of the spring
    # Shape (6, 6), symmetric and positive semidefinite: N/m, N/rad and N·m/rad over translation and
    # rotation vector.
    stiffness: Array


@dataclass(frozen=True)
class Supports:
    """The groups whose nodes do not move, those that slide, and those on springs."""

    fixed: tuple[str, ...] = ()
    sliding: tuple[Sliding, ...] = ()
    bushings: tuple[Bushing, ...] = ()


ON_YIELD = ("warn", "fail")
"""Outcome of a solve in which a material yields: a note with the answer, or no answer."""


@dataclass(frozen=True)
class Analysis:
    """How to solve: geometrically nonlinear or not, the integration of hex20 cells, own weight.

    `gravity` is the acceleration of gravity in the mesh's axes, m/s^2; None for no weight.
    `on_yield` is what becomes of a solve beyond a material's yield strength, one of `ON_YIELD`.
    """

    nonlinear: bool = True
    integration: str = "reduced"
    gravity: tuple[float, float, float] | None = None
    on_yield: str = "warn"


@dataclass(frozen=True, eq=False)
class DeclaredRange:
    """The loads expected."""

    # low, high: each of shape (6 i,), N and N·m, of i interfaces; zero for one that is held
    low: Array
    high: Array

    def corners(self) -> Array:
        """Return the corners of the range, shape (k, 6 i), N and N·m.

        Raises ValueError if there are more than 2^18: three interfaces have so many.
        """
        ends = [tuple(dict.fromkeys(pair)) for pair in zip(self.low, self.high, strict=True)]
        if math.prod(len(pair) for pair in ends) > 2**MOST_INPUTS:
            raise ValueError(f"a range of more than {MOST_INPUTS} loads has too many corners")
        return np.array(list(product(*ends)))


@dataclass(frozen=True)
class DeclaredTolerance:
    """The error a component's users accept: `translation` in m, `rotation` in rad."""

    translation: float
    rotation: float


@dataclass(frozen=True)
class Deck:
    """An expert's input deck for an outside solver."""

    # The deck, with $FX $FY $FZ $MX $MY $MZ where the wrench goes. Its axes are the interface
    # frame's.
    file: Path
    # The program and its arguments; ``{job}`` stands for the deck's name without its ending
    command: tuple[str, ...]
    output: Mapping[str, str]  # the reader of the solver's output, and that reader's options
    # Other files of the bundle that the deck or the command needs; copied next to the deck
    files: tuple[Path, ...] = ()
    # The deck's length unit, a key of `UNITS`: the moments go in as N times it, the translation is
    # read in it. Forces are newtons.
    unit: str = "m"
    timeout: float = 3600.0  # seconds after which one run of the command is ended
    # What the deck takes as moment: "spatial", about fixed axes, or "conjugate", that which works
    # on the rotation vector.
    moment: str = "spatial"


@dataclass(frozen=True, eq=False)
class Bundle:
    """A component as its folder describes it; see `fea.bundle.read.read_bundle`."""

    folder: Path
    name: str
    title: str
    mesh: MeshSource | None
    materials: tuple[Material, ...]
    supports: Supports | None
    # interface, others: the interface, or the first of several, and the others in their order
    interface: Interface | None
    analysis: Analysis
    range: DeclaredRange
    tolerance: DeclaredTolerance | None
    deck: Deck | None
    fingerprint: str  # 16 hexadecimal digits over everything that can change an answer
    others: tuple[Interface, ...] = ()
    further: tuple[ScalarInput, ...] = ()  # the inputs behind the loads

    @property
    def acting(self) -> DeclaredRange:
        """The range of all inputs: loads, then the others less their references."""
        low, high = ([getattr(scalar, end) for scalar in self.further] for end in ("low", "high"))
        zero = [scalar.reference for scalar in self.further]
        ends = np.subtract(low, zero), np.subtract(high, zero)
        return DeclaredRange(
            np.append(self.range.low, ends[0]), np.append(self.range.high, ends[1])
        )

    @property
    def interfaces(self) -> tuple[Interface, ...]:
        """All interfaces, in the order of their loads and displacements."""
        return () if self.interface is None else (self.interface, *self.others)

    @property
    def has_fea(self) -> bool:
        """Whether the component can be solved; a table-only component cannot."""
        return self.mesh is not None or self.deck is not None
