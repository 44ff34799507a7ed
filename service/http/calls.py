"""What each call takes and which statuses it can answer, for the OpenAPI document."""

from __future__ import annotations

from typing import Final

from service.http import asked_version, binary
from service.http.bodies import (
    BatchBody,
    DisplacementBody,
    FillBody,
    SceneBody,
    SolveBody,
    TableOnlyComponent,
)
from service.http.call import JSON, Call
from service.http.event_schemas import EVENT_CALLS
from service.http.gather_schemas import GATHER_CALLS
from service.http.key_schemas import KEY_CALLS
from service.http.library_schemas import LIBRARY_CALLS
from service.http.schemas import (
    BYTES,
    CANCELLED,
    COMPLIANCE,
    DISPLACEMENT,
    DISPLACEMENTS,
    JOBS,
    OBJECT,
    PLANS,
    TEXT,
    Schema,
    body_of,
)
from service.http.umbridge_schemas import UMBRIDGE_CALLS

_GLTF: Final = "model/gltf-binary"
_VTU: Final = "application/vnd.vtk.unstructuredgrid+xml"
_OF_A_COMPONENT = (404, 422)
_OF_A_JOB = (404, 409, 422)
_SOLVED = {200: "covered, solved or estimated", 202: "not solved yet: job tells, or reason"}
_BUNDLE: Final[Schema] = {
    "type": "object",
    "required": ["bundle"],
    "properties": {"bundle": {**BYTES, "description": "a zip of the bundle's folder"}},
}

CALLS: Final[dict[tuple[str, str], Call]] = {
    **GATHER_CALLS,
    **EVENT_CALLS,
    **LIBRARY_CALLS,
    **UMBRIDGE_CALLS,
    **KEY_CALLS,
    ("post", "/v1/components/{name}/displacement"): Call(
        _SOLVED,
        (404, 409, 410, 413, 422, 424),
        {JSON: DISPLACEMENT},
        {JSON: body_of(DisplacementBody)},
        (asked_version.PARAMETER,),
    ),
    ("post", "/v1/components/{name}/displacements"): Call(
        _SOLVED,
        (404, 409, 410, 413, 422),
        {JSON: DISPLACEMENTS, binary.MEDIA_TYPE: binary.REPLY},
        {JSON: body_of(BatchBody), binary.MEDIA_TYPE: binary.BODY},
        (*binary.PARAMETERS, asked_version.PARAMETER),
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
    ("get", "/v1/components"): Call({200: "the library"}, (422,)),
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
        {200: "the 6x6 at zero load, its mean and its checks"}, _OF_A_COMPONENT, {JSON: COMPLIANCE}
    ),
    ("get", "/v1/components/{name}/deformed"): Call(
        {200: "the surface; outside the load range, or with too few rows, it is flagged"},
        _OF_A_JOB,
        {JSON: OBJECT, _GLTF: BYTES, _VTU: BYTES},
    ),
    ("get", "/v1/components/{name}/report"): Call(
        {200: "the latest report", 202: "the first one is being made"},
        _OF_A_COMPONENT,
        {JSON: OBJECT, "text/markdown": TEXT, "text/html": TEXT},
    ),
    ("post", "/v1/components/{name}/report"): Call(
        {200: "made already", 202: "being made"}, (404, 409, 422), {JSON: OBJECT}
    ),
    ("post", "/v1/scenes/plan"): Call(
        {200: "the plan of each component"},
        (404, 413, 422),
        {JSON: PLANS},
        {JSON: body_of(SceneBody)},
    ),
    ("get", "/v1/components/{name}/scene"): Call(
        {200: "what Client.download(name, scene=) reads", 304: "the sender has this version"},
        _OF_A_COMPONENT,
        {"application/x-wrenchbook-scene": BYTES},
    ),
    ("get", "/v1/jobs"): Call({200: "jobs, newest first"}, (404, 422)),
    ("delete", "/v1/jobs"): Call({200: "how many"}, (404, 422), {JSON: CANCELLED}),
    ("get", "/v1/jobs/{job_id}"): Call({200: "the job"}, (404, 422)),
    ("delete", "/v1/jobs/{job_id}"): Call({200: "cancelled"}, _OF_A_JOB),
    ("post", "/v1/jobs/{job_id}/retry"): Call({200: "waiting again"}, _OF_A_JOB),
    ("get", "/v1/jobs/{job_id}/files"): Call(
        {200: "the attempt's folder"}, (404, 422), {"application/zip": BYTES}
    ),
    ("get", "/metrics"): Call(
        {200: "metrics in Prometheus' text form"}, (), {"text/plain": TEXT}, always=(500,)
    ),
    ("get", "/health/live"): Call({200: "the process answers"}, always=(500,)),
    ("get", "/health/ready"): Call(
        {200: "ready", 503: "not ready; the faults tell why"}, (), {JSON: OBJECT}, always=(500,)
    ),
}
