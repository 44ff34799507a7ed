"""Scenes: a simulation's requirements on components, and tables cut to them."""

from __future__ import annotations

import hashlib
from statistics import median
from typing import Annotated

import numpy as np
import orjson
from fastapi import APIRouter, Header, Query
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from wrenchbook.service.http import bodies
from wrenchbook.service.http.body import JsonRoute, read_body
from wrenchbook.service.http.needs import scene_need
from wrenchbook.service.http.openapi import BYTES, refused
from wrenchbook.service.http.routes import Newest, Opened, holds, json_reply, naming
from wrenchbook.service.http.routes.table import PACKED_TYPE
from wrenchbook.service.library.component import Component
from wrenchbook.service.messages import Message, Plan
from wrenchbook.service.tables.mapped import ServedTable
from wrenchbook.service.workspace import CATCH_UP_S, Workspace
from wrenchbook.surrogate.scene.cut import cut
from wrenchbook.surrogate.scene.plan import Need, plan_of
from wrenchbook.surrogate.scene.savings import measured, not_measured

router = APIRouter(
    prefix="/v1", tags=["scenes"], responses=refused(404, 422), route_class=JsonRoute
)
SOLVES_TIMED = 32  # last done solves whose median is the time of a solve


class Plans(Message):
    """Plans of a scene's components, by name."""

    components: dict[str, Plan]


@router.post("/scenes/plan", response_model=Plans)
async def plan_scene(workspace: Opened, scene: bodies.SceneBody) -> Response:
    """Plan a scene: the tables that its components need, and the savings."""
    components = {name: workspace.library[name] for name in scene.components}
    needs = {
        name: scene_need(components[name], wanted, f"components.{name}")
        for name, wanted in scene.components.items()
    }
    plans = {}
    # One after the other while the caller waits: at most `bodies.MAX_SCENE_COMPONENTS`.
    for name, need in needs.items():
        component = components[name]
        table = await workspace.newest(name, CATCH_UP_S)
        plans[name] = await run_in_threadpool(_plan, workspace, component, table, need)
    return json_reply(Plans(components=plans))


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
    need = scene_need(component, body, "wanted")
    scene = orjson.dumps(body.model_dump(), option=orjson.OPT_SORT_KEYS)
    digest = hashlib.blake2b(scene + component.fingerprint.encode(), digest_size=8).hexdigest()
    tag = f'"{table.version}-{digest}-{table.packed.checksum:08x}"'
    if holds(if_none_match, tag):
        return Response(None, 304, naming(tag))

    # With the plan, also for a rigid or linear component. A strong ETag identifies bytes, so it
    # leaves out timings.
    plan = _plan(workspace, component, table, need, timed=False)
    values = orjson.loads(orjson.dumps(plan, option=orjson.OPT_SERIALIZE_NUMPY))
    content = b"".join(cut(table.packed, need, values))
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
    savings = measured(built, plan) if timed else not_measured("see POST /v1/scenes/plan")
    of_range, of_scene = plan.solves
    solves_from = "the component has no finite-element setup: nothing is solved"
    if component.has_fea:
        time_saved = _time_saved(workspace, component, of_range - of_scene) if timed else ""
        solves_from = (
            f"counted: the first design of an empty table has {of_range} wrenches for the whole "
            f"load range and {of_scene} for the scene{time_saved}"
        )
    limit = need.tolerance
    return Plan(
        decision=plan.decision,
        reason=plan.reason,
        loads=tuple(need.loads),
        axes=need.axes(),
        outputs=tuple(need.output_names()),
        tolerance=limit and {"translation": limit.translation, "rotation": limit.rotation},
        displacement_bound=plan.bound,
        solves={"whole": of_range, "scene": of_scene},
        saves={
            "build_s": savings.build_s,
            "memory_bytes": savings.memory_bytes,
            "us_per_answer": savings.us_per_answer,
        },
        saves_from={**savings.origin, "solves": solves_from},
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
