"""Keep-alive HTTP on the standard library: a small pool of connections, used by any thread."""

from __future__ import annotations

import contextlib
import http.client
import json
import os
import socket
import time
from collections.abc import Iterator, Mapping
from typing import Any, Self, TypeVar
from urllib.parse import urlencode, urlsplit

from .errors import InvalidArgument, Json, ProblemError, ServerTimeout, ServerUnreachable
from .request import (
    JSON,
    Call,
    Item,
    Items,
    Listen,
    NextLine,
    Pause,
    Request,
    Step,
    json_request,
    sync_and_async,
)
from .response import Response, receive

T = TypeVar("T")

RETRY_S = 10.0  # a restart takes 2.5 s with 20 tables of 20,000 rows
BACKOFF_S = (0.1, 1.0)  # between attempts: doubled from, up to
_ONE_WRITE = 65_536  # bytes that are worth copying to be sent at once: any request but a batch
# What a call raises when the other side has closed a kept connection.
_CLOSED = (http.client.RemoteDisconnected, ConnectionError, http.client.BadStatusLine)
_JSON_FIELDS = {"Content-Type": JSON, "Accept": JSON}

_pause = time.sleep


class Transport:
    """The address of a server, and connections to it that block.

    Each request takes an idle connection or opens one, and puts it back: threads never share one,
    and a loop of calls stays on one socket. A forked child opens its own. Parameters are those of
    `Client`; InvalidArgument if the address or the key is none.
    """

    def __init__(
        self, url: str = "http://127.0.0.1:8000", timeout: float = 30.0, key: str | None = None
    ) -> None:
        parts = urlsplit(url if "://" in url else f"http://{url}")
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise InvalidArgument(f"{url!r} is no address of a server; write http://127.0.0.1:8000")
        self._path = parts.path.rstrip("/")
        self.url = f"{parts.scheme}://{parts.netloc}{self._path}"
        self.timeout, self.retry_s = timeout, RETRY_S
        key = (os.environ.get("WRENCHBOOK_KEY") if key is None else key) or ""
        self._key = key.strip()
        if not (self._key.isascii() and self._key.isprintable()) or " " in self._key:
            raise InvalidArgument(  # which does not show it
                "the key holds blanks or characters that no key has; copy it again"
            )
        https = parts.scheme == "https"
        self._kind = http.client.HTTPSConnection if https else http.client.HTTPConnection
        default = 443 if https else 80
        self._host, self._port = parts.hostname, parts.port or default
        shown = f"[{parts.hostname}]" if ":" in parts.hostname else parts.hostname
        self._shown = shown if self._port == default else f"{shown}:{self._port}"
        self._idle: list[http.client.HTTPConnection] = []
        self._process_id = os.getpid()

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
        query: Mapping[str, object] | None = None,
        headers: Mapping[str, str] | None = None,
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
    def call_json(self, method: str, path: str, body: object = None, **options: Any) -> Call[Json]:
        """Send `body` as JSON and return the answer's JSON; options as in `call`."""
        return (yield json_request(method, path, body, **options)).json()

    def blocking(self) -> Connection:
        """Return a blocking connection to the same server."""
        return Connection(self.url, self.timeout, self._key)

    def finish(self, call: Call[T]) -> T:
        """Perform the steps of a call, and return its result."""
        try:
            step = next(call)
            while True:
                try:
                    result = self.perform(step)
                except Exception as error:
                    step = call.throw(error)
                else:
                    step = call.send(result)
        except StopIteration as end:
            return end.value

    def perform(self, step: Step) -> object:
        """Send a request, listen, read a line or wait."""
        if isinstance(step, Request):
            return self._send(step)
        if isinstance(step, NextLine):
            return step.stream.readline()
        if isinstance(step, Pause):
            return _pause(step.seconds)
        return self._listen(step)

    def _send(self, request: Request) -> Response:
        """Send a request, again while the server certainly has not taken it."""
        began, attempt = time.monotonic(), 0
        while True:
            try:
                return self._send_once(request)
            except (ServerUnreachable, ProblemError) as error:
                pause = None
                if isinstance(error, ServerUnreachable):
                    if error.refused:
                        pause = min(BACKOFF_S[0] * 2**attempt, BACKOFF_S[1])
                elif error.status == 503 and request.repeatable:
                    pause = error.retry_after
                limit = min(self.timeout, self.retry_s) - (time.monotonic() - began)
                if pause is None or pause > limit or not request.retry:
                    raise
                _pause(pause)
                attempt += 1

    def _send_once(self, request: Request) -> Response:
        """Send a request on a kept connection, or on a new one if there is none or it is dead."""
        if self._process_id != os.getpid():
            # Forked: the sockets belong to the parent. Drop them without a byte on the wire.
            self._idle, self._process_id = [], os.getpid()
        if request.repeatable and (kept := _last(self._idle)) is not None:
            try:
                return self._exchange(kept, request)
            except _CLOSED:
                self._close_idle()  # the server has closed what was kept: once more on a new one
        try:
            return self._exchange(self._kind(self._host, self._port), request)
        except TimeoutError:
            raise
        except (http.client.HTTPException, OSError) as error:
            raise self._unreachable(error) from error

    def _close_idle(self) -> None:
        """Close the idle connections; those of requests on the way close after the answer."""
        idle, self._idle = self._idle, []
        while (connection := _last(idle)) is not None:
            connection.close()

    def _exchange(self, connection: http.client.HTTPConnection, request: Request) -> Response:
        """Send and receive on one connection, then keep it, or close it when anything failed."""
        fields = _JSON_FIELDS if request.kind is None else {"Content-Type": request.kind}
        fields = {**fields, **(request.headers or {})}
        content = request.content or b""
        if request.content is not None or request.method != "GET":
            fields = {"Content-Length": str(len(content)), **fields}
        head = self._head(request.method, request.path, request.query, fields)
        timeout, idle = self.timeout + (request.wait_s or 0.0), self._idle
        try:
            connection.timeout = timeout
            if connection.sock is None:
                connection.connect()
            sock = connection.sock
            assert sock is not None
            sock.settimeout(timeout)
            if len(content) <= _ONE_WRITE:  # one packet, one waking of the server
                sock.sendall(head + content)
            else:
                sock.sendall(head)
                sock.sendall(content)
            response = receive(sock, request.method)
        except TimeoutError as error:
            connection.close()
            raise ServerTimeout(
                f"{self.url} has not answered within {timeout:g} s; it goes on with what it has "
                "accepted: send the request again, or make the client with a longer timeout"
            ) from error
        except BaseException:
            connection.close()
            raise
        if response.will_close or idle is not self._idle:
            connection.close()
        else:
            idle.append(connection)
        if response.status >= 400:
            raise problem(response)
        return response

    def _listen(self, listen: Listen) -> _Lines:
        """Return the answer to a GET that is read line by line, on a connection of its own."""
        connection = self._kind(self._host, self._port, timeout=listen.timeout)
        try:
            connection.connect()
            sock = connection.sock
            assert sock is not None
            sock.sendall(self._head("GET", listen.path, listen.query, listen.headers))
            response = http.client.HTTPResponse(sock, method="GET")
            response.begin()
        except ConnectionError as error:
            raise self._unreachable(error) from error
        finally:
            connection.close()  # the response keeps the socket open
        if response.status >= 400:
            with response:
                refused = Response(response.status, response.read(), reason=response.reason)
            refused.headers = response.headers
            raise problem(refused)
        return _Lines(response, sock)

    def _head(
        self,
        method: str,
        path: str,
        query: Mapping[str, object] | None,
        fields: Mapping[str, str],
    ) -> bytes:
        """Lay out a request's head; InvalidArgument if something in it would end a line."""
        parameters = {
            key: str(value).lower() if isinstance(value, bool) else value
            for key, value in (query or {}).items()
            if value is not None
        }
        target = self._path + path
        target += f"?{urlencode(parameters, doseq=True)}" if parameters else ""
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
        why = str(error) or type(error).__name__
        text = f"no answer from {self.url} ({why}); start a server with: wrenchbook serve"
        closed = ConnectionResetError, BrokenPipeError, http.client.IncompleteRead
        if isinstance(error, closed):
            text = f"{self.url} ended the connection before its reply ({why}); try again"
        unreachable = ServerUnreachable(text)
        unreachable.refused = isinstance(error, ConnectionRefusedError)
        return unreachable


