"""Keep-alive HTTP on the standard library: a small pool of connections, used by any thread."""

from __future__ import annotations

import http.client
import json
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from email.message import Message
from typing import Any, Self
from urllib.parse import urlencode, urlsplit

from .answer_bytes import Received, receive
from .errors import ProblemError, ServerTimeout, ServerUnreachable

_JSON = {"Content-Type": "application/json", "Accept": "application/json"}
# What an http.client call raises when the other side has closed a kept connection.
_CLOSED = (http.client.RemoteDisconnected, ConnectionError, http.client.BadStatusLine)
_ONE_WRITE = 65_536  # bytes that are worth copying to be sent at once: any question but a batch
# Method, target, body, headers, and the seconds it may take.
_Request = tuple[str, str, bytes | None, dict[str, str], float]


class Reply:
    """Status, body and headers of an answer that is no problem."""

    __slots__ = ("_received",)

    def __init__(self, received: Received) -> None:
        self._received = received

    @property
    def status(self) -> int:
        """The status, below 400."""
        return self._received.status

    @property
    def content(self) -> bytes:
        """The body."""
        return self._received.content

    @property
    def headers(self) -> Message:
        """The header fields."""
        return self._received.headers

    def json(self) -> Any:
        """Return the body as JSON."""
        return json.loads(self._received.content)


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
    key : str, optional
        What the server was told to let in; the variable WRENCHBOOK_KEY if not given.
    """

    def __init__(
        self, url: str = "http://127.0.0.1:8000", timeout: float = 30.0, key: str | None = None
    ) -> None:
        parts = urlsplit(url if "://" in url else f"http://{url}")
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise ValueError(f"{url!r} is no address of a server; write http://127.0.0.1:8000")
        self.url = f"{parts.scheme}://{parts.netloc}{parts.path.rstrip('/')}"
        self.timeout = timeout
        self._key = _checked_key(os.environ.get("WRENCHBOOK_KEY") if key is None else key)
        self._path = parts.path.rstrip("/")
        self._host, self._port = parts.hostname, parts.port
        https = parts.scheme == "https"
        self._kind = http.client.HTTPSConnection if https else http.client.HTTPConnection
        shown = f"[{parts.hostname}]" if ":" in parts.hostname else parts.hostname
        default = self._kind.default_port
        self._shown = shown if parts.port in (None, default) else f"{shown}:{parts.port}"
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

    @contextmanager
    def stream(
        self, path: str, *, query: dict[str, Any], headers: dict[str, str], timeout: float
    ) -> Iterator[http.client.HTTPResponse]:
        """Give the answer to a GET that is read line by line, on a connection of its own.

        Parameters
        ----------
        timeout : float
            Seconds without a byte before TimeoutError.

        Raises
        ------
        ProblemError
            If the server refuses.
        ServerUnreachable
            If nothing answers at the address.
        """
        connection = self._kind(self._host, self._port, timeout=timeout)
        try:
            try:
                own = {"Authorization": f"Bearer {self._key}"} if self._key else {}
                target = self._path + path + _query(query)
                connection.request("GET", target, headers=headers | own)
                response = connection.getresponse()
            except ConnectionError as error:
                raise ServerUnreachable(
                    f"no answer from {self.url} ({error}); start a server with: wrenchbook serve"
                ) from error
            if response.status >= 400:
                refused = Received(response.status, response.read(), reason=response.reason)
                refused.headers = response.headers
                raise _problem(refused)
            yield response
        finally:
            connection.close()

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
        head = self._head(method, target, content, headers)
        try:
            connection.timeout = timeout
            if connection.sock is None:
                connection.connect()
            sock = connection.sock
            assert sock is not None
            sock.settimeout(timeout)
            _send(sock, head, content or b"")
            received = receive(sock, method)
        except TimeoutError as error:
            connection.close()
            raise ServerTimeout(
                f"{self.url} has not answered within {timeout:g} s; what it has accepted it goes "
                "on with: ask again, or make the client with a longer timeout"
            ) from error
        except BaseException:
            connection.close()
            raise
        if received.will_close:
            connection.close()
        else:
            self._idle.append(connection)
        if received.status >= 400:
            raise _problem(received)
        return Reply(received)

    def _head(self, method: str, target: str, content: bytes | None, fields: dict[str, str]) -> str:
        """Lay out a request's head.

        Raises
        ------
        ValueError
            If something in it would end a line.
        """
        lines = [f"{method} {target} HTTP/1.1", f"Host: {self._shown}", "Accept-Encoding: identity"]
        if content is not None or method != "GET":
            lines.append(f"Content-Length: {len(content or b'')}")
        if self._key:
            lines.append(f"Authorization: Bearer {self._key}")
        lines += [f"{name}: {value}" for name, value in fields.items()]
        if not "".join(lines).isprintable():
            raise ValueError(f"a request's head is of printable characters alone, not {fields}")
        return "\r\n".join([*lines, "", ""])


def _checked_key(key: str | None) -> str | None:
    """Return a key without the blanks around it; None for an empty one.

    Raises
    ------
    ValueError
        If it is none that a header can hold; what it is is not told.
    """
    key = (key or "").strip()
    if not key:
        return None
    if not (key.isascii() and key.isprintable()) or " " in key:
        raise ValueError("the key holds blanks or characters that no key has; copy it again")
    return key


def _send(sock: socket.socket, head: str, content: bytes) -> None:
    """Send a small request whole: one packet, one waking of the server."""
    start = head.encode("latin-1")
    if len(content) <= _ONE_WRITE:
        sock.sendall(start + content)
    else:
        sock.sendall(start)
        sock.sendall(content)


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


def _problem(received: Received) -> ProblemError:
    """Read an answer of status 400 or more, whoever on the way wrote it."""
    status, reason, content = received.status, received.reason, received.content
    kind = received.headers.get_content_type()
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
