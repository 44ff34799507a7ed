"""Scenes: a simulation's requirements on components, and tables cut to them."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import asdict
from statistics import median
from typing import Annotated, Any, cast

import numpy as np
import orjson
from fastapi import APIRouter, Header, Query
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from wrenchbook.service.http import bodies
from wrenchbook.service.http.body import JsonRoute, read_body
from wrenchbook.service.http.openapi import BYTES, refused
from wrenchbook.service.http.problems import bad_body
from wrenchbook.service.http.routes import Newest, Opened, holds, json_reply, naming
from wrenchbook.service.http.routes.table import PACKED_TYPE
from wrenchbook.service.library.component import Component
from wrenchbook.service.messages import Message, Plan
from wrenchbook.service.mistakes import MAX_VALUE
from wrenchbook.service.tables.mapped import ServedTable
from wrenchbook.service.workspace import CATCH_UP_S, Workspace
from wrenchbook.surrogate.scene.cut import cut
from wrenchbook.surrogate.scene.plan import Need, NeedError, need_of, plan_of
from wrenchbook.surrogate.scene.savings import measured, not_measured
from wrenchbook.surrogate.table.rows import Floats, LoadRange
from wrenchbook.surrogate.table.space import Space

router = APIRouter(
    prefix="/v1", tags=["scenes"], responses=refused(404, 422), route_class=JsonRoute
)
SOLVES_TIMED = 32  # last done solves whose median is the time of a solve


class Plans(Message):
    components: dict[str, Plan]


@router.post("/scenes/plan", response_model=Plans)
async def plan_scene(workspace: Opened, scene: bodies.SceneBody) -> Response:
    """Plan a scene: the tables that its components need, and the savings."""
    components = {name: workspace.library[name] for name in scene.components}
    needs = {
        name: _need_of(components[name], wanted, f"components.{name}")
        for name, wanted in scene.components.items()
    }
    plans = {}
    for name, need in needs.items():
        component = components[name]
        table = await workspace.newest(name, CATCH_UP_S)
        plans[name] = await run_in_threadpool(_plan, workspace, component, table, need)
    return json_reply({"components": plans})


@router.get(
    "/components/{name}/scene",
    response_class=Response,
    responses={
        200: {
            "description": "packed table, as `Client.download(name, scene=)` reads it",
            "content": {PACKED_TYPE: BYTES},
        },
        304: {"description": "the version of If-None-Match is current"},
    },
)
def scene_table(
    name: str,
    workspace: Opened,
    table: Newest,
    wanted: Annotated[str, Query(max_length=8192)],
    if_none_match: Annotated[str | None, Header()] = None,
) -> Response:
    """Download a packed table reduced to a scene."""
    component = workspace.library[name]
    body = read_body(bodies.SceneComponent, wanted.encode(), "wanted")
    need = _need_of(component, body, "wanted")
    scene = orjson.dumps(body.model_dump(), option=orjson.OPT_SORT_KEYS)
    digest = hashlib.sha256(scene + component.fingerprint.encode()).hexdigest()[:16]
    tag = f'"{table.version}-{digest}-{table.packed.checksum:08x}"'
    if holds(if_none_match, tag):
        return Response(None, 304, naming(tag))

    # With the plan, also for a rigid or linear component. A strong ETag identifies bytes, so it
    # leaves out timings.
    plan = _plan(workspace, component, table, need, timed=False)
    content = b"".join(cut(table.packed, need, orjson.loads(json_reply(plan).body)))
    return Response(content, 200, naming(tag), PACKED_TYPE)


def _plan(
    workspace: Workspace,
    component: Component,
    table: ServedTable,
    need: Need,
    *,
    timed: bool = True,
) -> Plan:
    """Return a scene's plan of a component; without `timed` it is the same for the same table."""
    built = table.surrogate()
    plan = plan_of(built, need, solved=component.has_fea)
    saves: Any = asdict(
        measured(built, plan) if timed else not_measured("see POST /v1/scenes/plan")
    )
    origins = saves.pop("origin")

    of_range, of_scene = plan.solves
    origins["solves"] = "the component has no finite-element setup: nothing is solved"
    if component.has_fea:
        time_saved = _time_saved(workspace, component, of_range - of_scene) if timed else ""
        origins["solves"] = (
            f"counted: the first design of an empty table has {of_range} wrenches for the whole "
            f"load range and {of_scene} for the scene{time_saved}"
        )
    return Plan(
        decision=plan.decision,
        reason=plan.reason,
        loads=tuple(need.loads),
        axes=need.axes(),
        outputs=tuple(need.output_names()),
        tolerance=cast(Any, need.tolerance and asdict(need.tolerance)),
        displacement_bound=plan.bound,
        solves={"whole": of_range, "scene": of_scene},
        saves=saves,
        saves_from=origins,
        # Contiguous for the JSON writer.
        compliance=None if plan.compliance is None else np.ascontiguousarray(plan.compliance),
        table_version=table.version,
    )


