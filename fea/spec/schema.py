"""Models of the tables of ``component.toml``, the parts of a bundle; SI units throughout."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field
from pydantic.json_schema import SkipJsonSchema

from wrenchbook.fea.spec.keys import (
    Axes,
    BundleFile,
    Flag,
    MistakesError,
    Name,
    Number,
    Pair,
    Point,
    Positive,
    Six,
    Text,
    Texts,
    Three,
    ThreePositive,
    array_of,
    array_table,
    counted,
    different,
    either,
    key,
    keys_of,
    mesh_axes,
    table,
)
from wrenchbook.fea.spec.material import AnyMaterial, Direction
from wrenchbook.fea.spec.mesh_source import LengthUnit, MeshSource

FREEDOMS = ("ux", "uy", "uz", "rx", "ry", "rz")
"""The interface's six degrees of freedom, in the order of the wrench contract."""
LOADS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
"""The six loads of a wrench, each works on the freedom at its place."""
PLACEHOLDERS = tuple(f"${load.upper()}" for load in LOADS)
"""The loads in the text of a ``[deck]``."""

# Inputs that vary, the loads of three interfaces: 2^18 corners of 18 loads are 38 MB.
MAX_INPUTS = 18
ALL_INPUTS = 24  # all inputs: the loads of four interfaces, the most that a joint has
# Largest load: tables square loads and divide by them. The square root of the largest double,
# 1e154, is too near, since sums of such squares must be finite too.
LARGEST_LOAD = 1e100

Coupling = Literal["rigid", "distributed"]
Weights = Literal["area", "equal", "deck"]

TEMPERATURE = "temperature"
ACCELERATIONS = ("ax", "ay", "az")
"""Along the mesh's axes."""


@dataclass(frozen=True)
class ScalarInput:
    """An input after the loads: the uniform temperature, or a component of the acceleration."""

    name: str  # `TEMPERATURE` or one of `ACCELERATIONS`, which follow it
    unit: str  # unit of the three numbers: degC, K, or m/s^2
    # low, high: the range expected
    low: float
    high: float
    reference: float = 0.0  # value without an effect
    # A file of temperatures at points, see `fea.mesh.io.temperature_field`; None for a uniform
    # temperature.
    field: Path | None = None

    @property
    def key(self) -> str:
        """The table of the bundle that defines it."""
        return f"inputs.{TEMPERATURE if self.name == TEMPERATURE else 'acceleration'}"


_ABSOLUTE_ZERO = {"degC": -273.15, "K": 0.0}


def rising(ends: tuple[float, float]) -> tuple[float, float]:
    """Return two ends of a range, the first below the second."""
    if ends[0] >= ends[1]:
        raise ValueError(f"must be [low, high] with low below high, not [{ends[0]:g}, {ends[1]:g}]")
    return ends


@table
class Temperature:
    """The part's temperature, uniform or of a field, as an input."""

    range: Annotated[Pair, AfterValidator(rising)] = key("degC or K", "[-20, 60]")
    """the temperatures expected"""
    reference: Number = key("degC or K", "20")
    """where nothing is strained by it"""
    unit: Literal["degC", "K"] = key("", '"K"', default="degC")
    """`"degC"` or `"K"`"""
    field: BundleFile | None = key("", '"hot.csv"', default=None, default_text="uniform")
    """temperatures at points: one line of names, then x, y, z (m, the mesh's axes) and the
    temperature in `unit`. The input is the temperature where the file's rise over `reference` is
    largest; all others rise in proportion"""

    def __post_init__(self) -> None:
        zero = _ABSOLUTE_ZERO[self.unit]
        mistakes = []
        for name, lowest in (("range", self.range[0]), ("reference", self.reference)):
            if lowest < zero:
                bound = f"below {zero:g} {self.unit}, absolute zero"
                mistakes.append((name, f"{lowest:g} {self.unit} is {bound}; correct it"))
        if mistakes:
            raise MistakesError(*mistakes)


@table
class Acceleration:
    """Three components of the acceleration as inputs."""

    range: ThreePositive = key("m/s^2", "[20, 20, 20]")
    """each from minus to plus its number"""


