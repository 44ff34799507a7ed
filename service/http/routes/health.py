"""Health: is the process alive, and is it ready to answer."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Request
from starlette.responses import JSONResponse

from service.files.discreet import discreetly
from service.http.openapi import answers
from service.workspace import Workspace

router = APIRouter(prefix="/health", tags=["health"])


@router.get("/live", summary="The process answers", response_description="the process answers")
async def live() -> dict[str, str]:
    return {"status": "live"}


@router.get(
    "/ready",
    summary="Whether jobs are accepted and solved; which components are broken or still built",
    responses=answers(dict[str, Any], "ready")
    | answers(dict[str, Any], "not ready; see faults", 503),
)
def ready(request: Request) -> JSONResponse:
    workspace: Workspace = request.app.state.workspace
    faults = workspace.faults()
    body: dict[str, Any] = {
        "status": "ready" if not faults else "not ready",
        "components": len(workspace.library.names()),
        "solvers": workspace.settings.solvers,
        "faults": faults,
        "broken": workspace.broken(),
        "building": workspace.tables.building(),
    }
    return JSONResponse(discreetly(body), 200 if not faults else 503)
