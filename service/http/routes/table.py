"""A component's table: bulk import from outside, and export."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal

import orjson
from fastapi import APIRouter, Query, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from service.http.problems import ProblemError
from service.library.component import Component
from service.tablefile import (
    ParsedTable,
    UnitError,
    read_csv,
    read_json,
    write_csv,
    write_json,
)
from service.tables.rows import foreign_rows, insert, usable_rows
from service.workspace import Workspace

router = APIRouter(prefix="/v1/components/{name}/table", tags=["table"])

Format = Literal["csv", "json"]
MAX_TABLE_BYTES = 256 * 1024 * 1024
CATCH_UP_S = 10.0
_FORMATS = {"text/csv": "csv", "application/csv": "csv", "application/json": "json"}
_MEDIA_TYPES = {"csv": "text/csv; charset=utf-8", "json": "application/json"}
_READERS: dict[str, Callable[[bytes], ParsedTable]] = {"csv": read_csv, "json": read_json}


@router.get("", summary="Export the table")
def export_table(
    name: str,
    request: Request,
    format: Format = "json",  # noqa: A002 (the contract's word)
    force: Annotated[str, Query(description="csv: unit of forces")] = "N",
    moment: Annotated[str, Query(description="csv: unit of moments")] = "N*m",
    translation: Annotated[str, Query(description="csv: unit of translations")] = "m",
    rotation: Annotated[str, Query(description="csv: unit of rotations")] = "rad",
) -> Response:
    workspace: Workspace = request.app.state.workspace
    component = workspace.library[name]
    rows = usable_rows(workspace.ledger, component)
    if format == "json":
        return Response(write_json(rows), 200, None, _MEDIA_TYPES["json"])
    units = {"force": force, "moment": moment, "translation": translation, "rotation": rotation}
    try:
        text = write_csv(rows, units=units)
    except UnitError as error:
        raise ProblemError(422, "unit", "Not a unit this export can use", str(error)) from None
    headers = {"Content-Disposition": f'attachment; filename="{name}.csv"'}
    return Response(text, 200, headers, _MEDIA_TYPES["csv"])


@router.post("", summary="Bulk import: all rows or none")
async def import_table(
    name: str,
    request: Request,
    format: Format | None = None,  # noqa: A002 (the contract's word)
    dry_run: bool = False,
) -> Response:
    workspace: Workspace = request.app.state.workspace
    component = workspace.library[name]
    body = await request.body()
    if len(body) > MAX_TABLE_BYTES:
        raise ProblemError(
            413, "too-large", "The table is too large", "Send at most 256 MiB a call; send parts."
        )
    reader = _READERS[format or _format_of(request)]
    reply = await run_in_threadpool(_import, workspace, component, reader, body, dry_run)
    if reply["errors"] and not dry_run:
        raise _refused(reply["errors"])
    return Response(orjson.dumps(reply), 200, None, "application/json")


def _format_of(request: Request) -> str:
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if kind not in _FORMATS:
        raise ProblemError(
            415,
            "media-type",
            "Not a form of table this call takes",
            f"The content type is {kind or 'missing'}. Send text/csv or application/json, or say "
            "?format=csv or ?format=json.",
        )
    return _FORMATS[kind]


def _import(
    workspace: Workspace,
    component: Component,
    reader: Callable[[bytes], ParsedTable],
    body: bytes,
    dry_run: bool,
) -> dict[str, Any]:
    """Read, check and, unless something is wrong or it is a dry run, insert in one transaction."""
    table = reader(body)
    errors = [error.as_dict() for error in (*table.errors, *foreign_rows(component, table))]
    inserted = existing = 0
    if not errors:
        inserted, existing = insert(workspace.ledger, component, table, dry_run=dry_run)
    if inserted and not dry_run:
        workspace.tables.catch_up(component.name, CATCH_UP_S)
    return {
        "inserted": inserted,
        "existing": existing,
        "errors": errors,
        "dry_run": dry_run,
        "table_version": workspace.tables.surrogate(component.name).version,
    }


def _refused(errors: list[dict[str, Any]]) -> ProblemError:
    first = errors[0]
    return ProblemError(
        422,
        "bad-rows",
        "The table has mistakes",
        f"Nothing was loaded. {len(errors)} mistake(s); the first is in row {first['row']}, "
        f"{first['field']}: {first['message']}. Mend them and send the whole file again.",
        inserted=0,
        existing=0,
        errors=[
            {**error, "loc": f"row {error['row']}.{error['field']}", "msg": error["message"]}
            for error in errors
        ],
    )
