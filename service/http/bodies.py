"""Bodies of requests, as pydantic checks them. All quantities are SI."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    FailFast,
    Field,
    Tag,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError, PydanticKnownError

from wrenchbook.fea.spec.schema import LARGEST_LOAD
from wrenchbook.service.contract import MAX_BATCH, MAX_BLOCK, NUMBER_LIMIT, QUERY_WAIT_S, OnThin
from wrenchbook.service.query import Query
from wrenchbook.surrogate.answer import METHODS
from wrenchbook.surrogate.table.rows import Tolerance

Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0)]
NotNegative = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0)]
Load = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-LARGEST_LOAD, le=LARGEST_LOAD)]


def _length(count: int, contents: str) -> BeforeValidator:
    """Return the check of a list's length, with one message for both limits."""

    def check(values: Any) -> Any:
        if isinstance(values, list) and len(values) != count:
            context = {"contents": contents, "length": len(values)}
            raise PydanticCustomError("length", "must be {contents}, not {length}", context)
        return values

    return BeforeValidator(check)


Vector = Annotated[list[Load], Field(min_length=3, max_length=3), _length(3, "3 numbers (x, y, z)")]
Wrench = list[Load]
# A list of a million mistakes would take gigabytes.
Wrenches = Annotated[list[Wrench], FailFast()]
Seconds = Annotated[float, Field(strict=True, ge=0, le=3600, allow_inf_nan=False)]
Flag = Annotated[bool, Field(strict=True)]

# Components of a scene: each is measured, tenths of a second, while the caller waits.
MAX_SCENE_COMPONENTS = 64
ClientName = Annotated[str, Field(min_length=1, max_length=64)]
SequenceNumber = Annotated[int, Field(ge=0, lt=NUMBER_LIMIT)]
# Numbers of each wrench in a binary body, whose bytes do not show them.
BinaryWidth = Annotated[int, Field(ge=1)] | None


class Body(BaseModel):
    """A request body: unknown fields are mistakes, and strings are not converted to numbers."""

    model_config = ConfigDict(extra="forbid")


def _space_size(count: Literal["inputs", "outputs"]) -> AfterValidator:
    """Return the check of a vector's length against the space in the validation's context."""

    def check(values: list[float], info: ValidationInfo) -> list[float]:
        size = len(getattr((info.context or {})["space"], count))
        length = len(values)
        if length == size:
            return values
        context = {"size": size, "length": length}
        raise PydanticCustomError("length", "must be {size} numbers, not {length}", context)

    return AfterValidator(check)


InputVector = Annotated[list[Finite], _space_size("inputs")]
OutputVector = Annotated[list[Finite], _space_size("outputs")]


def _check_method(method: str | None) -> str | None:
    if method is not None and method not in METHODS:
        text = "the method must be one of {methods}, not {method}"
        context = {"method": repr(method[:40]), "methods": ", ".join(METHODS)}
        raise PydanticCustomError("unknown_method", text, context)
    return method


Method = Annotated[str | None, AfterValidator(_check_method)]


class ToleranceBody(Body):
    """Largest acceptable error bar: translation in m, rotation in rad."""

    translation: Positive
    rotation: Positive


def tolerance_of(body: ToleranceBody | None) -> Tolerance | None:
    """Return the tolerance of a body, m and rad."""
    return Tolerance(body.translation, body.rotation) if body else None


def query_of(options: Body, tolerance: Tolerance | None) -> Query:
    """Return the query without its wrench, from the fields that body and query share."""
    common = type(options).model_fields.keys() & set(Query._fields) - {"tolerance"}
    return Query((), tolerance=tolerance, **{name: getattr(options, name) for name in common})


class WrenchBody(Body):
    """One wrench: force in N and moment in N·m, shape (3,) each; at least one of them."""

    force: Vector | None = None
    moment: Vector | None = None

    @model_validator(mode="after")
    def _require_loads(self) -> WrenchBody:
        if self.is_empty():
            raise ValueError(
                "the load is missing; give 'force', 'moment' or both, each a list of three numbers"
            )
        return self

    def is_empty(self) -> bool:
        """Return whether there are no loads."""
        return self.force is None and self.moment is None

    def wrench(self) -> list[float]:
        """Return force then moment, zeros for a missing one."""
        zero = [0.0, 0.0, 0.0]
        return [number + 0.0 for number in (self.force or zero) + (self.moment or zero)]


class LoadsBody(WrenchBody):
    """The loads of a component: one wrench, or one for each interface; and further inputs."""

    loads: dict[str, WrenchBody] = {}
    inputs: dict[str, Load] = {}

    def is_empty(self) -> bool:
        """Return whether there are no loads."""
        return super().is_empty() and not self.loads and not self.inputs


class QueryOptions(Body):
    """Options of a query."""

    on_thin: OnThin = "queue"
    wait_s: Seconds = QUERY_WAIT_S
    tolerance: ToleranceBody | None = None
    method: Method = None
    beyond_range: Flag = False
    derivatives: Flag = False

    def query(self) -> Query:
        """Return the query without its wrench."""
        return query_of(self, tolerance_of(self.tolerance))


class DisplacementBody(QueryOptions, LoadsBody):
    """One wrench and the options of its query."""

    detail: Flag = False


class BatchBody(QueryOptions):
    """A batch of wrenches, each force then moment."""

    wrenches: Annotated[Wrenches, Field(max_length=MAX_BATCH)]


class SolveBody(LoadsBody):
    """One wrench to solve (DirectFEA), covered or not."""

    wait_s: Seconds = 0.0
    beyond_range: Flag = False


