"""Keep-alive HTTP on the standard library: a small pool of connections, used by any thread."""

from __future__ import annotations

import http.client
import json
import os
from email.message import Message
from typing import Any, Self
from urllib.parse import urlencode, urlsplit

from .errors import ProblemError, ServerTimeout, ServerUnreachable

_JSON = {"Content-Type": "application/json", "Accept": "application/json"}
# What an http.client call raises when the other side has closed a kept connection.
_CLOSED = (http.client.RemoteDisconnected, ConnectionError, http.client.BadStatusLine)
_ONE_WRITE = 65_536  # bytes that are worth copying to be sent at once: any question but a batch
# Method, target, body, headers, and the seconds it may take.
_Request = tuple[str, str, bytes | None, dict[str, str], float]


class Reply:
    """Status, body and headers of an answer that is no problem."""

    __slots__ = ("content", "headers", "status")

    def __init__(self, status: int, content: bytes, headers: Message) -> None:
        self.status = status
        self.content = content
        self.headers = headers

    def json(self) -> Any:
        """Return the body as JSON."""
        return json.loads(self.content)


class _OneWrite:
    """A connection that sends a small request whole: one packet, one waking of the server.

    http.client sends head and body apart, and the server starts on a head that it cannot use yet.
    """

    _held: list[Any] | None = None

    def request(self, *request: Any, **more: Any) -> None:
        """Send a request, as http.client does."""
        self._held = held = []
        try:
            super().request(*request, **more)  # pyright: ignore[reportAttributeAccessIssue]
        finally:
            self._held = None
        if all(isinstance(piece, bytes) for piece in held) and sum(map(len, held)) <= _ONE_WRITE:
            held = [b"".join(held)]
        for piece in held:
            self.send(piece)

    def send(self, data: Any) -> None:
        """Send a piece, or hold it while its request is put together."""
        if self._held is None:
            super().send(data)  # pyright: ignore[reportAttributeAccessIssue]
        else:
            self._held.append(data)


class _Plain(_OneWrite, http.client.HTTPConnection):
    pass


class _Secure(_OneWrite, http.client.HTTPSConnection):
    pass


class Connection:
    """Connections to one server.

    Each call takes an idle connection or opens one, and puts it back: threads never share one, and
    a loop of calls stays on one socket. A forked child opens its own.

    Parameters
    ----------
    url : str
        Address of the server, with a path if it is served below one.
    timeout : float
        Seconds without an answer before `ServerTimeout`; the time a call asks the server to wait
        is added to it.
    """

    def __init__(self, url: str = "http://127.0.0.1:8000", timeout: float = 30.0) -> None:
        parts = urlsplit(url if "://" in url else f"http://{url}")
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise ValueError(f"{url!r} is no address of a server; write http://127.0.0.1:8000")
        self.url = f"{parts.scheme}://{parts.netloc}{parts.path.rstrip('/')}"
        self.timeout = timeout
        self._path = parts.path.rstrip("/")
        self._host, self._port = parts.hostname, parts.port
        https = parts.scheme == "https"
        self._kind = _Secure if https else _Plain
        self._idle: list[http.client.HTTPConnection] = []
        self._process_id = os.getpid()

    def __getstate__(self) -> dict[str, Any]:
        """Return what is pickled: connections stay behind."""
        return vars(self) | {"_idle": []}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the idle connections; a later call opens a new one."""
        while self._idle:
            self._idle.pop().close()

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
    ) -> Reply:
        """Send one request and return its answer.

        Parameters
        ----------
        method, path : str
            HTTP method and the path below `url`, quoted.
        content : bytes, optional
            Body; JSON unless `kind` names another content type.
        query : dict, optional
            Query parameters; those that are None are left out.
        headers : dict, optional
            Further header fields.
        wait_s : float, optional
            Seconds the server was asked to hold the answer back.
        repeatable : bool
            Whether sending the request twice does no more than once. A request that is not never
            goes to a kept connection, which may have been closed, so it is sent once.

        Raises
        ------
        ProblemError
            If the server refuses.
        ServerUnreachable
            If nothing answers at the address, or the server closed the connection without a reply.
        ServerTimeout
            If the answer does not come in time.
        """
        target = self._path + path + _query(query)
        fields = _JSON if kind is None else {"Content-Type": kind}
        if headers:
            fields = fields | headers
        request = (method, target, content, fields, self.timeout + (wait_s or 0.0))
        return self._send(request, self._take() if repeatable else None)

    def call_json(self, method: str, path: str, body: Any = None, **options: Any) -> Any:
        """Send `body` as JSON and return the answer's JSON; options as in `call`."""
        content = None if body is None else json.dumps(body, allow_nan=False).encode()
        return self.call(method, path, content, **options).json()

    def _send(self, request: _Request, kept: http.client.HTTPConnection | None) -> Reply:
        """Send a request on the kept connection, or on a new one if there is none or it is dead."""
        if kept is not None:
            try:
                return self._exchange(kept, request)
            except _CLOSED:
                self.close()  # the server has ended what was kept: once more on a new connection
        connection = self._kind(self._host, self._port)
        try:
            return self._exchange(connection, request)
        except ServerTimeout:
            raise
        except (http.client.HTTPException, OSError) as error:
            raise ServerUnreachable(
                f"no answer from {self.url} ({error or type(error).__name__}); "
                "start a server with: wrenchbook serve"
            ) from error

    def _take(self) -> http.client.HTTPConnection | None:
        if self._process_id != os.getpid():
            # Forked: the sockets belong to the parent. Let go of them without a word on the wire.
            self._idle, self._process_id = [], os.getpid()
        try:
            return self._idle.pop()
        except IndexError:
            return None

    def _exchange(self, connection: http.client.HTTPConnection, request: _Request) -> Reply:
        """Send and receive on one connection, then keep it, or close it when anything failed."""
        method, target, content, headers, timeout = request
        try:
            connection.timeout = timeout
            if connection.sock is not None:
                connection.sock.settimeout(timeout)
            connection.request(method, target, body=content, headers=headers)
            response = connection.getresponse()
            received = response.read()
        except TimeoutError as error:
            connection.close()
            raise ServerTimeout(
                f"{self.url} has not answered within {timeout:g} s; what it has accepted it goes "
                "on with: ask again, or make the client with a longer timeout"
            ) from error
        except BaseException:
            connection.close()
            raise
        if not response.will_close:
            self._idle.append(connection)
        if response.status >= 400:
            kind = response.headers.get_content_type()
            raise _problem(response.status, response.reason, kind, received)
        return Reply(response.status, received, response.headers)


def _query(query: dict[str, Any] | None) -> str:
    """Lay out the query parameters that are given."""
    if not query:
        return ""
    given = {
        key: str(value).lower() if isinstance(value, bool) else value
        for key, value in query.items()
        if value is not None
    }
    return f"?{urlencode(given)}" if given else ""


def _problem(status: int, reason: str, kind: str, content: bytes) -> ProblemError:
    """Read an answer of status 400 or more, whoever on the way wrote it."""
    body: Any = None
    if kind.endswith("json"):
        try:
            body = json.loads(content)
        except ValueError:
            body = None
    if not isinstance(body, dict):
        return ProblemError(status, reason, content[:200].decode(errors="replace").strip())
    errors = body.get("errors")
    return ProblemError(
        status,
        str(body.get("title") or reason),
        str(body.get("detail") or ""),
        [one for one in errors if isinstance(one, dict)] if isinstance(errors, list) else [],
        body,
    )
