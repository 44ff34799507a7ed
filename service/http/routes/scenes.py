"""Scenes: what a simulation needs of its components, and its components' tables cut to that."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Annotated

import numpy as np
import orjson
from fastapi import APIRouter, Header, Query, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from wrenchbook.service.answering.scenes import scene_file, scene_reply
from wrenchbook.service.http.bodies import RangeBody, SceneBody, SceneComponent, ToleranceBody
from wrenchbook.service.http.body import read_limited
from wrenchbook.service.http.links import holds, naming
from wrenchbook.service.http.openapi import BYTES, refused, takes
from wrenchbook.service.http.parsing import read_body
from wrenchbook.service.http.problems import bad_body
from wrenchbook.service.http.replies import json_reply
from wrenchbook.service.http.routes import Opened
from wrenchbook.service.http.routes.table import PACKED_TYPE
from wrenchbook.service.http.schemas import Plans
from wrenchbook.service.library.component import Component
from wrenchbook.service.workspace import Workspace
from wrenchbook.surrogate.scene.need import Need, NeedError, need_of
from wrenchbook.surrogate.table.rows import Tolerance
from wrenchbook.surrogate.table.space import OUTPUTS

router = APIRouter(prefix="/v1", tags=["scenes"], responses=refused(404, 422))
CATCH_UP_S = 25.0


@router.post(
    "/scenes/plan",
    summary="What a scene needs of its components, and what that saves",
    response_model=Plans,
    openapi_extra=takes(SceneBody),
)
async def plan(request: Request, workspace: Opened) -> Response:
    scene = read_body(SceneBody, await read_limited(request.receive))
    needs = {name: _need(workspace, name, wanted) for name, wanted in scene.components.items()}
    plans = {}
    for name, need in needs.items():
        component, table = workspace.library[name], await workspace.newest(name, CATCH_UP_S)
        plans[name] = await run_in_threadpool(scene_reply, workspace, component, table, need)
    return json_reply({"components": plans})


@router.get(
    "/components/{name}/scene",
    summary="The packed table cut to a scene",
    response_class=Response,
    responses={
        200: {
            "description": "what Client.download(name, scene=) reads",
            "content": {PACKED_TYPE: BYTES},
        },
        304: {"description": "the caller has this version"},
    },
)
async def scene_table(
    name: str,
    workspace: Opened,
    wanted: Annotated[
        str, Query(max_length=8192, description="JSON: what /v1/scenes/plan takes a component")
    ],
    if_none_match: Annotated[str | None, Header()] = None,
) -> Response:
    component = workspace.library[name]
    body = read_body(SceneComponent, wanted.encode())
    need = need_from(component, body, body.outputs, body.tolerance, "wanted")
    table = await workspace.newest(name, CATCH_UP_S)
    scene = orjson.dumps(body.model_dump(), option=orjson.OPT_SORT_KEYS)
    what = hashlib.sha256(scene + component.fingerprint.encode()).hexdigest()[:16]
    tag = f'"{table.version}-{what}-{table.packed.checksum:08x}"'
    if holds(if_none_match, tag):
        return Response(None, 304, naming(tag))
    content = await run_in_threadpool(scene_file, workspace, component, table, need)
    return Response(content, 200, naming(tag), PACKED_TYPE)


def _need(workspace: Workspace, name: str, wanted: SceneComponent) -> Need:
    where = f"components.{name}"
    component = workspace.library[name]
    return need_from(component, wanted, wanted.outputs, wanted.tolerance, where)


def need_from(
    component: Component,
    span: RangeBody | None,
    outputs: Sequence[str] | None,
    tolerance: ToleranceBody | None,
    where: str,
) -> Need:
    """Return what a scene needs of a component, from the parts of a body.

    Raises
    ------
    HttpProblemError
        422, if an end is beyond the component's load range or the two ends are the wrong way round.
    """
    bounds = None if span is None else np.array(span.bounds())
    read = range(6) if outputs is None else [OUTPUTS.index(name) for name in outputs]
    limit = Tolerance(tolerance.translation, tolerance.rotation) if tolerance else None
    try:
        return need_of(component.load_range, bounds, read, limit, component.idle)
    except NeedError as error:
        raise bad_body([_mistake(where, *one) for one in error.mistakes]) from None


def _mistake(where: str, load: int, message: str) -> dict[str, str]:
    word, place = ("force", load) if load < 3 else ("moment", load - 3)
    return {"loc": f"{where}.{word}.{place}", "msg": message}
