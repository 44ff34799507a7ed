"""Commands that need no running server."""

from __future__ import annotations

import inspect
import json
import os
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Annotated, Any, get_args, get_type_hints

import typer
from annotated_types import Ge, Le
from rich.text import Text

from wrenchbook.service.cli.connect import AsJson, print_json
from wrenchbook.service.cli.keys import make_first_key
from wrenchbook.service.cli.screen import Screen
from wrenchbook.service.files.program import run_child, usable_cores
from wrenchbook.service.settings import Settings, SettingsError, as_file, read_settings

CORES = usable_cores()
DEFAULT_DATA = Settings.data
Folder = Annotated[Path, typer.Option(help="data directory", envvar="WRENCHBOOK_DATA")]


def _option(name: str, hint: Any) -> inspect.Parameter:
    """Return the parameter of a command that stands for a field of `Settings`."""
    kind, *notes = get_args(hint)
    bounds = {type(note): note for note in notes if not isinstance(note, str)}
    default = next(one for one in fields(Settings) if one.name == name).default
    option = typer.Option(
        f"--{name.replace('_', '-')}",
        help=next(note for note in notes if isinstance(note, str)),
        min=bounds[Ge].ge if Ge in bounds else None,
        max=bounds[Le].le if Le in bounds else None,
        show_default=False if default in (None, False, MISSING) else str(default),
    )
    annotation = Annotated[kind | None, option]
    keyword = inspect.Parameter.KEYWORD_ONLY
    return inspect.Parameter(name, keyword, default=None, annotation=annotation)


def serve(
    config: Annotated[
        Path | None, typer.Option(help="settings; otherwise wrenchbook.toml in the data directory")
    ] = None,
    show_settings: Annotated[
        bool, typer.Option("--show-settings", help="print all settings, and where from, and end")
    ] = False,
    as_json: AsJson = False,
    **options: Any,
) -> None:
    """Serve the API and solve what is queued."""
    given = {name: value for name, value in options.items() if value is not None}
    try:
        settings, origins = read_settings(given, config)
    except SettingsError as error:
        raise typer.BadParameter(str(error)) from error
    if show_settings and as_json:
        shown = {"value": lambda name: getattr(settings, name), "origin": origins.get}
        print_json({n: {key: of(n) for key, of in shown.items()} for n in origins})
    elif show_settings:
        typer.echo(as_file(settings, origins), nl=False)
    else:
        _serve(settings, as_json)


serve.__annotations__ = get_type_hints(serve, include_extras=True)
_own = list(inspect.signature(serve).parameters.values())[:-1]
_hints = get_type_hints(Settings, include_extras=True)
serve.__signature__ = inspect.Signature(  # pyright: ignore[reportFunctionMemberAccess]
    [
        *(one.replace(annotation=serve.__annotations__[one.name]) for one in _own),
        *(_option(name, hint) for name, hint in _hints.items()),
    ]
)


def _serve(settings: Settings, as_json: bool) -> None:
    """Serve by the settings found."""
    from wrenchbook.service.keys import require_keys
    from wrenchbook.service.workers.supervisor import AddressError, supervise

    _make_folder(settings.data)
    if settings.first_key:
        make_first_key(settings.data, err=as_json)
    require_keys(settings.host, settings.data)
    try:
        supervise(settings, as_json=as_json)
    except AddressError as error:
        raise _refused(str(error)) from error


def _refused(message: str) -> typer.Exit:
    """Print why nothing is served, on one line, and return the exit with status 2."""
    Screen(stderr=True).print(Text(message, style="red"), soft_wrap=True)
    return typer.Exit(2)


def _make_folder(folder: Path) -> None:
    """Refuse a data directory that cannot be made or written."""
    from wrenchbook.service.ops.checks import not_writable

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _refused(
            f"the data directory {folder} cannot be made: {error.strerror}; name another with "
            "--data, or make it for the user that serves"
        ) from error
    if paths := not_writable(folder):
        raise _refused(
            f"{paths[0]} cannot be read and written; name another directory with --data, or make "
            f"it readable and writable for user {os.getuid()}"
        )


def work(
    data: Folder = DEFAULT_DATA,
    solvers: Annotated[int, typer.Option(min=1, help="solves at once; by default one a core")] = (
        CORES
    ),
    as_json: AsJson = False,
) -> None:
    """Solve the queued jobs of a data directory, next to its server, until SIGINT or SIGTERM."""
    import signal
    import threading

    from wrenchbook.service.settings import Settings
    from wrenchbook.service.workers.builder import opened, solving

    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    settings = Settings(data, solvers)
    with opened(settings) as parts, solving(settings, parts):
        ready = {"data": str(data), "solvers": solvers, "pid": os.getpid()}
        line = f"solving for {data} with {solvers} solvers"
        print(json.dumps(ready) if as_json else line, flush=True)
        stop.wait()


def demo(
    keep: Annotated[
        Path | None, typer.Option(help="keep the data directory in this folder")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Show query, solve and fill of a plate with finite elements; one or two minutes."""
    from wrenchbook.service.cli.demo import run

    figures = run(Screen(stderr=as_json), keep)
    if as_json:
        print_json(figures)
    raise typer.Exit(1 if figures["failed"] else 0)


# Programs with an argument parser of their own: this process never imports the finite elements.
PROGRAMS = {
    "new": ("proposal", "Propose a component for an input deck, check it, and print what is open."),
    "check": (
        "__main__",
        "Check a component bundle before its upload: mesh, supports, cost.",
    ),
    "converge": ("converge", "Solve a part on finer meshes: order, limit, error of its own mesh."),
    "condense": (
        "condense",
        "Write stiffness and mass of frames and modes (Craig-Bampton).",
    ),
}


def add_programs(app: typer.Typer) -> None:
    """Add the commands of `PROGRAMS`, which get their arguments as they are."""
    passed_on = {"ignore_unknown_options": True, "allow_extra_args": True}
    for name, (_, summary) in PROGRAMS.items():
        app.command(name, help=summary, add_help_option=False, context_settings=passed_on)(_run)


def _run(ctx: typer.Context) -> None:
    module, _ = PROGRAMS[str(ctx.info_name)]
    raise typer.Exit(run_child(f"wrenchbook.fea.check.{module}", *ctx.args))


LOCAL_COMMANDS = (serve, work, demo)
