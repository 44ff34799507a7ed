"""Models of the tables of ``component.toml`` about the mesh: its source, and groups by geometry."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import field, replace
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import AfterValidator, Field
from pydantic.json_schema import SkipJsonSchema

from wrenchbook.fea.spec.keys import (
    MAX_COUNT,
    BundleFile,
    Integer,
    MistakesError,
    Number,
    Positive,
    Text,
    Three,
    counted,
    different,
    either,
    key,
    keys_of,
    table,
)
from wrenchbook.fea.spec.material import Cylinder, Direction

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
LengthUnit = Literal["m", "dm", "cm", "mm", "um", "in", "ft"]
CELLS_ROUND_A_CIRCLE = 7  # least number of cells round a full circle: gmsh's default
GEOMETRY_ENDINGS = (".step", ".stp")
"""Endings of files that have geometry to be meshed, not a mesh."""


def _second_order(order: int) -> int:
    if order != 2:
        raise ValueError(
            f"must be 2, not {order}, since first-order cells are too stiff in bending; order = 2 "
            "adds midside nodes"
        )
    return order


def _listed(points: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return the points of a value that is one point or a list of points, in a fixed order."""
    return tuple(sorted(points)) if points and isinstance(points[0], tuple) else (points,)


Order = Annotated[Integer, Field(ge=1), AfterValidator(_second_order)]
Near = Annotated[tuple[Three, ...], either(Three, tuple[Three, ...], 2), AfterValidator(_listed)]
Numbers = Annotated[
    tuple[Annotated[Integer, Field(ge=1)], ...],
    Field(min_length=1),
    AfterValidator(different),
    AfterValidator(lambda numbers: tuple(sorted(numbers))),
]
_NUMBER = f"a whole number from 1 to {MAX_COUNT}, as `wrenchbook check` lists it"


class Selector:
    """The choice of faces for a group, or of bodies for a region."""

    ways: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not any(getattr(self, way) not in (None, ()) for way in self.ways):
            listed = f"{', '.join(self.ways[:-1])} or {self.ways[-1]}"
            raise MistakesError((self.ways[0], f"is missing; write {listed}"))


def _box(corners: tuple[Any, Any]) -> tuple[Any, Any]:
    for axis, low, high in zip("xyz", *corners, strict=True):
        if low > high:
            numbers = f"swap {axis}, {low:g} and {high:g}"
            raise ValueError(f"must be the low corner, then the high corner; {numbers}")
    return corners


Box = Annotated[tuple[Three, Three], counted(2, "must be two points"), AfterValidator(_box)]


@table
class FaceSelector(Selector):
    """Faces of the surface: facets that any of `ADDING` names, restricted by each other key."""

    ADDING: ClassVar = ("faces", "near", "plane", "radius")
    ways = (*ADDING, "box", "normal", "inside")
    faces: Numbers = key("", "[3, 7]", default=(), default_text="none", expected_text=_NUMBER)
    """by number"""
    near: Near = key("m", "[[0.05, 0.0, 0.01]]", default=(), default_text="none")
    """for each point (or the one point) the face nearest to it"""
    plane: Annotated[
        Literal["x", "y", "z"] | Direction | None, either(Literal["x", "y", "z"], Direction)
    ] = key("", '"x"', default=None)
    """every facet in the plane square to this axis, or direction `[0.6, 0.8, 0]`, `at` a place"""
    at: Annotated[Number | Three | None, either(Number, Three)] = key(
        "m", "0.0", default=None, default_text="-"
    )
    """with `plane`: where it is along its axis or direction, or a point of it"""
    radius: Positive | None = key("m", "0.008", default=None)
    """every cylindrical face of that radius"""
    cylinder: Cylinder | None = key(
        "", "{point = [0, 0, 0], axis = [0, 0, 1]}", default=None, default_text="any"
    )
    """with `radius`: the facets of the cylinder about this axis alone"""
    box: Box | None = key("m", "[[0, 0, 0], [0.1, 0.1, 0.01]]", default=None)
    """restricts: facets all corners of which lie between the low and the high corner"""
    normal: Direction | None = key("", "[0, 0, 1]", default=None)
    """restricts: facets whose outward normal has this direction, within `angle`"""
    angle: Annotated[Number, Field(gt=0, lt=90)] | None = key(
        "deg", "30", default=None, default_text="10"
    )
    """with `normal`: the largest angle to it, below 90"""
    inside: Text | None = key("", '"flange"', default=None)
    """restricts: facets of this other group"""

    def __post_init__(self) -> None:
        if self.plane is None and self.at is not None:
            message = 'is missing; "at" is a position along it: write plane = "x", "y" or "z"'
            raise MistakesError(("plane", message))
        for name, of in (("radius", "cylinder"), ("normal", "angle")):
            if getattr(self, name) is None and getattr(self, of) is not None:
                raise MistakesError((name, f'is missing; write it, or leave "{of}" out'))
        super().__post_init__()
        if self.plane is not None and self.at is None:
            raise MistakesError(("at", "is missing; write where the plane is, in m: at = 0.0"))


