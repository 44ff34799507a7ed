"""Replies of the server, a dataclass each.

A route returns it, OpenAPI shows it, the client reads it. A field of `left_out` is in a reply
unless it has its default. All quantities are SI; arrays have NaN where JSON has null. No
dependency but numpy: simulators import it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
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

from wrenchbook.service.contract import CONTRACT, Coverage

Vector = NDArray[np.float64]
JobStatus = Literal["waiting", "running", "done", "failed", "cancelled"]
Part = Literal["translation", "rotation"]


class Doc:
    """The description of a field, as OpenAPI shows it."""

    def __init__(self, text: str) -> None:
        self.text = text

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> dict[str, Any]:
        return {**handler(core), "description": self.text}


class FloatArray:
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


class IntArray(FloatArray):
    """Marks a field as an array of integers."""

    number: ClassVar = {"type": "integer"}, np.int64


class FiniteArray(FloatArray):
    """Marks a field as an array of floats, none of which is null."""

    number: ClassVar = {"type": "number"}, np.float64


Wrench = Annotated[Vector, FiniteArray(6), Doc("N and N·m")]
Three = Annotated[Vector, FloatArray(3)]
Six = Annotated[Vector, FloatArray(6)]
Sixes = Annotated[Vector, FloatArray(None, 6)]
Matrix = Annotated[Vector, FloatArray(6, 6)]
Slopes = Annotated[
    Matrix | None,
    Doc("du/dw, a line an output, m and rad over N and N·m; null where it is not known"),
]


def left_out(*, default: Any) -> Any:
    """Return a field that a reply has only where it differs from its default."""
    return field(default=default, metadata={"left_out": True})


@dataclass_transform(
    frozen_default=True, eq_default=False, kw_only_default=True, field_specifiers=(field, left_out)
)
class Message:
    """A reply; each subclass is a frozen dataclass, whose fields are keywords."""

    _left_out: ClassVar[list[tuple[str, Any]]]

    def __init_subclass__(cls) -> None:
        dataclass(frozen=True, eq=False, kw_only=True)(cls)
        items = fields(cast(Any, cls))
        cls._left_out = [(item.name, item.default) for item in items if "left_out" in item.metadata]

    def __post_init__(self) -> None:
        for name, default in self._left_out:
            value = self.__dict__[name]
            if value is default or (isinstance(value, str) and value == default):
                del self.__dict__[name]  # the class has the default

    @classmethod
    def of(cls, parts: dict[str, Any]) -> Self:
        """Return the message with the fields of its JSON, in their order and unchecked.

        It takes half a microsecond, the constructor four.
        """
        message = object.__new__(cls)
        message.__dict__.update(parts)
        return message

    @classmethod
    def read(cls, body: Mapping[str, Any], **more: Any) -> Self:
        """Return the message of its JSON; None where it lacks a field without a default.

        `more` are fields that the JSON has not, or has in another form.
        """
        parts: dict[str, Any] = {
            item.name: None
            for item in fields(cast(Any, cls))
            if item.default is MISSING and item.default_factory is MISSING
        }
        for name, read in _readers(cls).items():
            if name in body and name not in more:
                parts[name] = read(body[name])
        message = cls(**parts | more)
        message.__dict__["_raw"] = dict(body)
        return message

    @property
    def raw(self) -> dict[str, Any]:
        """The reply as it came."""
        return self.__dict__.get("_raw", {})


@cache
def _readers(kind: type[Message]) -> dict[str, Callable[[Any], Any]]:
    hints = get_type_hints(kind, include_extras=True)
    return {item.name: _reader(hints[item.name]) for item in fields(cast(Any, kind))}


def _reader(hint: Any) -> Callable[[Any], Any]:
    """Return the function that converts the JSON of a field to its value."""
    inner, marks = get_args(hint), getattr(hint, "__metadata__", ())
    if marks:
        numbers = [mark for mark in marks if isinstance(mark, FloatArray)]
        return _unless_none(numbers[0].read) if numbers else _reader(inner[0])
    if isinstance(hint, type) and issubclass(hint, Message):
        return hint.read
    if get_origin(hint) is tuple:
        read = _reader(inner[0])
        return lambda values: tuple(map(read, values))
    if get_origin(hint) is dict:
        read_value = _reader(inner[1])
        return lambda values: {name: read_value(value) for name, value in values.items()}
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
    ] = left_out(default=False)

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


class RecordingCounts(Message):
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


class Recording(Gathered, RecordingCounts):
    """What the server has recorded of a component."""

    wrenches: Annotated[
        Sixes, Doc("those kept, in the order they came, shape (n, inputs), N and N·m")
    ]

    def __len__(self) -> int:
        return len(self.wrenches)


class _BoundKind(FloatArray):
    """`Envelope.bound`, of which the client has the kind alone."""

    def schema(self) -> dict[str, Any]:
        text = {"anyOf": [{"type": "string"}, {"type": "null"}]}
        return {"type": "object", "additionalProperties": text}

    def read(self, values: Any) -> Any:
        return values["kind"]


class Envelope(Gathered, Box):
    """The extremes of each load, and a bound of the displacements under them."""

    at_min: Annotated[
        Sixes, Doc("the complete wrench at each least value, shape (inputs, inputs), N and N·m")
    ]
    at_max: Annotated[
        Sixes, Doc("the complete wrench at each largest value, shape (inputs, inputs), N and N·m")
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
        Doc("per axis that is composed its loads that can occur, and the number that vary"),
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
        Doc("what the scene's table needs less than the complete one"),
    ]
    saves_from: Annotated[dict[str, str], Doc("the source of each number of saves and solves")]
    compliance: Annotated[
        Vector | None,
        FloatArray(None, 6),
        Doc(
            "with linear, where it is known: the displacement over the wrench, shape (6, 6), m and "
            "rad over N and N·m; zero by loads that cannot occur"
        ),
    ] = left_out(default=None)
    table_version: int


class Stress(Message):
    """The largest von Mises stress of a component."""

    largest: Annotated[float, Doc("Pa")]
    error: Annotated[
        float | None,
        Doc("95 % error bar, Pa, of the table alone: without the mesh's; null if not known"),
    ]
    at: Annotated[
        Vector, FloatArray(3), Doc("where, undeformed, m, in the interface frame from its point")
    ]
    region: Annotated[str, Doc("the material there")]
    yield_strength: Annotated[float | None, Doc("of that material, Pa; null if it is not known")]
    yields: Annotated[
        bool | None,
        Doc("whether it yields there; null without a strength, or if the bar lies across it"),
    ]


class DeformedShape(Message):
    """A component's surface under one wrench, in the undeformed interface frame from its point."""

    component: str = ""
    force: Annotated[Vector | None, FloatArray(3), Doc("N")] = None
    moment: Annotated[Vector | None, FloatArray(3), Doc("N·m")] = None
    frame: dict[Literal["point", "axes"], Any] | None = None
    vertices: Annotated[Vector, FloatArray(None, 3), Doc("undeformed, shape (v, 3), m")]
    triangles: Annotated[
        NDArray[np.int64],
        IntArray(None, 3),
        Doc("vertices, shape (t, 3), anticlockwise seen from outside"),
    ]
    displacement: Annotated[Vector, FloatArray(None, 3), Doc("shape (v, 3), m")]
    error: Annotated[
        Vector | None,
        FloatArray(None),
        Doc(
            "95 % error bar of each vertex's displacement, shape (v,), m; null where it is not "
            "known. The mesh's error is in it if error_parts has mesh"
        ),
    ]
    error_parts: Annotated[
        dict[str, Any] | None,
        Doc("the largest of each part of error, m: table, mesh, linearity; mesh_basis as text"),
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
    rows: Annotated[tuple[int, ...], Doc("the rows that it interpolates")] = ()
    coverage: Annotated[Coverage, Doc("of the interpolation error alone")]
    reason: Annotated[str, Doc("why it is not covered")] = left_out(default="")

    @property
    def is_covered(self) -> bool:
        """Whether the interpolation error is within the component's tolerance."""
        return self.coverage == "covered"

    def deformed(self, scale: float = 1.0) -> Vector:
        """Return the displaced vertices, shape (v, 3), m, exaggerated by `scale`."""
        return self.vertices + scale * self.displacement


_WITHIN = (
    "whether the total error bar is within the tolerance, the request's or the component's. "
    "coverage compares the interpolation error alone, which more rows lower: covered and false "
    "means that the solver's own error is over the tolerance, and the component's warnings say "
    "what to do. null without a tolerance, or if the error bar of an answered output is not known"
)


class Displacement(Message):
    component: str
    translation: Annotated[Three | None, Doc("m")] = None
    rotation: Annotated[Three | None, Doc("rotation vector, rad")] = None
    error: Annotated[dict[Part, Three] | None, Doc("estimated 95 % error bars, m and rad")] = None
    displacements: Annotated[
        dict[str, dict[Literal["translation", "rotation", "error"], Any]] | None,
        Doc("of several interfaces: translation, rotation and error of each by its name"),
    ] = left_out(default=None)
    coverage: Coverage
    within_tolerance: Annotated[bool | None, Doc(_WITHIN)] = None
    source: Annotated[str | None, Doc("table, or of the row that answers: fea, measured")]
    method: str | None
    table_version: Annotated[
        int,
        Doc(
            "the version of the table that answers; where source is fea the answer is that of row, "
            "which may be newer than this version"
        ),
    ]
    elapsed_us: Annotated[float, Doc("time spent on the answer, µs")]
    reason: Annotated[str, Doc("why not covered, why no solve is queued")] = left_out(default="")
    missing: Annotated[tuple[str, ...], Doc("the outputs that no row of the table holds")] = (
        left_out(default=())
    )
    row: Annotated[
        int | None, Doc("the row of the solve, in the ledger and in the table's exports")
    ] = left_out(default=None)
    notes: Annotated[tuple[str, ...], Doc("of the solver: doubtful cells, ill conditioning")] = (
        left_out(default=())
    )
    derivative: Slopes = left_out(default=None)
    axes: Annotated[
        tuple[dict[str, Any], ...], Doc("with detail; empty if a row of the table answers")
    ] = left_out(default=())
    method_detail: Annotated[str, Doc("with detail: the method's way of answering")] = left_out(
        default=""
    )
    error_parts: Annotated[
        dict[str, Any] | None,
        Doc(
            "with detail: the parts of error. table: what more rows lower; mesh: what a finer "
            "mesh lowers; linearity: what a linear component leaves out; measurement: hysteresis, "
            "drift and sessions of the measured rows. null where not known"
        ),
    ] = left_out(default=None)
    error_of_a_reading: Annotated[
        dict[Part, Any] | None,
        Doc("with detail, of measured rows: the 95 % error bar of one more reading, m and rad"),
    ] = left_out(default=None)
    job: JobLink | None = left_out(default=None)


class WrenchJob(Message):
    """The job of one wrench of a batch."""

    index: Annotated[int, Doc("number of the wrench, from 0")]
    id: Annotated[int | None, Doc("null: no solve is queued")]
    status: JobStatus | None
    url: str | None
    reason: Annotated[Literal["", "beyond-range", "queue-limit"], Doc("why none is queued")] = (
        left_out(default="")
    )


class Displacements(Message):
    displacements: Annotated[Sixes, Doc("m and rad")]
    errors: Annotated[Sixes, Doc("95 % error bars, m and rad")]
    coverage: Sequence[Coverage]
    within_tolerance: Annotated[
        Sequence[bool | None] | None, Doc(f"{_WITHIN}; left out where there is no tolerance")
    ] = left_out(default=None)
    derivatives: Sequence[Slopes] | None = left_out(default=None)
    component: str
    jobs: Annotated[Sequence[WrenchJob], Doc("one a wrench not covered; several may share a job")]
    method: str | None
    table_version: int | None
    elapsed_us: Annotated[float | None, Doc("time spent on the answers, µs")]


Displacement.__doc__ = Displacements.__doc__ = " ".join(
    f"{name}: {meaning}." for name, meaning in CONTRACT.items()
)


class Mistake(Message):
    loc: str
    msg: str


class Problem(Message):
    """RFC 9457; further members give details."""

    type: Annotated[str, Doc("urn:wrenchbook:problem:...")]
    title: str
    status: int
    detail: Annotated[str, Doc("what is wrong and what to do")]
    errors: tuple[Mistake, ...] = left_out(default=())
    request_id: Annotated[str, Doc("of a 5xx: as in the server's log")] = left_out(default="")


class ImportFinding(Message):
    cause: Annotated[
        str,
        Doc(
            "dead, noise, clipped, stuck, outlier, sentinel, sign, unit, lever, asymmetry, "
            "clearance, campaign, solves, drift, hysteresis, session, scale, zero, clock, twice"
        ),
    ]
    message: Annotated[str, Doc("the error, its size and the remedy")]
    rows: Annotated[
        Sequence[int], Doc("of the file, worst first, 500 at most; [] if all are meant")
    ]
    count: Annotated[int, Doc("the number of rows")]


class TableRow(Message):
    wrench: Wrench
    displacement: Annotated[Six, Doc("m and rad; null where not measured")]
    uncertainty: Annotated[Six | None, Doc("m and rad; null where not known")] = left_out(
        default=None
    )
    compliance: Annotated[
        Vector | None,
        FiniteArray(6, 6),
        Doc("tangent d(displacement)/d(wrench), a line an output, m and rad over N and N·m"),
    ] = left_out(default=None)
    curvature: Annotated[
        Vector | None,
        FiniteArray(None),
        Doc("third derivatives of the complementary energy by (F, mu), SI"),
    ] = left_out(default=None)
    source: Annotated[str, Doc("fea, measured ...")] = left_out(default="")
    note: str = left_out(default="")
    fingerprint: Annotated[str, Doc("the setup that was solved")] = left_out(default="")


class TableRows(Message):
    """A table as JSON."""

    rows: Sequence[TableRow]
    units: Literal["SI"] = left_out(default="SI")
    component: str = left_out(default="")
    table_version: int | None = left_out(default=None)


class RowMistake(Message):
    row: Annotated[int, Doc("line or place, from 1; 0: the complete file")]
    field: str
    message: Annotated[str, Doc("what is wrong and what to write")]


class RowMistakes(RowMistake):
    """Mistakes of one cause."""

    count: int
    rows: Annotated[Sequence[int], Doc("the first 10")]
    fields: Annotated[Sequence[str], Doc("the first 10")]


class PreviewRow(Message):
    row: int
    wrench: Wrench
    displacement: Annotated[Six, Doc("m and rad; null where not measured")]