class Connection(Transport):
    """Blocking connections to one server; parameters are those of `Transport`."""

    run = Transport.finish

    def __getstate__(self) -> Mapping[str, object]:
        """Everything but the connections."""
        return vars(self) | {"_idle": []}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the idle connections; a later call opens a new one."""
        self._close_idle()

    def blocking(self) -> Connection:
        """Return this connection."""
        return self

    def iterate(self, call: Items[T]) -> Iterator[T]:
        """Perform the steps of a call that is an iterator, and yield its items."""
        try:
            step = next(call)
            while True:
                if isinstance(step, Item):
                    yield step.value
                    step = next(call)
                    continue
                try:
                    result = self.perform(step)
                except Exception as error:
                    step = call.throw(error)
                else:
                    step = call.send(result)
        except StopIteration:
            return
        finally:
            call.close()


class _Lines:
    """The lines of a response that goes on."""

    def __init__(self, response: http.client.HTTPResponse, sock: socket.socket) -> None:
        self._response, self._socket = response, sock
        self.readline = response.readline

    def close(self) -> None:
        """Close the connection; a thread that reads a line gets the end."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._response.close()


def _last(idle: list[http.client.HTTPConnection]) -> http.client.HTTPConnection | None:
    try:
        return idle.pop()
    except IndexError:
        return None


def problem(response: Response) -> ProblemError:
    """Return an answer of status 400 or more as an error, whichever program wrote it."""
    status, reason, content = response.status, response.reason, response.content
    body: Json = None
    if response.headers.get_content_type().endswith("json"):
        with contextlib.suppress(ValueError):
            body = json.loads(content)
    if isinstance(body, dict):
        errors = body.get("errors")
        errors = errors if isinstance(errors, list) else []
        listed = [error for error in errors if isinstance(error, dict)]
        title, detail = str(body.get("title") or reason), str(body.get("detail") or "")
        error = ProblemError(status, title, detail, listed, body)
    else:
        error = ProblemError(status, reason, content[:200].decode(errors="replace").strip())
    seconds = response.headers.get("Retry-After", "")
    error.retry_after = float(seconds) if seconds.isdigit() else None
    return error