@table
class Inputs:
    """Inputs besides the loads."""

    temperature: Temperature | None = key("", "{range = [-20, 60], reference = 20}", default=None)
    """the table `[inputs.temperature]`"""
    acceleration: Acceleration | None = key("", "{range = [20, 20, 20]}", default=None)
    """the table `[inputs.acceleration]`"""

    @property
    def scalars(self) -> tuple[ScalarInput, ...]:
        """The inputs in their order: the temperature, then the three accelerations."""
        warm = self.temperature
        sizes = self.acceleration.range if self.acceleration else ()
        first = warm and ScalarInput(
            TEMPERATURE, warm.unit, *warm.range, warm.reference, warm.field
        )
        others = (
            ScalarInput(name, "m/s^2", -size, size)
            for name, size in zip(ACCELERATIONS, sizes, strict=False)
        )
        return (*((first,) if first else ()), *others)


@array_table
class Sliding:
    """A facet or node group that does not move along some directions."""

    group: Text = key("", '"symmetry"')
    """a facet or node group"""
    along: Annotated[
        tuple[Literal["x", "y", "z"], ...], Field(min_length=1), AfterValidator(different)
    ] = key("", '["x"]', name="directions")
    """its displacements along these are zero: of x, y, z"""
    axes: Axes = key(
        "", "[[0.6, 0.8, 0], [-0.8, 0.6, 0], [0, 0, 1]]", default=mesh_axes, default_text="mesh's"
    )
    """x, y, z of the directions, in the mesh's axes"""

    @property
    def directions(self) -> np.ndarray:
        """Unit vectors in the mesh's axes, shape (d, 3)."""
        return self.axes[["xyz".index(name) for name in sorted(self.along)]]


_ROUNDOFF = 1e-9  # part of a stiffness' diagonal: decks write nine digits and more


def _stiffness(numbers: tuple[Any, ...]) -> np.ndarray:
    """Return six stiffnesses, or 6 x 6, as a matrix whose energy is never negative."""
    matrix = np.array(numbers) if isinstance(numbers[0], tuple) else np.diag(numbers)
    diagonal = np.diagonal(matrix)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    scaled = matrix / scale / scale[:, None]
    asymmetry = np.abs(scaled - scaled.T)
    if asymmetry.max() > _ROUNDOFF:
        i, j = divmod(int(asymmetry.argmax()), len(matrix))
        raise ValueError(
            f"must be symmetric, but row {i + 1}, column {j + 1} is {matrix[i, j]:.10g} and row "
            f"{j + 1}, column {i + 1} is {matrix[j, i]:.10g}; make the two equal"
        )
    if diagonal.min() < 0:
        i = int(diagonal.argmin())
        freedom = f"that of {FREEDOMS[i]} is {diagonal[i]:.4g}"
        raise ValueError(f"must have no negative stiffness, but {freedom}; write 0 or more")
    if (least := np.linalg.eigvalsh(scaled)[0]) < -_ROUNDOFF:
        raise ValueError(
            f"its least eigenvalue is negative ({least:.2g} times its diagonal), so some motion "
            "would release energy; reduce the off-diagonal numbers"
        )
    if not matrix.any():
        raise ValueError("is zero, so nothing resists; write a stiffness, or leave the table out")
    return 0.5 * matrix + 0.5 * matrix.T  # the sum of two near 1e308 would overflow


_Rows = Annotated[tuple[Six, ...], counted(6)]
Stiffness = Annotated[np.ndarray, array_of(Annotated[Any, either(Six, _Rows, 2)], _stiffness)]


@array_table
class Attached:
    """The connection of a group of nodes to one frame."""

    coupling: Coupling = key("", '"distributed"', kw_only=True)
    """`distributed`: by the least-squares mean of the group; `rigid`: as a rigid body"""
    point: Point | None = key(
        "m",
        "[0.0, 0.0, 0.01]",
        default=None,
        default_text="the area centre; of a spring midway",
        kw_only=True,
    )
    """where an interface's wrench acts and its displacement is measured, or a spring is, in the
    mesh's axes"""
    weights: Weights = key("", '"deck"', default="area", kw_only=True)
    """of nodes in the mean of `distributed`: `area`; `equal`; `deck`: of `RBE3`, or the second
    column of a node `*SURFACE`"""
    # Shape (3, 3): row i is the direction of the frame's axis i, orthonormal and right-handed
    axes: Axes = key(
        "",
        "[[0.6, 0.8, 0], [-0.8, 0.6, 0], [0, 0, 1]]",
        default=mesh_axes,
        default_text="mesh's",
        kw_only=True,
    )
    """x, y and z of the frame in the mesh's axes"""

    def end(self, group: str) -> Interface:
        """Return a group as a section, with this object's point and axes."""
        return Interface(group, **{name: getattr(self, name) for name in keys_of(Attached)})


