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
from service.http.limited import MOST_BATCH_BYTES, read_limited
from service.http.parsing import read_batch, read_query, read_solve
from service.http.replies import write_batch, write_binary, write_outcome
from service.workspace import Workspace


class DirectRoute(APIRoute):
    """A call that takes the bare request: nothing of it is parsed before its endpoint runs."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return the endpoint itself."""
        return self.endpoint


router = APIRouter(prefix="/v1/components/{name}", tags=["displacement"], route_class=DirectRoute)


async def reply_to(workspace: Workspace, name: str, body: bytes) -> Response:
    """Answer the main call of a component from the call's body."""
    query = read_query(body)
    outcome = await answer_or_submit(workspace, name, query)
    return write_outcome(outcome, derivatives=query.derivatives)


@router.post(
    "/displacement", summary="The displacement under one wrench", description=CONTRACT_TEXT
)
async def displacement(request: Request) -> Response:
    workspace: Workspace = request.app.state.workspace
    body = await read_limited(request.receive)
    return await reply_to(workspace, request.path_params["name"], body)


@router.post(
    "/displacements", summary="The displacements under many wrenches", description=CONTRACT_TEXT
)
async def displacements(request: Request) -> Response:
    binary, body = is_binary(request), await read_limited(request.receive, MOST_BATCH_BYTES)
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
    query = read_solve(await read_limited(request.receive))
    workspace: Workspace = request.app.state.workspace
    return write_outcome(await answer_or_submit(workspace, request.path_params["name"], query))
