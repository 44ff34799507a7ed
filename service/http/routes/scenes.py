"""Scenes: what a simulation needs of its components, and its components' tables cut to that."""

from __future__ import annotations

import hashlib
from typing import Annotated

import orjson
from fastapi import APIRouter, Header, Query, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from wrenchbook.service.answering.scenes import scene_file, scene_reply
from wrenchbook.service.http.bodies import SceneBody, SceneComponent
from wrenchbook.service.http.body import read_limited
from wrenchbook.service.http.needs import need_from
from wrenchbook.service.http.openapi import BYTES, refused, takes
from wrenchbook.service.http.parsing import read_body
from wrenchbook.service.http.replies import json_reply
from wrenchbook.service.http.routes import Opened
from wrenchbook.service.http.routes.table import PACKED_TYPE
from wrenchbook.service.http.schemas import Plans
from wrenchbook.service.http.versions import holds, naming
from wrenchbook.service.workspace import Workspace
from wrenchbook.surrogate.scene.need import Need

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
    told = {}
    for name, need in needs.items():
        component, table = workspace.library[name], await workspace.newest(name, CATCH_UP_S)
        told[name] = await run_in_threadpool(scene_reply, workspace, component, table, need)
    return json_reply({"components": told})


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
    told = orjson.dumps(body.model_dump(), option=orjson.OPT_SORT_KEYS)
    what = hashlib.sha256(told + component.fingerprint.encode()).hexdigest()[:16]
    tag = f'"{table.version}-{what}-{table.packed.checksum:08x}"'
    if holds(if_none_match, tag):
        return Response(None, 304, naming(tag))
    content = await run_in_threadpool(scene_file, workspace, component, table, need)
    return Response(content, 200, naming(tag), PACKED_TYPE)


def _need(workspace: Workspace, name: str, wanted: SceneComponent) -> Need:
    where = f"components.{name}"
    component = workspace.library[name]
    return need_from(component, wanted, wanted.outputs, wanted.tolerance, where)
