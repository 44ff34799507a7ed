"""HTTP/1.1 protocol of the server: uvicorn's, with timeouts and a fast path for single queries.

uvicorn makes a scope, a task and two messages of each request, which costs more than most answers.
The fast path answers a `POST /v1/components/{name}/displacement` with a small JSON body of force,
moment and on_thin from its bytes. All other requests, and each problem, go to the application, with
the fast path's permission, query and reply.
"""

from __future__ import annotations

import asyncio
import logging
import math
import re
import select
from collections.abc import Iterable, Sized
from time import perf_counter
from typing import Any, ClassVar, Final, NamedTuple

import orjson
from httptools import HttpParserError, HttpParserUpgrade, HttpRequestParser
from starlette.datastructures import State
from uvicorn.config import Config
from uvicorn.protocols.http.flow_control import FlowControl
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol, RequestResponseCycle
from uvicorn.server import ServerState

from wrenchbook.service.http.headers import PLAIN
from wrenchbook.service.http.permission import PERMISSION, Permission
from wrenchbook.service.http.problems import HttpProblemError
from wrenchbook.service.http.proxy import PEER
from wrenchbook.service.query import answer_at_once, fields_of, plain_query

log = logging.getLogger(__name__)

# Connections, below the open files of a server, see `server.OPEN_FILES`.
MAX_CONNECTIONS: Final = 8192
MAX_HEAD_BYTES: Final = 64 * 1024  # bytes of a head that proxies and other servers allow, or less
HEAD_S: Final = 10.0  # s for a head, from its first byte or from the connection's beginning
# s for a body, for the rest of a refused body, and in addition the time at this rate:
BODY_S: Final = 30.0
SLOWEST: Final = 16 * 1024  # bytes a second; a bad mobile connection is faster
READ_S: Final = 60.0  # s within which the caller must read some of a waiting reply
POLL_S: Final = 5.0  # s between two checks of a connection's timeouts
LAST_S: Final = 0.25  # s for a last request of an idle connection when the server stops
# s between two log lines: input that is not HTTP needs no key and could fill the log.
REFUSALS_S: Final = 60.0
_SIZES: Final = {b"content-length", b"transfer-encoding"}
_NO_UPGRADE: Final = HttpProblemError(
    400,
    "upgrade",
    "This server does not switch protocols",
    "A body with the header Connection: Upgrade is not read; nothing was changed. Send the request "
    "without the headers Connection: Upgrade and Upgrade.",
)
_HOSTS: Final = HttpProblemError(
    400,
    "hosts",
    "More than one Host",
    "The request has several Host fields, which proxies may read differently (RFC 9112, section "
    "3.2); nothing was changed. Send one.",
)
_NOT_HTTP: Final = HttpProblemError(
    400,
    "not-http",
    "Not a request of HTTP/1.1",
    "The last bytes of the connection are not a valid HTTP request, and the connection is closed. "
    "Earlier requests are answered. Correct the client, and send the request again.",
)
_TOO_LONG: Final = HttpProblemError(
    431,
    "head-too-long",
    "The head of the request is too long",
    f"URL and header fields may have at most {MAX_HEAD_BYTES:,} bytes together; nothing was "
    "changed. Send long data in the body.",
)


ANSWERED: Final = "wrenchbook.answered"  # key in a scope: the fast path's query and its outcome
ROUTE: Final = "/v1/components/{name}/displacement"
HEADER: Final = b"x-request-id"
_ID: Final = re.compile(rb"[\x21-\x7e]{1,128}")
_FIRST_LINE: Final = re.compile(rb"POST /v1/components/([\w-]+)/displacement HTTP/1\.1\r\n")
_BLANK_LINE: Final = b"\r\n\r\n"
_UNUSUAL: Final = frozenset({b"expect", b"transfer-encoding", b"upgrade"})
# Lengths of a body on the fast path; the longest bodies have some 400.
_LENGTH: Final = re.compile(rb"[1-9]\d{0,2}|[1-3]\d{3}")
_MAX_PLAIN_HEAD: Final = 2048  # bytes of a head on the fast path: a loop's heads have some 200
# Cached heads, 2 MiB: a loop's heads differ by component and content-length.
_MAX_HEADS: Final = 1024


def id_of(headers: Iterable[tuple[bytes, bytes]]) -> bytes | None:
    """Return the id of a request: empty without the header, None if it is not valid."""
    sent = next((value for name, value in headers if name == HEADER), b"")
    return sent if not sent or _ID.fullmatch(sent) else None


class Head(NamedTuple):
    """The head of a query, of `size` bytes; `request_id` is empty without one."""

    component: str
    permission: Permission
    request_id: bytes
    size: int
    body_bytes: int


