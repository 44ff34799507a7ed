"""Commands on a data directory: backup, restore, doctor."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from wrenchbook.service.cli.connect import AsJson, print_json
from wrenchbook.service.cli.local import DEFAULT_DATA, Folder
from wrenchbook.service.cli.render import plain
from wrenchbook.service.cli.screen import Screen

_out = Screen()


def backup(
    file: Annotated[Path, typer.Argument(help="the backup to write", dir_okay=False)],
    as_json: AsJson = False,
    data: Folder = DEFAULT_DATA,
) -> None:
    """Write a data directory into one file; a server may use it meanwhile."""
    from wrenchbook.service.ops.backup import back_up

    manifest = back_up(data, file)
    size = sum(length for length, _ in manifest.files.values())
    if as_json:
        print_json({"file": file, "files": len(manifest.files), "bytes": size})
        return
    plain(_out, f"{file}: {len(manifest.files)} files, {size / 1e6:.1f} MB, read again and whole.")


def restore(
    file: Annotated[Path, typer.Argument(help="the backup", exists=True, dir_okay=False)],
    data: Folder = DEFAULT_DATA,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="move existing files of the data directory aside")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Make a data directory from a backup."""
    from wrenchbook.service.keys import FILE as KEYS
    from wrenchbook.service.ops.restore import restore as run

    manifest, aside = run(file, data, overwrite=overwrite)
    skipped, keys = manifest.skipped, (data / KEYS).exists()
    if as_json:
        about = {"data": data, "files": len(manifest.files), "former": aside}
        print_json({**about, "skipped": skipped, "keys": keys})
        return
    start = f"wrenchbook serve{_data_option(data)}"
    plain(_out, f"{data}: {len(manifest.files)} files restored. Start it with: {start}")
    if skipped:
        plain(_out, f"Not restored, since backups hold no such files: {', '.join(skipped)}.")
    if keys:
        plain(_out, "Its keys stay as they were.")
    else:
        add = f"wrenchbook keys add NAME{_data_option(data)}"
        plain(_out, f"It has no keys: anybody on this machine may call it. Make one with: {add}")
    if aside is not None:
        plain(_out, f"The former files are in {aside}; remove them once you need them no more.")


def doctor(
    data: Folder = DEFAULT_DATA,
    repair: Annotated[
        bool,
        typer.Option(
            "--repair", "--mend", help="repair the ledger or a table from the copy that is intact"
        ),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Check the ledger, tables, files and disk of a data directory; nothing is ever deleted."""
    from wrenchbook.service.ops.checks import COMMAND
    from wrenchbook.service.ops.doctor import examine

    findings = examine(data, repair=repair)
    if as_json:
        print_json({"findings": [vars(one) for one in findings]})
    else:
        for one in findings:
            colour = {"fault": "red", "repaired": "yellow", "note": None}[one.kind]
            plain(_out, f"{one.kind}: {one.what}", style=colour)
            if one.remedy:
                plain(_out, f"  {one.remedy.replace(COMMAND, COMMAND + _data_option(data))}")
    faults = sum(one.kind == "fault" for one in findings)
    if not as_json:
        plain(_out, f"{faults} fault{'s' * (faults != 1)}." if faults else f"{data} is in order.")
    raise typer.Exit(1 if faults else 0)


def _data_option(data: Path) -> str:
    """Return the option that has another command use the same data directory."""
    return "" if data == DEFAULT_DATA else f" --data {shlex.quote(str(data))}"


OPS_COMMANDS = (backup, restore, doctor)
