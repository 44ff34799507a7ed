"""A component's table: bulk import from outside, and export."""

from __future__ import annotations

import asyncio
import hashlib
import json
import shutil
import tempfile
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple
from weakref import WeakValueDictionary

from fastapi import Header, Query, Request
from starlette.background import BackgroundTask
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import UploadFile
from starlette.responses import FileResponse, Response

from wrenchbook.service.contract import NUMBER_LIMIT, ExportFormat, counted
from wrenchbook.service.http.body import PIECE, content_type, form_of, spooled
from wrenchbook.service.http.imports import Imported, ImportQuery
from wrenchbook.service.http.openapi import BODIES, BYTES, answers, component_router, refused, takes
from wrenchbook.service.http.permission import permission_of
from wrenchbook.service.http.problems import MAX_PLACE, HttpProblemError, bad_body
from wrenchbook.service.http.routes import Opened, attached, holds, json_reply, naming
from wrenchbook.service.ledger import ImportOrigin
from wrenchbook.service.library.component import Component
from wrenchbook.service.library.rigs import rig_of
from wrenchbook.service.messages import TableRows
from wrenchbook.service.sandbox import SandboxBusyError
from wrenchbook.service.tables.bushing import BushingError, Others, bushing_csv
from wrenchbook.service.tables.exporting import ENDINGS, ExportRequest, export_table
from wrenchbook.service.tables.importing import import_files, solved_compliance
from wrenchbook.service.tables.store import setup_of
from wrenchbook.service.workspace import CATCH_UP_S, Workspace
from wrenchbook.surrogate.kernel.format import SUFFIX
from wrenchbook.surrogate.solver_error import SolverError

router = component_router("table", "/table")
# s of waiting for the caller's other table: the processor time it may take.
_READER_WAIT_S: Final = 60.0
MAX_TABLE_BYTES: Final = 512 * 1024 * 1024  # 5,000,000 rows (`MAX_ROWS`) of 107 characters
_MAX_APPENDED_BYTES: Final = 1 << 20  # bytes of a block: 1,000 rows of 1 KiB as JSON
_FORM_BYTES: Final = 64 * 1024  # bytes of a form around its files
_reader_locks: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()

MEDIA_TYPES = {
    "csv": "text/csv",
    "json": "application/json",
    "hdf5": "application/x-hdf5",
    "xlsx": "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet",
    "parquet": "application/vnd.apache.parquet",
}
PACKED_TYPE = "application/octet-stream"
_FILES = {MEDIA_TYPES[form]: BYTES for form in ("hdf5", "xlsx", "parquet")} | {
    MEDIA_TYPES["csv"]: {"schema": {"type": "string", "description": "units in the header"}}
}
_LOGS = {
    "type": "object",
    "description": BODIES["logs"],
    "properties": {
        name: {**BYTES["schema"], "description": BODIES[f"logs.{name}"]}
        for name in ("table", "loads", "displacements")
    },
}
_REQUEST_BODIES = {
    **_FILES,
    PACKED_TYPE: BYTES,
    "application/gzip": BYTES,
    "multipart/form-data": {"schema": _LOGS},
}
_PACKED = {**BYTES["schema"], "description": BODIES["packed"]}
_REPLY_BODIES = {**_FILES, PACKED_TYPE: {"schema": _PACKED}}
_ETAG = {"ETag": {"schema": {"type": "string"}, "description": BODIES["etag"]}}
_CURRENT = "the version of If-None-Match is current"
# A file of any form may be sent as plain bytes: its content identifies it.
_ACCEPTED = frozenset(
    {
        *MEDIA_TYPES.values(),
        *("application/csv", "application/x-matlab-data", "application/octet-stream"),
        *("application/gzip", "application/x-gzip", "multipart/form-data"),
        "application/vnd.ms-excel",  # content type of a CSV in browsers on Windows
    }
)


