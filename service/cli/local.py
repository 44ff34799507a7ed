"""Commands on a data directory, which need no running server: serve, keys, backup, doctor, ..."""

from __future__ import annotations

import inspect
import json
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import MISSING, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args, get_type_hints

import typer
from annotated_types import Ge, Le
from rich.table import Table

from wrenchbook.service.actors import ANY
from wrenchbook.service.cli.connect import AsJson, Commands, in_folder
from wrenchbook.service.cli.render import Screen, plain, print_json, show
from wrenchbook.service.contract import counted
from wrenchbook.service.files.program import child_command, usable_cores
from wrenchbook.service.keys import FILE as KEYS
from wrenchbook.service.keys import (
    MEGABYTES,
    OVERLAP_HOURS,
    RATE,
    Keyring,
    KeysError,
    Scope,
    require_keys,
)
from wrenchbook.service.settings import (
    Settings,
    SettingsError,
    as_file,
    check_copies,
    check_engine,
    check_names,
    read_settings,
)

if TYPE_CHECKING:
    from wrenchbook.service.ops.backup import Manifest

CORES = usable_cores()
DEFAULT_DATA = Settings.data
Folder = Annotated[Path, typer.Option(help="data directory", envvar="WRENCHBOOK_DATA")]
_KEYLESS = "anybody on this machine may call it. Make one with: wrenchbook keys add NAME{}"


def serve(
    config: Annotated[
        Path | None,
        typer.Option(help="file of settings; by default wrenchbook.toml in the data directory"),
    ] = None,
    show_settings: Annotated[
        bool, typer.Option("--show-settings", help="print all settings with their sources, and end")
    ] = False,
    as_json: AsJson = False,
    **options: Any,
) -> None:
    """Serve the API and solve the queued jobs."""
    from wrenchbook.service.http.proxy import proxy_trust
    from wrenchbook.service.workers.supervisor import AddressError, supervise

    chosen = {name: value for name, value in options.items() if value is not None}
    try:
        settings, origins = read_settings(chosen, config)
        if show_settings and as_json:
            print_json(
                {
                    name: {"value": getattr(settings, name), "origin": origin}
                    for name, origin in origins.items()
                }
            )
            return
        if show_settings:
            typer.echo(as_file(settings, origins), nl=False)
            return
        check_engine(settings.engine, settings.scheduler)
        trust = proxy_trust(settings)
        check_copies(settings)
        check_names(settings)
    except SettingsError as error:
        raise typer.BadParameter(str(error)) from error
    _make_folder(settings.data)
    if settings.first_key:
        make_first_key(settings.data, err=as_json)
    if trust is None:  # without a trusted proxy a caller needs a key
        require_keys(settings.host, settings.data)
    try:
        supervise(settings, as_json=as_json)
    except AddressError as error:
        raise _refused(str(error)) from error


def _with_settings() -> inspect.Signature:
    """Return the signature of `serve` with an option for each field of `Settings`."""
    hints = get_type_hints(serve, include_extras=True)
    serve.__annotations__ = hints
    parameters = list(inspect.signature(serve).parameters.values())[:-1]
    parameters = [part.replace(annotation=hints[part.name]) for part in parameters]
    defaults = {field.name: field.default for field in fields(Settings)}

    for name, hint in get_type_hints(Settings, include_extras=True).items():
        kind, *notes = get_args(hint)
        bounds = {type(note): note for note in notes if not isinstance(note, str)}
        default = defaults[name]
        option = typer.Option(
            f"--{name.replace('_', '-')}",
            help=next(note for note in notes if isinstance(note, str)),
            min=bounds[Ge].ge if Ge in bounds else None,
            max=bounds[Le].le if Le in bounds else None,
            show_default=False if default in (None, False, MISSING) else str(default),
        )
        annotation = Annotated[kind | None, option]
        keyword = inspect.Parameter.KEYWORD_ONLY
        parameters.append(inspect.Parameter(name, keyword, default=None, annotation=annotation))
    return inspect.Signature(parameters)


serve.__signature__ = _with_settings()  # pyright: ignore[reportFunctionMemberAccess]


