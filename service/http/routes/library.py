"""The library: copies, names, notes, archived components; imports, disagreement and demand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from fastapi import Path, Query, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response
from typing_extensions import TypedDict

from wrenchbook.service.actors import CALLER
from wrenchbook.service.contract import NUMBER_LIMIT
from wrenchbook.service.demand import Demand
from wrenchbook.service.formats.cells import text_problem
from wrenchbook.service.http.bodies import CopyBody, NotesBody, RenameBody
from wrenchbook.service.http.body import JsonRoute, read_body, read_limited
from wrenchbook.service.http.openapi import TEXT, answers, component_router, refused, takes
from wrenchbook.service.http.permission import permission_of
from wrenchbook.service.http.problems import HttpProblemError, bad_body
from wrenchbook.service.http.routes import Opened, attached, json_reply
from wrenchbook.service.http.routes.components import component_body
from wrenchbook.service.http.routes.rows import file_fields
from wrenchbook.service.ledger import ImportOrigin, UnknownImportError, import_numbers
from wrenchbook.service.ledger.imports import findings, import_spans, imports, withdrawn_counts
from wrenchbook.service.messages import ImportFinding, Message
from wrenchbook.service.mistakes import MAX_VALUE
from wrenchbook.service.tables.comparison import (
    Comparison,
    Disagreement,
    UncomparableError,
    comparison,
    comparison_csv,
    disagreement,
)
from wrenchbook.service.tables.importing import copy_rows
from wrenchbook.service.tables.mapped import ServedTable
from wrenchbook.service.tables.rows import iso_time
from wrenchbook.service.workspace import CATCH_UP_S, Workspace
from wrenchbook.surrogate.findings.cycles import measured_stiffness

router = component_router("library", route=JsonRoute)
ImportId = Annotated[int, Path(ge=1, lt=NUMBER_LIMIT)]
Finding = Annotated[str | None, Query(max_length=100)]
MAX_NOTES_BYTES = 1 << 20  # bytes: 100,000 characters, escaped


class Card(Message):
    component: str
    archived: bool
    notes: str


class FileImport(Message):
    """The sender and the file of imported rows."""

    id: int
    who: str
    filename: str
    format: str
    sha256: str
    note: str
    rig: str


class Import(FileImport):
    when: str
    rows: int
    withdrawn: int
    table_version: int | None
    findings: Sequence[ImportFinding]


class Imports(Message):
    imports: Sequence[Import]


# A dataclass cannot have a field named `import`.
ImportEdited = TypedDict(
    "ImportEdited",
    {
        "component": str,
        "import": int,
        "status": Literal["withdrawn", "restored"],
        "rows": int,
        "current": bool,
        "table_version": int,
    },
    total=False,
)


@router.post(
    "/copy", status_code=201, responses=answers(dict[str, Any], "the copy", 201) | refused(409)
)
def copy_component(name: str, request: Request, body: CopyBody) -> Response:
    """Copy a component, with or without its rows."""
    return _copy(request, name, body)


@router.post(
    "/rename",
    status_code=201,
    responses=answers(dict[str, Any], "the copy; the original is archived", 201) | refused(409),
)
def rename_component(name: str, request: Request, body: RenameBody) -> Response:
    """Rename: copy under another name and archive the original."""
    return _copy(request, name, CopyBody(name=body.name), renamed=True)


@router.post("/archive", response_model=Card)
def archive_component(name: str, request: Request) -> Response:
    """Archive a component."""
    return _put(request, name, archived=True)


@router.post("/unarchive", response_model=Card)
def unarchive_component(name: str, request: Request) -> Response:
    """Unarchive a component."""
    return _put(request, name, archived=False)


@router.put("/notes", response_model=Card, openapi_extra=takes(NotesBody))
async def write_notes(name: str, request: Request) -> Response:
    """Replace the notes of a component."""
    text = read_body(NotesBody, await read_limited(request.receive, MAX_NOTES_BYTES)).text
    if problem := text_problem(text):
        raise bad_body([{"loc": "text", "msg": problem}])
    return await run_in_threadpool(_put, request, name, notes=text)


@router.get("/imports", response_model=Imports)
def list_imports(name: str, workspace: Opened) -> Response:
    """List imports, newest first."""
    name = workspace.library[name].name
    with workspace.ledger.reading() as db:
        records = imports(db, name)
        versions = {span.record.id: span.last for span in import_spans(db, name)}
        stored: list[Any] = findings(db, name)
        withdrawn = withdrawn_counts(db, name)
    return json_reply(
        Imports(
            imports=[
                Import(
                    **file_fields(record),
                    when=iso_time(record.created),
                    rows=record.rows,
                    withdrawn=withdrawn[record.id],
                    table_version=versions.get(record.id),
                    findings=[item for item in stored if item["import"] == record.id],
                )
                for record in records
            ]
        )
    )


@router.delete("/imports/{number}", response_model=ImportEdited)
def withdraw_import(
    name: str, number: ImportId, workspace: Opened, finding: Finding = None
) -> Response:
    """Withdraw an import's rows, or the rows of one finding."""
    return _edit_import(workspace, name, number, finding, withdrawn=True)


