"""OpenAPI descriptions of the calls whose bodies are read by hand for speed."""

from __future__ import annotations

from typing import Any, Final

from service.contract import CONTRACT
from service.http.binary import BODY, MEDIA_TYPE, PARAMETERS
from service.http.bodies import BatchQuery, Body, DisplacementQuery, FillOrder, SolveOrder

_BODIES: Final[dict[str, type[Body]]] = {
    body.__name__: body for body in (DisplacementQuery, BatchQuery, SolveOrder, FillOrder)
}
_THREE = {"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3}
_SIX = {"type": "array", "items": {"type": "number"}, "minItems": 6, "maxItems": 6}
_COVERAGE = {"enum": ["covered", "thin", "outside"]}
_JOB = {
    "type": "object",
    "properties": {
        "id": {"type": "integer"},
        "status": {"enum": ["waiting", "running", "done", "failed", "cancelled"]},
        "url": {"type": "string"},
    },
}

_REPLIES: Final[dict[str, dict[str, Any]]] = {
    "displacement": {
        "component": {"type": "string"},
        "translation": {**_THREE, "description": "m; null when nothing can be said"},
        "rotation": {**_THREE, "description": "rotation vector, rad"},
        "error": {
            "type": "object",
            "description": "estimated 95 % error bar per output, m and rad",
            "properties": {"translation": _THREE, "rotation": _THREE},
        },
        "coverage": _COVERAGE,
        "source": {"description": "table, or where the row that answers came from: fea, measured"},
        "method": {"type": "string"},
        "table_version": {"type": "integer"},
        "elapsed_us": {"type": "number", "description": "time spent on the answer, µs"},
        "reason": {"type": "string", "description": "why not covered"},
        "job": _JOB,
    },
    "displacements": {
        "displacements": {"type": "array", "items": _SIX, "description": "m and rad"},
        "errors": {"type": "array", "items": _SIX, "description": "95 % error bars, m and rad"},
        "coverage": {"type": "array", "items": _COVERAGE},
        "jobs": {
            "type": "array",
            "items": {**_JOB, "properties": {"index": {"type": "integer"}, **_JOB["properties"]}},
            "description": "one per wrench that is not covered; index is the wrench's number",
        },
        "table_version": {"type": "integer"},
        "elapsed_us": {"type": "number"},
    },
}


def body_schema(name: str) -> dict[str, Any]:
    """Return the ``openapi_extra`` of a call that reads the body ``name``."""
    schema = _BODIES[name].model_json_schema(ref_template="#/components/schemas/{model}")
    schema.update(_inlined(schema))
    schema.pop("$defs", None)
    return {"requestBody": {"required": True, "content": {"application/json": {"schema": schema}}}}


def component_call(name: str) -> dict[str, Any]:
    """Return `body_schema` with the path's parameter, for a call that reads both by hand."""
    parameter = {"name": "name", "in": "path", "required": True, "schema": {"type": "string"}}
    return {"parameters": [parameter], **body_schema(name)}


def batch_schema() -> dict[str, Any]:
    """Return the ``openapi_extra`` of the batch call, with its binary form."""
    extra = body_schema("BatchQuery")
    extra["requestBody"]["content"][MEDIA_TYPE] = BODY
    return {**extra, "parameters": PARAMETERS}


def reply_schema(name: str) -> dict[int | str, dict[str, Any]]:
    """Return the ``responses`` of a call, with the wrench contract in the schema."""
    schema = {
        "type": "object",
        "description": " ".join(f"{word}: {meaning}." for word, meaning in CONTRACT.items()),
        "properties": _REPLIES[name],
    }
    content = {"application/json": {"schema": schema}}
    problem = {"content": {"application/problem+json": {}}}
    return {
        200: {"description": "covered, solved or estimated", "content": content},
        202: {"description": "too thin: a solve is queued", "content": content},
        404: {"description": "no such component", **problem},
        409: {"description": "not covered, and no solve was asked for or possible", **problem},
        422: {"description": "the body has mistakes; nothing was changed", **problem},
        424: {"description": "the solve of this wrench failed", **problem},
    }


def _inlined(schema: dict[str, Any]) -> dict[str, Any]:
    """Put the definitions of nested bodies where they are referred to."""
    definitions = schema.get("$defs", {})

    def walk(node: Any) -> Any:
        if isinstance(node, dict):
            if "$ref" in node:
                return walk(definitions[node["$ref"].rsplit("/", 1)[-1]])
            return {key: walk(value) for key, value in node.items() if key != "$defs"}
        return [walk(item) for item in node] if isinstance(node, list) else node

    return walk(schema)
