"""The main call, its batch form and DirectFEA: read, answer or submit, write."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any

from fastapi import APIRouter, Request
from fastapi.routing import APIRoute
from starlette.responses import Response

from service.answering.many import answer_or_submit_many
from service.answering.one import answer_or_submit
from service.contract import CONTRACT_TEXT
from service.http.binary import is_binary, read_binary
from service.http.parsing import read_batch, read_query, read_solve
from service.http.replies import write_batch, write_binary, write_outcome
from service.workspace import Workspace


class DirectRoute(APIRoute):
    """A call that takes the bare request: nothing of it is parsed before its endpoint runs."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return the endpoint itself."""
        return self.endpoint


router = APIRouter(prefix="/v1/components/{name}", tags=["displacement"], route_class=DirectRoute)


@router.post(
    "/displacement", summary="The displacement under one wrench", description=CONTRACT_TEXT
)
async def displacement(request: Request) -> Response:
    query = read_query(await request.body())
    workspace: Workspace = request.app.state.workspace
    return write_outcome(await answer_or_submit(workspace, request.path_params["name"], query))


@router.post(
    "/displacements", summary="The displacements under many wrenches", description=CONTRACT_TEXT
)
async def displacements(request: Request) -> Response:
    binary, body = is_binary(request), await request.body()
    batch = read_binary(body, dict(request.query_params)) if binary else read_batch(body)
    workspace: Workspace = request.app.state.workspace
    outcome = await answer_or_submit_many(workspace, request.path_params["name"], batch)
    return write_binary(outcome) if binary else write_batch(outcome)


@router.post(
    "/solve",
    summary="DirectFEA: solve this wrench, whatever the table says",
    description=CONTRACT_TEXT,
)
async def solve(request: Request) -> Response:
    query = read_solve(await request.body())
    workspace: Workspace = request.app.state.workspace
    return write_outcome(await answer_or_submit(workspace, request.path_params["name"], query))
