"""The main call: a wrench in, a displacement out; and its batch form."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from time import perf_counter_ns
from typing import Any

import numpy as np
import orjson
from fastapi import APIRouter, Request
from fastapi.routing import APIRoute
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from service.contract import CONTRACT_TEXT
from service.http.binary import is_binary, read_binary, write_binary
from service.http.openapi import component_call, reply_schema
from service.http.parsing import Batch, Query, read_batch, read_query, unknown_method
from service.http.problems import ProblemError
from service.http.routes.jobs import job_link
from service.ledger import Job, LedgerRow
from service.workspace import Workspace
from surrogate.answers import Answer
from surrogate.surrogate import Surrogate


class DirectRoute(APIRoute):
    """A call that takes the bare request: nothing of it is parsed before its endpoint runs."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return the endpoint itself."""
        return self.endpoint


router = APIRouter(tags=["displacement"], route_class=DirectRoute)
COVERAGE = ("covered", "thin", "outside")
EXACT = "One row of the table has exactly this wrench."


@router.post(
    "/v1/components/{name}/displacement",
    summary="The displacement under one wrench",
    description=CONTRACT_TEXT,
    openapi_extra=component_call("DisplacementQuery"),
    responses=reply_schema("displacement"),
)
async def displacement(request: Request) -> Response:
    name = request.path_params["name"]
    query = read_query(await request.body())
    workspace: Workspace = request.app.state.workspace
    surrogate = workspace.surrogate(name)
    started = perf_counter_ns()
    try:
        answer = await _answered(surrogate, query)
    except ValueError as error:
        raise unknown_method(error) from None
    elapsed_us = (perf_counter_ns() - started) / 1e3
    fields = _fields(name, surrogate, query.wrench, answer, elapsed_us)
    if query.detail:
        fields["axes"] = surrogate.explain(query.wrench, query.tolerance, query.method)
    if answer.coverage == "covered" or query.on_thin == "estimate":
        return _json(fields)
    return await _when_thin(workspace, name, query, answer, fields)


async def _answered(surrogate: Surrogate, query: Query) -> Answer:
    """Answer here by the component's own method; others may have to be built first, elsewhere."""
    asked = (query.wrench, query.tolerance, query.method)
    if query.method is None:
        return surrogate.answer(*asked)
    return await run_in_threadpool(surrogate.answer, *asked)


async def _when_thin(
    workspace: Workspace, name: str, query: Query, answer: Answer, fields: dict[str, Any]
) -> Response:
    """Follow ``on_thin`` for a wrench the table does not cover."""
    if query.on_thin == "reject":
        raise ProblemError(
            409,
            "not-covered",
            "The table does not cover this wrench",
            f"{answer.reason} Ask with on_thin 'queue' or 'wait' to have it solved, or 'estimate' "
            "for the best guess.",
            coverage=answer.coverage,
        )
    job = await run_in_threadpool(
        workspace.order, name, query.wrench, urgent=query.on_thin == "wait"
    )
    if query.on_thin == "wait" and not job.is_final:
        job = await workspace.wait(job.id, query.wait_s)
    return await job_reply(workspace, job, fields)


async def job_reply(workspace: Workspace, job: Job, fields: dict[str, Any]) -> Response:
    """Answer with a job's row when it is done, its failure when it failed, else with 202."""
    if job.status == "failed":
        raise solve_failed(job)
    if job.status == "done" and job.row is not None:
        row = await run_in_threadpool(workspace.ledger.row, job.row)
        return _json({**fields, **_row_fields(row), "job": job_link(job)})
    fields["job"] = job_link(job)
    return _json(fields, 202, {"Location": fields["job"]["url"]})


def solve_failed(job: Job) -> ProblemError:
    """Describe a failed solve: what went wrong and its remedy."""
    error = job.error or {}
    return ProblemError(
        424,
        "solve-failed",
        f"The solve failed: {error.get('kind', 'unknown')}",
        f"{error.get('message', '')} {error.get('remedy', '')} "
        f"Once mended, POST /v1/jobs/{job.id}/retry.".strip(),
        job=job_link(job),
        error=error,
    )


