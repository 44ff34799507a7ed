"""Scenes: what a simulation needs of its components, and its components' tables cut to that."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Annotated

import numpy as np
import orjson
from fastapi import APIRouter, Header, Query
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from wrenchbook.service.answering.scenes import scene_file, scene_reply
from wrenchbook.service.http.bodies import (
    InterfaceSpan,
    SceneBody,
    SceneComponent,
    SpaceSpan,
    ToleranceBody,
    ends_of,
)
from wrenchbook.service.http.body import JsonRoute
from wrenchbook.service.http.links import holds, naming
from wrenchbook.service.http.openapi import BYTES, refused
from wrenchbook.service.http.parsing import read_body
from wrenchbook.service.http.problems import bad_body
from wrenchbook.service.http.replies import json_reply
from wrenchbook.service.http.routes import Opened
from wrenchbook.service.http.routes.table import PACKED_TYPE
from wrenchbook.service.library.component import Component
from wrenchbook.service.messages import Plans
from wrenchbook.surrogate.scene.need import Need, NeedError, need_of
from wrenchbook.surrogate.table.rows import Floats, LoadRange, Tolerance
from wrenchbook.surrogate.table.space import Space

router = APIRouter(
    prefix="/v1", tags=["scenes"], responses=refused(404, 422), route_class=JsonRoute
)
CATCH_UP_S = 25.0


@router.post(
    "/scenes/plan",
    summary="What a scene needs of its components, and what that saves",
    response_model=Plans,
)
async def plan_scene(workspace: Opened, scene: SceneBody) -> Response:
    needs = {
        name: _need_of(workspace.library[name], wanted, f"components.{name}")
        for name, wanted in scene.components.items()
    }
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
    need = _need_of(component, body, "wanted")
    table = await workspace.newest(name, CATCH_UP_S)
    scene = orjson.dumps(body.model_dump(), option=orjson.OPT_SORT_KEYS)
    what = hashlib.sha256(scene + component.fingerprint.encode()).hexdigest()[:16]
    tag = f'"{table.version}-{what}-{table.packed.checksum:08x}"'
    if holds(if_none_match, tag):
        return Response(None, 304, naming(tag))
    content = await run_in_threadpool(scene_file, workspace, component, table, need)
    return Response(content, 200, naming(tag), PACKED_TYPE)


def _need_of(component: Component, wanted: SceneComponent, where: str) -> Need:
    parts = wanted, wanted.outputs, wanted.tolerance
    return need_from(component, *parts, where, f"{where}.outputs")


def need_from(
    component: Component,
    span: SpaceSpan | None,
    outputs: Sequence[str] | None,
    tolerance: ToleranceBody | None,
    where: str,
    of_outputs: str,
) -> Need:
    """Return what a scene needs of a component, from the parts of a body.

    Parameters
    ----------
    where, of_outputs : str
        The places of the span and of the outputs in the body.

    Raises
    ------
    HttpProblemError
        422, if an interface, an input or an output is none of the component's, an end is beyond
        the component's load range or the two ends are the wrong way round.
    """
    whole, names = component.load_range, component.space.output_names
    mistakes = [] if span is None else _unknown(span, whole.space, where)
    for place, name in enumerate(outputs or ()):
        if name not in names:
            message = f"Input should be {in_words(names)}"
            mistakes.append({"loc": f"{of_outputs}.{place}", "msg": message})
    if mistakes:
        raise bad_body(mistakes)
    bounds = None if span is None else _bounds(span, whole)
    read = None if outputs is None else [names.index(name) for name in outputs]
    limit = Tolerance(tolerance.translation, tolerance.rotation) if tolerance else None
    try:
        return need_of(whole, bounds, read, limit, component.idle)
    except NeedError as error:
        places = _places(whole.space)
        found = [{"loc": f"{where}.{places[at]}", "msg": text} for at, text in error.mistakes]
        raise bad_body(found) from None


def in_words(names: Sequence[str]) -> str:
    """Return names as pydantic lists a literal's: ``'ux', 'uy' or 'uz'``."""
    *first, last = [repr(name) for name in names]
    return f"{', '.join(first)} or {last}" if first else last


def _unknown(span: SpaceSpan, space: Space, where: str) -> list[dict[str, str]]:
    """Return the mistakes of interfaces and inputs that the component has not."""
    several = len(space.interfaces) > 1
    known = ", ".join(space.interfaces)
    further = [one.name for one in space.inputs if one.kind == "scalar"]
    plain = [name for name in ("force", "moment") if getattr(span, name) is not None]
    found = []
    for name in plain if several else ():
        message = f"the component has the interfaces {known}: give 'loads' by interface"
        found.append({"loc": f"{where}.{name}", "msg": message})
    for name in span.loads or ():
        if not several:
            message = "the component has one interface: give 'force' and 'moment'"
            found.append({"loc": f"{where}.loads", "msg": message})
        elif name not in space.interfaces:
            message = f"no interface of the component, which has {known}"
            found.append({"loc": f"{where}.loads.{name}", "msg": message})
    for name in set(span.inputs or ()).difference(further):
        message = f"no further input of the component, which has {', '.join(further) or 'none'}"
        found.append({"loc": f"{where}.inputs.{name}", "msg": message})
    return found


def _bounds(span: SpaceSpan, whole: LoadRange) -> Floats:
    """Return the low and the high end of each input, shape (n, 2), N, N·m and further units."""
    loads, none, further = span.loads or {}, InterfaceSpan(), span.inputs or {}
    found = []
    for name in whole.space.interfaces:
        one = loads.get(name, none) if name else span
        found += ends_of(one.force, one.moment)
    for given, low, high in zip(whole.space.inputs, whole.low, whole.high, strict=True):
        if given.kind == "scalar":
            ends = further.get(given.name, [low, high])
            found.append([-ends, ends] if isinstance(ends, int | float) else list(ends))
    return np.array(found)


def _places(space: Space) -> list[str]:
    """Return where a body has each input: ``force.0``, ``loads.left.force.0``."""
    found = []
    for place, one in enumerate(space.inputs):
        if one.kind == "scalar":
            found.append(f"inputs.{one.name}")
        else:
            front = f"loads.{one.interface}." if one.interface else ""
            found.append(f"{front}{one.kind}.{place % 3}")
    return found
