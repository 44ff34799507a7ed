"""The command line: ``wrenchbook``. The commands here are clients of a server."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from service.cli import render
from service.cli.local import LOCAL_COMMANDS
from service.client import Client, Displacement, Job, ProblemError, ServerUnreachable
from service.client.library import table_format

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Displacements of deformable components from tables of finite-element results.",
)
out = Console()
for command in LOCAL_COMMANDS:
    app.command()(command)

Three = tuple[float, float, float]
Six = tuple[float, float, float, float, float, float]
ZERO: Three = (0.0, 0.0, 0.0)

Name = Annotated[str, typer.Argument(help="the component")]
Force = Annotated[Three, typer.Option(help="F_x F_y F_z, N", metavar="FX FY FZ")]
Moment = Annotated[Three, typer.Option(help="M_x M_y M_z, N·m", metavar="MX MY MZ")]
Server = Annotated[
    str, typer.Option(envvar="WRENCHBOOK_SERVER", help="address of a running server")
]
Data = Annotated[
    Path | None,
    typer.Option(help="work on this data directory with a private server of its own instead"),
]
BeyondRange = Annotated[
    bool, typer.Option(help="solve a wrench outside the component's load range all the same")
]
AsJson = Annotated[bool, typer.Option("--json", help="print the server's reply as JSON")]
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

DEFAULT_SERVER = "http://127.0.0.1:8000"


@contextmanager
def connected(server: str, data: Path | None, solvers: int = 2) -> Iterator[Client]:
    """Give a client of the running server, or of a private one on ``data``."""
    if data is None:
        with Client(server) as client:
            yield client
        return
    from service.http.server import private_server

    with private_server(data, solvers) as client:
        yield client


@app.command()
def query(
    name: Name,
    force: Force = ZERO,
    moment: Moment = ZERO,
    on_thin: Annotated[str, typer.Option(help="queue, wait, estimate or reject")] = "wait",
    wait_s: Annotated[float, typer.Option(help="with wait: seconds")] = 60.0,
    method: Annotated[
        str | None, typer.Option(help="such as griddata; the component's own choice otherwise")
    ] = None,
    detail: Annotated[bool, typer.Option(help="what each axis contributes")] = False,
    derivatives: Annotated[
        bool, typer.Option("--derivatives", help="add du/dw, 6 x 6, to what --json prints")
    ] = False,
    beyond_range: BeyondRange = False,
    as_json: AsJson = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Ask for the displacement under a wrench."""
    with connected(server, data) as client:
        answer = client.displacement(
            name,
            force,
            moment,
            on_thin=on_thin,
            wait_s=wait_s,
            method=method,
            detail=detail,
            derivatives=derivatives,
            beyond_range=beyond_range,
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


@app.command("import")
def import_(
    name: Name,
    file: Annotated[
        Path,
        typer.Argument(help="a .csv, .json, .h5 or .hdf5 table", exists=True, dir_okay=False),
    ],
    dry_run: Annotated[bool, typer.Option(help="only check")] = False,
    decimal: Annotated[
        str | None, typer.Option(help="the decimal mark of a CSV: . or ,", metavar="MARK")
    ] = None,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Load a table from outside: all its rows, or none and the reasons."""
    table_format(file, reading=True)  # before a server is asked, or started, for nothing
    with connected(server, data) as client:
        reply = client.import_table(name, file, dry_run=dry_run, decimal=decimal)
    render.row_errors(out, reply["errors"])
    verb = "would be inserted" if dry_run else "inserted"
    out.print(f"{reply['inserted']} rows {verb}, {reply['existing']} were there already.")
    if not (dry_run or reply["errors"] or reply["in_use"]):
        out.print("The server still builds its table; it answers from the new rows shortly.")
    raise typer.Exit(1 if reply["errors"] else 0)


@app.command()
def export(
    name: Name,
    file: Annotated[Path, typer.Argument(help="a .csv, .json, .h5 or .hdf5 file; - prints CSV")],
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Write a table to a file; its ending chooses the format."""
    printed = str(file) == "-"
    format_ = "csv" if printed else table_format(file)
    with connected(server, data) as client:
        content = client.export_table(name, format_)
    if printed:
        sys.stdout.write(content)
        return
    partial = file.with_name(file.name + ".part")
    partial.write_bytes(content if isinstance(content, bytes) else content.encode())
    partial.replace(file)
    out.print(f"{file} written.")


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
def components(as_json: AsJson = False, server: Server = DEFAULT_SERVER, data: Data = None) -> None:
    """List the library."""
    with connected(server, data) as client:
        found = client.components()
    if as_json:
        _print_json(found)
    else:
        out.print(render.component_table(found))


@app.command()
def jobs(
    component: Annotated[str | None, typer.Option(help="only this component's")] = None,
    status: Annotated[str | None, typer.Option(help="only these, such as failed")] = None,
    as_json: AsJson = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """List jobs, newest first."""
    with connected(server, data) as client:
        found: list[Job] = client.jobs(component, status)
    if as_json:
        _print_json([job.raw for job in found])
    else:
        out.print(render.job_table(found))


def main() -> None:
    """Run the command line; errors a user can mend are one message on stderr and status 1."""
    try:
        # Named here, because a file run by its path would show that path.
        app(prog_name="wrenchbook")
    except ProblemError as error:
        err = Console(stderr=True)
        render.plain(err, error.title, style="red")
        render.plain(err, error.detail)
        render.body_errors(err, error.errors)
        sys.exit(1)
    except (ServerUnreachable, OSError, RuntimeError, ValueError) as error:
        render.plain(Console(stderr=True), str(error), style="red")
        sys.exit(1)


def _pairs(ends: Six) -> list[list[float]]:
    """Return three spans [low, high] from their six ends."""
    return [list(ends[place : place + 2]) for place in (0, 2, 4)]


def _print_answer(answer: Displacement, as_json: bool) -> None:
    if as_json:
        _print_json(answer.raw)
    else:
        out.print(render.answer_table(answer))


def _print_json(reply: Any) -> None:
    sys.stdout.write(json.dumps(reply, indent=2) + "\n")


if __name__ == "__main__":
    main()
