"""Keep-alive HTTP on the standard library: a small pool of connections, used by any thread."""

from __future__ import annotations

import contextlib
import http.client
import io
import json
import os
import re
import socket
import ssl
import time
from collections.abc import Mapping
from dataclasses import dataclass
from email.message import Message
from functools import cached_property
from numbers import Real
from typing import Any, Self
from urllib.parse import quote, urlencode, urlsplit

from .errors import (
    InvalidArgument,
    Json,
    ProblemError,
    ServerTimeout,
    ServerUnreachable,
    WrenchbookError,
)

JSON = "application/json"
BINARY = "application/octet-stream"
RETRY_S = 10.0  # a restart takes 2.5 s with 20 tables of 20,000 rows
MAX_TIMEOUT_S = 1e6  # 11 days: a socket waits 2^31 ms at most, and a call's own wait is added
# Between attempts, doubled each time: a restart of 2.5 s is noticed within 1 s.
FIRST_BACKOFF_S = 0.1
MAX_BACKOFF_S = 1.0
# Of a body that is sent with its head in one packet, which wakes the server once: all but large
# batches.
_MAX_JOINED_BYTES = 65_536
_FIRST_READ_BYTES = 65_536  # of the first read: all but large batches come in one piece
_MAX_READ_BYTES = 1 << 20  # of a further read: a socket has no more at once
_MAX_SHOWN_BYTES = 200  # of an answer that is no JSON: enough for a proxy's error page
# What a call raises when the other side has closed an idle connection.
_CLOSED = (http.client.RemoteDisconnected, ConnectionError, http.client.BadStatusLine)
_BLANK_LINE = b"\r\n\r\n"
_LENGTH_FIELD = b"\r\ncontent-length:"
# Fields on the use of a connection or the coding of a body: these responses go to http.client.
_CODING_FIELDS = (b"\r\nconnection:", b"\r\ntransfer-encoding:", b"\r\ncontent-encoding:")
_SUCCESS = (b"HTTP/1.1 200 ", b"HTTP/1.1 201 ", b"HTTP/1.1 202 ")
_JSON_FIELDS = {"Content-Type": JSON, "Accept": JSON}

_pause = time.sleep


@dataclass(eq=False)
class Response:
    """A response as it was received; `will_close`: its connection is of no further use."""

    status: int
    content: bytes
    head: bytes = b""
    reason: str = ""
    will_close: bool = False

    @cached_property
    def headers(self) -> Message:
        """The header fields, parsed at their first use."""
        _, _, lines = self.head.partition(b"\r\n")
        return http.client.parse_headers(io.BytesIO(lines + _BLANK_LINE))

    def json(self) -> Json:
        """Return the body as JSON."""
        return json.loads(self.content)


def component_path(name: str, call: str = "") -> str:
    """Return the path of a component's call, or of the component itself."""
    if not isinstance(name, str):
        raise InvalidArgument(f"a component's name must be a string such as 'plate', not {name!r}")
    return f"/v1/components/{quote(name, safe='')}" + (f"/{call}" if call else "")