@array_table
class Bushing(Attached):
    """A group on an elastic spring to the ground."""

    group: Text = key("", '"hole"')
    """a facet or node group"""
    # Shape (6, 6), symmetric and positive semidefinite, over translation and rotation vector
    stiffness: Stiffness = key("N/m, N/rad and N·m/rad", "[1e6, 1e6, 1e6, 50, 50, 50]")
    """of x, y, z and the rotations about them; or K, six rows of six, symmetric and without
    negative eigenvalues"""


@array_table
class Bolt:
    """A shank that is cut across its axis and tightened."""

    region: Text | None = key("", '"shank"', default=None)
    """the shank's cell group, cut between cells near the plane square to the axis"""
    group: Text | None = key("", '"cut"', default=None)
    """in place of `region`: facets inside the body, all across the shank"""
    axis: Direction = key("", "[0, 0, 1]", kw_only=True)
    """the shank's direction, in the mesh's axes"""
    force: Positive = key("N", "12e3", kw_only=True)
    """the preload: the shank's tension when it is tightened and nothing else acts"""
    point: Point | None = key("m", "[0, 0, 0.02]", default=None, default_text="the region's middle")
    """with `region`: a point of the plane of the cut"""
    keeps: Literal["length", "force"] = key("", '"force"', default="length")
    """under the loads after it is tightened: its `length`, as bolts do, or its `force`, as soft
    disc springs do"""

    def __post_init__(self) -> None:
        if self.region is None and self.group is None:
            raise MistakesError(("region", "is missing; write a region or a group"))
        if self.region is not None and self.group is not None:
            raise MistakesError(("region", "contradicts group; leave one of the two out"))
        if self.group is not None and self.point is not None:
            raise MistakesError(("point", "is for a region, not for a group; leave it out"))


@array_table
class Joint(Attached):
    """Two groups with a spring between them, or joined rigidly."""

    groups: Annotated[tuple[Text, Text], counted(2), AfterValidator(different)] = key(
        "", '["hub", "rim"]', expected_text="two names of facet or node groups"
    )
    """two facet or node groups; the spring's axes turn with the first"""
    stiffness: Stiffness | None = key(
        "N/m, N/rad and N·m/rad", "[1e6, 1e6, 1e6, 50, 50, 50]", default=None
    )
    """as of a bushing, of the second group's motion relative to the first"""
    rigid: Flag = key("", "true", default=False)
    """in place of `stiffness`: both move as one rigid body; with `coupling = "rigid"`"""

    def __post_init__(self) -> None:
        if self.stiffness is None and not self.rigid:
            message = "is missing; write a stiffness, or rigid = true for a rigid joint"
            raise MistakesError(("stiffness", message))
        if self.stiffness is not None and self.rigid:
            message = "contradicts rigid = true, which has no stiffness; leave one of the two out"
            raise MistakesError(("stiffness", message))
        if self.rigid and self.coupling != "rigid":
            message = f'is "{self.coupling}", but rigid = true needs coupling = "rigid"; write that'
            raise MistakesError(("coupling", message))


@table
class Supports:
    """The groups whose nodes do not move, those that slide, and those on springs."""

    fixed: Annotated[Texts, Field(min_length=1)] = key(
        "", '["rim"]', default=(), default_text="none"
    )
    """facet or node groups that do not move"""
    sliding: Annotated[tuple[Sliding, ...], Field(min_length=1)] = key(
        "", '[{group = "symmetry", directions = ["x"]}]', default=(), default_text="none"
    )
    """groups held in single directions, each `[[supports.sliding]]`"""
    bushings: Annotated[tuple[Bushing, ...], Field(min_length=1)] = key(
        "",
        '[{group = "hole", coupling = "rigid", stiffness = [1e6, 1e6, 1e6, 50, 50, 50]}]',
        default=(),
        default_text="none",
        name="bushing",
    )
    """groups on springs, each `[[supports.bushing]]`"""


@array_table
class Tie:
    """Two surfaces that hold together although their meshes do not match."""

    secondary: Text = key("", '"pin"')
    """a facet group, better the finer or the smaller: its nodes follow the main surface (slave)"""
    main: Text = key("", '"hole"')
    """the facet group that they follow (master)"""
    distance: Positive | None = key(
        "m", "2e-5", default=None, default_text="a tenth of the facets' mean edge"
    )
    """facets farther from each other stay loose; more than their mean edge counts as that"""


