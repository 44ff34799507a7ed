"""Shared parts of the HTTP routes; each resource has its own file."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Mapping
from typing import Annotated, Any, get_origin
from urllib.parse import urlencode

import orjson
from fastapi import Depends, Query, Request, params
from fastapi.dependencies.utils import get_flat_params
from fastapi.routing import APIRoute
from pydantic import AliasChoices
from starlette.responses import Response

from wrenchbook.service.http.body import query_options
from wrenchbook.service.messages import Message
from wrenchbook.service.tables.mapped import ServedTable
from wrenchbook.service.workspace import CATCH_UP_S, Workspace


async def _workspace(request: Request) -> Workspace:
    return request.app.state.workspace


Opened = Annotated[Workspace, Depends(_workspace)]
"""A route parameter: the workspace of the server."""


WaitSeconds = Annotated[float, Query(ge=0, le=600)]


async def _newest(name: str, request: Request) -> ServedTable:
    return await request.app.state.workspace.newest(name, CATCH_UP_S)


Newest = Annotated[ServedTable, Depends(_newest)]
"""A route parameter: the component's table with all rows committed so far."""


class DirectRoute(APIRoute):
    """A call that takes the bare request: FastAPI's own reading takes 60 µs, an answer 50."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return the endpoint, called with the request and the path's parameters."""

        async def handle(request: Request) -> Response:
            return await self.endpoint(request=request, **request.path_params)

        return handle


async def check_query(request: Request) -> None:
    """Refuse unknown and repeated query parameters of a call whose parameters FastAPI reads."""
    if not request.query_params:
        return
    known, lists = list[str](), list[str]()
    for field in get_flat_params(request.scope["route"].dependant):
        info = field.field_info
        if not isinstance(info, params.Path | params.Header | params.Cookie):
            alias = info.validation_alias
            names = [*map(str, alias.choices)] if isinstance(alias, AliasChoices) else [field.alias]
            known += names
            lists += names if get_origin(info.annotation) is list else ()
    query_options(request.query_params, known, lists)


def json_reply(
    fields: dict[str, Any] | Message, status: int = 200, headers: dict[str, str] | None = None
) -> Response:
    """Return a JSON reply; numbers that are not finite become null."""
    content = orjson.dumps(fields, option=orjson.OPT_SERIALIZE_NUMPY)
    return Response(content, status, headers, "application/json")


def attached(filename: str) -> dict[str, str]:
    """Return the header of a reply that is saved as a file (RFC 6266)."""
    return {"Content-Disposition": f'attachment; filename="{filename}"'}


def cut_page(
    response: Response,
    path: str,
    query: Mapping[str, Any],
    entries: list[Any],
    limit: int,
    order: str = "id",
) -> str | None:
    """Cut entries to `limit`; return the URL of the next page, in the header Link too (RFC 8288).

    The entries are in the order of the attribute `order`. The last page has no next: None.
    """
    if len(entries) <= limit:
        return None
    del entries[limit:]
    query = {**query, "limit": limit, "after": getattr(entries[-1], order)}
    parameters = {
        name: "true" if value is True else value for name, value in query.items() if value
    }
    url = f"{path}?{urlencode(parameters)}"
    response.headers["Link"] = f'<{url}>; rel="next"'
    return url


def naming(tag: str) -> dict[str, str]:
    """Return the headers of a version: its entity tag, and that caches revalidate it."""
    return {"ETag": tag, "Cache-Control": "no-cache"}


def holds(if_none_match: str | None, tag: str) -> bool:
    """Return whether the caller has this version (RFC 9110, section 13.1.2)."""
    tags = [tag.strip().removeprefix("W/") for tag in (if_none_match or "").split(",")]
    return tag in tags or "*" in tags
