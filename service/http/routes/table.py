"""A component's table: bulk import from outside, and export."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Annotated, Any, Literal

import orjson
from fastapi import APIRouter, Header, Query, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from service.http.problems import ProblemError
from service.http.routes.table_schema import (
    EXPORT_REPLIES,
    IMPORT_BODY,
    IMPORT_REPLIES,
    MEDIA_TYPES,
)
from service.library.component import Component
from service.tablefile import (
    ParsedTable,
    UnitError,
    read_csv,
    read_hdf5,
    read_json,
    write_csv,
    write_hdf5,
    write_json,
)
from service.tables.rows import ExportRows, insert, misplaced_rows, table_meta, usable_rows
from service.workspace import Workspace

router = APIRouter(prefix="/v1/components/{name}/table", tags=["table"])

Format = Literal["csv", "json", "hdf5"]
Reader = Callable[[bytes], ParsedTable]
MAX_TABLE_BYTES = 256 * 1024 * 1024
_FORMATS = {kind: name for name, kind in MEDIA_TYPES.items()} | {"application/csv": "csv"}


@router.get("", summary="Export the table", response_class=Response, responses=EXPORT_REPLIES)
def export_table(
    name: str,
    request: Request,
    format: Format = "json",  # noqa: A002 (the contract's word)
    force: Annotated[str, Query(description="csv: unit of forces")] = "N",
    moment: Annotated[str, Query(description="csv: unit of moments")] = "N*m",
    translation: Annotated[str, Query(description="csv: unit of translations")] = "m",
    rotation: Annotated[str, Query(description="csv: unit of rotations")] = "rad",
    if_none_match: Annotated[str | None, Header(description="a version held already")] = None,
) -> Response:
    workspace: Workspace = request.app.state.workspace
    component = workspace.library[name]
    # Only a table that is behind the ledger has to be read before its version is known.
    if workspace.tables.catch_up(name, 0.0):
        tag = _tag(component, workspace.tables.surrogate(name).version)
        if _holds(if_none_match, tag):
            return Response(status_code=304, headers=_naming(tag))
    rows = usable_rows(workspace.ledger, component)
    headers = _naming(_tag(component, rows.version))
    if format != "json":
        filename = f"{name}-v{rows.version}.{'csv' if format == 'csv' else 'h5'}"
        headers["Content-Disposition"] = f'attachment; filename="{filename}"'
    units = {"force": force, "moment": moment, "translation": translation, "rotation": rotation}
    content = _written(format, component, rows, units)
    kind = MEDIA_TYPES[format] + ("; charset=utf-8" if format == "csv" else "")
    return Response(content, 200, headers, kind)


@router.post(
    "",
    summary="Bulk import: all rows or none",
    response_class=Response,
    responses=IMPORT_REPLIES,
    openapi_extra=IMPORT_BODY,
)
async def import_table(
    name: str,
    request: Request,
    format: Format | None = None,  # noqa: A002 (the contract's word)
    dry_run: bool = False,
    decimal: Annotated[
        Literal[".", ","] | None, Query(description="csv: the decimal mark; told if not given")
    ] = None,
) -> Response:
    workspace: Workspace = request.app.state.workspace
    component = workspace.library[name]
    reader = _reader(format or _format_of(request), component, decimal)
    body = await _limited_body(request)
    reply = await run_in_threadpool(_import, workspace, component, reader, body, dry_run)
    if reply["errors"] and not dry_run:
        raise _refused(reply["errors"])
    return Response(orjson.dumps(reply), 200, None, "application/json")


def _tag(component: Component, version: int) -> str:
    """Return what differs with a table's rows; an edited setup has others at the same version."""
    return f'"{version}-{component.fingerprint}"' if component.has_fea else f'"{version}"'


def _naming(tag: str) -> dict[str, str]:
    """Return the headers that name a table's version; no cache may serve it unasked."""
    return {"ETag": tag, "Cache-Control": "no-cache"}


def _holds(if_none_match: str | None, tag: str) -> bool:
    """Tell whether the sender has this version (RFC 9110, section 13.1.2)."""
    tags = [tag.strip().removeprefix("W/") for tag in (if_none_match or "").split(",")]
    return tag in tags or "*" in tags


def _written(
    format_: Format, component: Component, rows: ExportRows, units: dict[str, str]
) -> str | bytes:
    if format_ == "json":
        about = {"component": component.name, "table_version": rows.version}
        return write_json(rows, about)
    if format_ == "hdf5":
        return write_hdf5(rows, rows.seq, table_meta(component, rows))
    try:
        return write_csv(rows, units=units)
    except UnitError as error:
        raise ProblemError(422, "unit", "Not a unit this export can use", str(error)) from None


def _format_of(request: Request) -> str:
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if kind not in _FORMATS:
        raise ProblemError(
            415,
            "media-type",
            "Not a form of table this call takes",
            f"The content type is {kind or 'missing'}. Send {', '.join(MEDIA_TYPES.values())}, or "
            f"say one of {', '.join(f'?format={name}' for name in MEDIA_TYPES)}.",
        )
    return _FORMATS[kind]


def _reader(format_: str, component: Component, decimal: str | None) -> Reader:
    if format_ == "csv":
        return partial(read_csv, decimal=decimal, load_range=component.load_range)
    if decimal is not None:
        raise ProblemError(
            422,
            "decimal",
            "Only CSV has a decimal mark",
            f"decimal={decimal} says nothing about {format_}; leave it out.",
        )
    read = read_json if format_ == "json" else read_hdf5
    return partial(read, load_range=component.load_range)


async def _limited_body(request: Request) -> bytes:
    """Return the body, or refuse it as soon as it is seen to be too long."""
    body = bytearray()
    async for piece in request.stream():
        body += piece
        if len(body) > MAX_TABLE_BYTES:
            raise ProblemError(
                413,
                "too-large",
                "The table is too large",
                f"Send at most {MAX_TABLE_BYTES >> 20} MiB a call; send parts.",
            )
    return bytes(body)


def _import(
    workspace: Workspace, component: Component, reader: Reader, body: bytes, dry_run: bool
) -> dict[str, Any]:
    """Read, check and, unless something is wrong or it is a dry run, insert: all rows or none.

    The reply leaves when they are durable; they answer once the table's version is the reply's.
    """
    table = reader(body)
    errors = [error.as_dict() for error in (*table.errors, *misplaced_rows(component, table))]
    inserted = existing = 0
    if not errors:
        inserted, existing = insert(workspace.ledger, component, table, dry_run=dry_run)
    loaded = not errors and not (dry_run and inserted)
    return {
        "inserted": inserted,
        "existing": existing,
        "errors": errors,
        "dry_run": dry_run,
        "in_use": loaded and workspace.tables.catch_up(component.name, 0.0),
        "table_version": workspace.ledger.last_seq(component.name),
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