@router.post("/imports/{number}/restore", response_model=ImportEdited)
def restore_import(
    name: str, number: ImportId, workspace: Opened, finding: Finding = None
) -> Response:
    """Restore an import's withdrawn rows, or the rows of one finding."""
    return _edit_import(workspace, name, number, finding, withdrawn=False)


@router.get("/disagreement", response_model=Disagreement)
def list_disagreements(name: str, workspace: Opened) -> Response:
    """List measured rows that disagree with the solved rows."""
    component = workspace.library[name]
    table = workspace.tables.caught_up(name, CATCH_UP_S)
    return json_reply(disagreement(component, table.rows, table.version, table.solver_error))


@router.get(
    "/comparison",
    response_class=Response,
    responses=answers(
        Comparison,
        "rows, residuals and summaries; csv: the rows in SI units",
        content={"text/csv": TEXT},
    )
    | refused(s409="the table has no measured rows of this import"),
)
async def get_comparison(
    name: str,
    workspace: Opened,
    number: Annotated[int | None, Query(alias="import", ge=1, lt=NUMBER_LIMIT)] = None,
    against: Annotated[int | None, Query(ge=1, lt=NUMBER_LIMIT)] = None,
    format: Literal["json", "csv"] = "json",  # noqa: A002 (the contract's word)
) -> Response:
    """Compare measured rows with solved rows or with another import."""
    table = await workspace.newest(name, CATCH_UP_S)
    async with workspace.comparison_lock:
        return await run_in_threadpool(_compare, workspace, name, table, number, against, format)


def _compare(
    workspace: Workspace,
    name: str,
    table: ServedTable,
    number: int | None,
    against: int | None,
    form: str,
) -> Response:
    component = workspace.library[name]
    spans = workspace.ledger.import_spans(name)
    try:
        source = component, table.rows, table.version, table.solver_error
        reply = comparison(*source, spans, number, against)
    except UncomparableError as error:
        raise HttpProblemError(409, "no-comparison", "Nothing to compare", str(error)) from None
    if form == "csv":
        headers = attached(f"{name}-comparison.csv")
        return Response(comparison_csv(reply, component.space), 200, headers, "text/csv")
    return json_reply(reply)


@router.get("/stiffness")
def get_stiffness(
    name: str,
    workspace: Opened,
    between: Annotated[str, Query(max_length=100)],
    axis: str = "",
    of: str = "",
    number: Annotated[int | None, Query(alias="import", ge=1, lt=NUMBER_LIMIT)] = None,
) -> Response:
    """Stiffness and play of measured rows between two loads."""
    component = workspace.library[name]
    table = workspace.tables.caught_up(name, CATCH_UP_S)
    rows, space, span = table.rows, component.space, component.load_range
    loads = [item.name for item in space.inputs if item.kind != "scalar"]
    ends = _two_loads(between)
    if number is not None:
        spans = workspace.ledger.import_spans(name)
        if all(span.record.id != number for span in spans):
            raise UnknownImportError(
                f"{name!r} has no import {number} with rows; list its imports with GET "
                f"/v1/components/{name}/imports"
            )
        rows = rows.take(import_numbers(spans, rows.seq) == number)
    # By default the load that these rows vary most, relative to its range.
    varied = np.ptp(rows.wrench, axis=0) / span.scale if len(rows) else span.scale
    axis = axis or loads[int(np.argmax(varied[: len(loads)]))]
    outputs = "", *space.output_names
    for parameter, value, names in (("axis", axis, loads), ("of", of, outputs)):
        if value not in names:
            message = f"must be one of {', '.join(filter(None, names))}, not {value[:MAX_VALUE]!r}"
            raise bad_body([{"loc": parameter, "msg": message}])
    load = loads.index(axis)
    output = space.output_names.index(of) if of else load  # each interface has six of both
    reply = {
        "component": name,
        "table_version": table.version,
        "import": number,
        "axis": axis,
        "of": space.output_names[output],
        "between": sorted(ends),
        "unit": f"{space.inputs[load].unit}/{space.outputs[output].unit}",
    }
    return json_reply(reply | measured_stiffness(rows, span, ends, load, output))


