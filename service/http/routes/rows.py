"""One row of a component's table: where it comes from; withdraw it, restore it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from fastapi import APIRouter, Path, Request

from service.http.openapi import refused
from service.http.problems import ProblemError
from service.http.provenance import row_told
from service.ledger import RowStatusError
from service.workspace import Workspace

router = APIRouter(
    prefix="/v1/components/{name}/table/{row}",
    tags=["table"],
    responses=refused(404, 422),
)

CATCH_UP_S = 10.0
# The ledger's numbers are SQLite's: 64 bits with a sign.
RowId = Annotated[int, Path(ge=1, lt=2**63, description="the row's id, its `seq`")]
_EDITS = refused(s409="the row is withdrawn already, or is in the table already")


@router.get("", summary="A row, and where it comes from")
def one_row(name: str, row: RowId, request: Request) -> dict[str, Any]:
    workspace: Workspace = request.app.state.workspace
    return row_told(workspace, workspace.library[name], row)


@router.delete("", summary="Withdraw a row: it leaves the table and its exports", responses=_EDITS)
def withdraw(name: str, row: RowId, request: Request) -> dict[str, Any]:
    workspace: Workspace = request.app.state.workspace
    return _edited(workspace, name, row, workspace.ledger.withdraw, "withdrawn")


@router.post("/restore", summary="Bring a withdrawn row back into the table", responses=_EDITS)
def restore(name: str, row: RowId, request: Request) -> dict[str, Any]:
    workspace: Workspace = request.app.state.workspace
    return _edited(workspace, name, row, workspace.ledger.restore, "restored")


def _edited(
    workspace: Workspace, name: str, row: int, edit: Callable[[str, int], None], done: str
) -> dict[str, Any]:
    component = workspace.library[name]
    try:
        edit(component.name, row)
    except RowStatusError as error:
        raise ProblemError(
            409, "row-status", "The row's state does not allow this", str(error)
        ) from None
    current = workspace.tables.catch_up(name, CATCH_UP_S)
    version = workspace.tables.surrogate(name).version
    return {
        "component": name,
        "row": row,
        "status": done,
        "table_version": version,
        "current": current,
    }
