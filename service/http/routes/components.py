"""Routes of components: list, show and add them, and fill their tables."""

from __future__ import annotations

import time
from dataclasses import asdict, astuple
from functools import partial
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import UploadFile
from starlette.responses import Response

from wrenchbook.fea.accuracy.advice import WHERE, over_tolerance
from wrenchbook.service.actors import CALLER
from wrenchbook.service.contract import CONTRACT
from wrenchbook.service.files.redact import redact
from wrenchbook.service.http.bodies import FillBody, TableOnlyComponent, tolerance_of
from wrenchbook.service.http.body import (
    MAX_QUERY_BYTES,
    JsonRoute,
    content_type,
    form_of,
    read_body,
    read_limited,
)
from wrenchbook.service.http.needs import fill_need
from wrenchbook.service.http.openapi import BYTES, answers, refused, takes
from wrenchbook.service.http.permission import permission_of
from wrenchbook.service.http.problems import HttpProblemError, bad_body
from wrenchbook.service.http.routes import Opened, WaitSeconds, cut_page, json_reply
from wrenchbook.service.library.bundles import MAX_BUNDLE_BYTES
from wrenchbook.service.library.component import (
    Component,
    interface_of,
    interfaces_of,
    vibration_of,
    warnings_of,
)
from wrenchbook.service.messages import JobLink, Queued
from wrenchbook.service.query import job_link
from wrenchbook.service.tables.mapped import ServedTable, warning_of
from wrenchbook.service.workspace import Workspace
from wrenchbook.surrogate.solver_error import UNKNOWN, SolverError

router = APIRouter(prefix="/v1/components", tags=["components"], route_class=JsonRoute)
_BUNDLE = {
    "type": "object",
    "required": ["bundle"],
    "properties": {"bundle": {**BYTES["schema"], "description": "a zip of the bundle's folder"}},
}


@router.get(
    "",
    response_description="components, unreadable components, and the URL of the next page or null",
    responses=refused(422),
)
def list_components(
    workspace: Opened,
    response: Response,
    q: Annotated[str, Query(max_length=200)] = "",
    archived: bool = False,
    limit: Annotated[int, Query(ge=1, le=1000)] = 1000,
    after: Annotated[str | None, Query(max_length=300)] = None,
) -> dict[str, Any]:
    """List components by name, in pages."""
    searched = q.casefold().split()
    components = []
    for component in workspace.library.all():
        name, card = component.name, workspace.catalogue[component.name]
        text = f"{name} {component.title} {card.notes}".casefold()
        is_listed = (after is None or name > after) and (archived or not card.archived)
        if is_listed and all(word in text for word in searched):
            components.append(component)

    read = partial(workspace.tables.surrogate, or_empty=True)
    query = {"q": q, "archived": archived, "limit": limit}
    next_url = cut_page(response, "/v1/components", query, components, order="name")
    return {
        "components": [
            _summary(workspace, component, read(component.name)) for component in components
        ],
        "next": next_url,
        "broken": [
            {"name": name, "reason": redact(reason)}
            for name, reason in sorted(workspace.broken().items())
        ],
    }


@router.get("/{name}", response_description="the component", responses=refused(404, 422))
async def get_component(name: str, workspace: Opened, wait_s: WaitSeconds = 0.0) -> dict[str, Any]:
    """Show a component: contract, load range, rows, coverage."""
    await workspace.newest(name, wait_s)
    return await run_in_threadpool(component_body, workspace, workspace.library[name])


@router.post(
    "",
    status_code=201,
    responses=answers(dict[str, Any], "the added component", 201)
    | answers(dict[str, Any], "with `faces=true`: the faces of the mesh")
    | refused(409, 422),
    openapi_extra=takes(TableOnlyComponent, {"multipart/form-data": {"schema": _BUNDLE}}),
)
async def add_component(request: Request, workspace: Opened, faces: bool = False) -> Response:
    """Add a component from a zip bundle, or a table-only component from JSON."""
    kind = content_type(request)
    if kind == "multipart/form-data":
        # The archive may be as large as a bundle, and the form adds its head.
        max_bytes = MAX_BUNDLE_BYTES + MAX_QUERY_BYTES
        async with form_of(request, max_bytes, 1, "Leave large files out of the zip.") as form:
            upload = form.get("bundle")
            if not isinstance(upload, UploadFile):
                message = "is missing; send the zip as the file 'bundle' of the form"
                raise bad_body([{"loc": "bundle", "msg": message}])
            if faces:
                listed = await run_in_threadpool(workspace.library.faces_of_zip, upload.file)
                return Response(listed, media_type="application/json")
            decks = permission_of(request.scope).allows("admin")
            component = await run_in_threadpool(workspace.library.add_zip, upload.file, decks=decks)

    elif kind == "application/json":
        if faces:
            message = (
                "lists the faces of a bundle's mesh: send the zip as the file 'bundle' of "
                "multipart/form-data, or leave faces out to add a table-only component"
            )
            raise bad_body([{"loc": "faces", "msg": message}])
        body = read_body(TableOnlyComponent, await read_limited(request.receive))
        fields = body.model_dump(exclude_none=True)
        component = await run_in_threadpool(lambda: workspace.library.add_table_only(**fields))

    else:
        why = (
            f"The content type is {kind or 'missing'}. Send a bundle's zip as multipart/form-data "
            "with the field 'bundle', or a table-only component as application/json."
        )
        raise HttpProblemError(415, "media-type", "The content type is not accepted", why)

    body = await run_in_threadpool(component_body, workspace, component)
    return json_reply(body, 201, {"Location": f"/v1/components/{component.name}"})


