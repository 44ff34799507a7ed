"""Types of the replies, for the OpenAPI document alone: no reply is validated when it is sent.

Any key may be left out of a reply, but for the required ones of `Problem`. All quantities are SI.
"""

from __future__ import annotations

from typing import (
    Annotated,
    Any,
    Literal,
    NotRequired,  # pydantic needs these before Python 3.12
)

from pydantic import Field
from typing_extensions import TypedDict

from wrenchbook.service.contract import CONTRACT, Coverage
from wrenchbook.service.messages import JobLink, JobStatus, Part


def text(description: str) -> Any:
    """Return the description of a field."""
    return Field(description=description)


Three = Annotated[list[float | None], Field(min_length=3, max_length=3)]
Six = Annotated[list[float | None], Field(min_length=6, max_length=6)]
Matrix = Annotated[list[Six], Field(min_length=6, max_length=6)]
Slopes = Annotated[
    Matrix | None,
    text("du/dw, a line an output, m and rad over N and N·m; null where it is not known"),
]
_WITHIN = (
    "whether the whole bar is within the tolerance, the request's or else the component's own. "
    "coverage compares the interpolation error alone, which more rows lower: covered and false "
    "means that the solver's own error is over the tolerance, and the component's warnings say "
    "what to do. null where there is no tolerance or no bar, or the solver's own error is not known"
)
_VERSION = (
    "the version of the table that answers; where source is fea the answer is that of row, which "
    "may be newer than this version"
)


class Mistake(TypedDict):
    loc: str
    msg: str


class Problem(TypedDict):
    """RFC 9457; further members give details."""

    type: Annotated[str, text("urn:wrenchbook:problem:...")]
    title: str
    status: int
    detail: Annotated[str, text("what is wrong and what to do")]
    errors: NotRequired[list[Mistake]]
    request_id: NotRequired[Annotated[str, text("of a 5xx: as in the server's log")]]


class WrenchJob(TypedDict, total=False):
    index: Annotated[int, text("number of the wrench, from 0")]
    id: Annotated[int | None, text("null: no solve is queued")]
    status: JobStatus | None
    url: str | None
    reason: Annotated[Literal["beyond-range", "queue-limit"], text("why none is queued")]


class Displacement(TypedDict, total=False):
    component: str
    translation: Annotated[Three | None, text("m")]
    rotation: Annotated[Three | None, text("rotation vector, rad")]
    error: Annotated[dict[Part, Three] | None, text("estimated 95 % error bars, m and rad")]
    coverage: Coverage
    within_tolerance: Annotated[bool | None, text(_WITHIN)]
    source: Annotated[str | None, text("table, or of the row that answers: fea, measured")]
    method: str | None
    table_version: Annotated[int, text(_VERSION)]
    elapsed_us: Annotated[float, text("time spent on the answer, µs")]
    reason: Annotated[str, text("why not covered, why no solve is queued")]
    row: Annotated[int, text("the row of the solve, in the ledger and in the table's exports")]
    notes: Annotated[list[str], text("of the solver: doubtful cells, ill conditioning")]
    missing: Annotated[list[str], text("the outputs that no row of the table holds")]
    job: JobLink | None
    axes: Annotated[list[dict[str, Any]], text("with detail; empty if a row of the table answers")]
    method_detail: Annotated[str, text("with detail: how the method answers")]
    error_parts: Annotated[
        dict[Literal["table", "mesh", "linearity", "measurement"], dict[Part, Three] | None],
        text(
            "with detail: the parts of error. table: what more rows lower; mesh: what a finer "
            "mesh lowers; linearity: what a linear component leaves out; measurement: hysteresis "
            "and drift of the measured rows. null where not known"
        ),
    ]
    error_of_a_reading: Annotated[
        dict[Part, Three],
        text("with detail, of measured rows: the 95 % error bar of one more reading, m and rad"),
    ]
    derivative: Slopes


class Displacements(TypedDict, total=False):
    component: str
    displacements: Annotated[list[Six], text("m and rad")]
    errors: Annotated[list[Six], text("95 % error bars, m and rad")]
    coverage: list[Coverage]
    within_tolerance: Annotated[
        list[bool | None], text(f"{_WITHIN}; left out where there is no tolerance")
    ]
    derivatives: list[Slopes]
    method: str
    jobs: Annotated[list[WrenchJob], text("one a wrench not covered; several may share a job")]
    table_version: int
    elapsed_us: Annotated[float, text("time spent on the answers, µs")]


Displacement.__doc__ = Displacements.__doc__ = " ".join(
    f"{word}: {meaning}." for word, meaning in CONTRACT.items()
)


class Compliance(TypedDict, total=False):
    component: str
    table_version: int
    tangent: Annotated[Slopes, text("du/dw at zero load, as derivative is")]
    tangent_origin: Annotated[
        str,
        text("row: that of the row at zero load; none: not known; else the interpolating method"),
    ]
    matrix: Annotated[
        Matrix,
        text(
            "the mean over the load range: the fit of one 6x6 to all rows; of a linear component "
            "its compliance. Zero for loads without rows, see known_loads"
        ),
    ]
    offset: Annotated[
        Six, text("added to matrix times inputs: own weight, a reference that is not 0")
    ]
    origin: Annotated[Literal["stored", "fitted", "none"], text("of matrix")]
    known_loads: list[str]
    error: Annotated[Six, text("95 % error bar of matrix at the rows, m and rad")]
    rows: list[str]
    columns: list[str]
    rows_checked: int
    ok: bool | None
    checks: Annotated[dict[str, Any], text("by name: ok, and what was found")]
