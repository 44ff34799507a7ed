"""Replies of the server, a dataclass each.

A route returns it, OpenAPI describes it, the client reads it. A reply leaves out a field of
`left_out` that has its default. All quantities are SI; arrays have NaN where JSON has null. This
file only depends on numpy: simulators import it.
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

from wrenchbook.service.contract import CONTRACT_TEXT, Coverage

Vector = NDArray[np.float64]
JobStatus = Literal["waiting", "running", "done", "failed", "cancelled"]
Part = Literal["translation", "rotation"]


class FloatArray:
    """Marks a field as an array of floats: `shape` of its JSON, None for a variable length."""

    item: ClassVar[dict[str, Any]] = {"anyOf": [{"type": "number"}, {"type": "null"}]}
    dtype: ClassVar[Any] = np.float64

    def __init__(self, *shape: int | None) -> None:
        self.shape = shape

    def schema(self) -> dict[str, Any]:
        """Return the JSON schema."""
        schema = self.item
        for size in reversed(self.shape):
            limits = {} if size is None else {"minItems": size, "maxItems": size}
            schema = {"type": "array", "items": schema, **limits}
        return schema

    def read(self, values: Any) -> Vector:
        """Return the array of JSON values, NaN for null, as a read-only array."""
        array = np.array(values, dtype=self.dtype)
        if not array.size and len(self.shape) == 2:
            array = array.reshape(0, self.shape[1] or 6)
        array.flags.writeable = False
        return array

    # Names that pydantic calls.
    def __get_pydantic_core_schema__(self, *_: Any) -> dict[str, Any]:
        return {"type": "any"}

    def __get_pydantic_json_schema__(self, *_: Any) -> dict[str, Any]:
        return self.schema()


class IntArray(FloatArray):
    """Marks a field as an array of integers."""

    item: ClassVar = {"type": "integer"}
    dtype: ClassVar = np.int64


class FiniteArray(FloatArray):
    """Marks a field as an array of floats without null."""

    item: ClassVar = {"type": "number"}


Wrench = Annotated[Vector, FiniteArray(6)]
Three = Annotated[Vector, FloatArray(3)]
Six = Annotated[Vector, FloatArray(6)]
Sixes = Annotated[Vector, FloatArray(None, 6)]
Matrix = Annotated[Vector, FloatArray(6, 6)]
Slopes = Matrix | None


def left_out(*, default: Any) -> Any:
    """Return a field that a reply leaves out if it has its default."""
    return field(default=default, metadata={"left_out": True})


@dataclass_transform(
    frozen_default=True, eq_default=False, kw_only_default=True, field_specifiers=(field, left_out)
)
class Message:
    """A reply; each subclass is a frozen dataclass with keyword fields."""

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
        """Return the message of its JSON; None for a missing field without a default.

        `more` are fields that the JSON lacks, or has in another form.
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
        """The reply as received."""
        return self.__dict__.get("_raw", {})


@cache
def _readers(kind: type[Message]) -> dict[str, Callable[[Any], Any]]:
    hints = get_type_hints(kind, include_extras=True)
    return {item.name: _reader(hints[item.name]) for item in fields(cast(Any, kind))}


def _reader(hint: Any) -> Callable[[Any], Any]:
    """Return the function that converts the JSON of a field to its value."""
    inner = get_args(hint)
    marks = getattr(hint, "__metadata__", ())
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
    return _unless_none(_reader(inner[0])) if type(None) in inner else lambda value: value


def _unless_none(read: Callable[[Any], Any]) -> Callable[[Any], Any]:
    return lambda value: None if value is None else read(value)


