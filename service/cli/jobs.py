"""``wrenchbook jobs``: the list of jobs, or a line for each change of one."""

from __future__ import annotations

import json
import time
from typing import Annotated, Any

import typer
from rich.console import Console

from wrenchbook.service.cli.connect import (
    DEFAULT_SERVER,
    AsJson,
    Data,
    Server,
    connected,
    print_json,
)
from wrenchbook.service.cli.render import job_table, plain
from wrenchbook.service.cli.screen import Screen
from wrenchbook.service.client import Client, Event, Job

MAX_SHOWN = 50  # open jobs in the table before the first event


def jobs(
    component: Annotated[str | None, typer.Option(help="only jobs of this component")] = None,
    status: Annotated[
        str | None, typer.Option(help="only waiting, running, done, failed or cancelled jobs")
    ] = None,
    limit: Annotated[int, typer.Option(min=1, help="largest number of jobs")] = 1000,
    after: Annotated[int | None, typer.Option(help="only jobs older than this job")] = None,
    follow: Annotated[
        bool, typer.Option("--follow", help="print each change from now on, until Ctrl-C")
    ] = False,
    as_json: AsJson = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """List jobs, newest first, or follow their changes."""
    out = Screen()
    with connected(server, data) as client:
        if follow:
            follow_jobs(out, client, component, as_json=as_json)
            return
        found: list[Job] = client.jobs(component, status, limit, after)
    if as_json:
        print_json([job.raw for job in found])
    else:
        out.print(job_table(found))
        if len(found) == limit:
            plain(out, f"Older ones: wrenchbook jobs --after {found[-1].id}")


def follow_jobs(
    out: Console,
    client: Client,
    component: str | None,
    timeout_s: float | None = None,
    *,
    as_json: bool = False,
) -> None:
    """Print the open jobs, then a line for each event, until Ctrl-C; as JSON only the events.

    Parameters
    ----------
    timeout_s : float, optional
        Seconds without an event after which it ends.
    """
    shown = False
    for event in client.events(component, timeout_s=timeout_s):
        if as_json:
            print(json.dumps({"event": event.kind, **event.body}), flush=True)
            continue
        if not shown:  # events arrive from here on, so none is missed after the list
            out.print(job_table(_open_jobs(client, component)))
            shown = True
        if line := event_line(event):
            plain(out, f"{time.strftime('%H:%M:%S')} {line}")


def event_line(event: Event) -> str:
    """Return an event in words; empty for an event without a message."""
    body = event.body
    if event.kind == "job":
        return _job_line(body)
    if event.kind == "jobs":
        return f"{body['count']} jobs of {body['component']} changed"
    if event.kind == "table":
        return f"{body['component']}: table version {body['table_version']}, {body['rows']} rows"
    return str(body["reason"]) if "reason" in body else ""


def _job_line(body: dict[str, Any]) -> str:
    line = f"job {body['id']} of {body['component']}: {body['status']}"
    if body.get("error"):
        return f"{line}, {body['error']['kind']}: {body['error']['message']}"
    if progress := body.get("progress"):
        return f"{line}, {progress['fraction']:.0%} {progress['message']}".rstrip()
    if body.get("row") is not None:
        return f"{line}, row {body['row']}"
    return line


def _open_jobs(client: Client, component: str | None) -> list[Job]:
    found = [
        job
        for status in ("running", "waiting")
        for job in client.jobs(component, status, limit=MAX_SHOWN)
    ]
    return found[:MAX_SHOWN]
