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
from typing import Any, NamedTuple

_ENOUGH = 65_536  # bytes of one read: all but large batches come in one piece
_BLANK_LINE = b"\r\n\r\n"
_LENGTH = b"\r\ncontent-length:"
# Fields that say what has to be done with a connection or a body: http.client knows how.
_UNUSUAL = (b"\r\nconnection:", b"\r\ntransfer-encoding:", b"\r\ncontent-encoding:")


class Response:
    """A response as it was received.

    Attributes
    ----------
    status : int
    reason, head, content : str, bytes, bytes
    will_close : bool
        Whether the connection is of no further use.
    """

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

    def json(self) -> Any:
        """Return the body as JSON."""
        return json.loads(self.content)


class Glance(NamedTuple):
    """Status, end of the head and length of the body, bytes, of an ordinary success."""

    status: int
    end: int
    length: int


def receive(sock: socket.socket, method: str) -> Response:
    """Read the answer to a request that has been sent.

    Raises
    ------
    http.client.HTTPException, OSError
        If none comes, or it breaks off, or is no HTTP.
    """
    came = sock.recv(_ENOUGH)
    if not came:
        raise http.client.RemoteDisconnected("the server closed the connection without an answer")
    seen = glance(came)
    if seen is None or len(came) > seen.end + seen.length:
        return _by_http_client(came, sock, method)
    content = came[seen.end :]
    if len(content) < seen.length:
        content = _rest(sock, content, seen.length)
    return Response(seen.status, content, came[: seen.end - len(_BLANK_LINE)])


def glance(came: bytes) -> Glance | None:
    """Return an ordinary success with a length, or None for whatever else this is."""
    end = came.find(_BLANK_LINE)
    if end < 0 or not came.startswith((b"HTTP/1.1 200 ", b"HTTP/1.1 201 ", b"HTTP/1.1 202 ")):
        return None
    head = came[:end].lower()
    before, found, after = head.partition(_LENGTH)
    if not found or _LENGTH in after or any(field in head for field in _UNUSUAL):
        return None
    digits = after.partition(b"\r\n")[0].strip()
    if not digits.isdigit():
        return None
    return Glance(int(before[9:12]), end + len(_BLANK_LINE), int(digits))


def _rest(sock: socket.socket, content: bytes, length: int) -> bytes:
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
    response = http.client.HTTPResponse(_Replay(came, sock), method=method)  # pyright: ignore
    try:
        response.begin()
        content = response.read()
        found = Response(
            response.status, content, reason=response.reason, will_close=response.will_close
        )
        found.headers = response.headers
        return found
    finally:
        response.close()


class _Replay(io.RawIOBase):
    """What has come, then what comes: all that http.client asks of a socket."""

    def __init__(self, came: bytes, sock: socket.socket) -> None:
        super().__init__()
        self._came, self._sock = came, sock

    def makefile(self, _mode: str) -> io.BufferedReader:
        return io.BufferedReader(self)

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: memoryview) -> int:  # pyright: ignore
        if not self._came:
            return self._sock.recv_into(buffer)
        count = min(len(buffer), len(self._came))
        buffer[:count], self._came = self._came[:count], self._came[count:]
        return count
