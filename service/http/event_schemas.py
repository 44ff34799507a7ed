"""What the call of server-sent events answers, for the OpenAPI document."""

from __future__ import annotations

from typing import Final

from service.http.call import Call
from service.http.schemas import Schema

_STREAM: Final[Schema] = {
    "type": "string",
    "description": "server-sent events (WHATWG HTML, section 9.2), each with id, event and data, "
    "which is JSON. hello: you listen, data tells each table's version. job: a job has changed, "
    "data as a job's link with component, attempt and, while it runs, progress. jobs: more jobs "
    "have changed than are told one by one, data {component, count, url}. table: a new version of "
    "a component's table answers, data {component, table_version, rows}. missed: events since "
    "Last-Event-ID are not there any more, data {reason}: read jobs and components again. "
    "dropped: this listener read too slowly and is let go, data {reason}. Comments between are "
    "heartbeats",
}
EVENT_CALLS: Final[dict[tuple[str, str], Call]] = {
    ("get", "/v1/events"): Call(
        {200: "events for as long as the connection lives"},
        (404, 422),
        {"text/event-stream": _STREAM},
    )
}
