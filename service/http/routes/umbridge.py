"""Each component as a model of the UM-Bridge protocol 1.0, for its clients in any language.

UM-Bridge (Seelinger et al. 2023, "UM-Bridge: Uncertainty quantification and modeling bridge") lets
any program for uncertainty quantification or optimisation call any simulation. A component is a
model with one input vector of its n inputs, and one output vector of its m outputs: the wrench and
the displacement, six each, of a component with one interface.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Coroutine
from typing import Annotated, Any, Final, Literal, TypeVar

import numpy as np
from fastapi import APIRouter, Request
from pydantic import BaseModel, Field
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect
from starlette.responses import Response
from typing_extensions import TypedDict

from wrenchbook.service.http import bodies
from wrenchbook.service.http.body import parsed_json, read_limited
from wrenchbook.service.http.openapi import answers, takes
from wrenchbook.service.http.problems import problem_of
from wrenchbook.service.http.routes import DirectRoute, json_reply
from wrenchbook.service.library.component import MAX_QUOTED
from wrenchbook.service.ops.logs import REQUEST_ID
from wrenchbook.service.query import Outcome, answer_or_submit
from wrenchbook.service.tables.mapped import TableBehindError
from wrenchbook.service.workspace import Workspace
from wrenchbook.surrogate.table.space import Space

log = logging.getLogger(__name__)

SUPPORT: Final = {"Evaluate": True, "Gradient": True, "ApplyJacobian": True, "ApplyHessian": False}
DEFAULT_WAIT_S: Final = 600.0  # s: a caller of this protocol waits for a simulation of any duration
Kind = Literal["ModelNotFound", "UnsupportedFeature", "InvalidInput", "InvalidOutput"]


class UmBridgeError(Exception):
    """An error of one of the protocol's kinds."""

    def __init__(self, kind: Kind, message: str) -> None:
        super().__init__(message)
        self.kind: Kind = kind


class Failure(TypedDict):
    """The JSON of an error."""

    type: Kind
    message: str


class Named(BaseModel):
    """The body of a call of one component."""

    name: str


class Config(bodies.Body):
    """Options of a call."""

    method: bodies.Method = None
    tolerance: bodies.ToleranceBody | None = None
    on_thin: Literal["wait", "estimate", "reject"] = "wait"
    wait_s: bodies.Seconds = DEFAULT_WAIT_S
    beyond_range: bodies.Flag = False


class EvaluateBody(Named):
    """One wrench, and options."""

    input: Annotated[list[bodies.InputVector], Field(min_length=1, max_length=1)]
    config: Config | None = None


class ProductBody(EvaluateBody):
    """One wrench and the indices of its vector and of the output's, which are 0."""

    outWrt: Literal[0]  # noqa: N815  # the protocol's spelling
    inWrt: Literal[0]  # noqa: N815


class GradientBody(ProductBody):
    """Weights of the outputs, to multiply by the transposed derivative."""

    sens: bodies.OutputVector


class JacobianBody(ProductBody):
    """Vector of loads, to multiply by the derivative."""

    vec: bodies.InputVector


_Kind = TypeVar("_Kind", bound=Named)


class UmBridgeRoute(DirectRoute):
    """A call whose errors have the protocol's form."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return the endpoint, called with the request; errors become replies."""
        call = super().get_route_handler()

        async def handle(request: Request) -> Response:
            try:
                return await call(request)
            except ClientDisconnect:
                raise
            except Exception as error:
                kind, message = _failure(error)
            body = {"error": {"type": kind, "message": message}}
            return json_reply(body, 500 if kind == "InvalidOutput" else 400)

        return handle


router = APIRouter(prefix="/umbridge", tags=["umbridge"], route_class=UmBridgeRoute)

_Vector = dict[Literal["output"], list[float]]
_Sizes = dict[Literal["inputSizes", "outputSizes"], list[int]]
_Error = dict[Literal["error"], Failure]
_ERRORS = answers(_Error, "mistake in the request", 400) | answers(
    _Error, "no output is available", 500
)


