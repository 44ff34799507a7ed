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
from wrenchbook.service.client.wrenches import NAMES

OUTPUTS = ("ux", "uy", "uz", "rx", "ry", "rz")
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
    out = Screen()
    with connected(server, data) as client:
        if clear:
            out.print(f"{client.clear_recording(name)} wrenches forgotten.")
        elif start:
            _follow(out, client, client.start_recording(name, budget, beyond_range=beyond_range))
        else:
            found = client.recording(name)
            print_json(found.raw) if as_json else _show_recording(out, name, found)


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
    out = Screen()
    with connected(server, data) as client:
        if clear:
            out.print(f"The envelope of {client.clear_envelope(name)} wrenches is forgotten.")
        elif start:
            _follow(out, client, client.start_envelope(name, beyond_range=beyond_range))
        else:
            found = client.envelope(name)
            print_json(found.raw) if as_json else _show_envelope(out, found)


def resolve(
    name: Name,
    budget: Budget = None,
    beyond_range: BeyondRange = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Solve again the wrenches of rows that an earlier setup of the component has."""
    with connected(server, data) as client:
        _follow(Screen(), client, client.resolve(name, budget, beyond_range=beyond_range))


def _check(start: bool, clear: bool) -> None:
    if start and clear:
        raise typer.BadParameter("give --start or --clear, not both")


def _follow(out: Console, client: Client, started: Started) -> None:
    if started.jobs:
        render.follow(out, client, list(started.jobs), WAIT_S)
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
    table = Table("load", "least", "largest", "output", "largest displacement")
    for place, load in enumerate(NAMES):
        bound = f"{found.displacement_bound[place]:.4g}"
        low, high = f"{found.min[place]:.6g}", f"{found.max[place]:.6g}"
        table.add_row(load, low, high, OUTPUTS[place], bound)
    out.print(table)
    verdict = {True: "negligible", False: "not negligible", None: "not known to be negligible"}
    out.print(f"{found.count} wrenches; {found.bound}; {verdict[found.negligible]}.")
    if found.reason:
        render.plain(out, found.reason)


RECORDING_COMMANDS = (recording, envelope, resolve)
