"""Error against run time of a component's table, as JSON, Markdown or a page with plots."""

from __future__ import annotations

import time
from dataclasses import asdict
from typing import Annotated, Any, Literal

from fastapi import Query
from starlette.responses import Response

from wrenchbook.service.http.openapi import JSON, TEXT, answers, component_router, refused
from wrenchbook.service.http.problems import HttpProblemError
from wrenchbook.service.http.routes import Opened, json_reply
from wrenchbook.service.ledger.audit import note
from wrenchbook.service.submission import NoSetupError
from wrenchbook.service.tables.mapped import TableBehindError
from wrenchbook.service.workspace import CATCH_UP_S, Workspace

router = component_router("report", "/report")

_MEDIA_TYPES = {
    "json": JSON,
    "md": "text/markdown; charset=utf-8",
    "html": "text/html; charset=utf-8",
}

POLL_S = 0.05  # s between two polls of the file of a table
_IN_PROGRESS = answers(dict[str, Any], "state of the running report", 202)


@router.post(
    "",
    status_code=202,
    responses=answers(dict[str, Any], "state of the finished report") | _IN_PROGRESS | refused(409),
)
def make_report(
    name: str,
    workspace: Opened,
    wrenches: Annotated[int, Query(ge=3, le=1000)] = 24,
    seed: Annotated[int, Query(ge=0)] = 1,
) -> Response:
    """Start a new report; it solves for minutes."""
    component = workspace.library[name]
    if not component.has_fea:
        raise NoSetupError(
            f"{name!r} has no finite-element setup, so a report has no reference. GET "
            f"/v1/components/{name}/coverage shows what its rows cover."
        )
    # The builder writes the file of a table after its rows.
    deadline = time.monotonic() + CATCH_UP_S
    tables = workspace.tables
    rows = tables.caught_up(name, CATCH_UP_S).row_count
    while rows and tables.written(name) is None:
        if time.monotonic() > deadline:
            why = f"the table of {name!r} is still being written after {CATCH_UP_S:g} s"
            raise TableBehindError(why + "; send the request again in a minute")
        time.sleep(POLL_S)
    try:
        begun = workspace.reports.make(component, rows, wrenches, seed)
    except FileNotFoundError as error:
        raise HttpProblemError(409, "no-rows", "The table has no rows", str(error)) from None
    if begun:
        with workspace.ledger.writing() as db:
            note(db, "report.make", name, name, after={"wrenches": wrenches})
    return _state(workspace, name)


@router.delete("")
def cancel_report(name: str, workspace: Opened) -> Response:
    """Cancel a running report."""
    _ = workspace.library[name]
    workspace.reports.cancel(name)
    return _state(workspace, name)


@router.get(
    "",
    responses=answers(
        dict[str, Any], "the latest report", content={"text/markdown": TEXT, "text/html": TEXT}
    )
    | _IN_PROGRESS,
)
def get_report(
    name: str,
    workspace: Opened,
    format: Literal["json", "md", "html", "state"] = "json",  # noqa: A002 (the contract's word)
) -> Response:
    """Show the latest report; 202 while the first report is running."""
    _ = workspace.library[name]
    if format == "state":
        return _state(workspace, name)
    latest = workspace.reports.state(name)  # before its file, which a report has at its end
    path = workspace.reports.file(name, format)
    if path is not None:
        return Response(path.read_bytes(), 200, None, _MEDIA_TYPES[format])
    if latest.state == "running":
        return _state(workspace, name)
    why = f"The last attempt failed: {latest.message}. " if latest.state == "failed" else ""
    why = f"{why}Make one with POST /v1/components/{name}/report or: wrenchbook report {name}"
    raise HttpProblemError(404, "no-report", "No report yet", why)


def _state(workspace: Workspace, name: str) -> Response:
    latest = workspace.reports.state(name)
    body = {"component": name, **asdict(latest), "url": f"/v1/components/{name}/report"}
    return json_reply(body, 202 if latest.state == "running" else 200)
