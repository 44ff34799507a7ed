"""The OpenAPI document: what FastAPI knows of each call, and what `calls` adds."""

from __future__ import annotations

import re
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from service.http.call import REFUSALS, Call
from service.http.calls import CALLS
from service.http.problems import MEDIA_TYPE
from service.http.schemas import PROBLEM

_PROBLEM_CONTENT = {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}}
_METHODS = ("get", "post", "put", "patch", "delete")


def install(app: FastAPI) -> None:
    """Make ``/openapi.json`` say all that calls take and answer."""
    made: dict[bool, dict[str, Any]] = {}

    def document() -> dict[str, Any]:
        keys = app.state.door.keys_needed
        if keys not in made:
            made[keys] = _document(app, keys=keys)
        return made[keys]

    app.openapi = document


def _document(app: FastAPI, *, keys: bool) -> dict[str, Any]:
    found = get_openapi(
        title=app.title,
        version=app.version,
        summary=app.summary,
        description=app.description,
        routes=app.routes,
    )
    schemas = found.setdefault("components", {}).setdefault("schemas", {})
    schemas["Problem"] = PROBLEM
    if keys:
        found["components"]["securitySchemes"] = {"key": {"type": "http", "scheme": "bearer"}}
        found["security"] = [{"key": []}]
    for path, operations in found["paths"].items():
        for method in operations.keys() & set(_METHODS):
            call = CALLS.get((method, path)) or _usual(path, operations[method])
            _complete(path, operations[method], call, keys)
    for validation in ("HTTPValidationError", "ValidationError"):
        schemas.pop(validation, None)  # mistakes are problems here
    return found


def _usual(path: str, operation: dict[str, Any]) -> Call:
    """Return what a call that `CALLS` does not name answers: what calls of its form do."""
    told = [int(code) for code in operation["responses"] if code.isdigit()]
    refusals = (404, 422) if "{" in path else (422,)
    return Call({}, (*refusals, *(code for code in told if code in REFUSALS)))


def _complete(path: str, operation: dict[str, Any], call: Call, keys: bool) -> None:
    """Add to an operation what it does not say by itself."""
    told = operation["responses"]
    operation["responses"] = _answers(told, call) | {
        str(status): _refusal(told.get(str(status), {}), status)
        for status in call.all_refusals(keys=keys)
    }
    if call.bodies and "requestBody" not in operation:
        content = {kind: {"schema": schema} for kind, schema in call.bodies.items()}
        operation["requestBody"] = {"required": True, "content": content}
    parameters = operation.get("parameters", []) + list(call.parameters)
    named = {one["name"] for one in parameters}
    parameters += [
        {"name": name, "in": "path", "required": True, "schema": {"type": "string"}}
        for name in re.findall(r"{(\w+)}", path)
        if name not in named
    ]
    if parameters:
        operation["parameters"] = parameters


def _refusal(told: dict[str, Any], status: int) -> dict[str, Any]:
    """Return a problem with what the route says of it, or what all calls mean by it."""
    described = told.get("content", {}).keys() <= {MEDIA_TYPE} and told.get("description")
    return {"description": described or REFUSALS[status], "content": _PROBLEM_CONTENT}


def _answers(told: dict[str, Any], call: Call) -> dict[str, Any]:
    """Return the answers that are not problems; FastAPI's own where the call says nothing."""
    if not call.answers:
        return {status: one for status, one in told.items() if status[0] in "23"}
    content = {kind: {"schema": schema} for kind, schema in call.replies.items()}
    plain: dict[str, Any] = {"application/json": {}}
    return {
        str(status): {
            "description": text,
            "content": content or told.get(str(status), {}).get("content", plain),
        }
        for status, text in call.answers.items()
    }
