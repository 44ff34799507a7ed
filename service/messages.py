"""Replies of the server, a dataclass each.

A route returns it, OpenAPI shows it, the client reads it. A field with metadata `LEFT_OUT` is
in a reply unless it has its default. All quantities are SI; arrays have NaN where JSON has null. No
dependency but numpy: simulators import it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, field, fields
from functools import cache
from typing import (
    Annotated,
    Any,
    ClassVar,
    Literal,
    Self,
    cast,
    dataclass_transform,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np
from numpy.typing import NDArray

from wrenchbook.service.contract import Coverage

Vector = NDArray[np.float64]
JobStatus = Literal["waiting", "running", "done", "failed", "cancelled"]
Part = Literal["translation", "rotation"]


class Doc:
    """The description of a field, as OpenAPI shows it."""

    def __init__(self, text: str) -> None:
        self.text = text

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> dict[str, Any]:
        return {**handler(core), "description": self.text}


class Numbers:
    """Marks a field as an array of floats: `shape` of its JSON, None where it varies."""

    number: ClassVar[tuple[dict[str, Any], Any]] = (
        {"anyOf": [{"type": "number"}, {"type": "null"}]},
        np.float64,
    )

    def __init__(self, *shape: int | None) -> None:
        self.shape = shape

    def schema(self) -> dict[str, Any]:
        """Return the JSON schema."""
        schema: dict[str, Any] = self.number[0]
        for size in reversed(self.shape):
            limits = {} if size is None else {"minItems": size, "maxItems": size}
            schema = {"type": "array", "items": schema, **limits}
        return schema

    def read(self, values: Any) -> Vector:
        """Return the array of JSON, NaN for null, that is not written to by mistake."""
        array = np.array(values, dtype=self.number[1])
        if not array.size and len(self.shape) == 2:
            array = array.reshape(0, self.shape[1] or 6)
        array.flags.writeable = False
        return array

    # As pydantic calls them.
    def __get_pydantic_core_schema__(self, *_: Any) -> dict[str, Any]:
        return {"type": "any"}

    def __get_pydantic_json_schema__(self, *_: Any) -> dict[str, Any]:
        return self.schema()


class Indices(Numbers):
    """Marks a field as an array of integers."""

    number: ClassVar = {"type": "integer"}, np.int64


Six = Annotated[Vector, Numbers(6)]
Sixes = Annotated[Vector, Numbers(None, 6)]


LEFT_OUT = {"left_out": True}
"""Metadata of a field that a reply has only where it differs from its default."""


@dataclass_transform(
    frozen_default=True, eq_default=False, kw_only_default=True, field_specifiers=(field,)
)
class Message:
    """A reply; each subclass is a frozen dataclass, whose fields are given by name."""

    def __init_subclass__(cls) -> None:
        dataclass(frozen=True, eq=False, kw_only=True)(cls)

    def __post_init__(self) -> None:
        for name, default in _left_out(type(self)):
            value = self.__dict__[name]
            if value is default or (isinstance(value, str) and value == default):
                del self.__dict__[name]  # the class has the default

    @classmethod
    def read(cls, body: Mapping[str, Any]) -> Self:
        """Return the message of its JSON; None where it lacks a field without a default."""
        parts: dict[str, Any] = {
            item.name: None for item in fields(cast(Any, cls)) if item.default is MISSING
        }
        for name, read in _readers(cls).items():
            if name in body:
                parts[name] = read(body[name])
        message = cls(**parts)
        message.__dict__["_raw"] = dict(body)
        return message

    @property
    def raw(self) -> dict[str, Any]:
        """The reply as it came."""
        return self.__dict__.get("_raw", {})


@cache
def _left_out(kind: type[Message]) -> list[tuple[str, Any]]:
    return [
        (item.name, item.default)
        for item in fields(cast(Any, kind))
        if item.metadata.get("left_out")
    ]


@cache
def _readers(kind: type[Message]) -> dict[str, Callable[[Any], Any]]:
    hints = get_type_hints(kind, include_extras=True)
    return {item.name: _reader(hints[item.name]) for item in fields(cast(Any, kind))}


def _reader(hint: Any) -> Callable[[Any], Any]:
    """Return what turns the JSON of a field into its value."""
    inner, marks = get_args(hint), getattr(hint, "__metadata__", ())
    if marks:
        numbers = [mark for mark in marks if isinstance(mark, Numbers)]
        return _unless_none(numbers[0].read) if numbers else _reader(inner[0])
    if isinstance(hint, type) and issubclass(hint, Message):
        return hint.read
    if get_origin(hint) is tuple:
        read = _reader(inner[0])
        return lambda values: tuple(map(read, values))
    if type(None) in inner:
        return _unless_none(_reader(inner[0]))
    return lambda value: value


def _unless_none(read: Callable[[Any], Any]) -> Callable[[Any], Any]:
    return lambda value: None if value is None else read(value)


class JobLink(Message):
    """A job, in short."""

    id: int
    status: JobStatus
    url: str = ""
    new: Annotated[
        bool | None, Doc("whether this request queued it; false: it was queued before")
    ] = field(default=False, metadata=LEFT_OUT)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.url:
            self.__dict__["url"] = f"/v1/jobs/{self.id}"


class Queued(Message):
    """A round of solves that fill a table."""

    component: str = ""
    jobs: Annotated[
        tuple[JobLink, ...],
        Doc("the solves queued; none when the interpolation error meets the tolerance"),
    ]
    stage: Annotated[str, Doc("first, refine or met")]
    reason: Annotated[str, Doc("why these, or why none")]


class Started(Message):
    """What a start has queued, and the count of wrenches that it has not."""

    component: str = ""
    jobs: Annotated[tuple[JobLink, ...], Doc("waiting or running for these wrenches")]
    solved: Annotated[int, Doc("wrenches that a row of the table has")]
    covered: Annotated[int, Doc("wrenches that the table covers: not solved")]
    failed: Annotated[int, Doc("wrenches whose solve has failed before")]
    beyond_range: Annotated[int, Doc("wrenches outside the load range: not solved")]
    left: Annotated[int, Doc("wrenches that the budget leaves")]
    reason: Annotated[str, Doc("why not all; empty if all are queued")]


class Gathered(Message):
    component: str = ""
    outside: Annotated[int, Doc("of all taken in: outside the load range")]
    reason: Annotated[str, Doc("remarks; empty if there are none")]


class Block(Gathered):
    recorded: int
    duplicate: Annotated[bool, Doc("the block was recorded before; nothing has changed")]


class Counts(Message):
    total: Annotated[int, Doc("wrenches taken in since it was cleared, each once")]
    kept: Annotated[int, Doc("wrenches kept; start solves these")]
    merged: Annotated[int, Doc("of total: within 1e-6 of the range of one kept")]
    thinned: Annotated[
        int,
        Doc("of total: left out by thinning, beyond 10,000 kept, or 1,000 outside the load range"),
    ]
    within: Annotated[
        float,
        Doc(
            "every wrench taken in within the load range is as near as this to one kept: the "
            "largest difference of a load by its scale"
        ),
    ]
    within_outside: Annotated[
        float, Doc("the same of those outside the range; there the difference is by the load")
    ]


class Box(Message):
    count: Annotated[int, Doc("wrenches taken in since it was cleared, each once")]
    min: Annotated[Six, Doc("least value of each load, N and N·m; null before the first")]
    max: Annotated[Six, Doc("largest value of each load, N and N·m; null before the first")]


class Recorded(Block, Counts):
    """What a block of wrenches changed in a recording."""


class Recording(Gathered, Counts):
    """What the server has recorded of a component."""

    wrenches: Annotated[
        Sixes, Doc("those kept, in the order they came, shape (n, inputs), N and N·m")
    ]

    def __len__(self) -> int:
        return len(self.wrenches)


class Widened(Block, Box):
    """What a block of wrenches changed in an envelope."""


class _BoundKind(Numbers):
    """`Envelope.bound`, of which the client has the kind alone."""

    def schema(self) -> dict[str, Any]:
        text = {"anyOf": [{"type": "string"}, {"type": "null"}]}
        return {"type": "object", "additionalProperties": text}

    def read(self, values: Any) -> Any:
        return values["kind"]


class Envelope(Gathered, Box):
    """The extremes of each load, and how far they can move the component."""

    at_min: Annotated[
        Sixes, Doc("the whole wrench at each least value, shape (inputs, inputs), N and N·m")
    ]
    at_max: Annotated[
        Sixes, Doc("the whole wrench at each largest value, shape (inputs, inputs), N and N·m")
    ]
    inputs: Annotated[tuple[str, ...], Doc("the order of min and max")]
    outputs: Annotated[tuple[str, ...], Doc("the order of displacement_bound")]
    displacement_bound: Annotated[Six, Doc("m and rad; null where nothing is known")]
    bound: Annotated[
        Any, _BoundKind(), Doc("what displacement_bound is; its kind is bound, estimate or unknown")
    ]
    negligible: Annotated[
        bool | None, Doc("whether displacement_bound is within the tolerance; null: see reason")
    ]
    tolerance: dict[Part, float] | None


class Cleared(Message):
    component: str
    cleared: Annotated[int, Doc("wrenches deleted")]


class Plan(Message):
    """What a scene needs of one component."""

    decision: Annotated[
        Literal["rigid", "linear", "table"],
        Doc("leave the component out; one compliance answers; its table does"),
    ]
    reason: str
    loads: Annotated[tuple[str, ...], Doc("the loads that can occur")]
    axes: Annotated[
        dict[str, dict[Literal["inputs", "dimensions"], Any]],
        Doc("per axis that is composed its loads that can occur, and how many of them vary"),
    ]
    outputs: Annotated[tuple[str, ...], Doc("the outputs that are read")]
    tolerance: Annotated[
        dict[Part, Any] | None, Doc("of the decision, m and rad: the scene's or the component's")
    ]
    displacement_bound: Annotated[
        Six,
        Doc(
            "what no displacement within the scene exceeds, m and rad: by the compliance and the "
            "answers at the scene's corners, bars included; null if not known"
        ),
    ]
    solves: Annotated[
        dict[Literal["whole", "scene"], int], Doc("of the first design, from an empty table")
    ]
    saves: Annotated[
        dict[Literal["build_s", "memory_bytes", "us_per_answer"], Any],
        Doc("what the scene's table needs less than the whole one"),
    ]
    saves_from: Annotated[dict[str, str], Doc("the source of each number of saves and solves")]
    compliance: Annotated[
        Vector | None,
        Numbers(None, 6),
        Doc(
            "with linear, where it is known: the displacement over the wrench, shape (6, 6), m and "
            "rad over N and N·m; zero by loads that cannot occur"
        ),
    ] = field(default=None, metadata=LEFT_OUT)
    table_version: int


class Plans(Message):
    components: dict[str, Plan]


class Stress(Message):
    """The largest von Mises stress of a component."""

    largest: Annotated[float, Doc("Pa")]
    error: Annotated[
        float | None,
        Doc("95 % error bar, Pa, of the table alone: without the mesh's; null if not known"),
    ]
    at: Annotated[
        Vector, Numbers(3), Doc("where, undeformed, m, in the interface frame from its point")
    ]
    region: Annotated[str, Doc("the material there")]
    yield_strength: Annotated[float | None, Doc("of that material, Pa; null if it is not given")]
    yields: Annotated[
        bool | None,
        Doc("whether it yields there; null without a strength, or if the bar lies across it"),
    ]


class DeformedShape(Message):
    """A component's surface under one wrench, in the undeformed interface frame from its point."""

    component: str = ""
    force: Annotated[Vector | None, Numbers(3), Doc("N")] = None
    moment: Annotated[Vector | None, Numbers(3), Doc("N·m")] = None
    frame: dict[Literal["point", "axes"], Any] | None = None
    vertices: Annotated[Vector, Numbers(None, 3), Doc("undeformed, shape (v, 3), m")]
    triangles: Annotated[
        NDArray[np.int64],
        Indices(None, 3),
        Doc("vertices, shape (t, 3), anticlockwise seen from outside"),
    ]
    displacement: Annotated[Vector, Numbers(None, 3), Doc("shape (v, 3), m")]
    error: Annotated[
        Vector | None,
        Numbers(None),
        Doc(
            "95 % error bar of each vertex's displacement, shape (v,), m; null where it is not "
            "known. The mesh's error is in it if error_parts has mesh"
        ),
    ]
    error_parts: Annotated[
        dict[str, Any] | None,
        Doc("the largest of each part of error, m: table, mesh, linearity; mesh_basis in words"),
    ] = None
    within_tolerance: Annotated[
        bool | None,
        Doc(
            "whether every bar is within the component's tolerance; null without one, or if the "
            "discretisation error is not known"
        ),
    ] = None
    simplified: dict[Literal["from", "to"], int] | None = None
    stress: Annotated[Stress | None, Doc("null where it is not known")]
    source: Annotated[
        str, Doc("row: a solve of this very wrench; rows: between them; linear: six unit fields")
    ]
    rows: Annotated[tuple[int, ...], Doc("the rows it is made of")] = ()
    coverage: Annotated[Coverage, Doc("of the interpolation error alone")]
    reason: Annotated[str, Doc("why it is not covered")] = field(default="", metadata=LEFT_OUT)

    @property
    def is_covered(self) -> bool:
        """Whether the interpolation error is within the component's tolerance."""
        return self.coverage == "covered"

    def deformed(self, scale: float = 1.0) -> Vector:
        """Return the displaced vertices, shape (v, 3), m, exaggerated by `scale`."""
        return self.vertices + scale * self.displacement
