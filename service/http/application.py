"""FastAPI, with a shorter path for single displacement queries.

A simulator sends thousands a second. Middleware, routing and dependencies of the framework cost
several times what an answer does, so the call is recognised by its path before any of them; its
route is there all the same, for the OpenAPI document and for servers mounted below a path. With
`FastPathProtocol`, queries that the table alone answers do not become requests: the protocol calls
`answer_at_once`.
"""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter
from typing import Any

from fastapi import FastAPI
from starlette.requests import ClientDisconnect
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from wrenchbook.service.answering.one import answer_at_once
from wrenchbook.service.http.access import AccessControl
from wrenchbook.service.http.access.permission import PERMISSION
from wrenchbook.service.http.body import read_limited
from wrenchbook.service.http.instrumentation import MAIN_ROUTE, ROUTE
from wrenchbook.service.http.parsing import read_plain_query
from wrenchbook.service.http.problems import crash_of, problem_of
from wrenchbook.service.http.replies import plain_content
from wrenchbook.service.http.routes.displacement import QUERY, reply_to

_BEFORE, _AFTER = "/v1/components/", "/displacement"


class Application(FastAPI):
    """The web application; single displacement queries bypass the framework."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or run the lifespan."""
        if scope["type"] != "http":
            await super().__call__(scope, receive, send)
            return
        await self.state.observer(scope, receive, send)

    async def permitted(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request that the access control lets in."""
        access: AccessControl = self.state.access
        passed = await access.pass_on(scope, receive, send)
        if passed is not None:
            await self._inside(scope, *passed)

    async def _inside(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request that was let in."""
        name = None if self.state.traced else _asked_component(scope)
        if name is None:
            await super().__call__(scope, receive, send)
            return
        scope[ROUTE] = MAIN_ROUTE
        response, crash = await self._answered(scope, receive, name)
        if response is not None:
            await response(scope, receive, send)
        if crash is not None:
            raise crash  # to the server's log

    def answer_at_once(
        self, name: str, headers: Sequence[tuple[bytes, bytes]], body: bytes
    ) -> bytes | dict[str, Any]:
        """Return the JSON of a 200 to a query, or what its request's scope is to have besides.

        Any problem with the query is left to the request. The headers are as those of a scope.
        """
        started, permission, query = perf_counter(), None, None
        try:
            permission = self.state.access.admit(headers)
            query = read_plain_query(body) if permission is not None else None
            if query is not None:
                outcome = answer_at_once(self.state.workspace, name, query)
                if outcome is not None:
                    content, counts = plain_content(outcome), self.state.counts
                    counts.add(outcome.coverage, outcome.method, outcome.elapsed_us)
                    counts.add_request(MAIN_ROUTE, "POST", 200, perf_counter() - started)
                    return content
        except Exception:
            query = None  # the request meets the error again, and answers it
        return {} if permission is None else {PERMISSION: permission, QUERY: query}

    async def _answered(
        self, scope: Scope, receive: Receive, name: str
    ) -> tuple[Response | None, Exception | None]:
        """Return the answer to the main call, and the mistake of ours that it is, if it is one."""
        try:
            body = await read_limited(receive)
            return await reply_to(self.state.workspace, name, body, self.state.counts, scope), None
        except ClientDisconnect:
            return None, None
        except Exception as error:
            try:
                return problem_of(error).response(), None
            except Exception as unknown:
                return crash_of(scope["method"], scope["path"]).response(), unknown


def _asked_component(scope: Scope) -> str | None:
    """Return the component that a main call is about; None for any other request."""
    if scope["method"] != "POST":
        return None
    path: str = scope["path"]
    if not (path.startswith(_BEFORE) and path.endswith(_AFTER)):
        return None
    name = path[len(_BEFORE) : -len(_AFTER)]
    return None if not name or "/" in name else name
