"""Components: list, show, add, and fill the table of one."""

from __future__ import annotations

from typing import Any

import numpy as np
import orjson
from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import UploadFile
from starlette.responses import Response

from service.contract import CONTRACT
from service.http.bodies import FillBody, RangeBody, TableOnlyComponent
from service.http.limited import read_limited
from service.http.links import job_link
from service.http.parsing import read_body
from service.http.problems import ProblemError, bad_body
from service.library.checked import interface_of, warnings_of
from service.library.component import Component
from service.workspace import Workspace
from surrogate.table.rows import LOAD_UNITS, LOADS, OUTPUTS, LoadRange, Tolerance

router = APIRouter(prefix="/v1/components", tags=["components"])
CATCH_UP_S = 25.0


@router.get("", summary="The library")
def list_components(request: Request) -> dict[str, Any]:
    workspace: Workspace = request.app.state.workspace
    library = workspace.library
    return {
        "components": [_summary(workspace, library[name]) for name in library.names()],
        "broken": [
            {"name": name, "reason": reason} for name, reason in sorted(workspace.broken().items())
        ],
    }


@router.get("/{name}", summary="One component: contract, range, rows, coverage")
async def one_component(name: str, request: Request) -> dict[str, Any]:
    workspace: Workspace = request.app.state.workspace
    await workspace.newest(name, CATCH_UP_S)
    return await run_in_threadpool(component_body, workspace, workspace.library[name])


@router.post("", status_code=201, summary="Add a component: a zip bundle, or JSON for a table only")
async def add_component(request: Request) -> Response:
    workspace: Workspace = request.app.state.workspace
    kind = request.headers.get("content-type", "").partition(";")[0].strip()
    if kind == "multipart/form-data":
        component = await _add_bundle(workspace, request)
    elif kind == "application/json":
        body = read_body(TableOnlyComponent, await read_limited(request.receive))
        component = await run_in_threadpool(_add_table_only, workspace, body)
    else:
        raise ProblemError(
            415,
            "media-type",
            "Not a form this call takes",
            f"The content type is {kind or 'missing'}. Send a bundle's zip as multipart/form-data "
            "with the field 'bundle', or a table-only component as application/json.",
        )
    content = orjson.dumps(await run_in_threadpool(component_body, workspace, component))
    headers = {"Location": f"/v1/components/{component.name}"}
    return Response(content, 201, headers, "application/json")


async def _add_bundle(workspace: Workspace, request: Request) -> Component:
    async with request.form(max_files=1) as form:
        upload = form.get("bundle")
        if not isinstance(upload, UploadFile):
            raise bad_body([{"loc": "bundle", "msg": "send the zip as the form's file 'bundle'"}])
        return await run_in_threadpool(workspace.library.add_zip, upload.file)


def _add_table_only(workspace: Workspace, body: TableOnlyComponent) -> Component:
    bounds = body.range.bounds()
    tolerance = body.tolerance.model_dump() if body.tolerance else None
    return workspace.library.add_table_only(
        body.name, body.title, bounds[:3], bounds[3:], tolerance
    )


@router.post(
    "/{name}/fill",
    summary="Queue the solves that lower the table's error most",
)
async def fill(name: str, request: Request) -> Response:
    order = read_body(FillBody, await read_limited(request.receive))
    workspace: Workspace = request.app.state.workspace
    reply = await run_in_threadpool(_fill, workspace, name, order)
    return Response(orjson.dumps(reply), 202 if reply["jobs"] else 200, None, "application/json")


def _fill(workspace: Workspace, name: str, order: FillBody) -> dict[str, Any]:
    """Design one round of solves on the newest table and accept them."""
    limit = Tolerance(**order.tolerance.model_dump()) if order.tolerance else None
    span = _span_of(order.range, workspace.library[name].load_range) if order.range else None
    outputs = range(6) if order.outputs is None else sorted(map(OUTPUTS.index, set(order.outputs)))
    design, jobs = workspace.fill(name, order.budget, limit, span, outputs)
    return {
        "component": name,
        "jobs": [job_link(job) for job in jobs],
        "stage": design.stage,
        "reason": design.reason,
    }


def _span_of(wanted: RangeBody, whole: LoadRange) -> LoadRange:
    """Return a fill's range, N and N·m.

    Raises
    ------
    ProblemError
        422, if an end is beyond the component's load range or the two ends are the wrong way round.
    """
    bounds = np.array(wanted.bounds())
    errors = []
    for load, (low, high) in enumerate(bounds.tolist()):
        where, place = ("force", load) if load < 3 else ("moment", load - 3)
        least, most = min(whole.low[load], 0.0), max(whole.high[load], 0.0)
        unit = LOAD_UNITS[load]
        if low > high:
            message = f"the low end of {LOADS[load]}, {low:g}, is above the high end, {high:g}"
        elif low < least or high > most:
            message = f"{LOADS[load]} must lie within {least:g} to {most:g} {unit}, the load range"
        else:
            continue
        errors.append({"loc": f"range.{where}.{place}", "msg": message})
    if errors:
        raise bad_body(errors)
    return LoadRange(bounds[:, 0], bounds[:, 1])


def component_body(workspace: Workspace, component: Component) -> dict[str, Any]:
    """Return all there is to say about a component."""
    surrogate = workspace.tables.surrogate(component.name)
    sources, counts = np.unique(surrogate.rows.source, return_counts=True)
    return {
        **_summary(workspace, component),
        "fingerprint": component.fingerprint,
        "contract": CONTRACT,
        "interface": interface_of(component),
        "warnings": warnings_of(component.folder),
        "sources": dict(zip(sources.tolist(), counts.tolist(), strict=True)),
        "coverage": surrogate.coverage_summary(),
        "jobs": workspace.ledger.counts(component.name),
    }


def _summary(workspace: Workspace, component: Component) -> dict[str, Any]:
    surrogate = workspace.tables.surrogate(component.name)
    low, high = component.load_range.low.tolist(), component.load_range.high.tolist()
    limit = component.tolerance
    return {
        "name": component.name,
        "title": component.title,
        "has_fea": component.has_fea,
        "linear": component.linear,
        "shipped": component.shipped,
        "range": {
            "force": [list(span) for span in zip(low[:3], high[:3], strict=True)],
            "moment": [list(span) for span in zip(low[3:], high[3:], strict=True)],
        },
        "tolerance": (
            {"translation": limit.translation, "rotation": limit.rotation} if limit else None
        ),
        "rows": len(surrogate.rows),
        "table_version": surrogate.version,
    }
