"""Tables in a simulator's own process: their download, and the surrogate room when needed."""

from __future__ import annotations

import importlib
from typing import Any

from .connection import Connection
from .questions import component_path

# The room beside this one: `wrenchbook.surrogate` to a simulator, which may have a package of its
# own called `surrogate`; `surrogate` in the server and its tests, where this is `service.client`.
ROOM = "wrenchbook.surrogate" if __name__.startswith("wrenchbook.") else "surrogate"


def room(module: str) -> Any:
    """Return a module of the surrogate room.

    Raises
    ------
    ImportError
        If a package that it needs is not installed; the text says how to install it.
    """
    try:
        return importlib.import_module(f"{ROOM}.{module}")
    except ModuleNotFoundError as error:
        if error.name is None or error.name.startswith(ROOM):
            raise
        raise ImportError(
            f"a scene's table needs the package {error.name!r}, which is not installed: "
            "pip install 'wrenchbook[local]'",
            name=error.name,
        ) from error


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