def _check_span(span: Any) -> Any:
    is_number = isinstance(span, int | float) and not isinstance(span, bool)
    if len(span) == 2 if isinstance(span, list) else is_number and span >= 0:
        return span
    raise PydanticCustomError("span", "must be 0 or more, or [low, high]")


FORMS = ("[low, high]", "0 or more")  # of a span: pydantic adds the form to a mistake's place
Span = Annotated[
    Annotated[Annotated[list[Finite], Field(min_length=2, max_length=2)], Tag(FORMS[0])]
    | Annotated[NotNegative, Tag(FORMS[1])],
    # A mistake in a span is reported for its own form alone.
    Discriminator(lambda span: FORMS[not isinstance(span, list)]),
    BeforeValidator(_check_span),
]


MAX_VALUES = 64  # inputs, or outputs, of a table
Outputs = Annotated[list[str] | None, Field(min_length=1, max_length=MAX_VALUES)]
Spans = Annotated[list[Span], Field(min_length=3, max_length=3), _length(3, "3 ranges (x, y, z)")]


class RangeBody(Body):
    """Expected loads: per direction a number (plus and minus; 0: no load) or ``[low, high]``."""

    force: Spans
    moment: Spans


class InterfaceSpan(Body):
    """Expected loads of one interface; zero if left out."""

    force: Spans | None = None
    moment: Spans | None = None


class SpaceSpan(Body):
    """Expected loads: of the only interface, or of each by its name, and of further inputs.

    An interface that is left out has no loads; a further input that is left out has the component's
    range.
    """

    # First, since it decides whether the others are required.
    loads: Annotated[dict[str, InterfaceSpan] | None, Field(max_length=MAX_VALUES)] = None
    inputs: Annotated[dict[str, Span] | None, Field(max_length=MAX_VALUES)] = None
    force: Annotated[Spans | None, Field(validate_default=True)] = None
    moment: Annotated[Spans | None, Field(validate_default=True)] = None

    @field_validator("force", "moment")
    @classmethod
    def _is_there(cls, value: list[Any] | None, info: ValidationInfo) -> list[Any] | None:
        plain = all(info.data.get(name, {}) is None for name in ("loads", "inputs"))
        if value is None and plain:
            raise PydanticKnownError("missing")
        return value


class FillBody(Body):
    """Aim of a fill: tolerance, loads, outputs and the largest number of solves."""

    tolerance: ToleranceBody | None = None
    budget: Annotated[int, Field(strict=True, ge=1, le=10_000)] = 24
    range: SpaceSpan | None = None
    outputs: Outputs = None
    for_joint: Flag = False


class SceneComponent(SpaceSpan):
    """Needs of a scene from one component: loads, outputs and tolerance."""

    outputs: Outputs = None
    tolerance: ToleranceBody | None = None


class SceneBody(Body):
    """A scene: its components by name."""

    components: Annotated[
        dict[str, SceneComponent], Field(min_length=1, max_length=MAX_SCENE_COMPONENTS)
    ]


class MeasuredInterface(Body):
    """One of several interfaces of a component without finite elements."""

    name: str
    range: RangeBody


class TemperatureBody(Body):
    """A temperature as a further input; at `reference` it has no effect."""

    unit: Literal["degC", "K"] = "degC"
    range: Annotated[list[Finite], Field(min_length=2, max_length=2)]
    reference: Finite


class AccelerationBody(Body):
    """Three accelerations as further inputs, each with both signs, m/s²."""

    range: Annotated[list[Positive], Field(min_length=3, max_length=3)]


class MeasuredInputs(Body):
    """The further inputs of a component without finite elements."""

    temperature: TemperatureBody | None = None
    acceleration: AccelerationBody | None = None


class TableOnlyComponent(Body):
    """A component without finite elements: one load range, or several interfaces with one each."""

    name: str
    title: str
    range: RangeBody | None = None
    interface: Annotated[list[MeasuredInterface] | None, Field(max_length=MAX_VALUES)] = None
    inputs: MeasuredInputs | None = None
    tolerance: ToleranceBody | None = None


class BlockKey(Body):
    """Identifies a block that is sent twice: its client, and the number the client gives it."""

    client: ClientName | None = None
    sequence: SequenceNumber | None = None

    @model_validator(mode="after")
    def _both_or_none(self) -> BlockKey:
        if (self.client is None) != (self.sequence is None):
            raise ValueError("'client' and 'sequence' belong together; give both, or neither")
        return self


class BinaryBlock(BlockKey):
    """The query parameters of a binary block."""

    inputs: BinaryWidth = None


class BlockBody(BlockKey):
    """Block of wrenches of a simulation, each with a number for each input."""

    # Any size is allowed: a recording stores each wrench of a loop; only a start checks which can
    # be solved.
    wrenches: Annotated[
        list[Annotated[list[Finite], FailFast()]], FailFast(), Field(max_length=MAX_BLOCK)
    ]


class StartBody(Body):
    """Limits of the solves that a start queues."""

    budget: Annotated[int, Field(strict=True, ge=1, le=MAX_BLOCK)] = MAX_BLOCK
    beyond_range: Flag = False


class EnvelopeStartBody(Body):
    """Whether extremes outside the load range are solved too."""

    beyond_range: Flag = False


class CopyBody(Body):
    """Name, title and rows of a component's copy."""

    name: Annotated[str, Field(max_length=300)]
    title: Annotated[str | None, Field(max_length=1000)] = None
    rows: Flag = True


class RenameBody(Body):
    """A component's new name."""

    name: Annotated[str, Field(max_length=300)]


class NotesBody(Body):
    """Notes about a component."""

    text: Annotated[str, Field(max_length=100_000)]