class Connection:
    """Blocking connections to one server.

    Each request takes an idle connection or opens one, and puts it back: threads never share one,
    and a loop of calls stays on one socket. A forked child opens its own. Parameters are those of
    `Client`; InvalidArgument if the address or the key is none.
    """

    def __init__(
        self, url: str = "http://127.0.0.1:8000", timeout: float = 30.0, key: str | None = None
    ) -> None:
        try:
            parts = urlsplit(url if "://" in url else f"http://{url}")
            port, hostname = parts.port, parts.hostname
            has_slip = "://" not in url and re.match("https?[:/]", url)  # http//host, http:/host
            if parts.scheme not in ("http", "https") or not hostname or has_slip:
                raise ValueError
            hostname.encode("idna")  # as a connection does; UnicodeError is a ValueError
        except (TypeError, ValueError):  # no text, no port, an empty label
            raise InvalidArgument(
                f"{url!r} is not the address of a server; write http:// or https://, the host and "
                "the port, such as http://127.0.0.1:8000"
            ) from None
        if not (isinstance(timeout, Real) and 0.0 < timeout <= MAX_TIMEOUT_S):
            limits = f"above 0 s and at most {MAX_TIMEOUT_S:,.0f} s"
            raise InvalidArgument(f"timeout must be {limits}, such as 10.0, not {timeout!r}")

        self._path = parts.path.rstrip("/")
        self.url = f"{parts.scheme}://{parts.netloc}{self._path}"
        self.timeout = timeout
        self.retry_s = RETRY_S

        origin = "the variable WRENCHBOOK_KEY" if key is None else "key="
        key = (os.environ.get("WRENCHBOOK_KEY") if key is None else key) or ""
        self._key = key.strip()
        if not (self._key.isascii() and self._key.isprintable()) or " " in self._key:
            raise InvalidArgument(  # which does not show it
                f"the key in {origin} contains blanks or characters other than ASCII, which no "
                "key has; copy the key again"
            )

        https = parts.scheme == "https"
        self._connection_class = (
            http.client.HTTPSConnection if https else http.client.HTTPConnection
        )
        default = 443 if https else 80
        self._host = hostname
        self._port = port or default
        shown = f"[{hostname}]" if ":" in hostname else hostname
        self._shown = shown if self._port == default else f"{shown}:{self._port}"
        self._idle: list[http.client.HTTPConnection] = []
        self._process_id = os.getpid()
        self._stream: Lines | None = None  # of the last `listen`
        self._abandoned = False

    def __repr__(self) -> str:
        key = ", key=..." if self._key else ""
        return f"{type(self).__name__}({self.url!r}, timeout={self.timeout:g}{key})"

    def __getstate__(self) -> Mapping[str, object]:
        """Everything but the connections."""
        return vars(self) | {"_idle": [], "_stream": None}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the idle connections; a later call opens a new one."""
        idle = self._idle  # those of requests on the way close after the answer
        self._idle = []
        while (connection := _pop(idle)) is not None:
            connection.close()

    def abandon(self) -> None:
        """Close for good: a call of another thread ends, its stream at once."""
        self._abandoned = True
        if (stream := self._stream) is not None:
            stream.close()
        self.close()

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
        retry: bool = True,
    ) -> Response:
        """Send one request and return its answer.

        Parameters
        ----------
        method, path : str
            The path is below the server's address, quoted.
        content : bytes, optional
            JSON unless `kind` names another content type.
        query : mapping, optional
            Parameters; those that are None are left out.
        wait_s : float, optional
            Seconds that the server may wait before it answers; adds to the timeout.
        repeatable : bool
            Whether sending the request twice does no more than once. Others are sent once, on a new
            connection: the server may have closed an idle one.
        retry : bool
            Whether a server that refuses the connection is tried again, and one that is busy (503
            with Retry-After) if `repeatable`.

        Raises
        ------
        ProblemError
            If the server refuses.
        ServerUnreachable
            If nothing answers at the address, or the server closed the connection without a reply.
        ServerTimeout
            If the answer does not come in time.
        """
        fields = _JSON_FIELDS if kind is None else {"Content-Type": kind}
        fields = {**fields, **(headers or {})}
        if content is not None or method != "GET":
            fields = {"Content-Length": str(len(content or b"")), **fields}
        head = self._head(method, path, query, fields)
        timeout = self.timeout + (wait_s or 0.0)
        began = time.monotonic()
        attempt = 0
        while True:
            try:
                return self._send(method, head, content or b"", timeout, repeatable)
            except (ServerUnreachable, ProblemError) as error:
                pause = _pause_before_retry(error, attempt, repeatable)
                remaining = min(self.timeout, self.retry_s) - (time.monotonic() - began)
                if pause is None or pause > remaining or not retry:
                    raise
                _pause(pause)
                attempt += 1

    def call_json(self, method: str, path: str, body: object = None, **options: Any) -> Json:
        """Send `body` as JSON and return the answer's JSON; options as in `call`."""
        content = None if body is None else json.dumps(body, allow_nan=False).encode()
        return self.call(method, path, content, **options).json()

    def _send(
        self, method: str, head: bytes, content: bytes, timeout: float, repeatable: bool
    ) -> Response:
        """Send a request on an idle connection, or on a new one."""
        self._require_not_abandoned()
        if self._process_id != os.getpid():
            # Forked: the sockets belong to the parent. Drop them without a byte on the wire.
            self._idle = []
            self._process_id = os.getpid()
        if repeatable and (connection := _pop(self._idle)) is not None:
            try:
                return self._exchange(connection, method, head, content, timeout)
            except _CLOSED:
                self.close()  # the server has closed the idle ones: once more on a new one
        try:
            connection = self._connection_class(self._host, self._port)
            return self._exchange(connection, method, head, content, timeout)
        except TimeoutError:
            raise
        except (http.client.HTTPException, OSError) as error:
            raise self._unreachable(error) from error

    def _exchange(
        self,
        connection: http.client.HTTPConnection,
        method: str,
        head: bytes,
        content: bytes,
        timeout: float,
    ) -> Response:
        """Send and receive on one connection, then keep it, or close it when anything failed."""
        idle = self._idle
        try:
            connection.timeout = timeout
            if connection.sock is None:
                connection.connect()
            sock = connection.sock
            assert sock is not None
            sock.settimeout(timeout)
            if len(content) <= _MAX_JOINED_BYTES:
                sock.sendall(head + content)
            else:
                sock.sendall(head)
                sock.sendall(content)
            response = receive(sock, method)
        except TimeoutError as error:
            connection.close()
            raise ServerTimeout(
                f"{self.url} has not answered within {timeout:g} s and continues with accepted "
                "work; send the request again, or create the client with a longer timeout"
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

    def _listen(
        self, path: str, query: Mapping[str, object], headers: Mapping[str, str], timeout: float
    ) -> Lines:
        """Return the answer to a GET that is read line by line, on a connection of its own.

        Reading raises TimeoutError after `timeout` seconds without a byte.
        """
        self._require_not_abandoned()
        connection = self._connection_class(self._host, self._port, timeout=timeout)
        try:
            connection.connect()
            sock = connection.sock
            assert sock is not None
            sock.sendall(self._head("GET", path, query, headers))
            response = http.client.HTTPResponse(sock, method="GET")
            response.begin()
        except TimeoutError:
            raise
        except (http.client.HTTPException, OSError) as error:
            raise self._unreachable(error) from error
        finally:
            connection.close()  # the response keeps the socket open
        if response.status >= 400:
            with response:
                refused = Response(response.status, response.read(), reason=response.reason)
            refused.headers = response.headers
            raise problem(refused)
        self._stream = Lines(response, sock)
        if self._abandoned:
            self._stream.close()
        return self._stream

    def _require_not_abandoned(self) -> None:
        if self._abandoned:
            raise WrenchbookError("the iteration was cancelled; start a new one")

    def _head(
        self, method: str, path: str, query: Mapping[str, object] | None, fields: Mapping[str, str]
    ) -> bytes:
        """Return a request's head; raises InvalidArgument for a character that is not printable."""
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
        unprintable = next((line for line in lines if not line.isprintable()), None)
        if unprintable is not None:
            raise InvalidArgument(
                "an argument puts a character that is not printable, such as a line end, into "
                f"the request's line {unprintable!r}; remove this character"
            )
        return "\r\n".join([*lines, "", ""]).encode("latin-1")

    def _unreachable(self, error: BaseException) -> ServerUnreachable:
        """Return the error of a failed connection: its cause, and what to do about that cause."""
        why = str(error) or type(error).__name__
        if isinstance(error, ConnectionResetError | BrokenPipeError | http.client.IncompleteRead):
            text = f"{self.url} closed the connection before its reply ({why}); repeat the request"
        elif isinstance(error, socket.gaierror):
            text = f"no host has the name {self._host!r} ({why}); correct the address {self.url}"
        elif isinstance(error, ssl.SSLError):
            text = (
                f"no encrypted connection to {self.url} ({why}); write http:// if the server has "
                "no TLS, otherwise name its certificate in the environment variable SSL_CERT_FILE"
            )
        elif isinstance(error, http.client.HTTPException):
            text = (
                f"the answer from {self.url} is not HTTP ({type(error).__name__}: {why}), so "
                "another program answers there; correct host and port"
            )
        else:
            text = f"no answer from {self.url} ({why}); start a server with: wrenchbook serve"
        unreachable = ServerUnreachable(text)
        unreachable.refused = isinstance(error, ConnectionRefusedError)
        return unreachable


class Lines:
    """The lines of a response that goes on."""

    def __init__(self, response: http.client.HTTPResponse, sock: socket.socket) -> None:
        self._response = response
        self._socket = sock
        self.readline = response.readline

    def close(self) -> None:
        """Close the connection; a thread that reads a line gets the end."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._response.close()


def _pause_before_retry(
    error: ServerUnreachable | ProblemError, attempt: int, repeatable: bool
) -> float | None:
    """Return the seconds until a request may be sent again after an error; None if it may not.

    A server that refuses the connection has not taken the request, one that is busy says when to
    come again. After any other error the server may have taken it.
    """
    if isinstance(error, ServerUnreachable):
        return min(FIRST_BACKOFF_S * 2**attempt, MAX_BACKOFF_S) if error.refused else None
    return error.retry_after if error.status == 503 and repeatable else None


def _pop(idle: list[http.client.HTTPConnection]) -> http.client.HTTPConnection | None:
    """Return the newest idle connection; None if another thread has taken the last one."""
    try:
        return idle.pop()
    except IndexError:
        return None


def receive(sock: socket.socket, method: str) -> Response:
    """Read the answer to a request that has been sent.

    An ordinary success is read here, others by http.client, which reads each header field into an
    e-mail message: that takes longer than the server does.

    Raises HTTPException or OSError if there is no answer, or it breaks off, or is no HTTP.
    """
    received = sock.recv(_FIRST_READ_BYTES)
    if not received:
        raise http.client.RemoteDisconnected("the server closed the connection without an answer")
    end = received.find(_BLANK_LINE)
    head = received[: max(end, 0)].lower()
    content = received[end + len(_BLANK_LINE) :]
    _, _, after = head.partition(_LENGTH_FIELD)
    length = after.partition(b"\r\n")[0].strip()

    if (
        received.startswith(_SUCCESS)
        and length.isdigit()
        and int(length) >= len(content)
        and _LENGTH_FIELD not in after
        and not any(field in head for field in _CODING_FIELDS)
    ):
        pieces = [content]
        missing = int(length) - len(content)
        while missing:
            piece = sock.recv(min(missing, _MAX_READ_BYTES))
            if not piece:
                raise http.client.IncompleteRead(b"".join(pieces), missing)
            pieces.append(piece)
            missing -= len(piece)
        return Response(int(head[9:12]), b"".join(pieces), received[:end])

    replay = _Replay(received, sock)
    unusual = http.client.HTTPResponse(replay, method=method)  # pyright: ignore
    try:
        unusual.begin()
        if replay.ended:  # http.client takes a head that breaks off as complete
            raise http.client.IncompleteRead(received)
        content = unusual.read()
        close = unusual.will_close
        response = Response(unusual.status, content, reason=unusual.reason, will_close=close)
        response.headers = unusual.headers
        return response
    finally:
        unusual.close()


class _Replay(io.RawIOBase):
    """The bytes received, then the socket's: all that http.client needs of a socket."""

    def __init__(self, received: bytes, sock: socket.socket) -> None:
        super().__init__()
        self._received = received
        self._sock = sock
        self.ended = False  # whether the server has closed the connection

    def makefile(self, _mode: str) -> io.BufferedReader:
        return io.BufferedReader(self)

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: memoryview) -> int:  # pyright: ignore
        if not self._received:
            count = self._sock.recv_into(buffer)
            self.ended = not count
            return count
        count = min(len(buffer), len(self._received))
        buffer[:count] = self._received[:count]
        self._received = self._received[count:]
        return count


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
        title = str(body.get("title") or reason)
        detail = str(body.get("detail") or "")
        error = ProblemError(status, title, detail, listed, body)
    else:
        page = content[:_MAX_SHOWN_BYTES].decode(errors="replace")
        text = " ".join(re.sub(r"<[^>]*>", " ", page).split())  # the words of a proxy's page
        if status == 413:
            text += (
                ". A proxy before the server refuses a body of this size; raise its limit to "
                "512 MB (nginx: client_max_body_size 512m), or send it in parts"
            )
        error = ProblemError(status, reason, text)
    seconds = response.headers.get("Retry-After", "")
    error.retry_after = float(seconds) if seconds.isdecimal() else None
    return error
