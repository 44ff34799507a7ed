"""HTTP/1.1 protocol of the server: uvicorn's, with timeouts and a fast path for single queries.

uvicorn makes a scope, a task and two messages of each request; that is more work than most answers
are. The fast path gives a query (`POST /v1/components/{name}/displacement`, a small body, nothing
unusual in the head) to the application's `answer_at_once` as soon as its last byte has arrived. A
request without such an answer goes to the application as any other, with what was found about it.
A loop sends the same head again and again: a head of the fast path is parsed once a connection.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Sequence, Sized
from typing import Any, Final, NamedTuple

from httptools import HttpRequestParser
from starlette.types import Receive, Scope, Send
from uvicorn.config import Config
from uvicorn.protocols.http.flow_control import FlowControl
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol
from uvicorn.server import ServerState

from wrenchbook.service.http.access.headers import PLAIN
from wrenchbook.service.http.problems import ProblemError

log = logging.getLogger(__name__)

MOST_CONNECTIONS: Final = 8192  # below the open files of a server, see `server.OPEN_FILES`
MOST_HEAD_BYTES: Final = 64 * 1024  # what proxies and other servers take, or less
HEAD_S: Final = 10.0  # for a head, from its first byte or from the connection's beginning
BODY_S: Final = 30.0  # for a body, and the time that it takes at this rate:
SLOWEST: Final = 16 * 1024  # bytes a second; a bad mobile connection has more
READ_S: Final = 60.0  # in which the caller must read some of an answer that waits
LOOK_S: Final = 5.0  # between two checks of a connection's timeouts
LAST_S: Final = 0.25  # for a last request of an idle connection when the server stops
TOO_LONG: Final = (
    b"HTTP/1.1 431 Request Header Fields Too Large\r\n"
    b"content-length: 0\r\nconnection: close\r\n\r\n"
)
_BEFORE, _AFTER = b"/v1/components/", b"/displacement"
_MOST_BODY: Final = 4096  # bytes of a query of the fast path
_MOST_HEADS: Final = 64  # of one connection: a loop's differ by component and content-length
_MOST_KNOWN_HEAD: Final = 2048  # bytes: a loop's heads have some 200
_BLANK_LINE: Final = b"\r\n\r\n"

Headers = Sequence[tuple[bytes, bytes]]
Found = dict[str, Any]
Answer = Callable[[str, Headers, bytes], bytes | Found]


class _Head(NamedTuple):
    """The head of a query of the fast path."""

    component: str
    headers: Headers
    body_bytes: int


class _Flow(FlowControl):
    """Flow control that reads no further while requests are queued."""

    def __init__(self, transport: asyncio.Transport, queue: Sized) -> None:
        super().__init__(transport)
        self._queue = queue

    def resume_reading(self) -> None:
        if not self._queue:
            super().resume_reading()


class FastPathProtocol(HttpToolsProtocol):
    """HTTP/1.1 on one connection.

    The fast path needs an application with `answer_at_once` that is not mounted below a path.
    """

    def __init__(
        self,
        config: Config,
        server_state: ServerState,
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
    ) -> None:
        super().__init__(config, server_state, app_state, _loop)
        # Whether the last byte is of an unfinished request, or of its body; whether one has begun.
        self._in_request = self._in_body = self._used = False
        self._head_bytes = self._body_bytes = 0
        self._unread = 0  # bytes of an answer that waited at the last check
        self._since = self._unread_since = self._answered_at = 0.0
        self._timer: asyncio.TimerHandle | None = None
        self._drops_input = self._is_last = False  # `_is_last`: the next answer closes

        self._answer: Answer | None = getattr(config.app, "answer_at_once", None)
        if self.root_path or config.access_log or self.limit_concurrency is not None:
            self._answer = None  # uvicorn alone logs and counts
        self._component: str | None = None  # of a query whose body is collected
        self._body = self._data = b""  # `_data`: the last bytes, while they may be one whole query
        self._found: Found | None = None  # about the query that has arrived
        self._heads: dict[bytes, _Head] = {}
        self._default_headers: Headers | None = None
        self._reply_head = b""

    def connection_made(self, transport: asyncio.Transport) -> None:  # pyright: ignore
        """Begin a connection; close it if there are too many."""
        super().connection_made(transport)
        self.flow = _Flow(transport, self.pipeline)
        self._since = self.loop.time()
        if len(self.connections) > MOST_CONNECTIONS:
            transport.close()
            return
        self._timer = self.loop.call_later(LOOK_S, self._check_timeouts)

    def connection_lost(self, exc: Exception | None) -> None:
        """End a connection."""
        if self._timer is not None:
            self._timer.cancel()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Answer a query with a known head, or parse what has arrived; refuse heads too long."""
        if self._drops_input or (not self._in_request and self._answer_known(data)):
            return
        self._data = b"" if self._in_request else data
        super().data_received(data)
        self._data, self._found = b"", None
        if self._head_bytes > MOST_HEAD_BYTES and not self.transport.is_closing():
            self.transport.write(TOO_LONG)
            self.transport.close()

    def on_message_begin(self) -> None:
        """Begin a request."""
        self._in_request = self._used = True
        self._in_body = False
        self._head_bytes = self._body_bytes = 0
        self._since = self.loop.time()
        super().on_message_begin()

    def on_url(self, url: bytes) -> None:
        """Take a piece of the URL."""
        self._head_bytes += len(url)
        if self._head_bytes <= MOST_HEAD_BYTES:
            super().on_url(url)

    def on_header(self, name: bytes, value: bytes) -> None:
        """Take a header field; trailers, behind a body, are dropped."""
        self._head_bytes += len(name) + len(value)
        if not self._in_body and self._head_bytes <= MOST_HEAD_BYTES:
            super().on_header(name, value)

    def on_headers_complete(self) -> None:
        """Start a request, or collect the body of a query of the fast path."""
        parser: HttpRequestParser = self.parser  # pyright: ignore[reportAssignmentType]
        self._in_body = True
        if self._head_bytes > MOST_HEAD_BYTES:
            return
        if parser.should_upgrade():
            self._start_upgrade()
        elif self.url.endswith(_AFTER) and self._may_be_fast(parser):
            self._component = self.url[len(_BEFORE) : -len(_AFTER)].decode("ascii")
            self._body = b""
        else:
            self._start_request()

    def on_body(self, body: bytes) -> None:
        """Take a piece of a body."""
        self._body_bytes += len(body)
        if self._component is not None:
            self._body += body
            if len(self._body) > _MOST_BODY:
                self._leave_fast_path({})
        elif self._head_bytes <= MOST_HEAD_BYTES:
            super().on_body(body)

    def on_message_complete(self) -> None:
        """Answer a query of the fast path, or end the body of another request."""
        self._in_request = False
        data, self._data = self._data, b""
        if self._component is not None:
            assert self._answer is not None
            found = self._found
            if found is None:
                found = self._answer(self._component, self.headers, self._body)
            if isinstance(found, bytes):
                self._know_head(self._component, data)
                self._component = None
                self._write(found)
                return
            self._leave_fast_path(found)
        if self._head_bytes <= MOST_HEAD_BYTES:
            super().on_message_complete()

    def shutdown(self) -> None:
        """Close after the present answer; without one, after the next one or `LAST_S`."""
        self._is_last = True
        if self._is_answered():
            self.loop.call_later(LAST_S, self._close_if_idle)
        else:
            self.cycle.keep_alive = False

    def timeout_keep_alive_handler(self) -> None:
        """Close a connection that has been idle since the last answer."""
        left = self._answered_at + self.timeout_keep_alive - self.loop.time()
        if left > 0:
            self._close_after(left)
        else:
            super().timeout_keep_alive_handler()

    def _close_after(self, seconds: float) -> None:
        self.timeout_keep_alive_task = self.loop.call_later(
            seconds, self.timeout_keep_alive_handler
        )

    def _close_if_idle(self) -> None:
        if not self._in_request and self._is_answered():
            self.transport.close()

    def _start_request(self) -> None:
        """Give a request to the application."""
        super().on_headers_complete()
        if self._is_last:
            self.cycle.keep_alive = False

    def _start_upgrade(self) -> None:
        """Answer a request to switch protocols as any other, and close (RFC 9110, section 7.8).

        The parser does not read its body: one with a body is refused, and later input is dropped.
        """
        self._drops_input = self._is_last = True
        names = {name for name, value in self.headers if value != b"0"}
        has_body = names & {b"content-length", b"transfer-encoding"}
        app, self.app = self.app, _refuse_upgrade if has_body else self.app
        self._start_request()
        self.app = app

    def _answer_known(self, data: bytes) -> bool:
        """Answer a query whose head is known; return whether that was possible."""
        end = data.find(_BLANK_LINE) + 4
        head = self._heads.get(data[:end])
        if head is None or len(data) != end + head.body_bytes or not self._is_free():
            return False
        assert self._answer is not None
        found = self._answer(head.component, head.headers, data[end:])
        if isinstance(found, bytes):
            self._write(found)
            return True
        self._found = found
        return False

    def _leave_fast_path(self, found: Found) -> None:
        """Start a request whose body was collected, with what was found about it in its scope."""
        self._component = None
        self._start_request()
        scope: Any = self.scope
        scope.update(found)
        super().on_body(self._body)

    def _may_be_fast(self, parser: HttpRequestParser) -> bool:
        """Return whether a head is that of a query, and the first of what has arrived."""
        name = self.url[len(_BEFORE) : -len(_AFTER)]
        return (
            self._data != b""
            and self.url.startswith(_BEFORE)
            and name.replace(b"_", b"").replace(b"-", b"").isalnum()
            and parser.get_method() == b"POST"
            and parser.get_http_version() == "1.1"
            and parser.should_keep_alive()
            and not self.expect_100_continue
            and self._is_free()
        )

    def _is_free(self) -> bool:
        """Return whether no other request is being answered, and the caller reads answers."""
        return (
            self._answer is not None
            and self._is_answered()
            and not self.flow.write_paused
            and not self.transport.is_closing()
        )

    def _is_answered(self) -> bool:
        """Return whether no request of the application is being answered."""
        return self.cycle is None or self.cycle.response_complete

    def _know_head(self, component: str, data: bytes) -> None:
        """Store the head of a query, if `data` is the query and no more."""
        end = data.find(_BLANK_LINE) + 4
        names = [name for name, _ in self.headers]
        sized = b"content-length" in names and b"transfer-encoding" not in names
        if not sized or end > _MOST_KNOWN_HEAD or len(data) != end + len(self._body):
            return
        if len(self._heads) >= _MOST_HEADS:
            self._heads.clear()
        self._heads[data[:end]] = _Head(component, tuple(self.headers), len(self._body))

    def _write(self, content: bytes) -> None:
        """Write a 200; the time until an idle connection is closed begins anew."""
        close = b"\r\nconnection: close" if self._is_last else b""
        fields = self.server_state.default_headers
        if fields is not self._default_headers:  # they change once a second
            lines = b"".join([b"%b: %b\r\n" % field for field in fields])
            self._reply_head = b"HTTP/1.1 200 OK\r\n%bcontent-length: " % lines
            self._default_headers = fields
        self.transport.write(
            b"%b%d%b\r\ncontent-type: application/json\r\n%b\r\n%b"
            % (self._reply_head, len(content), close, PLAIN, content)
        )
        self.server_state.total_requests += 1
        if self._is_last:
            self.transport.close()
            return
        self._answered_at = self.loop.time()
        if self.timeout_keep_alive_task is None:
            self._close_after(self.timeout_keep_alive)

    def _check_timeouts(self) -> None:
        """Close a connection that keeps the server waiting for too long."""
        if self.transport.is_closing():
            return
        if late := self._late(self.loop.time()):
            log.debug("closed a connection: %s", late)
            self.transport.abort()
        else:
            self._timer = self.loop.call_later(LOOK_S, self._check_timeouts)

    def _late(self, now: float) -> str:
        """Return what is overdue on the connection; an empty text if nothing is."""
        if self.flow.write_paused:
            left = self.transport.get_write_buffer_size()
            if left != self._unread:
                self._unread, self._unread_since = left, now
            return "an answer that is not read" if now - self._unread_since > READ_S else ""
        self._unread = 0
        self._since = now if self.flow.read_paused else self._since  # the caller waits for answers
        waited = now - self._since
        if not self._in_request:
            return "a first request" if not self._used and waited > HEAD_S else ""
        if not self._in_body:
            return "the rest of a head" if waited > HEAD_S else ""
        return "the rest of a body" if waited > BODY_S + self._body_bytes / SLOWEST else ""


async def _refuse_upgrade(scope: Scope, receive: Receive, send: Send) -> None:
    """Answer a request with a body and an Upgrade header."""
    detail = (
        "The body of a request with the header Connection: Upgrade is not read; nothing was "
        "changed. Send the request without the headers Connection: Upgrade and Upgrade."
    )
    refused = ProblemError(400, "upgrade", "This server does not switch protocols", detail)
    await refused.response()(scope, receive, send)