class JobLink(Message):
    """State and address of a job."""

    id: int
    status: JobStatus
    url: str = ""
    new: bool | None = left_out(default=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.url:
            self.__dict__["url"] = f"/v1/jobs/{self.id}"


class Queued(Message):
    """Solves that a fill has queued."""

    component: str = ""
    jobs: tuple[JobLink, ...]
    stage: str
    reason: str


class Started(Message):
    """Queued solves of a start, and counts of the other wrenches."""

    component: str = ""
    jobs: tuple[JobLink, ...]
    solved: int
    covered: int
    failed: int
    beyond_range: int
    left: int
    reason: str


class Gathered(Message):
    component: str = ""
    outside: int
    reason: str


class RecordingCounts(Message):
    total: int
    kept: int
    merged: int
    thinned: int
    within: float
    within_outside: float


class Box(Message):
    count: int
    min: Six
    max: Six


class Recording(Gathered, RecordingCounts):
    """Recorded wrenches of a component."""

    wrenches: Sixes

    def __len__(self) -> int:
        return len(self.wrenches)


class _BoundKind(FloatArray):
    """`Envelope.bound`, of which the client only has the kind."""

    def schema(self) -> dict[str, Any]:
        text = {"anyOf": [{"type": "string"}, {"type": "null"}]}
        return {"type": "object", "additionalProperties": text}

    def read(self, values: Any) -> Any:
        return values["kind"]


class Envelope(Gathered, Box):
    """The extremes of each load, and a bound of the displacements under them."""

    at_min: Sixes
    at_max: Sixes
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    displacement_bound: Six
    bound: Annotated[Any, _BoundKind()]
    negligible: bool | None
    tolerance: dict[Part, float] | None


class Plan(Message):
    """Decision for one component of a scene."""

    decision: Literal["rigid", "linear", "table"]
    reason: str
    loads: tuple[str, ...]
    axes: dict[str, dict[Literal["inputs", "dimensions"], Any]]
    outputs: tuple[str, ...]
    tolerance: dict[Part, Any] | None
    displacement_bound: Six
    solves: dict[Literal["whole", "scene"], int]
    saves: dict[Literal["build_s", "memory_bytes", "us_per_answer"], Any]
    saves_from: dict[str, str]
    compliance: Annotated[Vector | None, FloatArray(None, 6)] = left_out(default=None)
    table_version: int


class Stress(Message):
    """The largest von Mises stress of a component."""

    largest: float
    error: float | None
    at: Three
    region: str
    yield_strength: float | None
    yields: bool | None


class DeformedShape(Message):
    """A component's surface under one wrench, in the undeformed interface frame from its point."""

    component: str = ""
    force: Annotated[Vector | None, FloatArray(3)] = None
    moment: Annotated[Vector | None, FloatArray(3)] = None
    frame: dict[Literal["point", "axes"], Any] | None = None
    vertices: Annotated[Vector, FloatArray(None, 3)]
    triangles: Annotated[NDArray[np.int64], IntArray(None, 3)]
    displacement: Annotated[Vector, FloatArray(None, 3)]
    error: Annotated[Vector | None, FloatArray(None)]
    error_parts: dict[str, Any] | None = None
    within_tolerance: bool | None = None
    simplified: dict[Literal["from", "to"], int] | None = None
    stress: Stress | None
    source: str
    rows: tuple[int, ...] = ()
    coverage: Coverage
    reason: str = left_out(default="")

    @property
    def is_covered(self) -> bool:
        """Whether the interpolation error is within the component's tolerance."""
        return self.coverage == "covered"

    def deformed(self, scale: float = 1.0) -> Vector:
        """Return the displaced vertices, shape (v, 3), m, exaggerated by `scale`."""
        return self.vertices + scale * self.displacement


class Displacement(Message):
    component: str
    translation: Three | None = None
    rotation: Three | None = None
    error: dict[Part, Three] | None = None
    displacements: dict[str, dict[Literal["translation", "rotation", "error"], Any]] | None = (
        left_out(default=None)
    )
    coverage: Coverage
    within_tolerance: bool | None = None
    source: str | None
    method: str | None
    table_version: int
    elapsed_us: float
    reason: str = left_out(default="")
    missing: tuple[str, ...] = left_out(default=())
    row: int | None = left_out(default=None)
    notes: tuple[str, ...] = left_out(default=())
    derivative: Slopes = left_out(default=None)
    axes: tuple[dict[str, Any], ...] = left_out(default=())
    method_detail: str = left_out(default="")
    error_parts: dict[str, Any] | None = left_out(default=None)
    error_of_a_reading: dict[Part, Any] | None = left_out(default=None)
    job: JobLink | None = left_out(default=None)


class WrenchJob(Message):
    """The job of one wrench of a batch."""

    index: int
    id: int | None
    status: JobStatus | None
    url: str | None
    reason: Literal["", "beyond-range", "queue-limit"] = left_out(default="")


class Displacements(Message):
    displacements: Sixes
    errors: Sixes
    coverage: Sequence[Coverage]
    within_tolerance: Sequence[bool | None] | None = left_out(default=None)
    derivatives: Sequence[Slopes] | None = left_out(default=None)
    component: str
    jobs: Sequence[WrenchJob]
    method: str | None
    table_version: int | None
    elapsed_us: float | None


Displacement.__doc__ = Displacements.__doc__ = CONTRACT_TEXT


class Mistake(Message):
    loc: str
    msg: str


class Problem(Message):
    """RFC 9457; further members give details."""

    type: str
    title: str
    status: int
    detail: str
    errors: tuple[Mistake, ...] = left_out(default=())
    request_id: str = left_out(default="")


class ImportFinding(Message):
    cause: str
    message: str
    rows: Sequence[int]
    count: int


class TableRow(Message):
    wrench: Wrench
    displacement: Six
    uncertainty: Six | None = left_out(default=None)
    compliance: Annotated[Vector | None, FiniteArray(6, 6)] = left_out(default=None)
    curvature: Annotated[Vector | None, FiniteArray(None)] = left_out(default=None)
    source: str = left_out(default="")
    note: str = left_out(default="")
    fingerprint: str = left_out(default="")


class TableRows(Message):
    """A table as JSON."""

    rows: Sequence[TableRow]
    units: Literal["SI"] = left_out(default="SI")
    component: str = left_out(default="")
    table_version: int | None = left_out(default=None)


class RowMistake(Message):
    row: int
    field: str
    message: str


class RowMistakes(RowMistake):
    """Mistakes of one cause."""

    count: int
    rows: Sequence[int]
    fields: Sequence[str]


class PreviewRow(Message):
    row: int
    wrench: Wrench
    displacement: Six
