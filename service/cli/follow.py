"""Jobs as they change, line by line."""

from __future__ import annotations

import time
from typing import Any

from rich.console import Console

from wrenchbook.service.cli.render import job_table, plain
from wrenchbook.service.client import Client, Event

MOST_SHOWN = 50  # open jobs in the table before the first event


def follow_jobs(
    out: Console, client: Client, component: str | None, timeout_s: float | None = None
) -> None:
    """Show the open jobs, then a line for each thing that happens, until Ctrl-C.

    Parameters
    ----------
    timeout_s : float, optional
        It ends after so long without an event.
    """
    shown = False
    for event in client.events(component, timeout_s=timeout_s):
        if not shown:  # now that events come, nothing between the list and them is missed
            out.print(job_table(_open_jobs(client, component)))
            shown = True
        if line := event_line(event):
            plain(out, f"{time.strftime('%H:%M:%S')} {line}")


def event_line(event: Event) -> str:
    """Return an event in words; empty for those that say nothing to people."""
    body = event.body
    if event.kind == "job":
        return _job_line(body)
    if event.kind == "jobs":
        return f"{body['count']} jobs of {body['component']} changed"
    if event.kind == "table":
        return f"{body['component']}: table version {body['table_version']}, {body['rows']} rows"
    return str(body["reason"]) if "reason" in body else ""


def _job_line(body: dict[str, Any]) -> str:
    words = f"job {body['id']} of {body['component']}: {body['status']}"
    if body.get("error"):
        return f"{words}, {body['error']['kind']}: {body['error']['message']}"
    if progress := body.get("progress"):
        return f"{words}, {progress['fraction']:.0%} {progress['message']}".rstrip()
    if body.get("row") is not None:
        return f"{words}, row {body['row']}"
    return words


def _open_jobs(client: Client, component: str | None) -> list[Any]:
    found = [
        job
        for status in ("running", "waiting")
        for job in client.jobs(component, status, limit=MOST_SHOWN)
    ]
    return found[:MOST_SHOWN]
