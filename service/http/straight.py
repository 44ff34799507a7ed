"""The server's protocol with a straight way for the main call: bytes in, bytes out.

For an application, uvicorn makes a scope, a task and two messages of each request; that is more
work than most answers are. Here a plain question (`POST /v1/components/{name}/displacement`, a
small body, nothing unusual in the head) is put to the application's `answer_at_once` as soon as its
last byte is there, and the answer is written at once. Whatever that does not answer (None), and
every other request, goes the usual way, from its head on, as if it had just come.

A loop sends the same head again and again. One that was read as that of a plain question means the
same the next time: it is known by its bytes, and not read anew.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence, Sized
from typing import Any, NamedTuple

from httptools import HttpRequestParser
from uvicorn.config import Config
from uvicorn.protocols.http.flow_control import FlowControl
from uvicorn.server import ServerState

from service.http.door.fields import PLAIN
from service.http.patient import MOST_HEAD_BYTES, PatientProtocol

_BEFORE, _AFTER = b"/v1/components/", b"/displacement"
# Held back until its last byte is there; a longer one is counted as it comes by `limited`.
_MOST_BYTES = 4096
# Heads of one connection: a loop's differ by component and by the digits of their content-length.
_MOST_HEADS = 64
_MOST_HEAD = 2048  # bytes of a head that is kept: a loop's are some 200
_BLANK_LINE = b"\r\n\r\n"

Headers = Sequence[tuple[bytes, bytes]]
Answer = Callable[[str, Headers, bytes], bytes | None]


class _Head(NamedTuple):
    """A plain question's head: the component, its fields, and how long its body is."""

    name: str
    headers: Headers
    length: int


class _Flow(FlowControl):
    """Reads no further while requests wait for their turn; uvicorn alone queues all there are."""

    def __init__(self, transport: asyncio.Transport, waiting: Sized) -> None:
        super().__init__(transport)
        self._waiting = waiting

    def resume_reading(self) -> None:
        if not self._waiting:
            super().resume_reading()


