"""One file a resource of the HTTP interface."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends, Request

from wrenchbook.service.workspace import Workspace


async def _opened(request: Request) -> Workspace:
    return request.app.state.workspace


Opened = Annotated[Workspace, Depends(_opened)]
"""A parameter of a route: the workspace of the server."""