@array_table
class Interface(Attached):
    """A section where a rigid side is attached."""

    refused = dict.fromkeys(
        ("name", "held", "range"), "is for several [[interface]] tables; leave it out"
    )
    name = ""  # each of several interfaces has its own
    held = False  # whether it does not move: the others' displacements are relative to it

    section: Text = key("", '"tip"')
    """a facet or node group"""
    locked: Annotated[
        tuple[Literal["ux", "uy", "uz", "rx", "ry", "rz"], ...],
        AfterValidator(different),
        AfterValidator(lambda names: tuple(name for name in FREEDOMS if name in names)),
    ] = key("", '["ux", "rz"]', default=())
    """freedoms that a guide locks: ux uy uz rx ry rz"""

    def __post_init__(self) -> None:
        if self.locked == FREEDOMS and not self.held:
            raise MistakesError(("locked", "locks every freedom, so nothing can move; unlock one"))


def _load(ends: float | tuple[float, float]) -> tuple[float, float]:
    """Return a load's range; refuse it if its squares, or quotients with it, overflow."""
    low, high = ends if isinstance(ends, tuple) else (-ends, ends)
    if low == high == 0.0:
        return 0.0, 0.0
    if max(-low, high) <= LARGEST_LOAD and high - low >= 1 / LARGEST_LOAD:
        return low, high
    raise ValueError(
        f"must be at least {1 / LARGEST_LOAD:g} {{unit}} wide and within plus and minus "
        f"{LARGEST_LOAD:g} {{unit}}, not [{low:g}, {high:g}]"
    )


_NotNegative = Annotated[Number, Field(ge=0)]
_Ends = Annotated[Pair, AfterValidator(rising)]
Load = Annotated[tuple[float, float], either(_NotNegative, _Ends), AfterValidator(_load)]
Loads = Annotated[
    tuple[Load, Load, Load],
    counted(3, "must be three loads in {unit}, each a number or [low, high]"),
]


@table
class Range:
    """The loads expected, as (low, high); some may be 0: loads that do not act."""

    force: Loads = key("N", "[100, 100, [-500, 0]]")
    """Fx, Fy, Fz: each plus and minus a number, or [low, high]"""
    moment: Loads = key("N·m", "[5, 5, 5]")
    """Mx, My, Mz: each plus and minus a number, or [low, high]"""


RANGE_EXAMPLE = "{force = [20, 20, 200], moment = [5, 5, 5]}"


@array_table
class MeasuredInterface(Interface):
    """One of several interfaces of a measured part, which has no section."""

    refused: ClassVar = {}
    section: SkipJsonSchema[str] = field(default="", init=False)
    coupling: SkipJsonSchema[Any] = field(default="", init=False)
    weights: SkipJsonSchema[Any] = field(default="area", init=False)
    point: SkipJsonSchema[np.ndarray | None] = field(default=None, init=False)
    axes: SkipJsonSchema[np.ndarray] = field(default_factory=mesh_axes, init=False)
    locked: SkipJsonSchema[Any] = field(default=(), init=False)
    name: Name = key("", '"left"')
    """its name"""
    range: Range = key("", RANGE_EXAMPLE)
    """the loads expected"""


@array_table
class NamedInterface(Interface):
    """One of several interfaces."""

    refused: ClassVar = {}
    name: Name = key("", '"left"', default_text="none", kw_only=True)
    """of several interfaces each must have its own: a-z, 0-9, _ and -"""
    held: Flag = key("", "true", default=False, kw_only=True)
    """of several, one may be: it does not move, and the others move relative to it"""
    range: Range | None = key("", RANGE_EXAMPLE, default=None, kw_only=True)
    """of several, each that is not held: as `[range]`"""

    def __post_init__(self) -> None:
        if not self.held:
            super().__post_init__()
            if self.range is None:
                message = f"is missing; write range = {RANGE_EXAMPLE}, in N and N·m"
                raise MistakesError(("range", message))
            return
        if self.range is not None:
            raise MistakesError(("range", "has no effect with held = true; leave one of them out"))
        if self.locked not in ((), FREEDOMS):
            message = "has no effect with held = true, which locks all; leave one of them out"
            raise MistakesError(("locked", message))
        object.__setattr__(self, "locked", FREEDOMS)


