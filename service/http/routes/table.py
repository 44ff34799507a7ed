"""A component's table: bulk import from outside, and export."""

from __future__ import annotations

import asyncio
import shutil
import tempfile
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Final, Literal
from weakref import WeakValueDictionary

from fastapi import APIRouter, Header, Query, Request
from starlette.background import BackgroundTask
from starlette.concurrency import run_in_threadpool
from starlette.responses import FileResponse, Response

from wrenchbook.service.formats import SheetFullError, UnitError
from wrenchbook.service.http.access import permission_of
from wrenchbook.service.http.body import received
from wrenchbook.service.http.import_query import ImportQuery
from wrenchbook.service.http.openapi import BYTES, answers, refused, takes
from wrenchbook.service.http.problems import HttpProblemError, bad_body
from wrenchbook.service.http.replies import holds, json_reply, naming
from wrenchbook.service.http.routes import Opened
from wrenchbook.service.http.table_schemas import Imported, Table
from wrenchbook.service.ledger import About
from wrenchbook.service.library.component import Component
from wrenchbook.service.sandbox import SandboxBusyError
from wrenchbook.service.tables.exporting import (
    ENDINGS,
    ExportFormat,
    ExportRequest,
    check_units,
    export_table,
)
from wrenchbook.service.tables.importing import import_files, solved_compliance
from wrenchbook.service.tables.store import setup_of
from wrenchbook.service.workspace import CATCH_UP_S, Workspace
from wrenchbook.surrogate.packed.format import SUFFIX

router = APIRouter(
    prefix="/v1/components/{name}/table", tags=["table"], responses=refused(404, 422)
)
_READER_WAIT_S: Final = 60.0
_reader_locks: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()

Format = Literal["csv", "xlsx", "parquet", "hdf5", "json", "packed"]
MEDIA_TYPES = {
    "csv": "text/csv",
    "json": "application/json",
    "hdf5": "application/x-hdf5",
    "xlsx": "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet",
    "parquet": "application/vnd.apache.parquet",
}
PACKED_TYPE = "application/octet-stream"
_FILES = {MEDIA_TYPES[one]: BYTES for one in ("hdf5", "xlsx", "parquet")} | {
    MEDIA_TYPES["csv"]: {"schema": {"type": "string", "description": "units in the header"}}
}
_LOGS = {
    "type": "object",
    "description": "one 'table', or two logs that are joined by their time columns",
    "properties": dict.fromkeys(("table", "loads", "displacements"), BYTES["schema"]),
}
_SENT = {
    **_FILES,
    PACKED_TYPE: BYTES,
    "application/gzip": BYTES,
    "multipart/form-data": {"schema": _LOGS},
}
_PACKED = {
    **BYTES["schema"],
    "description": "packed: the table that answers, for `Table.open` and the kernel's `wb_open`",
}
_WRITTEN = {**_FILES, PACKED_TYPE: {"schema": _PACKED}}
_ETAG = {
    "ETag": {
        "schema": {"type": "string"},
        "description": "names the table version and setup; of packed the content",
    }
}
_CURRENT = "the version named by If-None-Match is the present one"
# A file of any form may come as plain bytes: the content identifies it.
_TAKEN = frozenset(
    {
        *MEDIA_TYPES.values(),
        "application/csv",
        "application/x-matlab-data",
        "application/gzip",
        "application/x-gzip",
        "application/octet-stream",
        "application/vnd.ms-excel",  # what browsers on Windows say of a CSV
        "multipart/form-data",
    }
)


@router.get(
    "",
    summary="Export the table",
    response_class=Response,
    responses=answers(Table, "the table", content=_WRITTEN, headers=_ETAG)
    | {304: {"description": _CURRENT, "headers": _ETAG}}
    | refused(s409="this form cannot hold this table"),
)
async def get_table(
    name: str,
    workspace: Opened,
    format: Format = "json",  # noqa: A002 (the contract's word)
    force: Annotated[str, Query(description="csv, xlsx: unit of forces")] = "N",
    moment: Annotated[str, Query(description="csv, xlsx: unit of moments")] = "N*m",
    translation: Annotated[str, Query(description="csv, xlsx: unit of translations")] = "m",
    rotation: Annotated[str, Query(description="csv, xlsx: unit of rotations")] = "rad",
    table_version: Annotated[
        int | None, Query(ge=0, lt=2**63, description="the table as it was; now if left out")
    ] = None,
    comments: Annotated[
        bool, Query(description="csv: lines after a # that say what it is")
    ] = False,
    if_none_match: Annotated[
        str | None, Header(description="the version that the caller has")
    ] = None,
) -> Response:
    if format == "packed":
        if table_version is not None:
            message = "a packed table is of the newest version; save it to keep that version"
            raise bad_body([{"loc": "query.table_version", "msg": message}])
        return await _packed(workspace, name, if_none_match)
    units = {"force": force, "moment": moment, "translation": translation, "rotation": rotation}
    how = units, table_version, comments
    return await run_in_threadpool(_export, workspace, name, format, how, if_none_match)


async def _packed(workspace: Workspace, name: str, if_none_match: str | None) -> Response:
    """Return the packed table that answers."""
    component = workspace.library[name]
    await workspace.newest(name, CATCH_UP_S)
    table = await run_in_threadpool(workspace.surrogate, name)
    # What is known of the solver's error is in the file too, and can change within a version.
    tag = f'{_tag(component, table.version)[:-1]}-{table.packed.checksum:08x}"'
    headers = naming(tag)
    if holds(if_none_match, tag):
        return Response(status_code=304, headers=headers)
    filename = f"{name}-{table.version}{SUFFIX}"
    headers["Content-Disposition"] = f'attachment; filename="{filename}"'
    content = await run_in_threadpool(lambda: table.packed.content)
    return Response(content, 200, headers, PACKED_TYPE)


