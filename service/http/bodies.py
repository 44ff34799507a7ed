"""Bodies of requests, as pydantic checks them. All quantities are SI."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0)]
Vector = Annotated[list[Finite], Field(min_length=3, max_length=3)]
Wrench = Annotated[list[Finite], Field(min_length=6, max_length=6)]
Output = Literal["ux", "uy", "uz", "rx", "ry", "rz"]
OnThin = Literal["queue", "wait", "estimate", "reject"]
Flag = Annotated[
    bool, Field(description="whether a wrench outside the load range may be solved as well")
]
Derivatives = Annotated[bool, Field(description="whether to add du/dw, 6 x 6, to the answer")]
Seconds = Annotated[float, Field(ge=0, le=3600, allow_inf_nan=False)]

MAX_BATCH = 1_000_000


class Body(BaseModel):
    """A request body: unknown fields are mistakes, numbers are never guessed from strings."""

    model_config = ConfigDict(extra="forbid")


class ToleranceBody(Body):
    """Largest acceptable error bar: translation in m, rotation in rad."""

    translation: Positive
    rotation: Positive


class WrenchBody(Body):
    """One wrench: force in N and moment in N·m, shape (3,) each; at least one of them."""

    force: Vector | None = None
    moment: Vector | None = None

    @model_validator(mode="after")
    def _one_is_given(self) -> WrenchBody:
        if self.force is None and self.moment is None:
            raise ValueError("give 'force', 'moment' or both, each a list of three numbers")
        return self

    def wrench(self) -> tuple[float, ...]:
        """Return force then moment, zeros for what was not given."""
        zero = [0.0, 0.0, 0.0]
        return tuple(map(float, (self.force or zero) + (self.moment or zero)))


class DisplacementBody(WrenchBody):
    """The main call's body."""

    on_thin: OnThin = "queue"
    wait_s: Seconds = 30.0
    tolerance: ToleranceBody | None = None
    method: str | None = None
    detail: bool = False
    beyond_range: Flag = False
    derivatives: Derivatives = False


class BatchBody(Body):
    """A batch of wrenches, each force then moment."""

    wrenches: Annotated[list[Wrench], Field(max_length=MAX_BATCH)]
    on_thin: OnThin = "queue"
    wait_s: Seconds = 30.0
    tolerance: ToleranceBody | None = None
    method: str | None = None
    beyond_range: Flag = False
    derivatives: Derivatives = False


class SolveBody(WrenchBody):
    """DirectFEA: solve this wrench now, whatever the table says."""

    wait_s: Seconds = 0.0
    beyond_range: Flag = False


Span = Annotated[list[Finite], Field(min_length=2, max_length=2)] | Positive


class RangeBody(Body):
    """Expected loads: per direction a positive number (plus and minus) or ``[low, high]``."""

    force: Annotated[list[Span], Field(min_length=3, max_length=3)]
    moment: Annotated[list[Span], Field(min_length=3, max_length=3)]

    def bounds(self) -> list[list[float]]:
        """Return the low and the high end of each of the six loads, N and N·m."""
        spans = [*self.force, *self.moment]
        return [[-one, one] if isinstance(one, int | float) else list(one) for one in spans]


class FillBody(Body):
    """How thick the table shall become, where and in what, and how many solves that may cost."""

    tolerance: ToleranceBody | None = None
    budget: Annotated[int, Field(ge=1, le=10_000)] = 24
    range: RangeBody | None = None
    outputs: Annotated[list[Output], Field(min_length=1, max_length=6)] | None = None


class TableOnlyComponent(Body):
    """A component without finite elements: its table is loaded from outside."""

    name: str
    title: str
    range: RangeBody
    tolerance: ToleranceBody | None = None
