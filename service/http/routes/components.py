"""Components: list, show, add, and fill the table of one."""

from __future__ import annotations

import time
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import UploadFile
from starlette.responses import Response

from wrenchbook.fea.accuracy.advice import WHERE, over_tolerance
from wrenchbook.service.contract import CONTRACT
from wrenchbook.service.files.redact import redact
from wrenchbook.service.http.access import permission_of
from wrenchbook.service.http.bodies import FillBody, TableOnlyComponent
from wrenchbook.service.http.body import MAX_QUERY_BYTES, JsonRoute, form_of, read_limited
from wrenchbook.service.http.openapi import BYTES, answers, refused, takes
from wrenchbook.service.http.parsing import read_body
from wrenchbook.service.http.problems import HttpProblemError, bad_body
from wrenchbook.service.http.replies import json_reply, next_page
from wrenchbook.service.http.routes import Opened
from wrenchbook.service.http.routes.scenes import need_from
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
from wrenchbook.service.tables.mapped import warning_of
from wrenchbook.service.workspace import CATCH_UP_S, Workspace
from wrenchbook.surrogate.solver_error import UNKNOWN, SolverError
from wrenchbook.surrogate.table.rows import Tolerance

router = APIRouter(prefix="/v1/components", tags=["components"], route_class=JsonRoute)
_BUNDLE = {
    "type": "object",
    "required": ["bundle"],
    "properties": {"bundle": {**BYTES["schema"], "description": "a zip of the bundle's folder"}},
}


@router.get(
    "",
    summary="The library by name, a page at a time",
    response_description="components, broken ones, and the URL of the next page or null",
    responses=refused(422),
)
def list_components(
    workspace: Opened,
    response: Response,
    q: Annotated[str, Query(max_length=200, description="in name, title or notes")] = "",
    archived: Annotated[bool, Query(description="with archived ones")] = False,
    limit: Annotated[int, Query(ge=1, le=1000)] = 1000,
    after: Annotated[
        str | None, Query(max_length=300, description="go on after this component's name")
    ] = None,
) -> dict[str, Any]:
    library, cards = workspace.library, workspace.catalogue
    found = [
        library[name]
        for name in library.names()
        if (after is None or name > after) and (archived or not cards[name].archived)
    ]
    searched = q.casefold().split()
    found = [
        item
        for item in found
        if all(
            word in f"{item.name} {item.title} {cards[item.name].notes}".casefold()
            for word in searched
        )
    ]
    following = None
    if len(found) > limit:
        words = {"q": q, "archived": archived, "limit": limit, "after": found[limit - 1].name}
        following = next_page(response, "/v1/components", words)
    return {
        "components": [_summary(workspace, one) for one in found[:limit]],
        "next": following,
        "broken": [
            {"name": name, "reason": redact(reason)}
            for name, reason in sorted(workspace.broken().items())
        ],
    }


@router.get(
    "/{name}",
    summary="One component: contract, range, rows, coverage",
    response_description="the component",
    responses=refused(404, 422),
)
async def get_component(name: str, workspace: Opened) -> dict[str, Any]:
    await workspace.newest(name, CATCH_UP_S)
    return await run_in_threadpool(component_body, workspace, workspace.library[name])


@router.post(
    "",
    status_code=201,
    summary="Add a component: a zip bundle, or JSON for a table only",
    responses=answers(dict[str, Any], "added", 201) | refused(409, 422),
    openapi_extra=takes(TableOnlyComponent, {"multipart/form-data": {"schema": _BUNDLE}}),
)
async def add_component(request: Request, workspace: Opened) -> Response:
    kind = request.headers.get("content-type", "").partition(";")[0].strip()
    if kind == "multipart/form-data":
        component = await _add_bundle(workspace, request)
    elif kind == "application/json":
        body = read_body(TableOnlyComponent, await read_limited(request.receive))
        fields = body.model_dump(exclude_none=True)
        component = await run_in_threadpool(lambda: workspace.library.add_table_only(**fields))
    else:
        raise HttpProblemError(
            415,
            "media-type",
            "Not a form this call takes",
            f"The content type is {kind or 'missing'}. Send a bundle's zip as multipart/form-data "
            "with the field 'bundle', or a table-only component as application/json.",
        )
    body = await run_in_threadpool(component_body, workspace, component)
    return json_reply(body, 201, {"Location": f"/v1/components/{component.name}"})


async def _add_bundle(workspace: Workspace, request: Request) -> Component:
    # The archive may be as large as a bundle, and its form has a head.
    async with form_of(request, MAX_BUNDLE_BYTES + MAX_QUERY_BYTES, most_files=1) as form:
        upload = form.get("bundle")
        if not isinstance(upload, UploadFile):
            raise bad_body([{"loc": "bundle", "msg": "send the zip as the form's file 'bundle'"}])
        decks = permission_of(request.scope).allows("admin")
        return await run_in_threadpool(workspace.library.add_zip, upload.file, decks=decks)


