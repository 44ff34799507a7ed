"""Declarations of routes for the OpenAPI document, and the document itself at `/openapi.json`.

The descriptions of fields, parameters and calls are in openapi.toml.
"""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import orjson
from fastapi import APIRouter, FastAPI
from fastapi.openapi.utils import get_openapi
from fastapi.routing import APIRoute
from pydantic import TypeAdapter
from starlette.requests import Request
from starlette.responses import Response

from wrenchbook.service.contract import CONTRACT_MARKDOWN
from wrenchbook.service.http.problems import MEDIA_TYPE
from wrenchbook.service.http.routes import holds, naming
from wrenchbook.service.messages import Problem

Schema = dict[str, Any]
Responses = dict[int | str, dict[str, Any]]

JSON: Final = "application/json"
BYTES: Final[Schema] = {"schema": {"type": "string", "format": "binary"}}
TEXT: Final[Schema] = {"schema": {"type": "string"}}
_PROBLEM: Final = {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}}
_KEY_STATUSES: Final = (401, 413, 429)  # refusals of any call of a server with keys
_BODY_STATUSES: Final = (413, 415)  # refusals of any call with a body
_REFERENCE: Final = "#/components/schemas/{model}"
_TOML: Final = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))
BODIES: Final[dict[str, str]] = _TOML["bodies"]
TEXTS: Final[dict[str, dict[str, str]]] = {
    **{name: _TOML[name] for name in ("fields", "parameters")},
    **{f"schemas.{name}": texts for name, texts in _TOML["schemas"].items()},
    **{f"calls.{name}": texts for name, texts in _TOML["calls"].items()},
}
_body_types: dict[str, Any] = {"Problem": Problem}  # by name; `takes` adds those of its calls
_DEFAULT: Final = "Successful Response"  # FastAPI's description of a reply
_OWN_ERRORS: Final = "/umbridge/"  # a protocol with its own form of errors

# Options of the application, and of the router of its calls.
OPTIONS: Final[dict[str, Any]] = {
    "openapi_url": None,  # `install` serves it with an ETag
    # service/http/routes/page.py has the documentation without another host's files.
    "docs_url": None,
    "redoc_url": None,
}
ROUTER_OPTIONS: Final[dict[str, Any]] = {
    "strict_content_type": False,  # programs may leave it out, see `access`
    # Generated clients name a call after its function; the calls of UM-Bridge begin with its name,
    # since it has an `info` and a `gradient` too.
    "generate_unique_id_function": lambda route: (
        f"umbridge_{route.name}" if "umbridge" in route.tags else route.name
    ),
}


def answers(model: Any, description: str, status: int = 200, **more: Any) -> Responses:
    """Return FastAPI's `responses` of one status with a JSON body."""
    return {status: {"model": model, "description": description, **more}}


def refused(*statuses: int, **texts: str) -> Responses:
    """Return FastAPI's `responses` of problems; `s409="..."` replaces a status's description."""
    described = {status: _TOML["refusals"][str(status)] for status in statuses}
    described |= {int(name[1:]): text for name, text in texts.items()}
    return {
        status: {"description": text, "content": _PROBLEM} for status, text in described.items()
    }


def component_router(
    tag: str, path: str = "", codes: Sequence[int] = (404, 422), route: type[APIRoute] = APIRoute
) -> APIRouter:
    """Return a router of calls of a component, whose paths begin with its name."""
    prefix = "/v1/components/{name}" + path
    return APIRouter(prefix=prefix, tags=[tag], responses=refused(*codes), route_class=route)


def takes(body: Any, more: Mapping[str, Any] | None = None, query: Any = None) -> Schema:
    """Return FastAPI's `openapi_extra` of a call that reads its body, and its `query`, itself.

    `more`: OpenAPI's description of further content types.
    """
    _body_types[body.__name__] = body  # the document has its schema by its name
    schema = {"$ref": _REFERENCE.format(model=body.__name__)}
    content = {JSON: {"schema": schema}, **(more or {})}
    extra: Schema = {"requestBody": {"required": True, "content": content}}
    if query is not None:
        fields = TypeAdapter(query).json_schema()["properties"].items()
        extra["parameters"] = [{"name": k, "in": "query", "schema": v} for k, v in fields]
    return extra


def install(app: FastAPI) -> None:
    """Serve the document, with one cached form with keys and one without."""
    documents: dict[tuple[bool, str], tuple[bytes, str]] = {}  # bytes and entity tag

    def serve(request: Request) -> Response:
        form = app.state.access.keys_needed, request.scope.get("root_path", "")
        if form not in documents:
            content = orjson.dumps(_document(app, *form))
            documents[form] = content, f'"{hashlib.blake2b(content, digest_size=12).hexdigest()}"'
        content, tag = documents[form]
        if holds(request.headers.get("if-none-match"), tag):
            return Response(None, 304, naming(tag))
        return Response(content, 200, naming(tag), JSON)

    app.openapi = lambda: _document(app, app.state.access.keys_needed, "")
    app.add_route("/openapi.json", serve, include_in_schema=False)


def _document(app: FastAPI, with_keys: bool, root_path: str) -> dict[str, Any]:
    """Return FastAPI's document with the refusals that depend on keys and on bodies."""
    document = get_openapi(
        title=app.title,
        version=app.version,
        summary=app.summary,
        description=app.description,
        servers=[{"url": root_path}] if root_path else None,
        routes=app.routes,
    )
    components = document["components"]
    bodies: list[Any] = [(name, "validation", TypeAdapter(t)) for name, t in _body_types.items()]
    _, schemas = TypeAdapter.json_schemas(bodies, ref_template=_REFERENCE)
    components["schemas"] |= schemas["$defs"]
    if with_keys:
        components["securitySchemes"] = {"key": {"type": "http", "scheme": "bearer"}}
        document["security"] = [{"key": []}]
    for path, operations in document["paths"].items():
        for operation in operations.values():
            if "description" in operation:  # the docstring of the call
                operation["summary"] = operation.pop("description").removesuffix(".")
            if path.startswith(_OWN_ERRORS):
                continue
            statuses: tuple[int, ...] = _KEY_STATUSES if with_keys else ()
            statuses += _BODY_STATUSES if "requestBody" in operation else ()
            refusals = {str(status): text for status, text in refused(*statuses).items()}
            operation["responses"] = refusals | operation["responses"]
    for item, key, *tables in places(document):
        text = next((TEXTS[name][key] for name in tables if key in TEXTS.get(name, ())), None)
        if text is not None:
            item["description"] = text.replace("{contract}", CONTRACT_MARKDOWN)
    return document


def places(document: dict[str, Any]) -> Iterator[tuple[Any, ...]]:
    """Yield each part of a document with the key of its text and the tables that may have it."""
    for name, schema in document["components"]["schemas"].items():
        yield schema, "*", f"schemas.{name}"
        for field, item in schema.get("properties", {}).items():
            yield item, field, f"schemas.{name}", "fields"
    for operations in document["paths"].values():
        for operation in operations.values():
            call = f"calls.{operation['operationId']}"
            yield operation, "text", call
            for item in operation.get("parameters", ()):
                yield item, item["name"], call, "parameters"
            for reply in operation["responses"].values():
                # FastAPI's default text, or its replacement.
                if reply["description"] in (_DEFAULT, TEXTS.get(call, {}).get("reply")):
                    yield reply, "reply", call