@router.post(
    "/{name}/fill",
    responses=answers(Queued, "the interpolation error is within the tolerance")
    | answers(Queued, "solves are queued", 202)
    | refused(404, 409, 422, 429),
)
def fill(name: str, workspace: Opened, order: FillBody) -> Response:
    """Queue the solves that lower the table's error the most."""
    began = time.time()
    component = workspace.library[name]
    is_part = order.range is not None or order.outputs is not None
    loads = len(component.space.inputs) - len(component.space.scalars)
    if order.for_joint and (is_part or len(component.idle) == loads):
        message = (
            "a joint needs an interface that moves, the complete load range and all outputs; "
            "leave out range and outputs"
        )
        raise bad_body([{"loc": "for_joint", "msg": message}])

    limit = tolerance_of(order.tolerance)
    need = fill_need(component, order) if is_part else None
    design, jobs = workspace.fill(name, order.budget, limit, need, for_joint=order.for_joint)
    is_fewer = 0 < len(jobs) < order.budget
    fewer = f"{len(jobs)} of at most {order.budget} solves: " if is_fewer else ""
    links = tuple(JobLink(**job_link(job, began)) for job in jobs)
    reply = Queued(component=name, jobs=links, stage=design.stage, reason=fewer + design.reason)
    return json_reply(reply, 202 if jobs else 200)


def component_body(workspace: Workspace, component: Component) -> dict[str, Any]:
    """Return all facts of a component."""
    table = workspace.tables.surrogate(component.name)
    error = workspace.solver_error(component, table) if component.has_fea else None
    solver_error = None  # a measured table has no solver
    if error is not None:
        names = ("mesh_basis", "linearity_basis", "buckling")
        basis = {name: error.values[name] for name in names if name in error.values}
        solver_error = {**error.at_full_range(), **basis}
    elif component.has_fea:
        solver_error = {"mesh": None, "mesh_basis": UNKNOWN}
    return {
        **_summary(workspace, component, table),
        "fingerprint": component.fingerprint,
        "contract": CONTRACT,
        "interface": interface_of(component),
        **({"interfaces": interfaces_of(component)} if component.space.several else {}),
        "warnings": _warnings(workspace, component, table, error),
        "vibration": vibration_of(component.folder, component.fingerprint),
        "solver_error": solver_error,
        "sources": dict(sorted(table.sources.items())),
        "coverage": table.summary,
        "jobs": workspace.ledger.counts(component.name),
    }


def _warnings(
    workspace: Workspace, component: Component, table: ServedTable, error: SolverError | None
) -> list[dict[str, Any]]:
    """Return the warnings of a component's check, solver error, rows and imports."""
    limit = component.tolerance
    warnings: list[dict[str, Any]] = [*warnings_of(component.folder)]
    if not table.bars_are_complete:
        warnings.append({"where": WHERE, "message": UNKNOWN})
    elif error is not None:  # the newest estimate replaces the check's
        warnings = [warning for warning in warnings if warning["where"] != WHERE]
        newest = over_tolerance(error.values, *(() if limit is None else astuple(limit)))
        warnings += ({"where": mistake.where, "message": mistake.message} for mistake in newest)
    # A large table may still be building, with rows in the ledger that are not in the table.
    findings = workspace.ledger.findings(component.name)
    if message := warning_of(component, table):
        warnings.append({"where": "rows", "message": message})
    warnings += ({"where": f"import {finding['import']}", **finding} for finding in findings)
    return warnings


def _summary(workspace: Workspace, component: Component, table: ServedTable) -> dict[str, Any]:
    """Return the facts of a component and its table that a list shows."""
    space, limit = component.space, component.tolerance
    card = workspace.catalogue[component.name]
    solved = table.sources.get("fea", 0)

    # The load range in the form of requests: by interface if there are several.
    bounds = component.load_range.low.tolist(), component.load_range.high.tolist()
    spans = [list(span) for span in zip(*bounds, strict=True)]
    loads = {
        name: {"force": spans[6 * k : 6 * k + 3], "moment": spans[6 * k + 3 : 6 * k + 6]}
        for k, name in enumerate(space.interfaces)
    }
    load_range: dict[str, Any] = {"loads": loads} if space.several else loads[space.interfaces[0]]
    if space.scalars:
        further = zip(space.scalars, spans[-len(space.scalars) :], strict=True)
        load_range |= {"inputs": {load.name: span for load, span in further}}

    return {
        "name": component.name,
        "title": component.title,
        "has_fea": component.has_fea,
        "mesh": component.mesh,
        "linear": component.linear,
        "shipped": component.shipped,
        "range": load_range,
        # The inputs and outputs if they are not those of one wrench.
        **({} if space.is_default else {"space": space.as_json()}),
        "tolerance": limit and asdict(limit),
        "rows": table.row_count,
        "pending_rows": workspace.unbuilt(component, table)[0],
        "solved": solved,
        "measured": table.row_count - solved,
        "another_setup": {"rows": table.other_rows, "wrenches": table.other_wrenches},
        "archived": card.archived,
        "notes": card.notes,
        "renamed_to": CALLER.get().visible(card.renamed_to),
        "copied_from": CALLER.get().visible(card.copied_from),
        "table_version": table.version,
    }
