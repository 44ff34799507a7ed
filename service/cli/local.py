"""Commands that need no running server."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from rich.text import Text

from wrenchbook.service.cli.connect import AsJson, print_json
from wrenchbook.service.cli.keys import make_first_key
from wrenchbook.service.cli.screen import Screen
from wrenchbook.service.files.program import run_child, usable_cores

CORES = usable_cores()
LogLevel = Literal["debug", "info", "warning", "error"]
LogFormat = Literal["text", "json"]
DEFAULT_DATA = Path("wrenchbook-data")


Host = Annotated[str, typer.Option(help="address to listen on")]
AccessLog = Annotated[
    bool, typer.Option("--access-log", help="a line a request; queries take no fast path then")
]
AllowHost = Annotated[
    str | None, typer.Option(help="further names of this server, with commas: a proxy's, say")
]
AllowOrigin = Annotated[
    str | None, typer.Option(help="other sites whose pages may call: https://..., with commas")
]
FirstKey = Annotated[
    bool, typer.Option("--first-key", help="make a key for admin if there is none; printed once")
]
Port = Annotated[int, typer.Option(min=0, max=65535, help="0 takes a free one")]
Solvers = Annotated[int, typer.Option(min=0, help="solves at once; by default one a core")]
Processes = Annotated[
    int, typer.Option(min=1, max=64, help="that answer; more than 1: one more builds and solves")
]
EngineName = Annotated[str, typer.Option(help="where solves run: local or dask")]
Scheduler = Annotated[
    str | None, typer.Option(help="with --engine dask: tcp://HOST:8786, or tls://")
]
AllowDecks = Annotated[
    bool, typer.Option(help="take uploaded bundles with a deck: solvers run its command")
]
Method = Annotated[
    Literal["griddata", "additive", "kriging", "linear"] | None,
    typer.Option(help="answers where a request names none; by default each table's best"),
]
QueueLimit = Annotated[int, typer.Option(min=0, help="open jobs of a component from queries")]
_DONE, _FAILED = "folders of done attempts are kept", "folders of failed and cancelled ones"
KeepDays = Annotated[float, typer.Option(min=0, help=f"days that {_DONE}")]
TableMemory = Annotated[
    int, typer.Option(min=0, help="MB of rows and numpy tables kept; packed tables are mapped")
]
KeepCount = Annotated[int, typer.Option(min=0, help=f"most {_DONE}, 27 kB each")]
KeepFailedDays = Annotated[float, typer.Option(min=0, help=f"days that {_FAILED} are kept")]
KeepFailedCount = Annotated[int, typer.Option(min=0, help=f"most {_FAILED} that are kept")]
Level = Annotated[LogLevel, typer.Option(help="how much the log tells")]
Form = Annotated[LogFormat, typer.Option(help="lines for people or JSON for programs")]
Config = Annotated[
    Path | None, typer.Option(help="settings; otherwise wrenchbook.toml in the data directory")
]
ShowSettings = Annotated[
    bool, typer.Option("--show-settings", help="print all settings, and where from, and end")
]
Folder = Annotated[Path, typer.Option(help="data directory", envvar="WRENCHBOOK_DATA")]


def serve(
    ctx: typer.Context,
    data: Folder = DEFAULT_DATA,
    host: Host = "127.0.0.1",
    port: Port = 8000,
    solvers: Solvers = CORES,
    processes: Processes = 1,
    engine: EngineName = "local",
    scheduler: Scheduler = None,
    allow_decks: AllowDecks = False,
    method: Method = None,
    queue_limit: QueueLimit = 64,
    table_memory: TableMemory = 700,
    keep_days: KeepDays = 30.0,
    keep_count: KeepCount = 2000,
    keep_failed_days: KeepFailedDays = 180.0,
    keep_failed_count: KeepFailedCount = 10_000,
    log_level: Level = "info",
    log_format: Form = "text",
    access_log: AccessLog = False,
    allow_host: AllowHost = None,
    allow_origin: AllowOrigin = None,
    first_key: FirstKey = False,
    config: Config = None,
    show_settings: ShowSettings = False,
    as_json: AsJson = False,
) -> None:
    """Serve the API and solve what is queued."""
    from wrenchbook.service.cli.settings import settings_of, shown

    found = settings_of(ctx, serve, config)
    if show_settings and as_json:
        print_json({name: vars(setting) for name, setting in found.items()})
    elif show_settings:
        typer.echo(shown(found), nl=False)
    else:
        _serve(**{name: setting.value for name, setting in found.items()}, as_json=as_json)


def _serve(**options: Any) -> None:
    """Serve by the settings found."""
    from wrenchbook.service.jobs.engines import EngineSettingsError, check_engine
    from wrenchbook.service.keys import require_keys
    from wrenchbook.service.workers.supervisor import AddressError, supervise

    try:
        check_engine(options["engine"], options["scheduler"])
    except EngineSettingsError as error:
        raise typer.BadParameter(str(error)) from error
    _make_folder(Path(options["data"]))
    if options["first_key"]:
        make_first_key(options["data"], err=options["as_json"])
    require_keys(options["host"], options["data"])
    try:
        supervise(options)
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
