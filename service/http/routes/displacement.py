"""The main call, its batch form and DirectFEA: read, answer or submit, write."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any, TypeVar

from fastapi import APIRouter, Request
from fastapi.routing import APIRoute
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from wrenchbook.service.answering.many import answer_or_submit_many
from wrenchbook.service.answering.one import answer_or_submit
from wrenchbook.service.answering.queries import BatchQuery, Query
from wrenchbook.service.contract import CONTRACT_TEXT
from wrenchbook.service.http.access import Permission, beyond_scope, permission_of
from wrenchbook.service.http.batch import (
    BINARY_BODY,
    BINARY_REPLY,
    BinaryOptions,
    few_large,
    is_binary,
    read_batch_body,
    read_binary,
)
from wrenchbook.service.http.bodies import BatchBody, DisplacementBody, SolveBody
from wrenchbook.service.http.body import MAX_BATCH_BYTES, Spooled, read_limited, spooled
from wrenchbook.service.http.fast_path import QUERY
from wrenchbook.service.http.openapi import answers, refused, takes
from wrenchbook.service.http.parsing import read_query, read_solve, refuse_query
from wrenchbook.service.http.problems import HttpProblemError
from wrenchbook.service.http.replies import write_batch, write_binary, write_outcome
from wrenchbook.service.http.schemas import Displacement, Displacements
from wrenchbook.service.workspace import Workspace
from wrenchbook.surrogate.table.space import Space

Body = TypeVar("Body", bytes, Spooled)
Asked = TypeVar("Asked", Query, BatchQuery)


class DirectRoute(APIRoute):
    """A call that takes the bare request: nothing of it is parsed before its endpoint runs."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return the endpoint, called with the request and the path's parameters."""

        async def handle(request: Request) -> Response:
            return await self.endpoint(request=request, **request.path_params)

        return handle


router = APIRouter(
    prefix="/v1/components/{name}",
    tags=["displacement"],
    route_class=DirectRoute,
    responses=refused(404, 409, 422),
)


_SOLVED, _UNSOLVED = "covered, solved or estimated", "not solved yet: see job, or reason"
_ONE = answers(Displacement, _SOLVED) | answers(Displacement, _UNSOLVED, 202) | refused(424)
_MANY = answers(Displacements, _SOLVED, content=BINARY_REPLY) | answers(
    Displacements, _UNSOLVED, 202, content=BINARY_REPLY
)


def _asking(permission: Permission, read: Callable[[Body], Asked], body: Body) -> Asked:
    """Read the body of a caller with a key for reading; refuse a query that queues solves.

    Raises
    ------
    HttpProblemError
        403.
    """
    try:
        query = read(body)
    except HttpProblemError:
        raise beyond_scope(permission, "write") from None
    if query.on_thin not in ("estimate", "reject"):
        raise beyond_scope(permission, "write")
    return query


@router.post(
    "/displacement",
    summary="The displacement under one wrench",
    description=CONTRACT_TEXT,
    responses=_ONE,
    openapi_extra=takes(DisplacementBody),
)
async def displacement(name: str, request: Request) -> Response:
    workspace: Workspace = request.app.state.workspace
    scope, body = request.scope, await read_limited(request.receive)
    permission = permission_of(scope)
    refuse_query(request.query_params)
    read: Callable[[bytes], Query] = partial(
        read_query, space=workspace.library.as_read(name).space
    )
    asking = read if permission.allows("write") else partial(_asking, permission, read)
    query: Query = scope.get(QUERY) or asking(body)
    outcome = await answer_or_submit(workspace, name, query)
    request.app.state.counts.add(outcome.coverage, outcome.method, outcome.elapsed_us)
    return write_outcome(outcome, derivatives=query.derivatives)


@router.post(
    "/displacements",
    summary="The displacements under many wrenches",
    description=CONTRACT_TEXT,
    responses=_MANY,
    openapi_extra=takes(BatchBody, BINARY_BODY, BinaryOptions),
)
async def displacements(name: str, request: Request) -> Response:
    binary, permission = is_binary(request), permission_of(request.scope)
    workspace: Workspace = request.app.state.workspace
    space = workspace.library.as_read(name).space
    read: Callable[[Spooled], BatchQuery] = partial(read_batch_body, inputs=len(space.inputs))
    if binary:
        read = partial(_read_binary, options=dict(request.query_params), space=space)
    else:
        refuse_query(request.query_params)
    async with spooled(request.receive, MAX_BATCH_BYTES) as body:
        asking = read if permission.allows("write") else partial(_asking, permission, read)
        batch = await run_in_threadpool(asking, body)
        async with few_large(len(batch.wrenches)):
            outcome = await answer_or_submit_many(workspace, name, batch)
    request.app.state.counts.add_batch(outcome.coverage, outcome.method, outcome.elapsed_us)
    return await run_in_threadpool(write_binary if binary else write_batch, outcome)


def _read_binary(body: Spooled, options: dict[str, str], space: Space) -> BatchQuery:
    return read_binary(body.read(), options, space)


@router.post(
    "/solve",
    summary="DirectFEA: solve this wrench, covered or not",
    description=CONTRACT_TEXT,
    responses=_ONE,
    openapi_extra=takes(SolveBody),
)
async def solve(name: str, request: Request) -> Response:
    workspace: Workspace = request.app.state.workspace
    body = await read_limited(request.receive)
    query = read_solve(body, workspace.library.as_read(name).space)
    return write_outcome(await answer_or_submit(workspace, name, query))
