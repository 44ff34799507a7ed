"""Events of the server: jobs that change, new versions of tables."""

from __future__ import annotations

import http.client
import json
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from .connection import Connection
from .errors import ProblemError, ServerUnreachable

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
        What it says: of ``job`` its id, status, component and, while it runs, progress; of
        ``table`` its component and table_version; of ``missed`` and ``dropped`` the reason.
    id : str
        To go on after it, with ``client.events(after=...)``.
    """

    kind: str
    body: dict[str, Any]
    id: str = ""


class EventCalls(Connection):
    """Listen to the server."""

    def events(
        self,
        component: str | None = None,
        *,
        after: str | None = None,
        timeout_s: float | None = None,
    ) -> Iterator[Event]:
        """Iterate over the events of one component, or of all.

        While the server is away it is tried again and again, and then gone on with after the last
        event that was told; what it does not know any more is told as an event ``missed``.

        Parameters
        ----------
        component : str, optional
            Only events about this one.
        after : str, optional
            The id of an event that was told before.
        timeout_s : float, optional
            The iteration ends after so long without an event; never if not given.

        Yields
        ------
        Event
            Heartbeats are not told.

        Raises
        ------
        ProblemError
            If there is no such component (404), or too many listen (503).
        ServerUnreachable
            If nothing answers at the first attempt.
        """
        yield from self._listen_on(component, after, timeout_s)

    def _listen_on(
        self, component: str | None, last: str | None, timeout_s: float | None
    ) -> Iterator[Event]:
        """Tell the events of one connection after another."""
        heard, wait, first = time.monotonic(), AGAIN_S[0], True
        while True:
            left = None if timeout_s is None else heard + timeout_s - time.monotonic()
            if left is not None and left <= 0:
                return
            try:
                for event in self._listen(component, last, left):
                    last, heard, wait = event.id or last, time.monotonic(), AGAIN_S[0]
                    yield event
                    heard = time.monotonic()
            except ProblemError as error:
                if first or error.status < 500:
                    raise
            except (ServerUnreachable, http.client.HTTPException, OSError) as error:
                if first and not isinstance(error, TimeoutError):
                    raise
            first = False
            pause = wait if timeout_s is None else min(wait, heard + timeout_s - time.monotonic())
            time.sleep(max(pause, 0.0))
            wait = min(2 * wait, AGAIN_S[1])

    def _listen(
        self, component: str | None, last: str | None, left: float | None
    ) -> Iterator[Event]:
        """Tell the events of one connection; it ends when the connection does."""
        headers = {"Accept": "text/event-stream", **({"Last-Event-ID": last} if last else {})}
        seconds = SILENCE_S if left is None else min(SILENCE_S, left)
        query = {"component": component}
        with self.stream("/v1/events", query=query, headers=headers, timeout=seconds) as reply:
            yield from read_events(_until(reply, left))


def _until(reply: Iterable[bytes], left: float | None) -> Iterator[bytes]:
    """Pass on lines until an event has not come for so long; heartbeats are no events."""
    end = None if left is None else time.monotonic() + left
    for line in reply:
        yield line
        if not line.startswith(b":") and line.strip():
            end = None if left is None else time.monotonic() + left
        elif end is not None and time.monotonic() >= end:
            return


def read_events(lines: Iterable[bytes]) -> Iterator[Event]:
    """Read server-sent events from their lines (WHATWG HTML, section 9.2.6)."""
    kind, content, number = "message", [], ""
    for line in lines:
        name, _, value = line.rstrip(b"\r\n").decode().partition(":")
        value = value.removeprefix(" ")
        if name == "event":
            kind = value
        elif name == "data":
            content.append(value)
        elif name == "id":
            number = value
        elif not line.strip():
            if content:
                yield Event(kind, json.loads("\n".join(content)), number)
            kind, content = "message", []
