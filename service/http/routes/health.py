"""Health, and metrics for Prometheus."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Request
from prometheus_client import CONTENT_TYPE_LATEST
from starlette.responses import JSONResponse, PlainTextResponse, Response

from wrenchbook.service.files.redact import redact_values
from wrenchbook.service.http.openapi import answers
from wrenchbook.service.http.routes import Opened
from wrenchbook.service.ops.metrics import Metrics

router = APIRouter(tags=["health"])


@router.get("/health/live", summary="The process answers")
async def live() -> dict[str, str]:
    return {"status": "live"}


@router.get(
    "/health/ready",
    summary="Whether jobs are accepted and solved; which components are broken or still built",
    responses=answers(dict[str, Any], "ready")
    | answers(dict[str, Any], "not ready; see faults", 503),
)
def ready(workspace: Opened) -> JSONResponse:
    faults = workspace.faults()
    body: dict[str, Any] = {
        "status": "ready" if not faults else "not ready",
        "components": len(workspace.library.names()),
        "solvers": workspace.settings.solvers,
        "faults": faults,
        "broken": workspace.broken(),
        "building": workspace.tables.building(),
    }
    return JSONResponse(redact_values(body), 200 if not faults else 503)


@router.get(
    "/metrics",
    summary="Counts and states for Prometheus",
    response_class=PlainTextResponse,
    response_description="metrics in Prometheus' text form",
)
def metrics(request: Request) -> Response:
    found: Metrics = request.app.state.metrics
    return Response(found.text(), media_type=CONTENT_TYPE_LATEST)