class _Fields:
    """Header fields of one head, collected by the parser's callbacks."""

    def __init__(self) -> None:
        self.fields: list[tuple[bytes, bytes]] = []
        self.is_complete = False

    def on_header(self, name: bytes, value: bytes) -> None:
        self.fields.append((name.lower(), value))

    def on_headers_complete(self) -> None:
        self.is_complete = True

    def on_body(self, _: bytes) -> None:
        self.is_complete = False  # the parser had read the end of the head before


class FastPath:
    """Answers queries without the application; caches the heads of a loop's requests.

    `state` is the application's, with `access`, `counts` and, while the server runs, `workspace`.
    """

    def __init__(self, state: State) -> None:
        self._state = state
        self._heads: dict[bytes, Head] = state.access.heads

    def head(self, data: bytes) -> Head | None:
        """Return the head of a permitted query at the beginning of `data`; None for any other."""
        start = data[: data.find(_BLANK_LINE) + 4]
        head = self._heads.get(start)
        if head is None:
            head = self._read(start)
            # A proxy gives each request another id.
            if head is not None and not head.request_id:
                if len(self._heads) >= _MAX_HEADS:
                    self._heads.clear()
                self._heads[start] = head
        return head

    def answer(self, head: Head, body: bytes) -> bytes | dict[str, Any]:
        """Return the JSON of a 200 to a query, or further entries of its request's scope."""
        started = perf_counter()
        state = self._state
        permission = head.permission
        if permission.key is not None and permission.wait() > 0.0:
            return {}
        known: dict[str, Any] = {PERMISSION: permission}
        try:
            fields = orjson.loads(body)
            # With more colons than keys, a key is repeated or anything else is unusual.
            query = plain_query(fields) if len(fields) == body.count(b":") else None
            if query is not None:
                outcome, is_complete = answer_at_once(state.workspace, head.component, query)
                known[ANSWERED] = query, outcome
                if is_complete:
                    content = orjson.dumps(fields_of(outcome))
                    reply = outcome.reply
                    state.counts.add(reply.coverage, reply.method, outcome.elapsed_us)
                    state.counts.add_request(ROUTE, "POST", 200, perf_counter() - started)
                    return content
        except Exception:  # the request meets the error again, and replies
            return {PERMISSION: permission}
        return known

    def _read(self, start: bytes) -> Head | None:
        """Return the head of a plain request that its key admits; None for any other request."""
        line = _FIRST_LINE.match(start)
        if line is None or len(start) > _MAX_PLAIN_HEAD:
            return None
        head = _Fields()
        parser = HttpRequestParser(head)
        try:
            parser.feed_data(start)
        except (HttpParserError, HttpParserUpgrade):
            return None
        named = dict(head.fields)
        length = named.get(b"content-length", b"")
        request_id = id_of(head.fields)
        if (
            not head.is_complete
            or not parser.should_keep_alive()
            or named.keys() & _UNUSUAL
            or [name for name, _ in head.fields].count(b"host") > 1
            or not _LENGTH.fullmatch(length)
            or request_id is None
        ):
            return None
        path = line[0].split()[1].decode()
        permission = self._state.access.admit(path, named)
        if permission is None:
            return None
        return Head(line[1].decode(), permission, request_id, len(start), int(length))


def reply_bytes(
    fields: Iterable[tuple[bytes, bytes]], head: Head, content: bytes, *, close: bool
) -> bytes:
    """Return a 200 with the server's `fields`, byte for byte as the application's route."""
    lines = [b"%b: %b\r\n" % field for field in fields]
    lines += [b"content-length: %d\r\n" % len(content)]
    if close:
        lines += [b"connection: close\r\n"]
    lines += [b"content-type: application/json\r\n", PLAIN]
    if head.request_id:
        lines += [b"%b: %b\r\n" % (HEADER, head.request_id)]
    return b"HTTP/1.1 200 OK\r\n%b\r\n%b" % (b"".join(lines), content)


class _Flow(FlowControl):
    """Flow control that stops reading while requests are queued."""

    def __init__(self, transport: asyncio.Transport, queue: Sized) -> None:
        super().__init__(transport)
        self._queue = queue

    def resume_reading(self) -> None:
        if not self._queue:
            super().resume_reading()


