"""The command line: ``wrenchbook``. The commands here are clients of a server."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, cast

import typer

import wrenchbook
from wrenchbook.service.cli import plan_table, render
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
from wrenchbook.service.cli.follow import follow_jobs
from wrenchbook.service.cli.keys import keys
from wrenchbook.service.cli.local import LOCAL_COMMANDS
from wrenchbook.service.cli.ops import OPS_COMMANDS
from wrenchbook.service.cli.recording import RECORDING_COMMANDS
from wrenchbook.service.cli.screen import Screen
from wrenchbook.service.cli.tables import TABLE_COMMANDS
from wrenchbook.service.client import Displacement, Job, ProblemError, Scene, ServerUnreachable
from wrenchbook.service.client.deformed import deformed_format
from wrenchbook.service.client.wrenches import OnThin

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Displacements of deformable components from tables of finite-element results.",
)
out = Screen()


def print_version(asked: bool) -> None:
    """Print the version and end, if that is asked for."""
    if asked:
        typer.echo(f"wrenchbook {wrenchbook.__version__}")
        raise typer.Exit


@app.callback()
def program(
    version: Annotated[
        bool, typer.Option("--version", callback=print_version, is_eager=True, help="print it")
    ] = False,
) -> None:
    """Displacements of deformable components from tables of finite-element results."""


for named, table_command in TABLE_COMMANDS.items():
    app.command(named)(table_command)
for command in (*LOCAL_COMMANDS, *RECORDING_COMMANDS, *OPS_COMMANDS):
    app.command()(command)
app.add_typer(keys, name="keys")

Three = tuple[float, float, float]
Six = tuple[float, float, float, float, float, float]
ZERO: Three = (0.0, 0.0, 0.0)

Force = Annotated[Three, typer.Option(help="F_x F_y F_z, N", metavar="FX FY FZ")]
Moment = Annotated[Three, typer.Option(help="M_x M_y M_z, N·m", metavar="MX MY MZ")]
Budget = Annotated[int, typer.Option(min=1, help="most solves to spend")]
Micro = Annotated[float | None, typer.Option(help="error bar to reach, translations, m")]
MicroRad = Annotated[float | None, typer.Option(help="error bar to reach, rotations, rad")]

ForceRange = Annotated[
    Six | None,
    typer.Option(help="only within, N", metavar="FX FX FY FY FZ FZ", show_default=False),
]
MomentRange = Annotated[
    Six | None,
    typer.Option(help="only within, N·m", metavar="MX MX MY MY MZ MZ", show_default=False),
]


@app.command()
def query(
    name: Name,
    force: Force = ZERO,
    moment: Moment = ZERO,
    on_thin: Annotated[
        str | None, typer.Option(help="queue, wait (the default), estimate or reject")
    ] = None,
    wait_s: Annotated[float, typer.Option(help="with wait: seconds")] = 60.0,
    method: Annotated[
        str | None, typer.Option(help="such as griddata; the component's own choice otherwise")
    ] = None,
    detail: Annotated[bool, typer.Option(help="what each axis contributes")] = False,
    derivatives: Annotated[
        bool, typer.Option("--derivatives", help="add du/dw, 6 x 6, to what --json prints")
    ] = False,
    beyond_range: BeyondRange = False,
    table_version: Annotated[
        int | None, typer.Option(help="ask the table as it was; where it was thin, estimate")
    ] = None,
    as_json: AsJson = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Ask for the displacement under a wrench."""
    word = on_thin or ("wait" if table_version is None else "estimate")
    with connected(server, data) as client:
        answer = client.displacement(
            name,
            force,
            moment,
            on_thin=cast(OnThin, word),  # the client refuses other words
            wait_s=wait_s,
            method=method,
            detail=detail,
            derivatives=derivatives,
            beyond_range=beyond_range,
            table_version=table_version,
        )
        _print_answer(answer, as_json)


