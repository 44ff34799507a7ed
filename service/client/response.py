"""Responses, and how one is read from a socket: an ordinary one at a glance, others by http.client.

http.client reads each header field into an e-mail message, which takes longer than the server does.
"""

from __future__ import annotations

import http.client
import io
import json
import socket
from email.message import Message
from functools import cached_property

from .errors import Json

_ENOUGH = 65_536  # bytes of one read: all but large batches come in one piece
_BLANK_LINE = b"\r\n\r\n"
_LENGTH = b"\r\ncontent-length:"
# Fields that say what has to be done with a connection or a body: http.client knows how.
_UNUSUAL = (b"\r\nconnection:", b"\r\ntransfer-encoding:", b"\r\ncontent-encoding:")


class Response:
    """A response as it was received; `will_close`: its connection is of no further use."""

    def __init__(
        self,
        status: int,
        content: bytes,
        head: bytes = b"",
        reason: str = "",
        *,
        will_close: bool = False,
    ) -> None:
        self.status, self.content, self.head = status, content, head
        self.reason, self.will_close = reason, will_close

    @cached_property
    def headers(self) -> Message:
        """The header fields, parsed at their first use."""
        _, _, lines = self.head.partition(b"\r\n")
        return http.client.parse_headers(io.BytesIO(lines + _BLANK_LINE))

    def json(self) -> Json:
        """Return the body as JSON."""
        return json.loads(self.content)


def receive(sock: socket.socket, method: str) -> Response:
    """Read the answer to a request that has been sent.

    HTTPException or OSError if none comes, or it breaks off, or is no HTTP.
    """
    came = sock.recv(_ENOUGH)
    if not came:
        raise http.client.RemoteDisconnected("the server closed the connection without an answer")
    seen = _glance(came)
    if seen is None or len(came) > sum(seen[1:]):
        return _by_http_client(came, sock, method)
    status, end, length = seen
    content = came[end:]
    if len(content) < length:
        content = _remaining(sock, content, length)
    return Response(status, content, came[: end - len(_BLANK_LINE)])


def _glance(came: bytes) -> tuple[int, int, int] | None:
    """Return status, end of the head and length of the body of an ordinary success, else None."""
    end = came.find(_BLANK_LINE)
    if end < 0 or not came.startswith((b"HTTP/1.1 200 ", b"HTTP/1.1 201 ", b"HTTP/1.1 202 ")):
        return None
    head = came[:end].lower()
    before, length, after = head.partition(_LENGTH)
    if not length or _LENGTH in after or any(field in head for field in _UNUSUAL):
        return None
    digits = after.partition(b"\r\n")[0].strip()
    return (int(before[9:12]), end + len(_BLANK_LINE), int(digits)) if digits.isdigit() else None


def _remaining(sock: socket.socket, content: bytes, length: int) -> bytes:
    pieces, missing = [content], length - len(content)
    while missing:
        piece = sock.recv(min(missing, 1 << 20))
        if not piece:
            raise http.client.IncompleteRead(b"".join(pieces), missing)
        pieces.append(piece)
        missing -= len(piece)
    return b"".join(pieces)


def _by_http_client(came: bytes, sock: socket.socket, method: str) -> Response:
    """Read an answer of which a part has come."""
    replay = _Replay(came, sock)
    response = http.client.HTTPResponse(replay, method=method)  # pyright: ignore
    try:
        response.begin()
        if replay.ended:  # http.client takes a head that breaks off as a whole one
            raise http.client.IncompleteRead(came)
        content = response.read()
        status, reason, close = response.status, response.reason, response.will_close
        received = Response(status, content, reason=reason, will_close=close)
        received.headers = response.headers
        return received
    finally:
        response.close()


class _Replay(io.RawIOBase):
    """What has come, then what comes: all that http.client asks of a socket."""

    def __init__(self, came: bytes, sock: socket.socket) -> None:
        super().__init__()
        self._came, self._sock, self.ended = came, sock, False

    def makefile(self, _mode: str) -> io.BufferedReader:
        return io.BufferedReader(self)

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: memoryview) -> int:  # pyright: ignore
        if not self._came:
            count = self._sock.recv_into(buffer)
            self.ended = not count
            return count
        count = min(len(buffer), len(self._came))
        buffer[:count], self._came = self._came[:count], self._came[count:]
        return count
