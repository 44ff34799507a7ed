"""Tables in a simulator's own process: their download, and the surrogate room when needed."""

from __future__ import annotations

import importlib
from typing import Any

from .connection import Connection
from .questions import component_path


def room(module: str) -> Any:
    """Return a module of the surrogate package; it needs numpy alone."""
    return importlib.import_module(f"wrenchbook.surrogate.{module}")


def fetched_table(
    client: Connection, name: str, call: str, query: dict[str, Any], etag: str | None
) -> tuple[bytes, str | None] | None:
    """Return a component's table file and its ETag; None if the server's is that of `etag`."""
    reply = client.call(
        "GET",
        component_path(name, call),
        query=query,
        headers={"If-None-Match": etag} if etag else None,
    )
    tag = reply.headers.get("ETag")
    # Some proxies answer from a cache of theirs with 200 where nothing is new.
    if reply.status == 304 or (etag is not None and tag == etag):
        return None
    return reply.content, tag