def _post(path: str, summary: str, reply: Any, body: Any = Named) -> Any:
    """Return the decorator of a call of the protocol."""
    described = {"summary": f"UM-Bridge: {summary}", "openapi_extra": takes(body)}
    return router.post(path, **described, response_model=reply, responses=_ERRORS)


@router.get("/Info")
async def info(request: Request) -> Response:
    """UM-Bridge: the protocol's version and the components."""
    workspace: Workspace = request.app.state.workspace
    names = await run_in_threadpool(workspace.library.names)
    # Components with rows first: programs try the first of a list.
    filled = {name for name, table in workspace.tables.present().items() if table.row_count}
    models = sorted(names, key=lambda name: name not in filled)
    return json_reply({"protocolVersion": 1.0, "models": models})


@_post("/ModelInfo", "supported calls of a component", dict[Literal["support"], dict[str, bool]])
async def model_info(request: Request) -> Response:
    await _read(request, Named)
    return json_reply({"support": SUPPORT})


@_post("/InputSizes", "size of the input vector: wrench and further inputs", _Sizes)
async def input_sizes(request: Request) -> Response:
    _, space = await _read(request, Named)
    return json_reply({"inputSizes": [len(space.inputs)]})


@_post("/OutputSizes", "size of the output vector: displacement of each interface", _Sizes)
async def output_sizes(request: Request) -> Response:
    _, space = await _read(request, Named)
    return json_reply({"outputSizes": [len(space.outputs)]})


@_post(
    "/Evaluate",
    "the displacement under a wrench",
    dict[Literal["output"], Annotated[list[list[float]], Field(min_length=1)]],
    EvaluateBody,
)
async def evaluate(request: Request) -> Response:
    body, _ = await _read(request, EvaluateBody)
    outcome = await _outcome(request, body)
    names, reply = outcome.table.load_range.space.output_names, outcome.reply
    values = np.array(reply.outputs or (None,) * len(names), dtype=float)
    if np.isfinite(values).all():
        return _reply(outcome, [values.tolist()])
    lost = [name for name, value in zip(names, values, strict=True) if not np.isfinite(value)]
    why = reply.reason or "no row of the table has it; import or solve one"
    raise UmBridgeError("InvalidOutput", f"{', '.join(lost)} has no value at this wrench: {why}")


@_post("/Gradient", "transposed derivative times `sens`", _Vector, GradientBody)
async def gradient(request: Request) -> Response:
    body, _ = await _read(request, GradientBody)
    return await _product(request, body, body.sens, "sens")


@_post("/ApplyJacobian", "derivative times `vec`", _Vector, JacobianBody)
async def apply_jacobian(request: Request) -> Response:
    body, _ = await _read(request, JacobianBody)
    return await _product(request, body, body.vec, "vec")


@_post("/ApplyHessian", "not offered; answers UnsupportedFeature", _Error)
async def apply_hessian(request: Request) -> Response:
    await _read(request, Named)
    message = "ApplyHessian is not supported; use ApplyJacobian (first derivatives)"
    raise UmBridgeError("UnsupportedFeature", message)


async def _read(request: Request, kind: type[_Kind]) -> tuple[_Kind, Space]:
    """Return a body whose component exists and whose vectors fit its space, and that space."""
    fields = parsed_json(await read_limited(request.receive))
    if not isinstance(fields, dict):
        raise UmBridgeError("InvalidInput", 'the body must be a JSON object, as {"name": "plate"}')
    workspace: Workspace = request.app.state.workspace
    name = fields.get("name")
    if not isinstance(name, str) or name not in workspace.library:
        names = ", ".join(await run_in_threadpool(workspace.library.names))
        mistake = f"there is no component {str(name)[:MAX_QUOTED]!r}"
        if "name" not in fields:
            mistake = "the body has no 'name'"
        raise UmBridgeError("ModelNotFound", mistake + f"; name one of: {names}")
    space = workspace.library[name].space
    return kind.model_validate(fields, context={"space": space}), space


