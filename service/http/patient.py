"""The server's protocol with an end to its patience: for heads, bodies, and readers that stall.

uvicorn closes a connection that idles after an answer. One that never asks, that sends a byte now
and then, or that reads none of its answer, it would hold for ever.
"""

from __future__ import annotations

import asyncio
import logging
from typing import Any, Final

from uvicorn.config import Config
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol
from uvicorn.server import ServerState

log = logging.getLogger(__name__)

MOST_CONNECTIONS: Final = 8192  # below the open files of a server, see `server.OPEN_FILES`
MOST_HEAD_BYTES: Final = 64 * 1024  # what proxies and other servers take, or less
HEAD_S: Final = 10.0  # for a head, from its first byte or from the connection's beginning
BODY_S: Final = 30.0  # for a body, beside what it takes at this rate:
SLOWEST: Final = 16 * 1024  # bytes a second; a bad mobile connection has more
READ_S: Final = 60.0  # in which a reader must take something of an answer that waits
LOOK_S: Final = 5.0
_TOO_LONG: Final = (
    b"HTTP/1.1 431 Request Header Fields Too Large\r\n"
    b"content-length: 0\r\nconnection: close\r\n\r\n"
)


class PatientProtocol(HttpToolsProtocol):
    """HTTP/1.1 on one connection as uvicorn does it, which is closed if nothing comes of it."""

    def __init__(
        self,
        config: Config,
        server_state: ServerState,
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
    ) -> None:
        super().__init__(config, server_state, app_state, _loop)
        self._inside = False  # whether the last byte that came is of a request that goes on
        self._in_body = False
        self._asked = False  # whether anything was ever asked
        self._since = 0.0
        self._head_bytes = self._body_bytes = 0
        self._unread = 0  # bytes of an answer that waited at the last look
        self._unread_since = 0.0
        self._watch: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # pyright: ignore
        """Begin a connection, if there are not too many."""
        super().connection_made(transport)
        self._since = self.loop.time()
        if len(self.connections) > MOST_CONNECTIONS:
            transport.close()
            return
        self._watch = self.loop.call_later(LOOK_S, self._look)

    def connection_lost(self, exc: Exception | None) -> None:
        """End a connection."""
        if self._watch is not None:
            self._watch.cancel()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Take what has come; a head that is longer than any is refused."""
        super().data_received(data)
        if self._head_bytes > MOST_HEAD_BYTES and not self.transport.is_closing():
            self.transport.write(_TOO_LONG)
            self.transport.close()

    def on_message_begin(self) -> None:
        """Start to read a request."""
        self._inside = self._asked = True
        self._in_body = False
        self._head_bytes = self._body_bytes = 0
        self._since = self.loop.time()
        super().on_message_begin()

    def on_url(self, url: bytes) -> None:
        """Take a piece of what is asked for."""
        self._head_bytes += len(url)
        if self._head_bytes <= MOST_HEAD_BYTES:
            super().on_url(url)

    def on_header(self, name: bytes, value: bytes) -> None:
        """Take a field of the head; those behind a body are nobody's."""
        self._head_bytes += len(name) + len(value)
        if not self._in_body and self._head_bytes <= MOST_HEAD_BYTES:
            super().on_header(name, value)

    def on_headers_complete(self) -> None:
        """Start a request."""
        self._in_body = True
        if self._head_bytes <= MOST_HEAD_BYTES:
            super().on_headers_complete()

    def on_body(self, body: bytes) -> None:
        """Take a piece of a body."""
        self._body_bytes += len(body)
        if self._head_bytes <= MOST_HEAD_BYTES:
            super().on_body(body)

    def on_message_complete(self) -> None:
        """Go on with a request that is whole."""
        self._inside = False
        if self._head_bytes <= MOST_HEAD_BYTES:
            super().on_message_complete()

    def _look(self) -> None:
        """Close a connection that keeps the server waiting for too long."""
        if self.transport.is_closing():
            return
        why = self._stalled(self.loop.time())
        if why:
            log.debug("closed a connection: %s", why)
            self.transport.abort()
            return
        self._watch = self.loop.call_later(LOOK_S, self._look)

    def _stalled(self, now: float) -> str:
        """Return what a connection waits for that does not come; nothing if all is well."""
        if self.flow.write_paused:
            return self._unread_for(now)
        self._unread = 0
        if self.flow.read_paused:
            self._since = now  # it is this side that keeps the other waiting
        waited = now - self._since
        if not self._inside:
            return "nothing was asked" if not self._asked and waited > HEAD_S else ""
        if not self._in_body:
            return "a head that does not end" if waited > HEAD_S else ""
        late = waited > BODY_S + self._body_bytes / SLOWEST
        return "a body that comes too slowly" if late else ""

    def _unread_for(self, now: float) -> str:
        left = self.transport.get_write_buffer_size()
        if left != self._unread:
            self._unread, self._unread_since = left, now
        return "an answer that nobody reads" if now - self._unread_since > READ_S else ""