@table
class BodySelector(Selector):
    """Bodies of a geometry."""

    ways = ("bodies", "near")
    bodies: Numbers = key("", "[1, 2]", default=(), default_text="none", expected_text=_NUMBER)
    """by number, as `wrenchbook check` lists them"""
    near: Near = key("m", "[0.05, 0.0, 0.01]", default=(), default_text="none")
    """for each point (or the one point) the body it lies in"""


@table
class MeshFile:
    """A mesh file."""

    geometry = generator = parameters = None

    file: BundleFile = key(
        "",
        '"bracket.msh"',
        default_text="none",
        expected_text='the name of a mesh "file", or a "generator"',
    )
    """gmsh, Abaqus/CalculiX .inp, MED, VTK, meshio's others but Nastran's, or STEP (.step, .stp)"""
    unit: LengthUnit = key("", '"mm"')
    """the mesh file's length unit: m, dm, cm, mm, um, in, ft; a STEP file has its own"""
    order: Order | None = key("", "2", default=None)
    """gives the cells of a first-order mesh file midside nodes, in the middle of straight edges
    (STEP is meshed so anyway)"""
    groups: Mapping[str, FaceSelector] = key(
        "", "{tip = {radius = 0.008}}", default=dict, default_text="none"
    )
    """mesh file or STEP: facet groups named by geometry, each `[mesh.groups.NAME]`"""


def _no_all(regions: dict[str, BodySelector]) -> dict[str, BodySelector]:
    if "all" in regions:
        raise MistakesError(("all", '"all" means every cell of the mesh; choose another name'))
    return regions


@table
class GeometryMeshing:
    """How to mesh a geometry file."""

    size: Positive = key("m", "0.004")
    """STEP: edge length of the cells"""
    curvature: Annotated[Integer, Field(ge=3)] | None = key("cells", "16", default=None)
    """STEP: least number of cells round a full turn of a curved face, 3 or more"""
    groups: Mapping[str, FaceSelector] = key(
        "", "{tip = {radius = 0.008}}", default=dict, default_text="none"
    )
    """facet groups named by geometry, each `[mesh.groups.NAME]`"""
    regions: Annotated[Mapping[str, BodySelector], AfterValidator(_no_all)] = key(
        "", "{steel = {bodies = [1]}}", default=dict, default_text="none"
    )
    """STEP: named cell groups, each `[mesh.regions.NAME]`"""
    # Least number of cells round a full circle of any size. For coarser and finer meshes of a
    # bundle; no key of a file.
    circle: SkipJsonSchema[int] = field(default=CELLS_ROUND_A_CIRCLE, init=False)

    def sized(self, size: float, circle: int) -> Self:
        """Return a copy with another size of cells, m, and least number round a circle."""
        copy = replace(self, size=size)
        object.__setattr__(copy, "circle", circle)
        return copy


@table
class GeometryFile(GeometryMeshing):
    """A geometry file, which holds its length unit."""

    unit = "m"
    generator = None
    parameters = None
    refused: ClassVar = {"unit": "a STEP file holds its length unit; leave this key out"}
    file: BundleFile = key("", '"bracket.step"', kw_only=True)
    """a STEP file"""
    order: Order | None = key("", "2", default=None, kw_only=True)
    """STEP: always 2"""

    @property
    def geometry(self) -> GeometryMeshing:
        """The meshing options without the file."""
        return self


@table
class Generator(ABC):
    """A generator of a mesh, with its parameters as the other fields."""

    file = order = geometry = None
    unit = "m"
    generator: str = key("", '"plate"', kw_only=True)
    """`bar`, `plate` or `spring`, with its parameters"""

    @property
    def parameters(self) -> dict[str, Any]:
        """All parameters by name."""
        return {name: getattr(self, name) for name in keys_of(type(self)) if name != "generator"}

    @abstractmethod
    def mistakes(self) -> list[tuple[str, str]]:
        """Return (key, message) for contradictory parameters, or too many cells."""

    @abstractmethod
    def mesh(self) -> Any:
        """Return the mesh, of 20-node hexahedra."""


MeshSource = MeshFile | GeometryFile | Generator
"""Source of the mesh: a mesh file, a geometry file, or a generator with its parameters."""