def _time_saved(workspace: Workspace, component: Component, fewer_solves: int) -> str:
    """Return a text on the time of `fewer_solves` solves, by the median of the last ones."""
    jobs = workspace.ledger.jobs(component.name, "done", SOLVES_TIMED)
    times = [job.seconds for job in jobs if job.seconds is not None]
    if not times:
        return "; no solve of it has been timed here yet"
    each = median(times)
    return (
        f"; at {each:.3g} s a solve, the median of the last {len(times)}, that is "
        f"{fewer_solves * each:.3g} s less"
    )


def _need_of(component: Component, wanted: bodies.SceneComponent, where: str) -> Need:
    return need_from(component, wanted, wanted.outputs, wanted.tolerance, where, f"{where}.outputs")


def need_from(
    component: Component,
    span: bodies.SpaceSpan | None,
    outputs: Sequence[str] | None,
    tolerance: bodies.ToleranceBody | None,
    where: str,
    of_outputs: str,
) -> Need:
    """Return a scene's requirements on a component.

    `where` and `of_outputs` are the paths of the span and of the outputs in the body.

    Raises HttpProblemError (422) for unknown names and ends beyond the range.
    """
    load_range, names = component.load_range, component.space.output_names
    mistakes = [] if span is None else _unknown(span, load_range.space, where)
    for place, name in enumerate(outputs or ()):
        if name not in names:
            message = f"must be one of {', '.join(names)}, not {name[:MAX_VALUE]!r}"
            mistakes.append({"loc": f"{of_outputs}.{place}", "msg": message})
    if mistakes:
        raise bad_body(mistakes)

    bounds = None if span is None else _bounds(span, load_range)
    read = None if outputs is None else [names.index(name) for name in outputs]
    try:
        return need_of(load_range, bounds, read, bodies.tolerance_of(tolerance), component.idle)
    except NeedError as error:
        paths = []  # force.0, loads.left.force.0, inputs.temperature
        for number, load in enumerate(load_range.space.inputs):
            front = f"loads.{load.interface}." if load.interface else ""
            is_scalar = load.kind == "scalar"
            name = f"inputs.{load.name}" if is_scalar else f"{front}{load.kind}.{number % 3}"
            paths.append(f"{where}.{name}")
        raise bad_body([{"loc": paths[at], "msg": text} for at, text in error.mistakes]) from None


def _unknown(span: bodies.SpaceSpan, space: Space, where: str) -> list[dict[str, str]]:
    """Return the mistakes of interfaces and inputs that the component lacks."""
    known = ", ".join(space.interfaces)
    further = [load.name for load in space.scalars]
    mistakes = []
    for name in ("force", "moment"):
        if space.several and getattr(span, name) is not None:
            text = f"the component has the interfaces {known}; give 'loads' by interface"
            mistakes.append((name, text))
    for name in span.loads or ():
        if not space.several:
            text = "the component has one interface; give 'force' and 'moment'"
            mistakes.append(("loads", text))
        elif name not in space.interfaces:
            text = f"is not an interface of the component; name one of {known}"
            mistakes.append((f"loads.{name}", text))
    for name in span.inputs or ():
        if name in further:
            continue
        text = "is not a further input here: the component has none; leave inputs out"
        if further:
            text = f"is not a further input here; name one of {', '.join(further)}"
        mistakes.append((f"inputs.{name}", text))
    return [{"loc": f"{where}.{place}", "msg": text} for place, text in mistakes]


def _bounds(span: bodies.SpaceSpan, load_range: LoadRange) -> Floats:
    """Return the low and the high end of each input, shape (n, 2), N, N·m and further units."""
    loads, further = span.loads or {}, span.inputs or {}
    zero = [[0.0, 0.0]] * 3
    spans = []
    for name in load_range.space.interfaces:
        of_interface = loads.get(name, bodies.InterfaceSpan()) if name else span
        spans += [*(of_interface.force or zero), *(of_interface.moment or zero)]
    for load, low, high in zip(
        load_range.space.inputs, load_range.low, load_range.high, strict=True
    ):
        if load.kind == "scalar":
            spans.append(further.get(load.name, [low, high]))
    return np.array([[-ends, ends] if isinstance(ends, int | float) else ends for ends in spans])