@router.get(
    "",
    response_class=Response,
    responses=answers(TableRows, "the table", content=_REPLY_BODIES, headers=_ETAG)
    | {304: {"description": _CURRENT, "headers": _ETAG}}
    | refused(s409="the format cannot hold this table"),
)
async def get_table(
    name: str,
    workspace: Opened,
    format: ExportFormat = "json",  # noqa: A002 (the contract's word)
    force: str = "N",
    moment: str = "N*m",
    translation: str = "m",
    rotation: str = "rad",
    table_version: Annotated[int | None, Query(ge=0, lt=NUMBER_LIMIT)] = None,
    comments: bool = False,
    points: Annotated[int, Query(ge=2, le=1001)] = 21,
    others: Others = "displacement",
    if_none_match: Annotated[str | None, Header()] = None,
) -> Response:
    """Export the table."""
    if table_version is not None and format in ("bushing", "packed"):
        message = f"is not possible for a {format} table, which always is the newest; leave it out"
        raise bad_body([{"loc": "table_version", "msg": message}])
    if format == "bushing":
        table = await workspace.newest(name, CATCH_UP_S)
        try:
            content = await run_in_threadpool(bushing_csv, table, points, others)
        except BushingError as error:
            raise HttpProblemError(409, "no-bushing", "No bushing table", str(error)) from None
        headers = attached(f"{name}-{table.version}-bushing.csv")
        return Response(content, 200, headers, MEDIA_TYPES["csv"])
    if format == "packed":
        table = await workspace.newest(name, CATCH_UP_S)
        # The file has the solver's error too, which can change within a version, as the setup can.
        tag = f'"{table.version}-{table.packed.checksum:08x}"'
        headers = naming(tag)
        if holds(if_none_match, tag):
            return Response(status_code=304, headers=headers)
        headers |= attached(f"{name}-{table.version}{SUFFIX}")
        content = await run_in_threadpool(lambda: table.packed.content)
        return Response(content, 200, headers, PACKED_TYPE)
    units = {"force": force, "moment": moment, "translation": translation, "rotation": rotation}
    export = ExportRequest(format, units, table_version, comments)
    return await run_in_threadpool(_export, workspace, name, export, if_none_match)


def _export(
    workspace: Workspace, name: str, export: ExportRequest, if_none_match: str | None
) -> Response:
    """Return the rows as a file that is written now and deleted after it has been sent."""
    component = workspace.library[name]
    form = export.format
    has_error = component.has_fea and form == "hdf5"
    error = workspace.errors.read(name, component.fingerprint) if has_error else None
    # Only a table that is behind the ledger must be read before its version is known.
    if export.version is None and workspace.tables.catch_up(name, 0.0):
        tag = _tag(component, workspace.tables.surrogate(name).version, error)
        if holds(if_none_match, tag):
            return Response(status_code=304, headers=naming(tag))
    folder = Path(tempfile.mkdtemp(prefix="wrenchbook-"))
    path = folder / f"table.{ENDINGS[form]}"
    try:
        version = export_table(workspace.ledger, component, export, path, error)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    headers = naming(_tag(component, version, error))
    if form != "json":
        headers |= attached(f"{name}-v{version}.{ENDINGS[form]}")
    kind = MEDIA_TYPES[form] + ("; charset=utf-8" if form == "csv" else "")
    done = BackgroundTask(shutil.rmtree, folder, ignore_errors=True)
    return FileResponse(path, 200, headers, kind, done)


def _tag(component: Component, version: int, error: SolverError | None) -> str:
    """Return a text that changes with the rows, range, tolerance and the solver's error."""
    values = json.dumps(error.values).encode() if error else b""
    digest = f"-{hashlib.sha256(values).hexdigest()[:16]}" if error else ""
    return f'"{version}-{setup_of(component)}{digest}"'


@router.post(
    "",
    responses=answers(Imported, "the rows are stored; with `dry_run`, they are counted")
    | refused(
        s413="the table is too large; send it in parts",
        s415="the content type is not a table format",
        s422="the table has mistakes; nothing was loaded",
    ),
    openapi_extra=takes(TableRows, _REQUEST_BODIES),
)
async def import_table(
    name: str, request: Request, workspace: Opened, query: Annotated[ImportQuery, Query()]
) -> Response:
    """Import rows from a file."""
    component = workspace.library[name]
    kind = content_type(request)
    if kind and kind not in _ACCEPTED:
        why = (
            f"The content type is {kind}. Send {', '.join(MEDIA_TYPES.values())} or "
            "application/octet-stream, gzipped or not; the content decides the format."
        )
        raise HttpProblemError(415, "media-type", "The content type is not that of a table", why)

    table = workspace.tables.surrogate(name)
    solved = await run_in_threadpool(solved_compliance, component, table)
    rig = await run_in_threadpool(rig_of, workspace.ledger, query.rig)
    options = replace(query.options(rig), solved=solved, linear=component.linear)
    max_bytes = _MAX_APPENDED_BYTES if query.append else MAX_TABLE_BYTES
    async with sent_files(request, max_bytes) as sent:
        alone = query.model_fields_set & {"time_offset_s", "max_gap_s"}
        if len(sent.files) == 1 and alone:
            message = "needs two logs; send the second one (--displacements FILE), or leave it out"
            raise bad_body([{"loc": min(alone), "msg": message}])

        key = permission_of(request.scope).key
        origin = ImportOrigin(
            who=key.name if key else "",
            filename=query.append or query.filename or sent.filename,
            digest="" if query.append else sent.digest,
            note=query.note,
        )
        caller = origin.who or (request.client.host if request.client else "")
        async with nullcontext() if query.append else reader_slot(caller):
            source = workspace.ledger, component, sent.files, options, origin
            known = table if component.space.is_default and not query.append else None
            flags = query.model_dump(include={"dry_run", "partial", "preview"})
            appends = bool(query.append)
            reply = await run_in_threadpool(
                import_files, *source, table=known, append=appends, **flags
            )

    loaded, is_ruined = reply.pop("loaded"), reply.pop("is_ruined")
    if reply["errors"] and not (query.dry_run or loaded):
        raise _bad_rows(reply, "block" if query.append else "complete file", is_ruined)
    # Rows that existed before need not wait for the next table; after an appended row the next one
    # comes soon.
    waits = loaded and (not query.append or "wait_s" in query.model_fields_set)
    # Read before the wait, after which others may have added rows that no table has yet.
    reply["table_version"] = await run_in_threadpool(workspace.ledger.last_seq, component.name)
    caught_up = await workspace.caught_up(component.name, query.wait_s if waits else 0.0)
    reply["in_use"] = caught_up and (loaded or not reply["inserted"])
    return json_reply(reply)


