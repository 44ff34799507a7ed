"""Events of the server: jobs that change, new versions of tables."""

from __future__ import annotations

import http.client
import json
import time
from collections.abc import Iterator
from dataclasses import dataclass

from .errors import Document, ProblemError, ServerUnreachable
from .transport import Connection

SILENCE_S = 45.0  # three heartbeats: a connection without one is dead
AGAIN_S = (0.2, 5.0)  # between attempts while the server is away: doubled from, up to


@dataclass(frozen=True)
class Event:
    """One event.

    Parameters
    ----------
    kind : str
        ``hello``, ``job``, ``jobs``, ``table``, ``missed`` or ``dropped``.
    body : dict
        Of ``job`` its id, status, component and, while it runs, progress; of ``table`` its
        component and table_version; of ``missed`` and ``dropped`` the reason.
    id : str
        To go on after it, with ``client.events(after=...)``.
    """

    kind: str
    body: Document
    id: str = ""


class EventCalls(Connection):
    """Events of the server."""

    def events(
        self,
        component: str | None = None,
        *,
        after: str | None = None,
        timeout_s: float | None = None,
    ) -> Iterator[Event]:
        """Iterate over the events of one component, or of all; heartbeats are no events.

        While the server is away it is tried again and again. The iteration then goes on after the
        last event; where the server no longer has what came in between, an event is ``missed``.

        Parameters
        ----------
        component : str, optional
            Only events about this one.
        after : str, optional
            The id of an earlier event.
        timeout_s : float, optional
            The iteration ends after so long without an event; never if not given.

        Yields
        ------
        Event

        Raises
        ------
        ProblemError
            If there is no such component (404), or too many listen (503).
        ServerUnreachable
            If nothing answers at the first attempt.
        """
        last, wait, first = after, AGAIN_S[0], True
        limit = float("inf") if timeout_s is None else timeout_s
        newest = time.monotonic()  # when the last event came
        while True:
            if (left := newest + limit - time.monotonic()) <= 0:
                return
            headers = {"Accept": "text/event-stream", **({"Last-Event-ID": last} if last else {})}
            try:
                query = {"component": component}
                stream = self._listen("/v1/events", query, headers, min(SILENCE_S, left))
                try:
                    parser = EventParser()
                    while line := stream.readline():
                        event = parser.feed(line)
                        if event is not None:
                            last, wait = event.id or last, AGAIN_S[0]
                            yield event
                            newest = time.monotonic()
                        elif newest + limit <= time.monotonic():
                            return
                finally:
                    stream.close()
            except ProblemError as error:
                if first or error.status < 500:
                    raise
            except (ServerUnreachable, http.client.HTTPException, EOFError, OSError) as error:
                if first and not isinstance(error, TimeoutError):
                    raise
            first = False
            time.sleep(max(min(wait, newest + limit - time.monotonic()), 0.0))
            wait = min(2 * wait, AGAIN_S[1])


class EventParser:
    """Server-sent events from their lines (WHATWG HTML, section 9.2.6)."""

    def __init__(self) -> None:
        self._kind, self._id = "message", ""
        self._content: list[str] = []

    def feed(self, line: bytes) -> Event | None:
        """Take a line; return the event that it ends, if it ends one."""
        name, _, value = line.rstrip(b"\r\n").decode().partition(":")
        value = value.removeprefix(" ")
        if name == "event":
            self._kind = value
        elif name == "data":
            self._content.append(value)
        elif name == "id":
            self._id = value
        elif not line.strip():
            kind, content = self._kind, self._content
            self._kind, self._content = "message", []
            return Event(kind, json.loads("\n".join(content)), self._id) if content else None
        return None
