"""Commands for recorded wrenches, envelopes, and rows of an earlier setup."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from wrenchbook.service.cli import render
from wrenchbook.service.cli.connect import (
    DEFAULT_SERVER,
    AsJson,
    BeyondRange,
    Data,
    Name,
    Server,
    connected,
    print_json,
)
from wrenchbook.service.cli.screen import Screen
from wrenchbook.service.client import Client, Envelope, Recording, Started
from wrenchbook.service.contract import LOADS, OUTPUTS

WAIT_S = 86_400.0  # a start may be thousands of solves

Clear = Annotated[bool, typer.Option("--clear", help="delete the recorded wrenches")]
Start = Annotated[bool, typer.Option("--start", help="solve them, and show the progress")]
Budget = Annotated[int | None, typer.Option(min=1, help="largest number of solves")]


def recording(
    name: Name,
    start: Start = False,
    clear: Clear = False,
    budget: Budget = None,
    beyond_range: BeyondRange = False,
    as_json: AsJson = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Show, solve or delete the wrenches that simulators have recorded (LM_direct)."""
    _check(start, clear)
    with connected(server, data) as client:
        if clear:
            count = client.clear_recording(name)
            _print_cleared(f"{count} wrenches forgotten.", count, as_json)
        elif start:
            started = client.start_recording(name, budget, beyond_range=beyond_range)
            _follow(client, started, as_json)
        else:
            found = client.recording(name)
            print_json(found.raw) if as_json else _show_recording(Screen(), name, found)


def envelope(
    name: Name,
    start: Start = False,
    clear: Clear = False,
    beyond_range: BeyondRange = False,
    as_json: AsJson = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Show, solve or delete the extreme wrenches that simulators have recorded (LM_max)."""
    _check(start, clear)
    with connected(server, data) as client:
        if clear:
            count = client.clear_envelope(name)
            _print_cleared(f"The envelope of {count} wrenches is forgotten.", count, as_json)
        elif start:
            _follow(client, client.start_envelope(name, beyond_range=beyond_range), as_json)
        else:
            found = client.envelope(name)
            print_json(found.raw) if as_json else _show_envelope(Screen(), found)


def resolve(
    name: Name,
    budget: Budget = None,
    beyond_range: BeyondRange = False,
    as_json: AsJson = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Solve again the wrenches of rows that an earlier setup of the component has."""
    with connected(server, data) as client:
        _follow(client, client.resolve(name, budget, beyond_range=beyond_range), as_json)


def _check(start: bool, clear: bool) -> None:
    if start and clear:
        raise typer.BadParameter("give --start or --clear, not both")


def _print_cleared(message: str, count: int, as_json: bool) -> None:
    print_json({"cleared": count}) if as_json else Screen().print(message)


def _follow(client: Client, started: Started, as_json: bool) -> None:
    out, jobs = Screen(stderr=as_json), list(started.jobs)
    if jobs:
        jobs = render.follow(out, client, jobs, WAIT_S)
    if as_json:
        print_json({**started.raw, "jobs": [job.raw for job in jobs]})
        return
    done = started.solved + started.covered
    out.print(f"{len(started.jobs)} solves; {done} wrenches were solved or covered before.")
    if started.reason:
        render.plain(out, started.reason)


def _show_recording(out: Console, name: str, found: Recording) -> None:
    out.print(
        f"{found.total} wrenches recorded of {name}: {len(found)} kept, {found.merged} merged, "
        f"{found.thinned} thinned, {found.outside} outside the load range."
    )
    if found.raw["reason"]:
        render.plain(out, found.raw["reason"])


def _show_envelope(out: Console, found: Envelope) -> None:
    inputs = found.raw.get("inputs", LOADS)
    table = Table("input", "least", "largest")
    for load, low, high in zip(inputs, found.min, found.max, strict=True):
        table.add_row(load, f"{low:.6g}", f"{high:.6g}")
    out.print(table)
    table = Table("output", "largest displacement")
    for output, bound in zip(
        found.raw.get("outputs", OUTPUTS), found.displacement_bound, strict=True
    ):
        table.add_row(output, f"{bound:.4g}")
    out.print(table)
    verdict = {True: "negligible", False: "not negligible", None: "not known to be negligible"}
    out.print(f"{found.count} wrenches; {found.bound}; {verdict[found.negligible]}.")
    if found.reason:
        render.plain(out, found.reason)


RECORDING_COMMANDS = (recording, envelope, resolve)
