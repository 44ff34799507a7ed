"""Addresses, request heads, refusals and retries: what both connections have in common."""

from __future__ import annotations

import http.client
import json
import os
import time
from typing import Any
from urllib.parse import urlencode, urlsplit

from .errors import InvalidArgument, ProblemError, ServerTimeout, ServerUnreachable
from .request import JSON, BlockingRunner, Call, Listen, Request, json_request, sync_and_async
from .response import Response

RETRY_S = 10.0  # a restart takes 2.5 s with 20 tables of 20,000 rows
BACKOFF_S = (0.1, 1.0)  # between attempts: doubled from, up to
# What a call raises when the other side has closed a kept connection.
CLOSED = (http.client.RemoteDisconnected, ConnectionError, http.client.BadStatusLine)
_JSON_FIELDS = {"Content-Type": JSON, "Accept": JSON}


class Transport:
    """The address of a server, and how requests to it are written.

    Parameters
    ----------
    url : str
        Address of the server, with a path if it is served below one.
    timeout : float
        Seconds without an answer before `ServerTimeout`; the time that the server may wait before
        it answers is added. A server that refuses the connection is tried again for as long, but
        10 s at most.
    key : str, optional
        A key of the server; the variable WRENCHBOOK_KEY if not given.

    Attributes
    ----------
    retry_s : float
        Seconds for which a server that refuses, or is busy, is tried again: 10; 0 for not at all.

    Raises
    ------
    InvalidArgument
        If the address or the key is none.
    """

    def __init__(
        self, url: str = "http://127.0.0.1:8000", timeout: float = 30.0, key: str | None = None
    ) -> None:
        parts = urlsplit(url if "://" in url else f"http://{url}")
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise InvalidArgument(f"{url!r} is no address of a server; write http://127.0.0.1:8000")
        self.url = f"{parts.scheme}://{parts.netloc}{parts.path.rstrip('/')}"
        self.timeout, self.retry_s = timeout, RETRY_S
        self._key = _checked_key(os.environ.get("WRENCHBOOK_KEY") if key is None else key)
        self._path = parts.path.rstrip("/")
        self._https = parts.scheme == "https"
        default = 443 if self._https else 80
        self._host, self._port = parts.hostname, parts.port or default
        shown = f"[{parts.hostname}]" if ":" in parts.hostname else parts.hostname
        self._shown = shown if self._port == default else f"{shown}:{self._port}"

    def __repr__(self) -> str:
        key = ", key=..." if self._key else ""
        return f"{type(self).__name__}({self.url!r}, timeout={self.timeout:g}{key})"

    @sync_and_async
    def call(
        self,
        method: str,
        path: str,
        content: bytes | None = None,
        *,
        kind: str | None = None,
        query: dict[str, Any] | None = None,
        headers: dict[str, str] | None = None,
        wait_s: float | None = None,
        repeatable: bool = True,
    ) -> Call[Response]:
        """Send one request and return its answer; parameters are those of `Request`.

        Raises
        ------
        ProblemError
            If the server refuses.
        ServerUnreachable
            If nothing answers at the address, or the server closed the connection without a reply.
        ServerTimeout
            If the answer does not come in time.
        """
        return (yield Request(method, path, content, kind, query, headers, wait_s, repeatable))

    @sync_and_async
    def call_json(self, method: str, path: str, body: Any = None, **options: Any) -> Call[Any]:
        """Send `body` as JSON and return the answer's JSON; options as in `call`."""
        return (yield json_request(method, path, body, **options)).json()

    def blocking(self) -> BlockingRunner:
        """Return a blocking connection to the same server."""
        raise NotImplementedError

    def _timeout(self, request: Request) -> float:
        return self.timeout + (request.wait_s or 0.0)

    def _written(self, request: Request) -> tuple[bytes, bytes]:
        """Return a request's head and body."""
        fields = _JSON_FIELDS if request.kind is None else {"Content-Type": request.kind}
        if request.headers:
            fields = fields | request.headers
        content = request.content
        if content is not None or request.method != "GET":
            fields = {"Content-Length": str(len(content or b"")), **fields}
        target = self._path + request.path + _query(request.query)
        return self._head(request.method, target, fields), content or b""

    def _written_listen(self, listen: Listen) -> bytes:
        """Return the head of a request whose answer is read line by line."""
        target = self._path + listen.path + _query(listen.query)
        return self._head("GET", target, listen.headers)

    def _head(self, method: str, target: str, fields: dict[str, str]) -> bytes:
        """Lay out a request's head.

        Raises
        ------
        InvalidArgument
            If something in it would end a line.
        """
        lines = [f"{method} {target} HTTP/1.1", f"Host: {self._shown}", "Accept-Encoding: identity"]
        if self._key:
            lines.append(f"Authorization: Bearer {self._key}")
        lines += [f"{name}: {value}" for name, value in fields.items()]
        if not "".join(lines).isprintable():
            raise InvalidArgument(
                f"a request's head is of printable characters alone, not {fields}"
            )
        return "\r\n".join([*lines, "", ""]).encode("latin-1")

    def _unreachable(self, error: BaseException) -> ServerUnreachable:
        found = ServerUnreachable(
            f"no answer from {self.url} ({error or type(error).__name__}); "
            "start a server with: wrenchbook serve"
        )
        # asyncio joins the errors of several addresses of a host in one without a number.
        several = type(error) is OSError and error.errno is None
        found.refused = several or isinstance(error, ConnectionRefusedError)
        return found

    def _late(self, timeout: float) -> ServerTimeout:
        return ServerTimeout(
            f"{self.url} has not answered within {timeout:g} s; it goes on with what it has "
            "accepted: send the request again, or make the client with a longer timeout"
        )

    def _pause_s(
        self, error: ServerUnreachable | ProblemError, request: Request, began: float, attempt: int
    ) -> float:
        """Return the seconds before a request is sent again.

        Raises
        ------
        ServerUnreachable, ProblemError
            The error, if the request may have been taken, or there is no time left.
        """
        if not request.retry:
            raise error
        if isinstance(error, ProblemError):
            pause = error.retry_after if error.status == 503 and request.repeatable else None
        else:
            pause = min(BACKOFF_S[0] * 2**attempt, BACKOFF_S[1]) if error.refused else None
        limit = min(self.timeout, self.retry_s)
        if pause is None or time.monotonic() - began + pause > limit:
            raise error
        return pause