@table
class Analysis:
    """How to solve."""

    nonlinear: Flag = key("", "true")
    """`true`: large displacements, and of rubber large strains; `false`: a linear analysis"""
    integration: Literal["reduced", "full"] = key(
        "", '"full"', default="reduced", default_text='the deck\'s, else `"reduced"`'
    )
    """hex20: 2x2x2 points, or 3x3x3; a deck's C3D20 is full, its C3D20R reduced"""
    gravity: Annotated[Three | None, AfterValidator(lambda g: g if g and any(g) else None)] = key(
        "m/s^2", "[0, 0, -9.81]", default=None
    )
    """self-weight as a constant load, in the mesh's axes; each material needs `density`"""
    zero: Literal["preloaded", "untightened"] = key("", '"untightened"', default="preloaded")
    """with bolts, the zero of displacement: the part as they are tightened and nothing else acts,
    or before that"""
    on_yield: Literal["warn", "fail"] = key("", '"fail"', default="warn")
    """where a `yield_strength` is exceeded: a note with the fraction of the volume beyond it, or a
    failed solve and no row"""


@dataclass(frozen=True, eq=False)
class DeclaredRange:
    """The loads expected."""

    # low, high: each of shape (6 i,), N and N·m, of i interfaces; zero for a held interface
    low: np.ndarray
    high: np.ndarray

    def corners(self) -> np.ndarray:
        """Return the corners of the range, shape (k, 6 i), N and N·m.

        Raises ValueError if more than `MAX_INPUTS` inputs vary.
        """
        ends = [tuple(dict.fromkeys(pair)) for pair in zip(self.low, self.high, strict=True)]
        varying = sum(len(pair) > 1 for pair in ends)
        if varying > MAX_INPUTS:
            limit = f"at most {MAX_INPUTS} may; write 0 as the range of loads that do not act"
            raise ValueError(f"[range] has {varying} inputs that vary, {limit}")
        return np.array(list(product(*ends)))


@table
class DeclaredTolerance:
    """The error that a component's users accept."""

    translation: Positive = key("m", "1e-5")
    """the error of a displacement that the component's users accept"""
    rotation: Positive = key("rad", "1e-4")
    """the error of a rotation that they accept"""


def _not_below(name: object) -> object:
    """Refuse a file in a subfolder: all files are copied into one folder."""
    if isinstance(name, str) and Path(name).name != name:
        raise ValueError(f'"{name}" must be directly in the bundle\'s folder; move it there')
    return name


FileBeside = Annotated[BundleFile, BeforeValidator(_not_below)]


@table
class Deck:
    """An expert's input deck for an outside solver."""

    file: BundleFile = key("", '"plate.inp"')
    """contains $FX $FY $FZ $MX $MY $MZ; its axes are the interface frame's"""
    command: Annotated[tuple[Text, ...], Field(min_length=1)] = key("", '["ccx", "{job}"]')
    """program and arguments; {job} is the deck's name without its ending"""
    output: Mapping[str, Text] = key(
        "", '{reader = "calculix-dat", point = "REF", rotation = "ROT"}'
    )
    """the reader of the answer: `[deck.output]`"""
    files: Annotated[tuple[FileBeside, ...], AfterValidator(different)] = key(
        "", '["mesh.inp"]', default=()
    )
    """other files of the bundle that the run needs"""
    unit: LengthUnit = key("", '"mm"', default="m")
    """the deck's length unit; moments go in as N times it"""
    timeout: Annotated[Positive, Field(lt=1e7)] = key("s", "600", default=3600.0)
    """after which a run is ended"""
    moment: Literal["spatial", "conjugate"] | None = key(
        "", '"spatial"', default=None, default_text="the reader's"
    )
    """`spatial`: about fixed axes; `conjugate`: works on the rotation vector"""

    def __post_init__(self) -> None:
        if self.file in self.files:
            where = f"files[{self.files.index(self.file)}]"
            raise MistakesError((where, "names the deck itself; leave it out"))


@dataclass(frozen=True, eq=False)
class Bundle:
    """A component as its folder describes it; see `fea.bundle.read.read_bundle`."""

    folder: Path
    name: str
    title: str
    mesh: MeshSource | None
    materials: tuple[AnyMaterial, ...]
    supports: Supports | None
    # interface, others: the interface, or the first of several, and the others in their order
    interface: Interface | None
    analysis: Analysis
    range: DeclaredRange
    tolerance: DeclaredTolerance | None
    deck: Deck | None
    fingerprint: str  # 16 hexadecimal digits over all contents that can change an answer
    others: tuple[Interface, ...] = ()
    ties: tuple[Tie, ...] = ()
    further: tuple[ScalarInput, ...] = ()  # the inputs after the loads
    bolts: tuple[Bolt, ...] = ()
    joints: tuple[Joint, ...] = ()

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