def _bad_rows(reply: dict[str, Any], unit: str, is_ruined: bool) -> HttpProblemError:
    """Return the problem of a table with mistakes, which names the `unit` to send again."""
    errors, rows = reply["errors"], reply["rows"]
    first = errors[0]
    places = [
        {**error, "loc": f"row {error['row']}.{error['field']}", "msg": error["message"]}
        for error in errors
    ]
    read = reply["sheet"]
    others = " or ".join(name for name in reply["sheets"] if name != read)
    sheet = f" of sheet {read} (--sheet reads {others})" if read and others else ""
    # 0: the mistake concerns the file, or a column.
    place = f"row {first['row']}, " if first["row"] else ""
    partial = ""
    if rows["read"] > rows["refused"] and not is_ruined:
        partial = ", or add --partial (over HTTP partial=true) to load only the good rows"
    them = "it" if len(errors) == 1 else "them"
    again = f" Correct {them} and send the {unit} again{partial}."
    if first["field"] == "file":  # its message has the remedy
        again = ""
    return HttpProblemError(
        422,
        "bad-rows",
        "The table has mistakes",
        f"Nothing was loaded; {counted(len(errors), 'mistake')}{sheet}, the first in "
        f"{place}{first['field']}: {first['message']}.{again}",
        **{**reply, "errors": places},
    )


class Received(NamedTuple):
    """The files of a table: their paths, their names at the caller, and the SHA-256 of all."""

    files: tuple[Path, ...]
    filename: str
    digest: str


@asynccontextmanager
async def sent_files(request: Request, max_bytes: int = MAX_TABLE_BYTES) -> AsyncIterator[Received]:
    """Yield a table's body as files, and delete them at the end.

    A plain body is one file; a form has the files ``loads`` and ``displacements``, or ``table``.

    Raises HttpProblemError with status 413 as soon as the body is too large, and 422 if a form
    lacks its files.
    """
    if content_type(request) != "multipart/form-data":
        async with spooled(request.receive, max_bytes) as body:
            path = body.path or await run_in_threadpool(body.append, body.content)
            yield Received((path,), "", await run_in_threadpool(_digest, (path,)))
        return
    async with form_of(request, max_bytes + _FORM_BYTES, 2) as form:
        names = ("loads", "displacements") if "loads" in form else ("table",)
        uploads = [sent for name in names if isinstance(sent := form.get(name), UploadFile)]
        if len(uploads) < len(names):
            message = "send the file 'table', or both logs as 'loads' and 'displacements'"
            if len(form):
                message += f"; the form has {', '.join(form)[:MAX_PLACE]}"
            raise bad_body([{"loc": "form", "msg": message}])

        folder = Path(await run_in_threadpool(tempfile.mkdtemp, prefix="wrenchbook-"))
        files = tuple(folder / f"table-{number}" for number in range(len(uploads)))

        def copy() -> str:
            """Copy a form's file, which has no name, as parsers open files by name."""
            for upload, path in zip(uploads, files, strict=True):
                with path.open("wb") as file:
                    shutil.copyfileobj(upload.file, file, PIECE)
            return _digest(files)

        try:
            filename = ", ".join(upload.filename or "" for upload in uploads).strip(", ")
            yield Received(files, filename, await run_in_threadpool(copy))
        finally:
            await run_in_threadpool(shutil.rmtree, folder, ignore_errors=True)


def _digest(files: Sequence[Path]) -> str:
    digest = hashlib.sha256()
    for path in files:
        with path.open("rb") as file:
            while block := file.read(PIECE):
                digest.update(block)
    return digest.hexdigest()


@asynccontextmanager
async def reader_slot(caller: str) -> AsyncIterator[None]:
    """Wait until no other table of a caller is read; SandboxBusyError after `_READER_WAIT_S`."""
    lock = _reader_locks.setdefault(caller, asyncio.Lock())
    try:
        async with asyncio.timeout(_READER_WAIT_S):
            await lock.acquire()
    except TimeoutError:
        raise SandboxBusyError(
            "Another table of this key or address is being read, and this one waited "
            f"{_READER_WAIT_S:g} s; send it again in a minute"
        ) from None
    try:
        yield
    finally:
        lock.release()
