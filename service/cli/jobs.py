"""The commands ``jobs`` (a list of jobs, or their changes) and ``audit`` (who wrote what)."""

from __future__ import annotations

import json
import time
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Column, Table

from wrenchbook.service.cli.connect import DEFAULT_SERVER, AsJson, Data, Server, connected
from wrenchbook.service.cli.render import Screen, job_table, plain, show
from wrenchbook.service.client import Client, Event
from wrenchbook.service.contract import counted

MAX_SHOWN = 50  # open jobs in the table before the first event: they fill a terminal


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
    if follow and (status is not None or after is not None):
        raise typer.BadParameter(
            "--follow shows the changes of all jobs; leave --status and --after out"
        )
    with connected(server, data) as client:
        if follow:
            follow_jobs(Screen(), client, component, as_json=as_json)
            return
        listed = client.jobs(component, status, limit, after)
    shown: list[Table | str] = [job_table(listed)]
    if len(listed) == limit:
        shown.append(f"Older ones: wrenchbook jobs --after {listed[-1].id}")
    show([job.raw for job in listed], as_json, lambda: shown)


def audit(
    component: Annotated[str | None, typer.Option(help="only writes about this component")] = None,
    actor: Annotated[
        str | None, typer.Option(help="only writes of this actor: the name of a key, or user:NAME")
    ] = None,
    action: Annotated[
        str | None, typer.Option(help="only writes of this action, such as row.withdraw or job.*")
    ] = None,
    since: Annotated[
        str | None, typer.Option(help="only writes from this time on, ISO 8601")
    ] = None,
    until: Annotated[
        str | None, typer.Option(help="only writes before this time, ISO 8601")
    ] = None,
    limit: Annotated[int, typer.Option(min=1, help="largest number of entries")] = 100,
    after: Annotated[int | None, typer.Option(help="only entries older than this one")] = None,
    as_json: AsJson = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """List writes with their actors, newest first; --json has the states before and after."""
    query = {"component": component, "actor": actor, "action": action, "since": since}
    query |= {"until": until, "limit": limit, "after": after}
    with connected(server, data) as client:
        entries = client.call_json("GET", "/v1/audit", query=query)["entries"]
    names = ("actor", "action", "component", "object")
    table = Table(Column("id", no_wrap=True), Column("time", no_wrap=True), *names)
    for entry in entries:
        table.add_row(str(entry["id"]), entry["time"], *(entry[name] for name in names))
    show(entries, as_json, lambda: [table])


def follow_jobs(
    out: Console, client: Client, component: str | None, *, as_json: bool = False
) -> None:
    """Print a table of open jobs, then a line for each event, until Ctrl-C.

    As JSON only the events are printed, an object a line.
    """
    has_table = False
    for event in client.events(component):
        if as_json:
            print(json.dumps({"event": event.kind, **event.body}), flush=True)
            continue
        if not has_table:  # after the first event, so that no change between both is missed
            # Waiting ones first: a job that starts in between is in both, and not in neither.
            waiting = client.jobs(component, "waiting", limit=MAX_SHOWN)
            running = client.jobs(component, "running", limit=MAX_SHOWN)
            listed = {job.id: job for job in running}
            listed |= {job.id: job for job in waiting if job.id not in listed}
            out.print(job_table([*listed.values()][:MAX_SHOWN]))
            has_table = True
        if line := event_line(event):
            plain(out, f"{time.strftime('%H:%M:%S')} {line}")


def event_line(event: Event) -> str:
    """Return the text of an event; empty for an event without a message."""
    body = event.body
    if event.kind == "jobs":
        return f"{counted(body['count'], 'job')} of {body['component']} changed"
    if event.kind == "table":
        rows = counted(body["rows"], "row")
        return f"{body['component']}: table version {body['table_version']}, {rows}"
    if event.kind != "job":
        return str(body.get("reason", ""))
    line = f"job {body['id']} of {body['component']}: {body['status']}"
    if body.get("error"):
        return f"{line}, {body['error']['kind']}: {body['error']['message']}"
    if progress := body.get("progress"):
        return f"{line}, {progress['fraction']:.0%} {progress['message']}".rstrip()
    return f"{line}, row {body['row']}" if body.get("row") is not None else line
