"""One row of a component's table: where it comes from; withdraw it, restore it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from fastapi import APIRouter, Path, Request

from service.http.problems import ProblemError
from service.http.provenance import row_told
from service.ledger import RowStatusError
from service.workspace import Workspace

router = APIRouter(prefix="/v1/components/{name}/table/{row}", tags=["table"])

CATCH_UP_S = 10.0
# The ledger's numbers are SQLite's: 64 bits with a sign.
RowId = Annotated[int, Path(ge=1, lt=2**63, description="the row's id, its `seq`")]
RESPONSES: dict[int | str, dict[str, Any]] = {
    404: {"description": "No such component, or no such row in its table"},
    409: {"description": "The row is withdrawn already, or is in the table already"},
    503: {"description": "The ledger cannot be written; nothing was changed"},
}


@router.get("", summary="A row, and where it comes from", responses={404: RESPONSES[404]})
def one_row(name: str, row: RowId, request: Request) -> dict[str, Any]:
    workspace: Workspace = request.app.state.workspace
    return row_told(workspace, workspace.library[name], row)


@router.delete(
    "", summary="Withdraw a row: it leaves the table and its exports", responses=RESPONSES
)
def withdraw(name: str, row: RowId, request: Request) -> dict[str, Any]:
    workspace: Workspace = request.app.state.workspace
    return _edited(workspace, name, row, workspace.ledger.withdraw, "withdrawn")


@router.post("/restore", summary="Bring a withdrawn row back into the table", responses=RESPONSES)
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
