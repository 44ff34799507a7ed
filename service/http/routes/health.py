"""Health, and metrics for Prometheus."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from fastapi import APIRouter, Request
from prometheus_client import CONTENT_TYPE_LATEST
from starlette.responses import JSONResponse, PlainTextResponse, Response

from wrenchbook.service.files.redact import redact_values
from wrenchbook.service.http.openapi import answers, refused
from wrenchbook.service.http.routes import Opened
from wrenchbook.service.ops.metrics import Metrics
from wrenchbook.service.ops.replica import trouble_of
from wrenchbook.service.workspace import Workspace

router = APIRouter(tags=["health"])

TableState = Literal["ready", "building", "degraded", "broken"]


@router.get("/health/live", openapi_extra={"security": []})
async def live() -> dict[str, str]:
    """Liveness of the server; needs no key."""
    return {"status": "live"}


@router.get(
    "/health/ready",
    responses=answers(dict[str, Any], "ready, degraded, or tables are being built")
    | answers(dict[str, Any], "not ready; see faults", 503)
    | refused(404, 422),
)
def ready(workspace: Opened, component: str | None = None) -> JSONResponse:
    """Readiness of jobs and tables."""
    faults = workspace.faults()
    names = set(workspace.library.names())
    rows = {
        name: workspace.unbuilt(name, table)[0]
        for name, table in workspace.tables.present().items()
        if name in names
    }
    pending = {name: count for name, count in rows.items() if count}
    tables = table_states(workspace, pending)
    if component is not None:
        if component not in tables:
            _ = workspace.library[component]  # raises if the component does not exist
        tables = {component: tables.get(component, "building")}  # it may just have been added

    states = set(tables.values())
    broken = workspace.broken()
    trouble = trouble_of(workspace.copies, workspace.settings)
    status = "ready"
    if faults:
        status = "not ready"
    elif "building" in states:
        status = "building"
    elif states & {"degraded", "broken"} or broken or trouble is not None:
        status = "degraded"
    body = {
        "status": status,
        "ready": not faults and states <= {"ready"},
        "components": len(names),
        "solvers": workspace.settings.solvers,
        "faults": faults,
        "broken": broken,
        "building": [name for name, state in tables.items() if state == "building"],
        "pending_rows": pending,
        "tables": tables,
        "copies": {**workspace.copies, "trouble": trouble},
        "age_s": workspace.age(),
    }
    served = not faults and (component is None or tables[component] in ("ready", "degraded"))
    return JSONResponse(redact_values(body), 200 if served else 503)


def table_states(workspace: Workspace, pending: Mapping[str, int]) -> dict[str, TableState]:
    """Return the state of each component's table, by name; `pending` rows are in no table yet.

    `degraded` answers although rows or files are damaged; `broken` does not answer.
    """
    present = workspace.tables.present()
    broken = workspace.broken()
    building = workspace.tables.building()
    states: dict[str, TableState] = {}
    for name in sorted({*workspace.library.names(), *workspace.library.broken()}):
        is_empty = name in pending and not present[name].row_count
        if name in broken:
            states[name] = "degraded" if name in present and not is_empty else "broken"
        else:
            states[name] = "building" if name in building or is_empty else "ready"
    return states


@router.get(
    "/metrics",
    response_class=PlainTextResponse,
    response_description="metrics in Prometheus' text form",
)
def metrics(request: Request) -> Response:
    """Show counts and states for Prometheus."""
    metrics: Metrics = request.app.state.metrics
    return Response(metrics.text(), media_type=CONTENT_TYPE_LATEST)
