"""Each component as a model of the UM-Bridge protocol 1.0, for its clients in any language."""

from __future__ import annotations

import logging
from typing import Annotated, Any, Literal

import orjson
from fastapi import APIRouter, Request
from pydantic import Field
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect
from starlette.responses import Response
from typing_extensions import TypedDict

from wrenchbook.service.answering.one import answer_or_submit
from wrenchbook.service.http import umbridge
from wrenchbook.service.http.bodies import Body
from wrenchbook.service.http.body import read_limited
from wrenchbook.service.http.openapi import answers, takes
from wrenchbook.service.http.problems import problem_of
from wrenchbook.service.http.routes.displacement import DirectRoute
from wrenchbook.service.http.umbridge import Call, UmBridgeError
from wrenchbook.service.library.component import UnknownComponentError
from wrenchbook.service.tables.served import TableBehindError
from wrenchbook.service.workspace import Workspace

log = logging.getLogger(__name__)

_Vector = Annotated[list[float], Field(min_length=6)]


class Failure(TypedDict):
    """The protocol's own form of an error."""

    type: Literal["ModelNotFound", "UnsupportedFeature", "InvalidInput", "InvalidOutput"]
    message: str


class Named(Body):
    """The body of a call about one component."""

    name: str


_Product = dict[Literal["output"], _Vector]
_Output = dict[Literal["output"], Annotated[list[_Vector], Field(min_length=1)]]
_Sizes = dict[Literal["inputSizes", "outputSizes"], list[int]]
_Error = dict[Literal["error"], Failure]
_ERRORS = answers(_Error, "a mistake of the caller", 400) | answers(
    _Error, "there is no output to give", 500
)


router = APIRouter(prefix="/umbridge", tags=["umbridge"], route_class=DirectRoute)


def _post(path: str, summary: str, reply: Any, body: Any = Named) -> Any:
    """Return the decorator of a call of the protocol."""
    described = {"summary": f"UM-Bridge: {summary}", "openapi_extra": takes(body)}
    return router.post(path, **described, response_model=reply, responses=_ERRORS)


@router.get("/Info", summary="UM-Bridge: the protocol's version and the components")
async def info(request: Request) -> Response:
    workspace: Workspace = request.app.state.workspace
    names = await run_in_threadpool(_names, workspace)
    return _reply({"protocolVersion": umbridge.PROTOCOL, "models": names})


@_post("/ModelInfo", "which calls a component supports", dict[Literal["support"], dict[str, bool]])
async def model_info(request: Request) -> Response:
    return await _constant_reply(request, {"support": umbridge.SUPPORT})


@_post("/InputSizes", "one vector in, the wrench, N and N·m", _Sizes)
async def input_sizes(request: Request) -> Response:
    return await _constant_reply(request, {"inputSizes": umbridge.SIZES})


@_post(
    "/OutputSizes",
    "one vector out, the displacement, m and rad",
    _Sizes,
)
async def output_sizes(request: Request) -> Response:
    return await _constant_reply(request, {"outputSizes": umbridge.SIZES})


@_post("/Evaluate", "the displacement under a wrench", _Output, umbridge.EvaluateBody)
async def evaluate(request: Request) -> Response:
    return await _answered(request, "Evaluate")


@_post("/Gradient", "J^T sens, J being du/dw", _Product, umbridge.ProductBody)
async def gradient(request: Request) -> Response:
    return await _answered(request, "Gradient")


@_post("/ApplyJacobian", "J vec, J being du/dw", _Product, umbridge.ProductBody)
async def apply_jacobian(request: Request) -> Response:
    return await _answered(request, "ApplyJacobian")


@_post("/ApplyHessian", "not offered; answers UnsupportedFeature", _Error)
async def apply_hessian(request: Request) -> Response:
    return await _constant_reply(request, None)


async def _constant_reply(request: Request, body: dict[str, Any] | None) -> Response:
    """Answer what is the same of every component; None: a call that no component supports."""
    try:
        await _named(request)
        if body is None:
            told = "ApplyHessian is not supported: tables tell first derivatives only"
            raise UmBridgeError("UnsupportedFeature", told)
        return _reply(body)
    except UmBridgeError as error:
        return _reply(error.body(), error.status)
    except Exception as error:
        return _refused(error)


async def _answered(request: Request, call: Call) -> Response:
    try:
        fields, name = await _named(request)
        query = umbridge.read_query(fields, call)
        direction = umbridge.read_direction(fields, call)
        outcome = await answer_or_submit(request.app.state.workspace, name, query)
        output = umbridge.output_of(call, outcome, direction)
    except UmBridgeError as error:
        return _reply(error.body(), error.status)
    except Exception as error:
        return _refused(error)
    # The protocol allows no further keys; headers tell what an answer is worth to whom looks.
    headers = {
        "Wrenchbook-Coverage": outcome.coverage,
        "Wrenchbook-Method": str(outcome.method),
        "Wrenchbook-Table-Version": str(outcome.table_version),
    }
    return _reply({"output": output}, headers=headers)


async def _named(request: Request) -> tuple[dict[str, Any], str]:
    """Return a body's fields and its component: the name is looked at before anything else."""
    fields = umbridge.read_fields(await read_limited(request.receive))
    workspace: Workspace = request.app.state.workspace
    name = fields.get("name")
    if isinstance(name, str) and name in workspace.library:
        return fields, name
    names = await run_in_threadpool(workspace.library.names)
    return fields, umbridge.model_name(fields, names)


def _names(workspace: Workspace) -> list[str]:
    """Return the components, those that have rows first: programs try the first of a list."""
    return sorted(workspace.library.names(), key=lambda name: not _has_rows(workspace, name))


def _has_rows(workspace: Workspace, name: str) -> bool:
    try:
        return workspace.tables.surrogate(name).row_count > 0
    except (TableBehindError, UnknownComponentError):  # still being built, or just removed
        return False


def _refused(error: Exception) -> Response:
    """Answer an error that has no word of its own in this protocol."""
    if isinstance(error, ClientDisconnect):
        raise error
    try:
        told = umbridge.error_of(problem_of(error))
    except Exception:
        log.exception("a call of /umbridge failed")
        told = UmBridgeError("InvalidOutput", "the server made a mistake; its log tells which")
    return _reply(told.body(), told.status)


def _reply(
    body: dict[str, Any], status: int = 200, headers: dict[str, str] | None = None
) -> Response:
    return Response(orjson.dumps(body), status, headers, "application/json")
