"""The program ``wrenchbook``: all commands by name, and those that query or fill a component."""

from __future__ import annotations

import re
import signal
import sys
from pathlib import Path
from typing import Annotated, Any, cast

import typer

import wrenchbook
from wrenchbook.service.cli import progress, render
from wrenchbook.service.cli.connect import (
    DEFAULT_SERVER,
    ZERO,
    AsJson,
    BeyondRange,
    Commands,
    Data,
    FurtherInput,
    Name,
    Server,
    Three,
    by_name,
    connected,
    further_inputs,
    in_folder,
    number,
    refuse_alone,
)
from wrenchbook.service.cli.jobs import audit, jobs
from wrenchbook.service.cli.joint import joint, stiffness
from wrenchbook.service.cli.local import LOCAL_COMMANDS, PROGRAMS, keys, run_program
from wrenchbook.service.cli.recording import RECORDING_COMMANDS
from wrenchbook.service.cli.render import Screen, plain, print_answer, print_json, show
from wrenchbook.service.cli.tables import TABLE_COMMANDS
from wrenchbook.service.client import Client, Displacement, ProblemError, Scene, ServerUnreachable
from wrenchbook.service.client.client import deformed_format
from wrenchbook.service.client.errors import InvalidArgument, mistake_line
from wrenchbook.service.contract import OnThin

app = Commands(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Displacements of deformable components from tables of finite-element results.",
)


def print_version(chosen: bool) -> None:
    """Print the version and end, if the option is given."""
    if chosen:
        typer.echo(f"wrenchbook {wrenchbook.__version__}")
        raise typer.Exit


@app.callback()
def program(
    version: Annotated[
        bool,
        typer.Option("--version", callback=print_version, is_eager=True, help="print the version"),
    ] = False,
) -> None:
    """Displacements of deformable components from tables of finite-element results."""


for command_name, table_command in TABLE_COMMANDS.items():
    app.command(command_name)(table_command)
for command in (*LOCAL_COMMANDS, *RECORDING_COMMANDS, jobs, audit, joint, stiffness):
    app.command()(command)
for program_name, summary in PROGRAMS.items():
    app.command(
        program_name,
        help=summary,
        add_help_option=False,  # the program parses its own options, --help too
        context_settings={"ignore_unknown_options": True, "allow_extra_args": True},
    )(run_program)
app.add_typer(keys, name="keys")

Six = tuple[float, float, float, float, float, float]
Force = Annotated[Three | None, typer.Option(help="force F_x F_y F_z, N", metavar="FX FY FZ")]
Moment = Annotated[
    Three | None,
    typer.Option(
        help="moment M_x M_y M_z, N·m, about the interface point where it is now",
        metavar="MX MY MZ",
    ),
]
InterfaceLoads = Annotated[
    list[str] | None,
    typer.Option(
        "--load",
        help="force, or force and moment, on one of several interfaces; repeatable",
        metavar="NAME=FX,FY,FZ[,MX,MY,MZ]",
    ),
]
ToleranceTranslation = Annotated[
    float | None, typer.Option(help="tolerance of a translation, m; by default the component's")
]
ToleranceRotation = Annotated[
    float | None, typer.Option(help="tolerance of a rotation, rad; by default the component's")
]
Former = Annotated[float | None, typer.Option(hidden=True)]  # names of version 0.2


