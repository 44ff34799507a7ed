"""The route of the audit: which actor wrote which change, and when."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query
from pydantic import AwareDatetime
from starlette.responses import Response

from wrenchbook.service.contract import NUMBER_LIMIT
from wrenchbook.service.http.openapi import refused
from wrenchbook.service.http.routes import Opened, cut_page
from wrenchbook.service.tables.rows import iso_time

router = APIRouter(prefix="/v1/audit", tags=["audit"], responses=refused(422))


@router.get("")
def list_audit(
    workspace: Opened,
    response: Response,
    component: Annotated[str | None, Query(max_length=300)] = None,
    actor: Annotated[str | None, Query(max_length=200)] = None,
    action: Annotated[str | None, Query(max_length=64)] = None,
    since: AwareDatetime | None = None,
    until: AwareDatetime | None = None,
    limit: Annotated[int, Query(ge=1, le=10_000)] = 1000,
    after: Annotated[int | None, Query(ge=1, lt=NUMBER_LIMIT)] = None,
) -> dict[str, Any]:
    """List writes, newest first, in pages; needs an admin key."""
    page = workspace.ledger.audit(
        component=component,
        actor=actor,
        action=action,
        since=since and since.timestamp(),
        until=until and until.timestamp(),
        limit=limit + 1,
        below=after,
    )
    query = {"component": component, "actor": actor, "action": action}
    query |= {"since": since and since.isoformat(), "until": until and until.isoformat()}
    next_url = cut_page(response, "/v1/audit", query | {"limit": limit}, page)
    entries = [
        {**vars(entry), "time": iso_time(entry.time), "actor": entry.actor or None}
        for entry in page
    ]
    return {"entries": entries, "next": next_url}
