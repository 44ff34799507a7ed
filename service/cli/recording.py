"""Commands whose solves are known beforehand: recordings, envelopes, rows of another setup."""

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

Clear = Annotated[bool, typer.Option("--clear", help="forget it")]
Start = Annotated[bool, typer.Option("--start", help="solve it, and follow the solves")]


def recording(
    name: Name,
    start: Start = False,
    clear: Clear = False,
    budget: Annotated[
        int | None, typer.Option(min=1, help="with --start: most solves to spend")
    ] = None,
    beyond_range: BeyondRange = False,
    as_json: AsJson = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Show the wrenches that loops have recorded (LM_direct); solve or forget them."""
    _check(start, clear)
    out = Screen()
    with connected(server, data) as client:
        if clear:
            out.print(f"{client.clear_recording(name)} wrenches forgotten.")
        elif start:
            _follow(out, client, client.start_recording(name, budget, beyond_range=beyond_range))
        elif as_json:
            print_json(client.recording(name).raw)
        else:
            _show_recording(out, name, client.recording(name))


def envelope(
    name: Name,
    start: Start = False,
    clear: Clear = False,
    beyond_range: BeyondRange = False,
    as_json: AsJson = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Show the extremes that loops have met (LM_max); solve or forget them."""
    _check(start, clear)
    out = Screen()
    with connected(server, data) as client:
        if clear:
            out.print(f"The envelope of {client.clear_envelope(name)} wrenches is forgotten.")
        elif start:
            _follow(out, client, client.start_envelope(name, beyond_range=beyond_range))
        elif as_json:
            print_json(client.envelope(name).raw)
        else:
            _show_envelope(out, client.envelope(name))


def resolve(
    name: Name,
    budget: Annotated[int | None, typer.Option(min=1, help="most solves to spend")] = None,
    beyond_range: BeyondRange = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Solve the wrenches again whose rows belong to another setup of a component."""
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