def problem(response: Response) -> ProblemError:
    """Return an answer of status 400 or more as an error, whichever program wrote it."""
    status, reason, content = response.status, response.reason, response.content
    body: Any = None
    if response.headers.get_content_type().endswith("json"):
        try:
            body = json.loads(content)
        except ValueError:
            body = None
    if isinstance(body, dict):
        errors = body.get("errors")
        listed = (
            [one for one in errors if isinstance(one, dict)] if isinstance(errors, list) else []
        )
        title, detail = str(body.get("title") or reason), str(body.get("detail") or "")
        found = ProblemError(status, title, detail, listed, body)
    else:
        found = ProblemError(status, reason, content[:200].decode(errors="replace").strip())
    seconds = response.headers.get("Retry-After", "")
    found.retry_after = float(seconds) if seconds.isdigit() else None
    return found


def _checked_key(key: str | None) -> str | None:
    """Return a key without the blanks around it; None for an empty one.

    Raises
    ------
    InvalidArgument
        If a header cannot have it; the message does not show it.
    """
    key = (key or "").strip()
    if not key:
        return None
    if not (key.isascii() and key.isprintable()) or " " in key:
        raise InvalidArgument("the key holds blanks or characters that no key has; copy it again")
    return key


def _query(query: dict[str, Any] | None) -> str:
    """Lay out the query parameters that are given."""
    if not query:
        return ""
    given = {
        key: str(value).lower() if isinstance(value, bool) else value
        for key, value in query.items()
        if value is not None
    }
    return f"?{urlencode(given, doseq=True)}" if given else ""