@router.post(
    "/v1/components/{name}/displacements",
    summary="The displacements under many wrenches",
    description=CONTRACT_TEXT,
    openapi_extra=component_call("BatchQuery"),
    responses=reply_schema("displacements"),
)
async def displacements(request: Request) -> Response:
    name = request.path_params["name"]
    binary, body = is_binary(request), await request.body()
    batch = read_binary(body, dict(request.query_params)) if binary else read_batch(body)
    workspace: Workspace = request.app.state.workspace
    reply = await run_in_threadpool(_answer_batch, workspace, name, batch)
    if batch.on_thin == "wait" and reply["jobs"]:
        await workspace.wait_all([job["id"] for job in reply["jobs"]], batch.wait_s)
        await run_in_threadpool(_fill_in, workspace, reply)
    open_jobs = any(job["status"] in ("waiting", "running") for job in reply["jobs"])
    status = 202 if open_jobs else 200
    if binary:
        return write_binary(reply, status)
    return _json({**reply, "coverage": [COVERAGE[code] for code in reply["coverage"]]}, status)


def _answer_batch(workspace: Workspace, name: str, batch: Batch) -> dict[str, Any]:
    surrogate = workspace.surrogate(name)
    started = perf_counter_ns()
    try:
        answers = surrogate.batch(batch.wrenches, batch.tolerance, batch.method)
    except ValueError as error:
        raise unknown_method(error) from None
    elapsed_us = (perf_counter_ns() - started) / 1e3
    reply: dict[str, Any] = {
        "component": name,
        "displacements": answers.displacement,
        "errors": answers.error,
        "coverage": answers.coverage.tolist(),
        "jobs": [],
        "table_version": surrogate.version,
        "elapsed_us": elapsed_us,
    }
    thin = np.flatnonzero(answers.coverage)
    if not len(thin) or batch.on_thin == "estimate":
        return reply
    if batch.on_thin == "reject":
        raise ProblemError(
            409,
            "not-covered",
            "The table does not cover all wrenches",
            f"{len(thin)} of {len(batch.wrenches)} wrenches are not covered, the first is number "
            f"{thin[0]}. Ask with on_thin 'queue', 'wait' or 'estimate'.",
            uncovered=thin.tolist(),
        )
    jobs = workspace.order_many(name, batch.wrenches[thin])
    reply["jobs"] = [
        {"index": index, **job_link(job)} for index, job in zip(thin.tolist(), jobs, strict=True)
    ]
    _fill_in(workspace, reply)
    return reply


def _fill_in(workspace: Workspace, reply: dict[str, Any]) -> None:
    """Put the rows of the jobs that are done in the place of the table's estimates."""
    for link in reply["jobs"]:
        job = workspace.ledger.job(link["id"])
        link["status"] = job.status
        if job.status == "done" and job.row is not None:
            row = workspace.ledger.row(job.row)
            reply["displacements"][link["index"]] = row.displacement
            reply["errors"][link["index"]] = row.uncertainty or (0.0,) * 6
            reply["coverage"][link["index"]] = COVERAGE.index("covered")


def _fields(
    name: str,
    surrogate: Surrogate,
    wrench: tuple[float, ...],
    answer: Answer,
    elapsed_us: float,
) -> dict[str, Any]:
    value, error = answer.displacement, answer.error
    fields: dict[str, Any] = {
        "component": name,
        "translation": value[:3] if value else None,
        "rotation": value[3:] if value else None,
        "error": {"translation": error[:3], "rotation": error[3:]} if error else None,
        "coverage": answer.coverage,
        "source": "table" if value else None,
        "method": answer.method,
        "table_version": surrogate.version,
        "elapsed_us": elapsed_us,
    }
    if answer.reason:
        fields["reason"] = answer.reason
    if answer.method == "row":
        fields["source"] = surrogate.source_of(wrench)
        fields["reason"] = EXACT
    return fields


def _row_fields(row: LedgerRow) -> dict[str, Any]:
    """Describe the answer a solve of exactly this wrench gave."""
    error = row.uncertainty or (0.0,) * 6
    return {
        "translation": row.displacement[:3],
        "rotation": row.displacement[3:],
        "error": {"translation": error[:3], "rotation": error[3:]},
        "coverage": "covered",
        "source": row.source,
        "method": "row",
        "row": row.seq,
        "reason": EXACT,
    }


def _json(
    fields: dict[str, Any], status: int = 200, headers: dict[str, str] | None = None
) -> Response:
    content = orjson.dumps(fields, option=orjson.OPT_SERIALIZE_NUMPY)
    return Response(content, status, headers, "application/json")