def _export(
    workspace: Workspace,
    name: str,
    format_: ExportFormat,
    how: tuple[dict[str, str], int | None, bool],
    if_none_match: str | None,
) -> Response:
    """Return the rows as a file; `how` has units, version and whether there are comments."""
    component, (_, table_version, _) = workspace.library[name], how
    # Only a table that is behind the ledger has to be read before its version is known.
    if table_version is None and workspace.tables.catch_up(name, 0.0):
        tag = _tag(component, workspace.tables.surrogate(name).version)
        if holds(if_none_match, tag):
            return Response(status_code=304, headers=naming(tag))
    export_request = ExportRequest(format_, *how)
    try:
        check_units(export_request)
    except UnitError as error:
        raise HttpProblemError(422, "unit", "Not a unit this export can use", str(error)) from None
    own = workspace.errors.read(name, component.fingerprint) if component.has_fea else None
    return _file(
        component,
        format_,
        lambda path: export_table(workspace.ledger, component, export_request, path, own),
    )


@router.post(
    "",
    summary="Bulk import: all rows or none, or the good ones with partial",
    responses=answers(Imported, "the rows are in, or were counted")
    | refused(
        s413="the table is too large; send it in parts",
        s415="the content type is no form of a table",
        s422="the table has mistakes; nothing was loaded",
    ),
    openapi_extra=takes(Table, _SENT),
)
async def import_table(
    name: str, request: Request, workspace: Opened, query: Annotated[ImportQuery, Query()]
) -> Response:
    component = workspace.library[name]
    _check_kind(request)
    table = workspace.tables.surrogate(name)
    solved = await run_in_threadpool(solved_compliance, component, table)
    options = replace(query.options(), solved=solved, linear=component.linear)
    async with received(request) as sent:
        key = permission_of(request.scope).key
        about = About(
            who=key.name if key else "",
            filename=query.filename or sent.filename,
            digest=sent.digest,
            note=query.note,
        )
        caller = about.who or (request.client.host if request.client else "")
        async with one_reader(caller):
            reply = await run_in_threadpool(
                import_files,
                workspace.ledger,
                component,
                sent.files,
                options,
                about,
                dry_run=query.dry_run,
                partial=query.partial,
                preview=query.preview,
            )
    loaded = reply.pop("loaded")
    if reply["errors"] and not (query.dry_run or loaded):
        raise _refused(reply)
    wait_s = query.wait_s if loaded and reply["inserted"] else 0.0
    caught_up = await workspace.caught_up(component.name, wait_s)
    reply["in_use"] = caught_up and (loaded or not reply["inserted"])
    reply["table_version"] = workspace.ledger.last_seq(component.name)
    return json_reply(reply)


@asynccontextmanager
async def one_reader(caller: str) -> AsyncIterator[None]:
    """Wait until no other table of a caller (a key, or an address without keys) is being read.

    Raises SandboxBusyError after `_READER_WAIT_S` seconds.
    """
    lock = _reader_locks.setdefault(caller, asyncio.Lock())
    try:
        async with asyncio.timeout(_READER_WAIT_S):
            await lock.acquire()
    except TimeoutError:
        message = "Another table of this key is being read; send it again in a minute"
        raise SandboxBusyError(message) from None
    try:
        yield
    finally:
        lock.release()


def _tag(component: Component, version: int) -> str:
    """Return what differs with a table's rows, and with the range and tolerance sent with them."""
    return f'"{version}-{setup_of(component)}"'


def _file(component: Component, format_: str, write: Any) -> Response:
    """Return a file that is written now and deleted when it has been sent."""
    folder = Path(tempfile.mkdtemp(prefix="wrenchbook-"))
    path = folder / f"table.{ENDINGS[format_]}"
    try:
        version = write(path)
    except BaseException as error:
        shutil.rmtree(folder, ignore_errors=True)
        if isinstance(error, SheetFullError):
            raise HttpProblemError(
                409, "export", "This export cannot be made", str(error)
            ) from None
        raise
    headers = naming(_tag(component, version))
    if format_ != "json":
        filename = f"{component.name}-v{version}.{ENDINGS[format_]}"
        headers["Content-Disposition"] = f'attachment; filename="{filename}"'
    kind = MEDIA_TYPES[format_] + ("; charset=utf-8" if format_ == "csv" else "")
    done = BackgroundTask(shutil.rmtree, folder, ignore_errors=True)
    return FileResponse(path, 200, headers, kind, done)


def _check_kind(request: Request) -> None:
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if kind and kind not in _TAKEN:
        raise HttpProblemError(
            415,
            "media-type",
            "Not a form of table this call takes",
            f"The content type is {kind}. Send {', '.join(MEDIA_TYPES.values())} or "
            "application/octet-stream, each gzipped if you like: the content tells which it is.",
        )


def _refused(reply: dict[str, Any]) -> HttpProblemError:
    errors = reply["errors"]
    first = errors[0]
    return HttpProblemError(
        422,
        "bad-rows",
        "The table has mistakes",
        f"Nothing was loaded. {len(errors)} mistake(s); the first is in row {first['row']}, "
        f"{first['field']}: {first['message']}. Mend them and send the whole file again, or "
        "say partial=true (--partial) to load the good rows.",
        **{
            **reply,
            "errors": [
                {**error, "loc": f"row {error['row']}.{error['field']}", "msg": error["message"]}
                for error in errors
            ],
        },
    )