def _two_loads(between: str) -> tuple[float, float]:
    """Return the two different loads of `between`, N or N·m; 422 if they are no such numbers."""
    try:
        low, high = (float(text) for text in between.split(","))
        if low != high and np.isfinite((low, high)).all():
            return low, high
    except ValueError:
        pass
    why = f"must be two different numbers separated by a comma, such as 100,500, not {between!r}"
    raise bad_body([{"loc": "between", "msg": why}])


@router.get("/demand", response_model=Demand)
def demand(name: str, workspace: Opened) -> Response:
    """Demand map of queries that were not covered."""
    span = workspace.library[name].load_range
    return json_reply(workspace.demand_maps.map_of(name, span))


@router.delete("/demand")
def forget_demand(name: str, workspace: Opened) -> dict[str, Any]:
    """Clear the demand map."""
    workspace.demand_maps.forget(workspace.library[name].name)
    return {"component": name, "asked": 0}


def _edit_import(
    workspace: Workspace, name: str, number: int, finding: str | None, *, withdrawn: bool
) -> Response:
    component = workspace.library[name].name
    count = workspace.ledger.edit_import(component, number, finding, withdrawn=withdrawn)
    # Read before the wait, after which others may have added rows that no table has yet.
    version = workspace.ledger.last_seq(component)
    body = {
        "component": component,
        "import": number,
        "status": "withdrawn" if withdrawn else "restored",
        "rows": count,
        "current": workspace.tables.catch_up(component, CATCH_UP_S),
        "table_version": version,
    }
    return json_reply(body)


def _put(request: Request, name: str, **fields: Any) -> Response:
    workspace: Workspace = request.app.state.workspace
    card = workspace.catalogue.change(workspace.library[name].name, **fields)
    return json_reply(Card(component=name, archived=card.archived, notes=card.notes))


def _copy(request: Request, name: str, body: CopyBody, renamed: bool = False) -> Response:
    """Copy a component; after an error while its rows are copied the copy has no rows."""
    workspace: Workspace = request.app.state.workspace
    source = workspace.library[name]
    if renamed and source.shipped:
        why = (
            f"{name!r} is part of the program. Copy it under another name: POST "
            f"/v1/components/{name}/copy."
        )
        raise HttpProblemError(409, "shipped", "A shipped component keeps its name", why)
    card = workspace.catalogue[name]
    newer = card.renamed_to
    if renamed and newer:
        shown = CALLER.get().visible(newer)
        why = f"{name!r} has a new name now, which this key does not allow. Ask for a key of it"
        if shown:
            why = f"{name!r} is {shown!r} now. Rename that"
        why += f", or copy: POST /v1/components/{name}/copy."
        raise HttpProblemError(409, "renamed", "The component was renamed already", why)
    copy = workspace.library.add_copy(name, body.name, body.title)
    workspace.catalogue.change(copy.name, notes=card.notes, copied_from=name)
    if body.rows:
        key = permission_of(request.scope).key
        origin = ImportOrigin(key.name if key else "", format="copy")
        copy_rows(workspace.ledger, source, copy, origin)
    if renamed:
        workspace.catalogue.change(name, archived=True, renamed_to=copy.name)
    workspace.tables.catch_up(copy.name, CATCH_UP_S)
    headers = {"Location": f"/v1/components/{copy.name}"}
    return json_reply(component_body(workspace, copy), 201, headers)