@app.command()
def query(
    name: Name,
    force: Force = None,
    moment: Moment = None,
    load: InterfaceLoads = None,
    further: FurtherInput = None,
    on_thin: Annotated[
        str | None,
        typer.Option(
            help="if the table does not cover the wrench: queue a solve and print the estimate "
            "(default), wait for the solve, estimate only, or reject (status 1)",
            metavar="WORD",
        ),
    ] = None,
    wait_s: Annotated[
        float | None,
        typer.Option(
            help="longest wait for the solve, s; sets --on-thin wait, whose default is 30 s"
        ),
    ] = None,
    tolerance_translation: ToleranceTranslation = None,
    tolerance_rotation: ToleranceRotation = None,
    method: Annotated[
        str | None,
        typer.Option(help="interpolation method, such as griddata; by default the component's"),
    ] = None,
    detail: Annotated[
        bool,
        typer.Option(
            "--detail",
            help="with --json: add the parts of the error bar, and the rows of each load group",
        ),
    ] = False,
    derivatives: Annotated[
        bool, typer.Option("--derivatives", help="with --json: add the derivative du/dw, 6 x 6")
    ] = False,
    beyond_range: BeyondRange = False,
    as_json: AsJson = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Print the displacement under a wrench, with its error bar."""
    on_thin = on_thin or ("queue" if wait_s is None else "wait")
    tolerance = _tolerance(tolerance_translation, tolerance_rotation)
    with connected(server, data) as client:
        answer = client.displacement(
            name,
            **_loads(force, moment, load, further),
            on_thin=cast(OnThin, on_thin),  # the client refuses other words
            wait_s=wait_s,
            tolerance=tolerance,
            method=method,
            detail=detail or not as_json,
            derivatives=derivatives,
            beyond_range=beyond_range,
        )
        tolerance = _tolerance_of(client, answer, tolerance)
    print_answer(answer, as_json, data, tolerance)


@app.command()
def solve(
    name: Name,
    force: Force = None,
    moment: Moment = None,
    load: InterfaceLoads = None,
    further: FurtherInput = None,
    wait_s: Annotated[float, typer.Option(help="longest wait for the solve, s")] = 600.0,
    beyond_range: BeyondRange = False,
    as_json: AsJson = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Solve a wrench with finite elements, even if the table covers it."""
    with connected(server, data) as client:
        loads = _loads(force, moment, load, further)
        answer = client.solve(name, **loads, beyond_range=beyond_range)
        if answer.job is not None and answer.job.status != "done":
            progress.follow(Screen(stderr=as_json), client, [answer.job], wait_s)
            answer = client.solve(name, **loads, beyond_range=beyond_range)
        tolerance = _tolerance_of(client, answer, None)
    print_answer(answer, as_json, data, tolerance)


@app.command()
def deformed(
    name: Name,
    file: Annotated[
        Path, typer.Argument(help="file to write: .glb, .vtu or .json", callback=in_folder)
    ],
    force: Force = None,
    moment: Moment = None,
    as_json: AsJson = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Write the deformed surface under a wrench, for a viewer or a simulator."""
    file_format = deformed_format(file)
    with connected(server, data) as client:
        content = client.deformed_file(name, force or ZERO, moment or ZERO, file_format)
    file.write_bytes(content)
    size = len(content)
    show({"file": file, "bytes": size}, as_json, f"{file}: {size} bytes")


@app.command()
def fill(
    name: Name,
    budget: Annotated[int, typer.Option(min=1, help="largest number of solves")] = 100,
    tolerance_translation: ToleranceTranslation = None,
    tolerance_rotation: ToleranceRotation = None,
    force_range: Annotated[
        Six | None,
        typer.Option(
            help="forces to fill, N: lowest and highest of each; by default the load range",
            metavar="FX FX FY FY FZ FZ",
        ),
    ] = None,
    moment_range: Annotated[
        Six | None,
        typer.Option(
            help="moments to fill, N·m: lowest and highest of each; by default the load range",
            metavar="MX MX MY MY MZ MZ",
        ),
    ] = None,
    output: Annotated[
        list[str] | None,
        typer.Option(
            help="an output whose interpolation error counts, such as uz; repeatable; default all"
        ),
    ] = None,
    for_joint: Annotated[
        bool, typer.Option("--for-joint", help="fill until a joint can invert the table")
    ] = False,
    translation: Former = None,
    rotation: Former = None,
    as_json: AsJson = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Solve the wrenches where the table's interpolation error is largest, in rounds of 24."""
    tolerance = _tolerance(
        translation if tolerance_translation is None else tolerance_translation,
        rotation if tolerance_rotation is None else tolerance_rotation,
    )
    if moment_range is None:
        refuse_alone("--moment-range MX MX MY MY MZ MZ", {"--force-range": force_range})
    if force_range is None:
        refuse_alone("--force-range FX FX FY FY FZ FZ", {"--moment-range": moment_range})
    load_range = None
    if force_range and moment_range:
        load_range = {"force": _pairs(force_range), "moment": _pairs(moment_range)}
    options = {
        "tolerance": tolerance,
        "range": load_range,
        "outputs": output or None,
        "for_joint": for_joint,
    }
    with connected(server, data) as client:
        filled = progress.fill(Screen(stderr=as_json), client, name, budget, options)
    if as_json:
        print_json(filled)


def _pairs(ends: Six) -> list[list[float]]:
    """Return [lowest, highest] of each of three loads."""
    return [list(ends[k : k + 2]) for k in (0, 2, 4)]


@app.command()
def plan(
    scene: Annotated[
        Path, typer.Argument(help="TOML file of the scene", exists=True, dir_okay=False)
    ],
    as_json: AsJson = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Print the part of each table that a scene needs, and the savings."""
    needs = Scene.read(scene)
    with connected(server, data) as client:
        plans = needs.plan(client)
    bodies = {
        name: {key: value for key, value in plan.raw.items() if key != "component"}
        for name, plan in plans.items()
    }
    show({"components": bodies}, as_json, lambda: render.plan_lines(plans))


@app.command()
def report(
    name: Name,
    wrenches: Annotated[int, typer.Option(min=3, help="random wrenches to compare")] = 24,
    html: Annotated[
        Path | None,
        typer.Option(help="write a page with plots to this .html file as well", callback=in_folder),
    ] = None,
    as_json: AsJson = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Compare error and run time of methods, table sizes and three meshes; takes minutes."""
    with connected(server, data) as client:
        client.make_report(name, wrenches)
        progress.follow_report(Screen(stderr=as_json), client, name)
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
        body = client.compliance(name)
    show(body, as_json, lambda: render.compliance_tables(body))


@app.command()
def components(as_json: AsJson = False, server: Server = DEFAULT_SERVER, data: Data = None) -> None:
    """List the components."""
    with connected(server, data) as client:
        listed = client.components()
    show(listed, as_json, lambda: [render.component_table(listed)])


def main() -> None:
    """Run the command line; an expected error is one message on stderr and status 1."""
    # As at Ctrl-C, the command cancels its solves and ends its temporary server.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        app(prog_name="wrenchbook")  # by default the help has the path of the program
    except ProblemError as error:
        if "--json" in sys.argv:
            print_json({"error": error.body or {"title": error.title, "detail": error.detail}})
        out = Screen(stderr=True)
        plain(out, error.title, style="red")
        plain(out, _with_options(error.detail))
        for cause in error.causes:
            plain(out, f"  {_with_options(mistake_line(cause))}")
        sys.exit(1)
    except (ServerUnreachable, ImportError, OSError, RuntimeError, ValueError) as error:
        detail = str(error)
        if isinstance(error, OSError) and error.filename is not None:
            detail = f"{error.filename}: {error.strerror}"  # without the number of the error
        if "--json" in sys.argv:
            print_json({"error": {"title": type(error).__name__, "detail": detail}})
        plain(Screen(stderr=True), detail, style="red")
        sys.exit(1)


def _with_options(text: str) -> str:
    """Return a message with fields of the request replaced by options of this command line."""

    def option(match: re.Match[str]) -> str:
        field, index = match[1], match[2]
        name = "--" + field.replace("_", "-")
        # The field of a repeatable option is a list with the plural: outputs.0 of --output.
        names = (name, name.removesuffix("s")) if index else (name,)
        if field == "time_offset_s":
            names = ("--lag", "--time-offset")
        return next((known for known in names if known in sys.argv), match[0])

    return re.sub(r"(?<![\w.-])([a-z]\w*)(\.\d+)?(?=: )", option, text)


def _tolerance(translation: float | None, rotation: float | None) -> dict[str, float] | None:
    """Return a request's tolerance, m and rad, or None for the component's own."""
    if translation is None and rotation is None:
        return None
    limits = {"translation": translation, "rotation": rotation}
    wrong = " and ".join(
        f"--tolerance-{name} {limit:g}"
        for name, limit in limits.items()
        if limit is not None and limit <= 0
    )
    if wrong:
        raise typer.BadParameter(f"a tolerance must be above 0, not {wrong}; give larger numbers")
    if translation is None or rotation is None:
        missing = "--tolerance-translation M" if translation is None else "--tolerance-rotation RAD"
        raise typer.BadParameter(f"a tolerance needs translation and rotation; add {missing}")
    return {"translation": translation, "rotation": rotation}


def _tolerance_of(
    client: Client, answer: Displacement, requested: dict[str, float] | None
) -> dict[str, float] | None:
    """Return the tolerance of an answer that exceeds one: the request's, or the component's."""
    if requested or answer.within_tolerance is not False:
        return requested
    return client.component(answer.component)["tolerance"]


def _loads(
    force: Three | None, moment: Three | None, load: list[str] | None, further: list[str] | None
) -> dict[str, Any]:
    """Return the loads of a query by argument; without any the force is zero."""
    if load is None and further is None and force is None:
        force = ZERO
    loads: dict[str, list[float]] = {}
    for name, text in by_name("--load", "NAME=FX,FY,FZ[,MX,MY,MZ]", load):
        numbers = [number(f"--load {name}", part) for part in text.split(",")]
        if len(numbers) not in (3, 6):
            raise InvalidArgument(
                f"--load {name} needs 3 numbers (force) or 6 (force and moment), separated by "
                f"commas, but {text!r} has {len(numbers)}"
            )
        loads[name] = numbers + [0.0] * (6 - len(numbers))
    inputs = further_inputs(further)
    return {"force": force, "moment": moment, "loads": loads or None, "inputs": inputs}


if __name__ == "__main__":
    main()
