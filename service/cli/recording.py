"""Commands for recorded wrenches, envelopes, and rows of an earlier setup."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

import typer
from rich.table import Table

from wrenchbook.service.cli import progress
from wrenchbook.service.cli.connect import (
    DEFAULT_SERVER,
    AsJson,
    BeyondRange,
    Data,
    Name,
    Server,
    connected,
    refuse_alone,
)
from wrenchbook.service.cli.render import Screen, cell, show
from wrenchbook.service.client import Client, Started
from wrenchbook.service.contract import LOADS, OUTPUTS, counted

Clear = Annotated[bool, typer.Option("--clear", help="delete the recorded wrenches")]
Start = Annotated[
    bool, typer.Option("--start", help="solve the recorded wrenches, and show the progress")
]
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
    _check(start, clear, {"--budget": budget, "--beyond-range": beyond_range})
    with connected(server, data) as client:
        if clear:
            count = client.clear_recording(name)
            show({"cleared": count}, as_json, f"{counted(count, 'wrench')} forgotten.")
        elif start:
            started = client.start_recording(name, budget, beyond_range=beyond_range)
            _follow(client, started, as_json)
        else:
            recorded = client.recording(name)
            counts = (
                f"{counted(recorded.total, 'wrench')} recorded of {name}: {len(recorded)} kept, "
                f"{recorded.merged} merged, {recorded.thinned} thinned, {recorded.outside} outside "
                "the load range."
            )
            show(recorded.raw, as_json, "\n".join(filter(None, [counts, recorded.raw["reason"]])))


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
    _check(start, clear, {"--beyond-range": beyond_range})
    with connected(server, data) as client:
        if clear:
            count = client.clear_envelope(name)
            show(
                {"cleared": count},
                as_json,
                f"The envelope of {counted(count, 'wrench')} is forgotten.",
            )
            return
        if start:
            _follow(client, client.start_envelope(name, beyond_range=beyond_range), as_json)
            return
        envelope = client.envelope(name)
    box = Table("input", "least", "largest")
    inputs = envelope.raw.get("inputs", LOADS)
    for load, low, high in zip(inputs, envelope.min, envelope.max, strict=True):
        box.add_row(load, cell(low, ".6g"), cell(high, ".6g"))
    bounds = Table("output", "largest displacement")
    outputs = envelope.raw.get("outputs", OUTPUTS)
    for output, bound in zip(outputs, envelope.displacement_bound, strict=True):
        bounds.add_row(output, cell(bound, ".4g"))
    verdict = {True: "negligible", False: "not negligible", None: "not known to be negligible"}
    text = f"{envelope.count} wrenches; {envelope.bound}; {verdict[envelope.negligible]}."
    shown = [box, bounds, "\n".join(filter(None, [text, envelope.reason]))]
    show(envelope.raw, as_json, lambda: shown)


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


def _check(start: bool, clear: bool, of_start: Mapping[str, object]) -> None:
    """Refuse --start beside --clear, and the options by name `of_start` without it."""
    if start and clear:
        raise typer.BadParameter("--start and --clear exclude each other; give one of them")
    if not start:
        refuse_alone("--start", of_start)


def _follow(client: Client, started: Started, as_json: bool) -> None:
    """Show the solves of a start until they end, then its counts."""
    jobs = list(started.jobs)
    if jobs:
        jobs = progress.follow(Screen(stderr=as_json), client, jobs)
    done = started.solved + started.covered
    were = f"{counted(done, 'wrench')} {'was' if done == 1 else 'were'} solved or covered before"
    counts = f"{counted(len(jobs), 'solve')}; {were}."
    reply = {**started.raw, "jobs": [job.raw for job in jobs]}
    show(reply, as_json, "\n".join(filter(None, [counts, started.reason])))


RECORDING_COMMANDS = (recording, envelope, resolve)