def _refused(message: str) -> typer.Exit:
    """Print why nothing is served, on one line, and return the exit with status 2."""
    plain(Screen(stderr=True), message, style="red")
    return typer.Exit(2)


def _make_folder(folder: Path) -> None:
    """Make the data directory; refuse one that cannot be written, or is not restored."""
    from wrenchbook.service.ledger.connection import unfinished_restore
    from wrenchbook.service.ops.backup import LEDGER
    from wrenchbook.service.ops.checks import not_writable

    try:
        folder.mkdir(0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise _refused(
            f"the data directory {folder} cannot be created: {error.strerror}; name another with "
            "--data, or create it and give it to the user that runs the server"
        ) from error
    if problem := unfinished_restore(folder.absolute() / LEDGER):
        raise _refused(problem)
    if paths := not_writable(folder):
        raise _refused(
            f"this user cannot read and write {paths[0]}; name another data directory with "
            f"--data, or make this one readable and writable for user {os.getuid()}"
        )


def work(
    data: Folder = DEFAULT_DATA,
    solvers: Annotated[int, typer.Option(min=1, help="solves at once; by default one a core")] = (
        CORES
    ),
    as_json: AsJson = False,
) -> None:
    """Solve the queued jobs of a data directory, next to its server, until SIGINT or SIGTERM."""
    import threading

    from wrenchbook.service.workers.builder import open_data, solving

    if not data.is_dir():  # an empty one is allowed: a container may start before the server's
        start = f"start wrenchbook serve --data {data} first, or correct the path"
        raise _refused(f"there is no data directory {data}; {start}")
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    settings = Settings(data, solvers)
    with open_data(settings) as parts, solving(settings, parts):
        ready = {"data": str(data), "solvers": solvers, "pid": os.getpid()}
        line = f"solving for {data} with {solvers} solvers"
        print(json.dumps(ready) if as_json else line, flush=True)
        stop.wait()


def demo(
    keep: Annotated[
        Path | None, typer.Option(help="keep the data directory of the demo in this folder")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Show query, solve and fill of a plate with finite elements; 1 to 3 minutes."""
    from wrenchbook.service.cli.demo import run

    figures = run(Screen(stderr=as_json), keep)
    if as_json:
        print_json(figures)
    raise typer.Exit(1 if figures["failed"] else 0)


# Programs with their own argument parser: this process never imports the finite elements.
PROGRAMS = {
    "new": "Propose a component for an input deck, and print its open points.",
    "check": "Check a component bundle before its upload: mesh, supports, cost.",
    "converge": "Solve a part on finer meshes: order, limit, error of its own mesh.",
    "condense": "Write stiffness and mass of frames and modes (Craig-Bampton).",
}


def run_program(ctx: typer.Context) -> None:
    """Run a command of `PROGRAMS` with its arguments unchanged; a SIGTERM ends it too."""
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    command = child_command("wrenchbook.fea.check.commands", str(ctx.info_name), *ctx.args)
    raise typer.Exit(subprocess.run(command, check=False).returncode)


def backup(
    file: Annotated[
        Path, typer.Argument(help="the backup to write", dir_okay=False, callback=in_folder)
    ],
    as_json: AsJson = False,
    data: Folder = DEFAULT_DATA,
) -> None:
    """Write a data directory into one file; a server may use it meanwhile."""
    from wrenchbook.service.ops.backup import back_up

    manifest = back_up(data, file)
    size = sum(length for length, _ in manifest.files.values())
    count = len(manifest.files)
    text = f"{file}: {counted(count, 'file')}, {size / 1e6:.1f} MB, read again and complete."
    show({"file": file, "files": count, "bytes": size}, as_json, text)


def restore(
    file: Annotated[str, typer.Argument(help="the backup, or the URL of a replica")],
    at: Annotated[
        datetime | None,
        typer.Option(help="restore the newest state of a replica until this time, UTC"),
    ] = None,
    data: Folder = DEFAULT_DATA,
    overwrite: Annotated[
        bool,
        typer.Option("--overwrite", help="move existing files of the data directory aside first"),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Make a data directory from a backup or a replica."""
    from wrenchbook.service.ops.restore import restore as restore_files

    source = file if "://" in file else Path(file)
    mistake = ""
    if isinstance(source, Path):
        if source.is_dir():
            mistake = f"{file} is a folder, not a file; name a backup's .zip"
        elif not source.is_file():
            mistake = f"the file {file} does not exist; give a backup's path, or a replica's URL"
        elif at:
            mistake = f"--at chooses a time of a replica, but {file} is a backup; leave --at out"
    if mistake:
        raise typer.BadParameter(mistake)

    until = at.replace(tzinfo=UTC).timestamp() if at else float("inf")
    manifest, former = restore_files(source, data, overwrite=overwrite, until=until)
    has_keys = (data / KEYS).exists()
    texts = _restored_texts(data, manifest, former, has_keys=has_keys)
    reply = {"data": data, "files": len(manifest.files), "former": former, **manifest.state}
    show(reply | {"skipped": manifest.skipped, "keys": has_keys}, as_json, "\n".join(texts))


def _restored_texts(
    data: Path, manifest: Manifest, former: Path | None, *, has_keys: bool
) -> list[str]:
    """Return the lines on a restored directory; `former`: the folder of its earlier files."""
    state = manifest.state
    option = _data_option(data)
    files = counted(len(manifest.files), "file")
    texts = [f"{data}: {files} restored. Start it with: wrenchbook serve{option}"]
    if state:
        created = datetime.fromtimestamp(state["created"], UTC).isoformat(" ", "milliseconds")
        texts.append(
            f"It is as it was at {created}: {counted(state['rows'], 'row')}, up to number "
            f"{state['last_row']}, and {counted(state['jobs'], 'job')}. What the server "
            f"accepted later is not in it: {state['interval']:g} s at most, if it shipped until "
            "its end. Serve it with another --replicate URL."
        )
    if manifest.skipped:
        skipped = ", ".join(manifest.skipped)
        texts.append(f"Not restored, since backups hold no such files: {skipped}.")
    if has_keys:
        texts.append("Its keys stay as they were.")
    else:
        texts.append(f"It has no keys: {_KEYLESS.format(option)}")
    if former is not None:
        texts.append(f"The former files are in {former}; remove them once you need them no more.")
    return texts


_COLOURS = {"fault": "red", "repaired": "yellow", "note": None}


def doctor(
    data: Folder = DEFAULT_DATA,
    repair: Annotated[
        bool,
        typer.Option("--repair", help="repair a damaged ledger or table from the intact copy"),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Check the ledger, tables, files and disk of a data directory; nothing is ever deleted."""
    from wrenchbook.service.ops.checks import COMMAND
    from wrenchbook.service.ops.doctor import examine

    findings = examine(data, repair=repair)
    faults = sum(finding.kind == "fault" for finding in findings)
    if as_json:
        print_json({"findings": [vars(finding) for finding in findings]})
    else:
        for finding in findings:
            plain(Screen(), f"{finding.kind}: {finding.problem}", style=_COLOURS[finding.kind])
            if finding.remedy:
                remedy = finding.remedy.replace(COMMAND, COMMAND + _data_option(data))
                plain(Screen(), f"  {remedy}")
        noun = "fault" if faults == 1 else "faults"
        plain(Screen(), f"{faults} {noun}." if faults else f"{data} is in order.")
    raise typer.Exit(1 if faults else 0)


def _data_option(data: Path) -> str:
    """Return the option by which another command uses the same data directory."""
    return "" if data == DEFAULT_DATA else f" --data {shlex.quote(str(data))}"


keys = Commands(no_args_is_help=True, help="List, add, rotate and revoke access keys.")

KeyName = Annotated[str, typer.Argument(help="name of the key's owner")]


@keys.command("add")
def add(
    name: KeyName,
    scope: Annotated[
        Scope,
        typer.Option(
            help="read allows GET and queries; write also changes; admin also keys and decks"
        ),
    ] = "write",
    rate: Annotated[float, typer.Option(help="largest number of requests a second")] = RATE,
    megabytes: Annotated[int, typer.Option(help="largest body, MiB")] = MEGABYTES,
    component: Annotated[
        list[str] | None,
        typer.Option(
            help="components of the key: a name or a pattern, plate_*; repeatable; default all"
        ),
    ] = None,
    days: Annotated[float | None, typer.Option(help="days of validity; default: no end")] = None,
    as_json: AsJson = False,
    data: Folder = DEFAULT_DATA,
) -> None:
    """Make a key and print it once."""
    fields = {"name": name, "scope": scope, "rate": rate, "megabytes": megabytes}
    fields["components"] = tuple(component or ANY)
    if days is not None and not 0.0 < days < 36_500.0:
        raise typer.BadParameter(f"--days must be above 0 and below 36,500, not {days:g}")
    fields["expires"] = None if days is None else time.time() + 86_400.0 * days
    with _noted(data, "key.add", name, after=fields):
        key = Keyring(data).add(**fields)
    print_json({"name": name, "scope": scope, "key": key}) if as_json else typer.echo(key)
    typer.echo(f"The key {name} for {scope}; it is not stored and not shown again.", err=True)


@keys.command("rotate")
def rotate(
    name: KeyName,
    hours: Annotated[
        float, typer.Option(help="hours that the old secret remains valid")
    ] = OVERLAP_HOURS,
    as_json: AsJson = False,
    data: Folder = DEFAULT_DATA,
) -> None:
    """Make a new secret of a key and print it once; the old one is valid for some hours more."""
    with _noted(data, "key.rotate", name, after={"overlap_hours": hours}):
        key = Keyring(data).rotate(name, 3600.0 * hours)
    print_json({"name": name, "key": key}) if as_json else typer.echo(key)
    typer.echo(f"The old secret of {name} is valid for {hours:g} hours more.", err=True)


@keys.command("list")
def list_(as_json: AsJson = False, data: Folder = DEFAULT_DATA) -> None:
    """List the keys, without their secrets."""
    listed = Keyring(data).public()
    dates = {"made": "created", "ends": "expires", "used": "last_used"}
    table = Table("name", "scope", "components", *dates, "a second", "MiB")
    for key in listed:
        times = [key[field] for field in dates.values()]
        days = [seconds and time.strftime("%Y-%m-%d", time.gmtime(seconds)) for seconds in times]
        fields = key["name"], key["scope"], ", ".join(key["components"]), *days
        table.add_row(*fields, f"{key['rate']:g}", str(key["megabytes"]))
    show(listed, as_json, lambda: [table])


@keys.command("revoke")
def revoke(name: KeyName, as_json: AsJson = False, data: Folder = DEFAULT_DATA) -> None:
    """Revoke a key; servers refuse it within a second."""
    with _noted(data, "key.revoke", name):
        Keyring(data).revoke(name)
    text = f"The key {name} is revoked."
    if not len(Keyring(data)):
        text += f" {data} has no keys left. A running server refuses all calls until it is "
        text += f"restarted; then {_KEYLESS.format(_data_option(data))}"
    show({"name": name, "revoked": True}, as_json, text)


@contextmanager
def _noted(data: Path, action: str, name: str, after: Any = None) -> Iterator[None]:
    """Change a key together with its entry in the audit of a data directory."""
    from wrenchbook.service.ledger import Ledger, noted

    if action != "key.add" and not (data / KEYS).exists():  # otherwise a ledger would be made there
        create = f"create one with: wrenchbook keys add NAME{_data_option(data)}"
        raise KeysError(f"{data} has no keys; {create}, or name another directory with --data")
    with (
        closing(Ledger(data / "ledger.sqlite")) as ledger,
        noted(ledger, action, name, after=after),
    ):
        yield


def make_first_key(data: Path, *, err: bool = False) -> None:
    """Make an admin key in a data directory without keys, and print it once, on stderr if `err`."""
    keyring = Keyring(data)
    if len(keyring):
        return
    with _noted(data, "key.add", "first", after={"scope": "admin"}):
        secret = keyring.add("first", "admin")
    typer.echo(f"The first key, for admin, shown this once: {secret}", err=err)


LOCAL_COMMANDS = (serve, work, demo, backup, restore, doctor)