class StraightProtocol(PatientProtocol):
    """HTTP/1.1 on one connection, as uvicorn does it, with the straight way.

    The way is there if the application has `answer_at_once` and is not mounted below a path.
    """

    def __init__(
        self,
        config: Config,
        server_state: ServerState,
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
    ) -> None:
        super().__init__(config, server_state, app_state, _loop)
        self._ask: Answer | None = getattr(config.app, "answer_at_once", None)
        if self.root_path or config.access_log or self.limit_concurrency is not None:
            self._ask = None  # these are told and counted on the usual way
        self._name: str | None = None  # the component of a question that is held back
        self._held = b""
        self._came = b""  # what has come last, for as long as it may be one question
        self._heads: dict[bytes, _Head] = {}
        self._fields: Headers | None = None
        self._told = b""
        self._spoke = 0.0

    def connection_made(self, transport: asyncio.Transport) -> None:  # pyright: ignore
        """Begin a connection."""
        super().connection_made(transport)
        self.flow = _Flow(transport, self.pipeline)

    def data_received(self, data: bytes) -> None:
        """Take what has come; one question in it may go straight, others wait their turn."""
        if not self._inside and self._answer_known(data):
            return
        self._came = b"" if self._inside else data
        super().data_received(data)
        self._came = b""

    def _answer_known(self, data: bytes) -> bool:
        """Answer a question whose head is known, and tell whether it was one."""
        end = data.find(_BLANK_LINE) + 4
        head = self._heads.get(data[:end])
        if head is None or len(data) != end + head.length or not self._is_free():
            return False
        assert self._ask is not None
        content = self._ask(head.name, head.headers, data[end:])
        if content is None:
            return False
        self._write(content)
        return True

    def on_headers_complete(self) -> None:
        """Start a request, unless it may be a plain question."""
        parser: HttpRequestParser = self.parser  # pyright: ignore[reportAssignmentType]
        if parser.should_upgrade():
            self._ask = None  # what comes then may be no HTTP
        if not self.url.endswith(_AFTER) or not self._may_be_plain(parser):
            super().on_headers_complete()
            return
        self._in_body = True
        self._name = self.url[len(_BEFORE) : -len(_AFTER)].decode("ascii")
        self._held = b""

    def on_body(self, body: bytes) -> None:
        """Take a piece of a body."""
        if self._name is None:
            super().on_body(body)
            return
        self._body_bytes += len(body)
        self._held += body
        if len(self._held) > _MOST_BYTES:
            self._go_the_usual_way()

    def on_message_complete(self) -> None:
        """Answer a plain question, or go on with a request."""
        came, self._came, self._inside = self._came, b"", False
        if self._name is None:
            super().on_message_complete()
            return
        assert self._ask is not None
        content = self._ask(self._name, self.headers, self._held)
        if content is None:
            self._go_the_usual_way()
            super().on_message_complete()
            return
        self._keep_head(came, _Head(self._name, tuple(self.headers), len(self._held)))
        self._name = None
        self._write(content)

    def shutdown(self) -> None:
        """Answer what has begun to arrive, then close."""
        if self._name is not None:
            self._go_the_usual_way()
        super().shutdown()

    def timeout_keep_alive_handler(self) -> None:
        """Close a connection that has been idle, counted from the last answer."""
        left = self._spoke + self.timeout_keep_alive - self.loop.time()
        if left > 0:
            self._close_after(left)
        else:
            super().timeout_keep_alive_handler()

    def _close_after(self, seconds: float) -> None:
        self.timeout_keep_alive_task = self.loop.call_later(
            seconds, self.timeout_keep_alive_handler
        )

    def _go_the_usual_way(self) -> None:
        """Hand over what was held back."""
        self._name, self._body_bytes = None, 0
        super().on_headers_complete()
        super().on_body(self._held)

    def _may_be_plain(self, parser: HttpRequestParser) -> bool:
        """Tell whether a head is that of a plain question, and the first of what has come."""
        name = self.url[len(_BEFORE) : -len(_AFTER)]
        return (
            self._came != b""
            and self._head_bytes <= MOST_HEAD_BYTES
            and self.url.startswith(_BEFORE)
            and name.replace(b"_", b"").replace(b"-", b"").isalnum()
            and parser.get_method() == b"POST"
            and parser.get_http_version() == "1.1"
            and parser.should_keep_alive()
            and not self.expect_100_continue
            and self._is_free()
        )

    def _is_free(self) -> bool:
        """Tell whether nothing else is being answered, and answers can be taken."""
        return (
            self._ask is not None
            and (self.cycle is None or self.cycle.response_complete)
            and not self.flow.write_paused
            and not self.transport.is_closing()
        )

    def _keep_head(self, came: bytes, head: _Head) -> None:
        """Know a question's head the next time, if all of it and no more has come in one piece."""
        end = came.find(_BLANK_LINE) + 4
        names = [name for name, _ in head.headers]
        told = b"content-length" in names and b"transfer-encoding" not in names
        if not told or end > _MOST_HEAD or len(came) != end + head.length:
            return
        if len(self._heads) >= _MOST_HEADS:
            self._heads.clear()
        self._heads[came[:end]] = head

    def _write(self, content: bytes) -> None:
        """Write a 200; the time until an idle connection is closed begins anew."""
        fields = self.server_state.default_headers
        if fields is not self._fields:  # they change once a second
            told = b"".join([b"%b: %b\r\n" % field for field in fields])
            self._told = b"HTTP/1.1 200 OK\r\n%bcontent-length: " % told
            self._fields = fields
        self.transport.write(
            b"%b%d\r\ncontent-type: application/json\r\n%b\r\n%b"
            % (self._told, len(content), PLAIN, content)
        )
        self.server_state.total_requests += 1
        self._spoke = self.loop.time()
        if self.timeout_keep_alive_task is None:
            self._close_after(self.timeout_keep_alive)
