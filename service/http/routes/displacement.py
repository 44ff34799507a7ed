"""The main call, its batch form and DirectFEA: read, answer or submit, write."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AsyncExitStack
from typing import TypeVar

from fastapi import Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from wrenchbook.service.http import batch
from wrenchbook.service.http.access import beyond_scope
from wrenchbook.service.http.bodies import BatchBody, DisplacementBody, SolveBody
from wrenchbook.service.http.body import (
    MAX_BATCH_BYTES,
    Spooled,
    checked,
    loads_of,
    parsed_json,
    query_options,
    read_limited,
    read_query,
    spooled,
)
from wrenchbook.service.http.openapi import answers, component_router, refused, takes
from wrenchbook.service.http.permission import Permission, permission_of
from wrenchbook.service.http.problems import HttpProblemError
from wrenchbook.service.http.protocol import ANSWERED
from wrenchbook.service.http.routes import DirectRoute, json_reply
from wrenchbook.service.messages import Displacement, Displacements
from wrenchbook.service.query import (
    Floats,
    Outcome,
    Query,
    answer_or_submit,
    answer_or_submit_many,
    fields_of,
)
from wrenchbook.service.workspace import Workspace

Read = TypeVar("Read", Query, tuple[Floats, Query])
_READS = (
    "A displacement with on_thin 'estimate' or 'reject' (--on-thin estimate) needs only read, if "
    "its body has no mistake."
)


router = component_router("displacement", codes=(404, 409, 422, 429), route=DirectRoute)


_SOLVED, _UNSOLVED = (
    "answer: covered, solved or estimated",
    "estimate; the solve is not finished, see `job` or `reason`",
)
_ONE = answers(Displacement, _SOLVED) | answers(Displacement, _UNSOLVED, 202) | refused(424)
_MANY = answers(Displacements, _SOLVED, content=batch.BINARY_REPLY) | answers(
    Displacements, _UNSOLVED, 202, content=batch.BINARY_REPLY
)


def _permitted(permission: Permission, read: Callable[[], Read]) -> Read:
    """Return the query that `read` returns, if the key may send it.

    Raises HttpProblemError (403) for a read-only key if the query cannot be read or queues solves.
    """
    if permission.allows("write"):
        return read()
    try:
        result = read()
    except HttpProblemError:
        raise beyond_scope(permission, "write", _READS) from None
    query = result if isinstance(result, Query) else result[1]
    if query.on_thin not in ("estimate", "reject"):
        raise beyond_scope(permission, "write", _READS)
    return result


@router.post("/displacement", responses=_ONE, openapi_extra=takes(DisplacementBody))
async def displacement(name: str, request: Request) -> Response:
    """Displacement under one wrench."""
    workspace: Workspace = request.app.state.workspace
    query, outcome = request.scope.get(ANSWERED, (None, None))
    if query is None:
        body = await read_limited(request.receive)
        query_options(request.query_params, ())
        space = workspace.library.as_read(name).space
        query = _permitted(permission_of(request.scope), lambda: read_query(body, space))
    outcome = await answer_or_submit(workspace, name, query, outcome)
    reply = outcome.reply
    request.app.state.counts.add(reply.coverage, reply.method or None, outcome.elapsed_us)
    return write_outcome(outcome)


@router.post(
    "/displacements",
    responses=_MANY,
    openapi_extra=takes(BatchBody, batch.BINARY_BODY, batch.BinaryOptions),
)
async def displacements(name: str, request: Request) -> Response:
    """Displacements under many wrenches."""
    workspace: Workspace = request.app.state.workspace
    binary = batch.is_binary(request)
    permission = permission_of(request.scope)
    space = workspace.library.as_read(name).space
    known = batch.BinaryOptions.model_fields if binary else ()
    options = query_options(request.query_params, known)

    def read(body: Spooled) -> tuple[Floats, Query]:
        if binary:
            return batch.read_binary(body, options, space)
        return batch.read_batch_body(body, len(space.inputs))

    async with spooled(request.receive, MAX_BATCH_BYTES) as body:
        wrenches, query = await run_in_threadpool(_permitted, permission, lambda: read(body))
        async with AsyncExitStack() as held:
            slots = request.app.state.large_batches
            await held.enter_async_context(batch.few_large(slots, len(wrenches)))
            outcome = await answer_or_submit_many(workspace, name, wrenches, query)
            write = batch.write_binary if binary else batch.write_batch
            reply = await run_in_threadpool(write, outcome)
            count = outcome.replies.coverage, outcome.method, outcome.elapsed_us
            request.app.state.counts.add_batch(*count)
            return batch.HoldingReply(reply, held.pop_all())


@router.post("/solve", responses=_ONE, openapi_extra=takes(SolveBody))
async def solve(name: str, request: Request) -> Response:
    """DirectFEA: solve this wrench, covered or not."""
    workspace: Workspace = request.app.state.workspace
    content = await read_limited(request.receive)
    query_options(request.query_params, ())
    space = workspace.library.as_read(name).space
    body: SolveBody = checked(SolveBody, parsed_json(content))
    query = Query(loads_of(body, space), "solve", body.wait_s, beyond_range=body.beyond_range)
    return write_outcome(await answer_or_submit(workspace, name, query))


def write_outcome(outcome: Outcome) -> Response:
    """Return the reply to one query: 200, or 202 while its solve is not done."""
    reply = Displacement.of(fields_of(outcome))
    if not outcome.unsolved:
        return json_reply(reply)
    headers = {"Location": f"/v1/jobs/{outcome.job.id}"} if outcome.job else None
    return json_reply(reply, 202, headers)