async def _outcome(request: Request, body: EvaluateBody, *, derivatives: bool = False) -> Outcome:
    """Return a solved or estimated answer, after waiting for rows that are not in the table yet."""
    workspace: Workspace = request.app.state.workspace
    config = body.config or Config()
    wrench = tuple(load + 0.0 for load in body.input[0])  # 0 for -0
    query = bodies.query_of(config, bodies.tolerance_of(config.tolerance))
    query = query._replace(wrench=wrench, derivatives=derivatives)
    try:
        outcome = await answer_or_submit(workspace, body.name, query)
    except TableBehindError:
        if not await workspace.caught_up(body.name, query.wait_s):
            raise
        outcome = await answer_or_submit(workspace, body.name, query)
    if not outcome.unsolved:
        return outcome
    if outcome.job is None:
        raise UmBridgeError("InvalidOutput", f"the wrench was not solved: {outcome.reply.reason}")
    raise UmBridgeError(
        "InvalidOutput",
        f"job {outcome.job.id} is still {outcome.job.status} after config wait_s; ask again "
        "later, or with a longer wait_s, or with config on_thin 'estimate'",
    )


async def _product(
    request: Request, body: EvaluateBody, vector: list[float], name: str
) -> Response:
    """Return the reply J^T sens, per N and N·m, or J vec, m and rad; J is du/dw (m, n), SI."""
    outcome = await _outcome(request, body, derivatives=True)
    derivative = outcome.details["derivative"]
    if derivative is None or not np.isfinite(derivative).all():
        why = outcome.reply.reason or "its rows do not determine it"
        message = f"the derivative is unknown at input {body.input[0]}: {why}. Add rows near it"
        raise UmBridgeError("InvalidOutput", message)
    product = (derivative.T if name == "sens" else derivative) @ np.array(vector)
    if not np.isfinite(product).all():
        largest = max(map(abs, vector))
        too_large = f"{name} times the derivative is too large; give numbers far below {largest:g}"
        raise UmBridgeError("InvalidInput", too_large)
    return _reply(outcome, product.tolist())


def _reply(outcome: Outcome, output: Any) -> Response:
    """Return a reply; the protocol allows no further keys, so the coverage is in the headers."""
    headers = {
        "Wrenchbook-Coverage": outcome.reply.coverage,
        "Wrenchbook-Method": outcome.reply.method,
        "Wrenchbook-Table-Version": str(outcome.table.version),
    }
    return json_reply({"output": output}, 200, headers)


def _failure(error: Exception) -> tuple[Kind, str]:
    """Return an error's kind in this protocol and its message; log an unknown error."""
    if isinstance(error, UmBridgeError):
        return error.kind, str(error)
    try:
        problem = problem_of(error)
    except Exception:
        log.exception("a call of /umbridge failed")
        number = REQUEST_ID.get()
        bug = f"the call failed because of a bug in the server (request {number}); report it with "
        return "InvalidOutput", bug + "the traceback, which the server's log has under this number"
    message = str(problem.body["detail"])
    mistakes = problem.body.get("errors")
    if problem.status == 422 and mistakes:
        texts = []
        for mistake in mistakes:
            # A dotted location with its indices in brackets: input[0][5].
            first, *rest = mistake["loc"].split(".")
            place = first + "".join(f"[{key}]" if key.isdecimal() else f".{key}" for key in rest)
            texts.append(f"{place}: {mistake['msg']}")
        message = "; ".join(texts)
    if problem.status == 404:
        return "ModelNotFound", message
    has_failed = problem.status >= 500 or problem.status == 424  # a failed solve, or the ledger
    kind: Kind = "InvalidOutput" if has_failed else "InvalidInput"
    return kind, message