@app.command()
def solve(
    name: Name,
    force: Force = ZERO,
    moment: Moment = ZERO,
    wait_s: Annotated[float, typer.Option(help="give up waiting after this long, s")] = 600.0,
    beyond_range: BeyondRange = False,
    as_json: AsJson = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Solve a wrench with finite elements, whatever the table says."""
    with connected(server, data) as client:
        answer = client.solve(name, force, moment, beyond_range=beyond_range)
        if answer.job is not None and answer.job.status != "done":
            render.follow(out, client, [answer.job], wait_s)
            answer = client.solve(name, force, moment, beyond_range=beyond_range)
        _print_answer(answer, as_json)


@app.command()
def deformed(
    name: Name,
    file: Annotated[Path, typer.Argument(help="written: .glb, .vtu or .json")],
    force: Force = ZERO,
    moment: Moment = ZERO,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Write the deformed surface under a wrench, for a viewer or a simulator."""
    form = deformed_format(file)
    with connected(server, data) as client:
        content = client.deformed_file(name, force, moment, form)
    file.write_bytes(content)
    typer.echo(f"{file}: {len(content)} bytes")


@app.command()
def fill(
    name: Name,
    budget: Budget = 100,
    translation: Micro = None,
    rotation: MicroRad = None,
    force_range: ForceRange = None,
    moment_range: MomentRange = None,
    output: Annotated[
        list[str] | None, typer.Option(help="an output that is wanted, such as uz; repeatable")
    ] = None,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Make a table thicker where its error bar is largest."""
    if (translation is None) != (rotation is None):
        raise typer.BadParameter("give --translation and --rotation together")
    tolerance = (
        {"translation": translation, "rotation": rotation} if translation and rotation else None
    )
    if (force_range is None) != (moment_range is None):
        raise typer.BadParameter("give --force-range and --moment-range together")
    span = None
    if force_range and moment_range:
        span = {"force": _pairs(force_range), "moment": _pairs(moment_range)}
    wanted = {"tolerance": tolerance, "range": span, "outputs": output or None}
    with connected(server, data) as client:
        render.fill(out, client, name, budget, wanted)


@app.command()
def plan(
    scene: Annotated[
        Path, typer.Argument(help="a scene's .toml file", exists=True, dir_okay=False)
    ],
    as_json: AsJson = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Tell what a scene needs of its components: what is left out, and what that saves."""
    wanted = Scene.read(scene)
    with connected(server, data) as client:
        plans = wanted.plan(client)
    if as_json:
        print_json({"components": {name: one.raw for name, one in plans.items()}})
    else:
        plan_table.show(out, plans)


@app.command()
def report(
    name: Name,
    wrenches: Annotated[int, typer.Option(min=3, help="random wrenches to compare")] = 24,
    html: Annotated[Path | None, typer.Option(help="write the page with plots here")] = None,
    as_json: AsJson = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Report error against run time: methods and table sizes beside three meshes; takes minutes."""
    with connected(server, data) as client:
        client.make_report(name, wrenches)
        render.follow_report(out, client, name)
        if html is not None:
            html.write_bytes(client.report(name, "html"))
        content = client.report(name, "json" if as_json else "md")
    sys.stdout.write(content.decode())


@app.command()
def compliance(
    name: Name, as_json: AsJson = False, server: Server = DEFAULT_SERVER, data: Data = None
) -> None:
    """Show a component's 6x6 compliance: at zero load, and its mean over the load range."""
    with connected(server, data) as client:
        found = client.compliance(name)
    if as_json:
        print_json(found)
    else:
        for table in render.compliance_tables(found):
            out.print(table)


@app.command()
def components(as_json: AsJson = False, server: Server = DEFAULT_SERVER, data: Data = None) -> None:
    """List the library."""
    with connected(server, data) as client:
        found = client.components()
    if as_json:
        print_json(found)
    else:
        out.print(render.component_table(found))


@app.command()
def jobs(
    component: Annotated[str | None, typer.Option(help="only this component's")] = None,
    status: Annotated[str | None, typer.Option(help="only these, such as failed")] = None,
    limit: Annotated[int, typer.Option(min=1, help="at most so many")] = 1000,
    after: Annotated[int | None, typer.Option(help="go on after this job, to older ones")] = None,
    follow: Annotated[
        bool, typer.Option("--follow", help="show what happens from now on, until Ctrl-C")
    ] = False,
    as_json: AsJson = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """List jobs, newest first, or follow them."""
    with connected(server, data) as client:
        if follow:
            follow_jobs(out, client, component)
            return
        found: list[Job] = client.jobs(component, status, limit, after)
    if as_json:
        print_json([job.raw for job in found])
    else:
        out.print(render.job_table(found))
        if len(found) == limit:
            render.plain(out, f"Older ones: wrenchbook jobs --after {found[-1].id}")


def main() -> None:
    """Run the command line; errors a user can mend are one message on stderr and status 1."""
    try:
        # Named here, because a file run by its path would show that path.
        app(prog_name="wrenchbook")
    except ProblemError as error:
        err = Screen(stderr=True)
        render.plain(err, error.title, style="red")
        render.plain(err, error.detail)
        render.body_errors(err, error.errors)
        sys.exit(1)
    except (ServerUnreachable, OSError, RuntimeError, ValueError) as error:
        render.plain(Screen(stderr=True), str(error), style="red")
        sys.exit(1)


def _pairs(ends: Six) -> list[list[float]]:
    """Return three spans [low, high] from their six ends."""
    return [list(ends[place : place + 2]) for place in (0, 2, 4)]


def _print_answer(answer: Displacement, as_json: bool) -> None:
    if as_json:
        print_json(answer.raw)
    else:
        out.print(render.answer_table(answer))


if __name__ == "__main__":
    main()
