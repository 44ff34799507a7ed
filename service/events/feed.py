"""Events kept for a while, and those who listen to them. Used on one event loop."""

from __future__ import annotations

import asyncio
import secrets
from collections import deque
from dataclasses import dataclass
from typing import Any

import orjson

KEPT = 2_000  # events held for those who come back: 0.6 MB
MOST_LISTENERS = 64  # each is a connection and at most `BEHIND` events
# Events a listener may be behind: minutes of usual work, a burst of the most told one by one.
BEHIND = 256


class TooManyListenersError(Exception):
    """All places of listeners are taken."""


@dataclass(frozen=True)
class FeedEvent:
    """One event as it goes over the wire.

    Attributes
    ----------
    number : int
        Counts up within one life of the feed.
    component : str or None
        Whom it is about; None for all listeners.
    wire : bytes
        Its lines.
    """

    number: int
    component: str | None
    wire: bytes


class Listener:
    """One who listens: what it has not read yet, at most `BEHIND` events."""

    def __init__(self, component: str | None) -> None:
        self.component = component
        self.ended = False
        self._waiting: deque[bytes] = deque()
        self._ready = asyncio.Event()

    def wants(self, event: FeedEvent) -> bool:
        """Tell whether an event is for this listener."""
        return self.component is None or event.component in (None, self.component)

    def put(self, wire: bytes) -> bool:
        """Add an event's lines; False if this listener is too far behind."""
        if len(self._waiting) >= BEHIND:
            return False
        self._waiting.append(wire)
        self._ready.set()
        return True

    def end(self, last: bytes = b"") -> None:
        """Let the listener go: it reads `last` and nothing of what it has not read."""
        self._waiting.clear()
        self.ended = True
        if last:
            self._waiting.append(last)
        self._ready.set()

    async def read(self, seconds: float) -> bytes:
        """Return all lines there are, waiting for the first; nothing after `seconds`."""
        if not self._waiting and not self.ended:
            try:
                await asyncio.wait_for(self._ready.wait(), seconds)
            except TimeoutError:
                return b""
        lines = b"".join(self._waiting)
        self._waiting.clear()
        self._ready.clear()
        return lines


class Feed:
    """The events of one server's life.

    An id is the feed's own mark and a number: one of an earlier life is told from one of this.
    """

    def __init__(self) -> None:
        self._mark = secrets.token_hex(4)
        self._number = 0
        self._kept: deque[FeedEvent] = deque(maxlen=KEPT)
        self._listeners: set[Listener] = set()
        self.closed = False

    @property
    def listeners(self) -> int:
        """How many listen."""
        return len(self._listeners)

    def publish(self, kind: str, component: str | None, body: dict[str, Any]) -> None:
        """Tell an event to all who want it, and keep it for those who come back."""
        self._number += 1
        event = FeedEvent(self._number, component, _wire(kind, body, self._id(self._number)))
        self._kept.append(event)
        for listener in [one for one in self._listeners if one.wants(event)]:
            if not listener.put(event.wire):
                self._drop(listener)

    def listen(self, component: str | None, last_id: str | None, hello: dict[str, Any]) -> Listener:
        """Add a listener, to be told what came after `last_id` and then what comes.

        Raises
        ------
        TooManyListenersError
            If there are `MOST_LISTENERS`.
        """
        if len(self._listeners) >= MOST_LISTENERS:
            raise TooManyListenersError(
                f"{MOST_LISTENERS} listeners are connected, the most this server has; end one, or "
                "poll GET /v1/jobs and GET /v1/components"
            )
        listener = Listener(component)
        missed = self._missed(last_id, listener) if last_id else []
        listener.put(b"retry: 2000\n" + _wire("hello", hello, None if missed else self._newest()))
        if missed is None:
            reason = "the events since your last one are not there any more: read jobs and tables"
            listener.put(_wire("missed", {"reason": reason}, self._newest()))
        for event in missed or ():
            listener.put(event.wire)
        self._listeners.add(listener)
        if self.closed:
            listener.end()
        return listener

    def leave(self, listener: Listener) -> None:
        """Forget a listener."""
        self._listeners.discard(listener)

    def forget(self) -> None:
        """Begin a new life: nobody has listened for long, and what has happened is not known."""
        self._mark = secrets.token_hex(4)
        self._kept.clear()

    def close(self) -> None:
        """Let all listeners go: the server stops."""
        self.closed = True
        for listener in list(self._listeners):
            listener.end()

    def _missed(self, last_id: str, listener: Listener) -> list[FeedEvent] | None:
        """Return what a listener has missed since an id; None if that is not known any more."""
        mark, _, number = last_id.partition(".")
        if mark != self._mark or not number.isdecimal() or int(number) > self._number:
            return None
        since = int(number)
        if since < self._number - len(self._kept):
            return None
        missed = [event for event in self._kept if event.number > since and listener.wants(event)]
        return missed if len(missed) < BEHIND - 2 else None

    def _drop(self, listener: Listener) -> None:
        self._listeners.discard(listener)
        reason = (
            f"this listener was more than {BEHIND} events behind; connect again with the id of the "
            "last one you have read"
        )
        listener.end(_wire("dropped", {"reason": reason}, None))

    def _newest(self) -> str:
        return self._id(self._number)

    def _id(self, number: int) -> str:
        return f"{self._mark}.{number}"


def _wire(kind: str, body: dict[str, Any], number: str | None) -> bytes:
    """Return an event's lines; JSON on one line, so no data of it can be taken for a field."""
    lines = [b"event: " + kind.encode(), b"data: " + orjson.dumps(body)]
    if number is not None:
        lines.insert(0, b"id: " + number.encode())
    return b"\n".join(lines) + b"\n\n"
