"""Request ids, request metrics and the access log of the web application."""

from __future__ import annotations

import asyncio
import logging
import re
import secrets
from collections.abc import Iterable
from time import perf_counter
from typing import Final

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from wrenchbook.service.http.access import sending
from wrenchbook.service.http.problems import CLIENT_GONE, HttpProblemError
from wrenchbook.service.ops.counts import Counts
from wrenchbook.service.ops.logs import REQUEST_ID

log = logging.getLogger(__name__)
access_log = logging.getLogger("wrenchbook.access")

HEADER: Final = b"x-request-id"
NO_ROUTE: Final = "none"  # no call of the API, or refused before the router
_ID: Final = re.compile(rb"[\x21-\x7e]{1,128}")
_METHODS: Final = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})
_STOPPING: Final = HttpProblemError(
    503,
    "stopping",
    "The server stops",
    "The request was not finished in the time that a server has to stop. Send it again in a few "
    "seconds: an import is loaded as a whole or not at all, and rows are never loaded twice.",
    headers={"Retry-After": "5"},  # s: a start takes three
)


class RequestObserver:
    """ASGI middleware: gives each request an id, counts it, and logs it on request.

    The id is the header X-Request-ID of the request (1 to 128 visible ASCII characters), else a
    random one. The reply has it, but for a displacement with status 200 to a request without the
    header: the fast path sends the same reply. `logged`: each request is a line of the access log.
    """

    def __init__(self, app: ASGIApp, counts: Counts, *, logged: bool) -> None:
        self._app, self._counts, self._logged = app, counts, logged

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass an HTTP request on."""
        started, status = perf_counter(), CLIENT_GONE
        given = id_of(scope["headers"])
        request_id = given or secrets.token_hex(8).encode()
        REQUEST_ID.set(request_id.decode())  # each request runs in a context of its own

        async def send_with_id(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                if given != b"" or status != 200 or not scope["path"].endswith("/displacement"):
                    fields = [*message.get("headers", ()), (HEADER, request_id)]
                    message = {**message, "headers": fields}
            await send(message)

        try:
            await self._app(scope, receive, send_with_id)
        except asyncio.CancelledError:  # see `Server.shutdown`
            if status == CLIENT_GONE:
                answer = sending(send_with_id, scope["path"], None)
                await _STOPPING.response()(scope, receive, answer)
        finally:
            seconds, method = perf_counter() - started, scope["method"]
            # The template of the route, such as ``/v1/jobs/{job_id}``; no words of the caller.
            route = getattr(scope.get("route"), "path", NO_ROUTE)
            known = method if method in _METHODS else "other"
            self._counts.add_request(route, known, status, seconds)
            if self._logged:
                host = (scope.get("client") or ("-",))[0]
                query = scope["query_string"].decode("latin-1")
                # The path as it was sent: a decoded one may hold a line end.
                target = scope["raw_path"].decode("latin-1").partition("?")[0]
                target += "?" + query if query else ""
                access_log.info(
                    '%s "%s %s" %d %.1f ms', host, method, target, status, 1e3 * seconds
                )


def id_of(headers: Iterable[tuple[bytes, bytes]]) -> bytes | None:
    """Return the id that a request has: empty without the header, None if it is not valid."""
    given = next((value for name, value in headers if name == HEADER), b"")
    return given if not given or _ID.fullmatch(given) else None
