"""Requests handed on to the server that is followed, and its replies handed back, unchanged."""

from __future__ import annotations

import http.client
import queue
from collections.abc import Sequence
from typing import NamedTuple
from urllib.parse import urlsplit

Headers = Sequence[tuple[bytes, bytes]]
# The longest that a call may be held back there (`wait_s`), and some more.
PATIENCE_S = 660.0
CONNECT_S = 5.0
MOST_IDLE = 16
MOST_REPLY_BYTES = 1 << 30  # an export of the largest table there is
# What is between two neighbours on the way, and no part of the message (RFC 9110, section 7.6.1).
_OF_THE_HOP = frozenset(
    {
        b"connection", b"keep-alive", b"proxy-authenticate", b"proxy-authorization", b"te",
        b"trailer", b"transfer-encoding", b"upgrade", b"host", b"content-length", b"expect",
        b"accept-encoding", b"date", b"server",
    }
)  # fmt: skip
# Which page has sent a request was looked at here, against the name that this server goes by: the
# other one goes by another name, and would take this server's own page for one of another site.
_OF_THIS_DOOR = frozenset({b"origin", b"referer", b"sec-fetch-site"})
_REPEATABLE = frozenset({"GET", "HEAD", "OPTIONS"})


class AwayError(Exception):
    """The server that is followed does not answer; `sent` tells whether it may have acted."""

    def __init__(self, reason: str, *, sent: bool) -> None:
        super().__init__(reason)
        self.sent = sent


class Forwarded(NamedTuple):
    """A reply as it came."""

    status: int
    headers: list[tuple[bytes, bytes]]
    content: bytes


class Forwarder:
    """Connections to the server that is followed; for any number of threads.

    Parameters
    ----------
    url : str
        Its address.
    """

    def __init__(self, url: str) -> None:
        parts = urlsplit(url)
        self._path = parts.path.rstrip("/")
        self._where = parts.hostname or "", parts.port
        https = parts.scheme == "https"
        self._kind = http.client.HTTPSConnection if https else http.client.HTTPConnection
        self._idle: queue.LifoQueue[http.client.HTTPConnection] = queue.LifoQueue(MOST_IDLE)

    def send(self, method: str, target: str, headers: Headers, body: bytes) -> Forwarded:
        """Send a request and return its reply, whatever it says.

        One that must not be sent twice goes to a new connection, so that no connection that was
        closed meanwhile leaves in doubt whether it has arrived.

        Raises
        ------
        AwayError
            If there is no reply.
        """
        kept = self._kept() if method in _REPEATABLE else None
        if kept is not None:
            try:
                return self._exchange(kept, method, target, headers, body)
            except (http.client.HTTPException, OSError):
                kept.close()  # it was closed meanwhile: once more on a new one
        connection = self._kind(*self._where, timeout=CONNECT_S)
        try:
            connection.connect()
        except OSError as error:
            raise AwayError(str(error) or type(error).__name__, sent=False) from error
        try:
            connection.sock.settimeout(PATIENCE_S)
            return self._exchange(connection, method, target, headers, body)
        except (http.client.HTTPException, OSError) as error:
            connection.close()
            raise AwayError(str(error) or type(error).__name__, sent=True) from error

    def close(self) -> None:
        """Close the idle connections."""
        while (kept := self._kept()) is not None:
            kept.close()

    def _exchange(
        self,
        connection: http.client.HTTPConnection,
        method: str,
        target: str,
        headers: Headers,
        body: bytes,
    ) -> Forwarded:
        connection.putrequest(method, self._path + target, skip_accept_encoding=True)
        for name, value in headers:
            if name.lower() not in _OF_THE_HOP | _OF_THIS_DOOR:
                connection.putheader(name.decode("latin-1"), value)
        if body or method not in _REPEATABLE:
            connection.putheader("Content-Length", str(len(body)))
        connection.endheaders(body or None)
        response = connection.getresponse()
        content = response.read(MOST_REPLY_BYTES)
        fields = [
            (name.encode("latin-1"), value.encode("latin-1"))
            for name, value in response.getheaders()
            if name.lower().encode("latin-1") not in _OF_THE_HOP
        ]
        self._keep(connection, response)
        return Forwarded(response.status, fields, content)

    def _kept(self) -> http.client.HTTPConnection | None:
        try:
            return self._idle.get_nowait()
        except queue.Empty:
            return None

    def _keep(
        self, connection: http.client.HTTPConnection, response: http.client.HTTPResponse
    ) -> None:
        try:
            if response.will_close or not response.isclosed():
                connection.close()
            else:
                self._idle.put_nowait(connection)
        except queue.Full:
            connection.close()