class FastPathProtocol(HttpToolsProtocol):
    """HTTP/1.1 on one connection.

    The fast path needs an application with `fast_path` that is not mounted below a path.
    """

    _refusals: ClassVar[int] = 0  # refusals of all connections, since the last line of the log
    _logged_at: ClassVar[float] = -math.inf

    def __init__(
        self,
        config: Config,
        server_state: ServerState,
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
    ) -> None:
        super().__init__(config, server_state, app_state, _loop)
        # Whether the last byte belongs to an unfinished request, or to its body; whether a request
        # has begun.
        self._in_request = self._in_body = self._used = False
        self._head_bytes = self._body_bytes = 0
        self._unread = 0  # bytes of a reply that waited at the last check
        self._since = self._unread_since = self._answered_at = 0.0
        self._timer: asyncio.TimerHandle | None = None
        # The request that is being answered; `cycle` is the last one that has arrived.
        self._answering: RequestResponseCycle | None = None
        # `_is_last`: the next reply closes the connection.
        self._drops_input = self._is_last = False

        self._fast: FastPath | None = getattr(config.app, "fast_path", None)
        if self.root_path or config.access_log or self.limit_concurrency is not None:
            self._fast = None  # uvicorn alone logs and counts
        self._partial = b""  # a query of the fast path until its whole body has arrived
        self._known: dict[str, Any] = {}  # the arrived query's entries of the scope

    def connection_made(self, transport: asyncio.Transport) -> None:  # pyright: ignore
        """Begin a connection; close it if there are too many."""
        super().connection_made(transport)
        self.flow = _Flow(transport, self.pipeline)
        self._since = self.loop.time()
        if len(self.connections) > MAX_CONNECTIONS:
            transport.close()
            return
        self._timer = self.loop.call_later(POLL_S, self._check_timeouts)

    def connection_lost(self, exc: Exception | None) -> None:
        """End a connection."""
        if self._timer is not None:
            self._timer.cancel()
        super().connection_lost(exc)
        self._abandon(self._answering)

    def data_received(self, data: bytes) -> None:
        """Answer a query of the fast path, or parse what has arrived; refuse heads too long."""
        if self._drops_input:
            return
        if self._partial or not self._in_request:
            data = self._partial + data
            self._partial = b""
            # No other request is being answered, and the caller reads replies.
            free = not self.flow.write_paused and not self.transport.is_closing()
            if self._fast and free and self._is_answered() and self._answer(self._fast, data):
                return
        self._unset_keepalive_if_required()
        try:
            self.parser.feed_data(data)
        except HttpParserUpgrade:
            pass  # see `on_headers_complete`
        except HttpParserError:
            self._refuse()
        self._known = {}

    def on_message_begin(self) -> None:
        """Begin a request."""
        self._begin(in_body=False)
        super().on_message_begin()

    def on_url(self, url: bytes) -> None:
        """Store a piece of the URL."""
        self._count(len(url))
        super().on_url(url)

    def on_header(self, name: bytes, value: bytes) -> None:
        """Store a header field; trailers, after a body, are dropped."""
        self._count(len(name) + len(value))
        if not self._in_body:
            super().on_header(name, value)

    def on_headers_complete(self) -> None:
        """Give a request to the application, with the fast path's permission, query and reply.

        A request to switch protocols is answered as any other (RFC 9110, section 7.8), and the
        connection closed. The parser does not read its body: one with a body is refused.
        """
        parser: HttpRequestParser = self.parser  # pyright: ignore[reportAssignmentType]
        app = self.app
        if parser.should_upgrade():
            self._drops_input = self._is_last = True
            sized = {name for name, value in self.headers if value != b"0"} & _SIZES
            self.app = _NO_UPGRADE.response() if sized else app
        if [name for name, _ in self.headers].count(b"host") > 1:
            self.app = _HOSTS.response()
        super().on_headers_complete()
        self.app = app
        self._in_body = True
        scope: Any = self.scope
        scope.update(self._known)
        # uvicorn replaces the scope's address by X-Forwarded-For.
        scope[PEER] = self.client[0] if self.client else ""
        if self._is_last:
            self.cycle.keep_alive = False

    def on_body(self, body: bytes) -> None:
        """Store a piece of a body."""
        self._body_bytes += len(body)
        super().on_body(body)

    def on_message_complete(self) -> None:
        """End the body of a request."""
        self._in_request = False
        super().on_message_complete()

    def on_response_complete(self) -> None:
        """Start the time limit for the rest of a body that is not read, such as a refused one."""
        self._since = self.loop.time()
        super().on_response_complete()

    def shutdown(self) -> None:
        """Close after the present reply; without one, after the next one or `LAST_S`."""
        self._is_last = True
        if self._is_answered():
            self.loop.call_later(LAST_S, self._close_if_idle)
        else:
            self.cycle.keep_alive = False

    def timeout_keep_alive_handler(self) -> None:
        """Close a connection that has been idle since the last reply."""
        remaining = self._answered_at + self.timeout_keep_alive - self.loop.time()
        if remaining > 0:
            self._close_after(remaining)
        else:
            self._close_if_idle()

    def _close_after(self, seconds: float) -> None:
        self.timeout_keep_alive_task = self.loop.call_later(
            seconds, self.timeout_keep_alive_handler
        )

    def _close_if_idle(self) -> None:
        """Close unless a request is being read or answered, or has arrived and is read next.

        After a stall the loop runs timers first: a request that arrived meanwhile would be reset.
        """
        if self._in_request or not self._is_answered() or self.transport.is_closing():
            return
        poll = select.poll()
        poll.register(self.transport.get_extra_info("socket").fileno(), select.POLLIN)
        if not poll.poll(0):
            self.transport.close()

    def _start_asgi_task(self, cycle: RequestResponseCycle, app: Any) -> None:
        self._answering = cycle
        super()._start_asgi_task(cycle, app)

    def _abandon(self, cycle: RequestResponseCycle | None) -> None:
        """End a request whose caller has disconnected: its reply is not written."""
        if cycle is not None and not cycle.response_complete:
            cycle.disconnected = True
            cycle.message_event.set()

    def _refuse(self) -> None:
        """Refuse input that is not HTTP after the replies to earlier requests, then close.

        Nothing more is read. The refusal replaces the reply to a request whose body cannot be read.
        """
        refusal = _TOO_LONG if self._head_bytes > MAX_HEAD_BYTES else _NOT_HTTP
        self._drops_input = self._is_last = True
        if self._in_request and self._in_body:
            if self.pipeline:
                self.pipeline.popleft()
            else:
                self._abandon(self.cycle)
                if self.cycle.response_started:
                    self.transport.close()
                    return
                self.cycle.response_complete = True
        self.app = refusal.response()
        self.parser = HttpRequestParser(self)
        self.parser.feed_data(b"GET / HTTP/1.1\r\n\r\n")
        kind = FastPathProtocol
        now = self.loop.time()
        kind._refusals += 1
        if now - kind._logged_at >= REFUSALS_S:
            log.warning(
                "refused %d requests that are not HTTP/1.1 or have too long a head since the last "
                "line of this kind; the last is from %s",
                kind._refusals,
                self.client[0] if self.client else "a socket",
            )
            kind._refusals = 0
            kind._logged_at = now

    def _begin(self, *, in_body: bool) -> None:
        """Start the time limits of a request."""
        self._in_request = self._used = True
        self._in_body = in_body
        self._head_bytes = self._body_bytes = 0
        self._since = self.loop.time()

    def _count(self, size: int) -> None:
        """Count bytes of a head; raises ValueError if the head is too long."""
        self._head_bytes += size
        if self._head_bytes > MAX_HEAD_BYTES:
            raise ValueError(f"the head has more than {MAX_HEAD_BYTES} bytes; send fewer headers")

    def _answer(self, fast: FastPath, data: bytes) -> bool:
        """Answer one complete query, or wait for the rest of its body; False for other requests."""
        head = fast.head(data)
        if head is None:
            return False
        missing = head.size + head.body_bytes - len(data)
        if missing > 0:
            if not self._in_request:
                self._begin(in_body=True)
                self._unset_keepalive_if_required()
            self._partial = data
            self._body_bytes = len(data) - head.size
            return True
        known = fast.answer(head, data[head.size :]) if missing == 0 else {}
        if isinstance(known, bytes):
            self._in_request = False
            self._used = True
            fields = self.server_state.default_headers
            self.transport.write(reply_bytes(fields, head, known, close=self._is_last))
            self.server_state.total_requests += 1
            self._answered_at = self.loop.time()
            if self._is_last:
                self.transport.close()
            elif self.timeout_keep_alive_task is None:
                self._close_after(self.timeout_keep_alive)
            return True
        self._known = known
        return False

    def _is_answered(self) -> bool:
        """Return whether no request of the application is being answered."""
        return self.cycle is None or self.cycle.response_complete

    def _check_timeouts(self) -> None:
        """Close a connection that keeps the server waiting for too long."""
        if self.transport.is_closing():
            return
        if late := self._late(self.loop.time()):
            log.debug("closed a connection: %s", late)
            self.transport.abort()
        else:
            self._timer = self.loop.call_later(POLL_S, self._check_timeouts)

    def _late(self, now: float) -> str:
        """Return the timeout that the connection exceeds; an empty text if none."""
        if self.flow.write_paused:
            unsent = self.transport.get_write_buffer_size()
            if unsent != self._unread:
                self._unread = unsent
                self._unread_since = now
            return "an answer that is not read" if now - self._unread_since > READ_S else ""
        self._unread = 0
        self._since = now if self.flow.read_paused else self._since  # the caller waits for replies
        waited = now - self._since
        if not self._in_request:
            return "a first request" if not self._used and waited > HEAD_S else ""
        if not self._in_body:
            return "the rest of a head" if waited > HEAD_S else ""
        read = 0 if self._is_answered() else self._body_bytes
        return "the rest of a body" if waited > BODY_S + read / SLOWEST else ""
