"""The route of server-sent events: jobs that change, and new versions of tables."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Mapping
from typing import Annotated

from fastapi import APIRouter, Header, Request
from starlette.responses import Response, StreamingResponse
from starlette.types import Message, Receive, Scope, Send

from wrenchbook.service.events import Events, Feed, Listener
from wrenchbook.service.http.openapi import BODIES, refused
from wrenchbook.service.http.permission import permission_of
from wrenchbook.service.http.routes import Opened

router = APIRouter(prefix="/v1/events", tags=["events"], responses=refused(404, 422))

HEARTBEAT_S = 15.0  # s: below the idle limits of proxies, usually 60 s
SEND_S = 20.0  # s for a listener to read when the sockets' buffers are full; then it is dropped
HEADERS: Mapping[str, str] = {
    "Content-Type": "text/event-stream; charset=utf-8",
    "Cache-Control": "no-store",
    "X-Accel-Buffering": "no",  # otherwise nginx would buffer events
}


@router.get(
    "",
    response_class=Response,
    responses={
        200: {
            "description": "events until the connection ends",
            "content": {
                "text/event-stream": {"schema": {"type": "string", "description": BODIES["events"]}}
            },
        }
    },
)
async def events(
    request: Request,
    workspace: Opened,
    component: str | None = None,
    last_event_id: Annotated[str | None, Header(max_length=64)] = None,
) -> Response:
    """Server-sent events."""
    source: Events = request.app.state.events
    if component is not None:
        _ = workspace.library[component]  # raises UnknownComponentError: 404
    listener = await source.listen(component, last_event_id)
    request.app.state.access.end_with_key(listener, permission_of(request.scope))
    return EventStream(source.feed, listener)


class EventStream(StreamingResponse):
    """Events until the connection or the listener ends, or the caller reads none for `SEND_S`."""

    def __init__(self, feed: Feed, listener: Listener) -> None:
        self._feed = feed
        self._listener = listener

        async def events() -> AsyncIterator[bytes]:
            while not listener.ended:
                yield await listener.read(HEARTBEAT_S) or b":\n\n"  # a comment, the heartbeat
            yield await listener.read(0.0)

        super().__init__(events(), headers=HEADERS)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the events, then remove the listener from the feed."""

        async def send_in_time(message: Message) -> None:
            await asyncio.wait_for(send(message), SEND_S)

        try:
            with contextlib.suppress(TimeoutError):
                await super().__call__(scope, receive, send_in_time)
        finally:
            self._feed.leave(self._listener)
