"""What each call takes and which statuses it can answer, for the OpenAPI document."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from service.http import binary
from service.http.bodies import BatchBody, DisplacementBody, FillBody, SolveBody, TableOnlyComponent
from service.http.schemas import (
    BYTES,
    CANCELLED,
    DISPLACEMENT,
    DISPLACEMENTS,
    JOBS,
    OBJECT,
    TEXT,
    Schema,
    body_of,
)

JSON: Final = "application/json"
REFUSALS: Final[dict[int, str]] = {
    404: "there is no such component, job or row",
    409: "it cannot be done as things are; the detail says why",
    413: "the body is too large",
    415: "a content type that this call does not take",
    422: "the request has mistakes; nothing was changed",
    424: "the solve of this wrench failed",
    500: "the server made a mistake; its log has the traceback",
    503: "the ledger cannot be read or written now; nothing was changed",
}
_ALWAYS: Final = (500, 503)  # what any call may come to that asks the ledger


@dataclass(frozen=True)
class Call:
    """One call.

    Attributes
    ----------
    answers : mapping of int to str
        What each status means that is not a problem.
    refusals : tuple of int
        The statuses that are problems, keys of `REFUSALS`.
    always : tuple of int
        Those of them that need no naming: 500 and 503.
    replies : mapping of str to schema
        What success answers, by content type; what FastAPI says of it if empty.
    bodies : mapping of str to schema
        What it takes, by content type.
    parameters : tuple of dict
        Query parameters that the call reads by hand.
    """

    answers: Mapping[int, str]
    refusals: tuple[int, ...] = ()
    replies: Mapping[str, Schema] = field(default_factory=dict)
    bodies: Mapping[str, Schema] = field(default_factory=dict)
    parameters: tuple[dict[str, Any], ...] = ()
    always: tuple[int, ...] = _ALWAYS

    @property
    def all_refusals(self) -> tuple[int, ...]:
        """All statuses that are problems, in order."""
        return tuple(sorted({*self.refusals, *self.always}))


_OF_A_COMPONENT = (404, 422)
_OF_A_JOB = (404, 409, 422)
_SOLVED = {200: "covered, solved or estimated", 202: "not solved yet: job tells, or reason"}
_BUNDLE: Final[Schema] = {
    "type": "object",
    "required": ["bundle"],
    "properties": {"bundle": {**BYTES, "description": "a zip of the bundle's folder"}},
}

CALLS: Final[dict[tuple[str, str], Call]] = {
    ("post", "/v1/components/{name}/displacement"): Call(
        _SOLVED, (404, 409, 413, 422, 424), {JSON: DISPLACEMENT}, {JSON: body_of(DisplacementBody)}
    ),
    ("post", "/v1/components/{name}/displacements"): Call(
        _SOLVED,
        (404, 409, 413, 422),
        {JSON: DISPLACEMENTS, binary.MEDIA_TYPE: binary.REPLY},
        {JSON: body_of(BatchBody), binary.MEDIA_TYPE: binary.BODY},
        binary.PARAMETERS,
    ),
    ("post", "/v1/components/{name}/solve"): Call(
        {200: "solved", 202: "not solved yet: job tells"},
        (404, 409, 413, 422, 424),
        {JSON: DISPLACEMENT},
        {JSON: body_of(SolveBody)},
    ),
    ("post", "/v1/components/{name}/fill"): Call(
        {200: "the table is as thick as asked", 202: "solves are queued"},
        (404, 409, 413, 422),
        {JSON: JOBS},
        {JSON: body_of(FillBody)},
    ),
    ("get", "/v1/components"): Call({200: "the library"}),
    ("post", "/v1/components"): Call(
        {201: "added"},
        (409, 413, 415, 422),
        {JSON: OBJECT},
        {"multipart/form-data": _BUNDLE, JSON: body_of(TableOnlyComponent)},
    ),
    ("get", "/v1/components/{name}"): Call({200: "the component"}, _OF_A_COMPONENT),
    ("get", "/v1/components/{name}/coverage"): Call(
        {200: "hull and gaps"}, _OF_A_COMPONENT, {JSON: OBJECT}
    ),
    ("get", "/v1/components/{name}/compliance"): Call(
        {200: "the 6x6 and its checks"}, _OF_A_COMPONENT, {JSON: OBJECT}
    ),
    ("get", "/v1/components/{name}/report"): Call(
        {200: "the latest report", 202: "the first one is being made"},
        _OF_A_COMPONENT,
        {JSON: OBJECT, "text/markdown": TEXT, "text/html": TEXT},
    ),
    ("post", "/v1/components/{name}/report"): Call(
        {200: "made already", 202: "being made"}, (404, 409, 422), {JSON: OBJECT}
    ),
    ("get", "/v1/jobs"): Call({200: "jobs, newest first"}, (422,)),
    ("delete", "/v1/jobs"): Call({200: "how many"}, (404, 422), {JSON: CANCELLED}),
    ("get", "/v1/jobs/{job_id}"): Call({200: "the job"}, (404, 422)),
    ("delete", "/v1/jobs/{job_id}"): Call({200: "cancelled"}, _OF_A_JOB),
    ("post", "/v1/jobs/{job_id}/retry"): Call({200: "waiting again"}, _OF_A_JOB),
    ("get", "/v1/jobs/{job_id}/files"): Call(
        {200: "the attempt's folder"}, (404, 422), {"application/zip": BYTES}
    ),
    ("get", "/health/live"): Call({200: "the process answers"}, always=(500,)),
    ("get", "/health/ready"): Call(
        {200: "ready", 503: "not ready; the faults tell why"}, (), {JSON: OBJECT}, always=(500,)
    ),
}
