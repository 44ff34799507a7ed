"""Health, and metrics for Prometheus."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence
from typing import Any, Literal

from fastapi import APIRouter, Request
from prometheus_client import CONTENT_TYPE_LATEST
from starlette.responses import JSONResponse, PlainTextResponse, Response

from wrenchbook.service.files.redact import redact_values
from wrenchbook.service.http.openapi import answers, refused
from wrenchbook.service.http.routes import Opened
from wrenchbook.service.messages import Message
from wrenchbook.service.ops.metrics import Metrics
from wrenchbook.service.ops.replica import trouble_of
from wrenchbook.service.tables.mapped import ServedTable

router = APIRouter(tags=["health"])

TableState = Literal["ready", "building", "degraded", "broken"]
Status = Literal["ready", "building", "degraded", "not ready"]


class Readiness(Message):
    status: Status
    ready: bool
    components: int
    solvers: int
    faults: Sequence[str]
    broken: dict[str, str]
    building: Sequence[str]
    pending_rows: dict[str, int]
    tables: dict[str, TableState]
    copies: dict[str, Any]
    age_s: float | None


@router.get("/health/live", openapi_extra={"security": []})
async def live() -> dict[str, str]:
    """Liveness of the server; needs no key."""
    return {"status": "live"}


@router.get(
    "/health/ready",
    responses=answers(Readiness, "ready, degraded, or tables are being built")
    | answers(Readiness, "not ready; see faults", 503)
    | refused(404, 422),
)
def ready(workspace: Opened, component: str | None = None) -> JSONResponse:
    """Readiness of the server, of its tables and of its copies."""
    faults, broken, copies = workspace.faults(), workspace.broken(), workspace.copies
    components, present = workspace.library.all(), workspace.tables.present()
    rows = {
        item.name: workspace.unbuilt(item, present[item.name])[0]
        for item in components
        if item.name in present
    }
    pending = {name: count for name, count in rows.items() if count}
    names = {item.name for item in components} | workspace.library.broken().keys()
    tables: dict[str, TableState] = table_states(names, present, broken, pending)
    if component is not None:
        if component in tables:
            tables = {component: tables[component]}
        else:
            _ = workspace.library[component]  # raises if the component does not exist
            tables = {component: "building"}  # it was added after the list was read

    states = set(tables.values())
    copy_problem = trouble_of(copies, workspace.settings)
    status: Status = "ready"
    if faults:
        status = "not ready"
    elif "building" in states:
        status = "building"
    elif states & {"degraded", "broken"} or broken or copy_problem is not None:
        status = "degraded"
    reply = Readiness(
        status=status,
        ready=not faults and states <= {"ready"},
        components=len(components),
        solvers=workspace.settings.solvers,
        faults=faults,
        broken=broken,
        building=[name for name, state in tables.items() if state == "building"],
        pending_rows=pending,
        tables=tables,
        copies={**copies, "trouble": copy_problem},
        age_s=workspace.age(),
    )
    # 200 also while tables are built or damaged: a proxy goes on sending queries to the others.
    table_answers = component is None or tables[component] in ("ready", "degraded")
    return JSONResponse(redact_values(vars(reply)), 200 if table_answers and not faults else 503)


def table_states(
    names: Iterable[str],
    present: Mapping[str, ServedTable],
    broken: Container[str],
    pending: Mapping[str, int],
) -> dict[str, TableState]:
    """Return the state of each component's table, by name; `pending` rows are in no table yet.

    `present` are the tables that answer, `broken` the components with a problem. `degraded` answers
    although rows or files are damaged; `broken` does not answer.
    """
    states: dict[str, TableState] = {}
    for name in sorted(names):
        is_empty = name not in present or (name in pending and not present[name].row_count)
        if name in broken:
            states[name] = "broken" if is_empty else "degraded"
        else:
            states[name] = "building" if is_empty else "ready"
    return states


@router.get(
    "/metrics",
    response_class=PlainTextResponse,
    response_description="metrics in Prometheus' text form",
)
def metrics(request: Request) -> Response:
    """Get counts, times and states of the server, for Prometheus."""
    collected: Metrics = request.app.state.metrics
    return Response(collected.text(), media_type=CONTENT_TYPE_LATEST)
