"""FastAPI, with a straight way for the main call.

A simulator asks it a thousand times a second. Middleware, routing and dependencies of the framework
cost several times what an answer does, so the call is told by its path before any of them; its
route is there all the same, for the OpenAPI document and for servers mounted below a path.
"""

from __future__ import annotations

from fastapi import FastAPI
from starlette.requests import ClientDisconnect
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from service.http.limited import read_limited
from service.http.problems import crash_of, problem_of
from service.http.routes.displacement import reply_to

_BEFORE, _AFTER = "/v1/components/", "/displacement"


class Application(FastAPI):
    """The web application; the main call goes past the framework."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or run the lifespan."""
        name = _asked_component(scope)
        if name is None:
            await super().__call__(scope, receive, send)
            return
        response, crash = await self._answered(scope, receive, name)
        if response is not None:
            await response(scope, receive, send)
        if crash is not None:
            raise crash  # to the server's log

    async def _answered(
        self, scope: Scope, receive: Receive, name: str
    ) -> tuple[Response | None, Exception | None]:
        """Return the answer to the main call, and the mistake of ours that it is, if it is one."""
        try:
            body = await read_limited(receive)
            return await reply_to(self.state.workspace, name, body), None
        except ClientDisconnect:
            return None, None
        except Exception as error:
            try:
                return problem_of(error).response(), None
            except Exception as unknown:
                return crash_of(scope["method"], scope["path"]).response(), unknown


def _asked_component(scope: Scope) -> str | None:
    """Return the component that a main call is about; None for any other request."""
    if scope["type"] != "http" or scope["method"] != "POST":
        return None
    path: str = scope["path"]
    if not (path.startswith(_BEFORE) and path.endswith(_AFTER)):
        return None
    name = path[len(_BEFORE) : -len(_AFTER)]
    return None if not name or "/" in name else name