@router.post(
    "/{name}/fill",
    summary="Queue the solves that lower the table's error most",
    responses=answers(Queued, "the interpolation error is within the tolerance")
    | answers(Queued, "solves are queued", 202)
    | refused(404, 409, 422),
)
def fill(name: str, workspace: Opened, order: FillBody) -> Response:
    began = time.time()
    limit = Tolerance(**order.tolerance.model_dump()) if order.tolerance else None
    need, component = None, workspace.library[name]
    if order.for_joint:
        moving = {
            load.interface
            for place, load in enumerate(component.space.inputs)
            if load.kind != "scalar" and place not in component.idle
        }
        if len(moving) != 1 or order.range is not None or order.outputs is not None:
            message = (
                "a joint needs one interface that moves, all of the load range and all outputs: "
                "leave out range and outputs"
            )
            raise bad_body([{"loc": "for_joint", "msg": message}])
    if order.range is not None or order.outputs is not None:
        need = need_from(component, order.range, order.outputs, order.tolerance, "range", "outputs")
    design, jobs = workspace.fill(name, order.budget, limit, need, for_joint=order.for_joint)
    fewer = (
        f"{len(jobs)} of at most {order.budget} solves: " if 0 < len(jobs) < order.budget else ""
    )
    links = tuple(JobLink(**job_link(job, began)) for job in jobs)
    reply = Queued(component=name, jobs=links, stage=design.stage, reason=fewer + design.reason)
    return json_reply(reply, 202 if jobs else 200)


def component_body(workspace: Workspace, component: Component) -> dict[str, Any]:
    """Return all there is to say about a component."""
    table = workspace.tables.surrogate(component.name)
    own_error = workspace.solver_error(component.name) if component.has_fea else None
    findings = workspace.ledger.findings(component.name)  # a large table may still be in the making
    warning = warning_of(component, table)  # of rows that are in the ledger and not in the table
    return {
        **_summary(workspace, component),
        "fingerprint": component.fingerprint,
        "contract": CONTRACT,
        "interface": interface_of(component),
        **({"interfaces": interfaces_of(component)} if component.space.several else {}),
        "warnings": [
            *_warnings(component, own_error, known=table.bars_are_whole),
            *([{"where": "rows", "message": warning}] if warning else []),
            *({"where": f"import {one['import']}", **one} for one in findings),
        ],
        "vibration": vibration_of(component.folder, component.fingerprint),
        "solver_error": _solver_error(component, own_error),
        "sources": dict(sorted(table.sources.items())),
        "coverage": table.summary,
        "jobs": workspace.ledger.counts(component.name),
    }


def _warnings(
    component: Component, error: SolverError | None, *, known: bool
) -> list[dict[str, str]]:
    """Return what its check warned of, and what the newest estimate of its solver's error does."""
    checked = warnings_of(component.folder)
    if not known:
        return [*checked, {"where": WHERE, "message": UNKNOWN}]
    limit = component.tolerance
    if error is None or limit is None:
        return checked
    now = over_tolerance(error.values, limit.translation, limit.rotation)
    return [
        *(one for one in checked if one["where"] != WHERE),
        *({"where": one.where, "message": one.message} for one in now),
    ]


def _solver_error(component: Component, error: SolverError | None) -> dict[str, Any] | None:
    """Return what the solver's own answers may be wrong by; None of a measured table."""
    if not component.has_fea:
        return None
    if error is None:
        return {"mesh": None, "mesh_basis": UNKNOWN}
    words = ("mesh_basis", "linearity_basis", "buckling")
    basis = {name: error.values[name] for name in words if name in error.values}
    return {**error.at_full_range(), **basis}


def _range(component: Component) -> dict[str, Any]:
    """Return the load range as requests have it: by interface where there are several."""
    space = component.space
    bounds = component.load_range.low.tolist(), component.load_range.high.tolist()
    spans = [list(span) for span in zip(*bounds, strict=True)]
    loads = {
        name: {"force": spans[6 * k : 6 * k + 3], "moment": spans[6 * k + 3 : 6 * k + 6]}
        for k, name in enumerate(space.interfaces)
    }
    further = {one.name: span for one, span in zip(space.scalars[::-1], spans[::-1], strict=False)}
    inputs = {"inputs": dict(reversed(further.items()))} if further else {}
    return ({"loads": loads} if space.several else next(iter(loads.values()))) | inputs


def _summary(workspace: Workspace, component: Component) -> dict[str, Any]:
    table = workspace.tables.surrogate(component.name)
    limit = component.tolerance
    card = workspace.catalogue[component.name]
    solved = table.sources.get("fea", 0)
    return {
        "name": component.name,
        "title": component.title,
        "has_fea": component.has_fea,
        "linear": component.linear,
        "shipped": component.shipped,
        "range": _range(component),
        # The inputs and outputs where they are not those of one wrench.
        **({} if component.space.is_default else {"space": component.space.words()}),
        "tolerance": (
            {"translation": limit.translation, "rotation": limit.rotation} if limit else None
        ),
        "rows": table.row_count,
        "pending_rows": workspace.unbuilt(component.name, table)[0],
        "solved": solved,
        "measured": table.row_count - solved,
        "another_setup": {"rows": table.other_rows, "wrenches": table.other_wrenches},
        "archived": card.archived,
        "notes": card.notes,
        "renamed_to": card.renamed_to,
        "copied_from": card.copied_from,
        "table_version": table.version,
    }
