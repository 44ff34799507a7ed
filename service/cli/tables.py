"""Commands that import and export tables."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.text import Text

from wrenchbook.service.cli import render
from wrenchbook.service.cli.connect import (
    DEFAULT_SERVER,
    AsJson,
    Data,
    Name,
    Server,
    connected,
    print_json,
)
from wrenchbook.service.cli.screen import Screen
from wrenchbook.service.client.library import check_readable, table_format
from wrenchbook.service.files.durable import write_whole_bytes

out = Screen()
_Unit = Annotated[str | None, typer.Option(help="unit in a CSV or XLSX file; SI by default")]
_Read = Annotated[
    Path,
    typer.Argument(
        help="a CSV, XLSX, Parquet, JSON, HDF5 or MAT table, gzipped or not",
        exists=True,
        dir_okay=False,
    ),
]
_DryRun = Annotated[bool, typer.Option("--dry-run", help="check the file and load nothing")]
_Partial = Annotated[
    bool, typer.Option("--partial", help="load the correct rows even if others have mistakes")
]
_Decimal = Annotated[
    str | None, typer.Option(help="the decimal mark of numbers in text: . or ,", metavar="MARK")
]
_Ignore = Annotated[list[str] | None, typer.Option(help="a column to leave out; repeatable")]
_IgnoreExtra = Annotated[bool, typer.Option("--ignore-extra", help="leave out all unknown columns")]
_Columns = Annotated[
    list[str] | None,
    typer.Option(
        metavar="FILE=TABLE",
        help="meaning of a column: --column 'Load cell=fz [N]'; =-fz [N] for the opposite sign",
    ),
]
_Zero = Annotated[
    bool, typer.Option("--missing-loads-zero", help="loads without a column are zero")
]
_Tare = Annotated[
    int, typer.Option(min=0, help="first rows, whose mean is subtracted from the others")
]
_Sheet = Annotated[str | None, typer.Option(help="sheet of an XLSX file; the first by default")]
_Frame = Annotated[
    str | None, typer.Option(help="the rig's axes in the interface's frame, such as x=-y,y=x,z=z")
]
_Point = Annotated[
    str | None,
    typer.Option(metavar="X,Y,Z", help="of the readings, from the interface's point, m"),
]
_LoadCell = Annotated[str | None, typer.Option(metavar="moving|fixed", help="point of the moments")]
_Rig = Annotated[
    Path | None, typer.Option(help="TOML of these four and name", exists=True, dir_okay=False)
]
_Moved = Annotated[
    Path | None,
    typer.Option(
        help="log of the displacements, joined by time with FILE, the log of the loads",
        exists=True,
        dir_okay=False,
    ),
]
_Lag = Annotated[
    str,
    typer.Option(
        "--lag",
        "--time-offset",
        help="seconds to add to the displacements' times; auto: as the two logs show",
    ),
]
_Import = Annotated[
    int | None, typer.Argument(metavar="IMPORT", help="number of the import", min=1)
]
_Finding = Annotated[
    str | None, typer.Option(help="cause of a finding: withdraw its rows, not all of the import")
]
_Restore = Annotated[bool, typer.Option("--restore", help="bring the rows back instead")]
_Wait = Annotated[
    float, typer.Option(help="seconds to wait until answers come from the rows", min=0, max=600)
]
_Note = Annotated[str | None, typer.Option(help="a note to store with the import")]
_Written = Annotated[
    Path,
    typer.Argument(
        help="a .csv, .xlsx, .parquet, .json, .h5, .hdf5, .wbt, .fmu or .zip file; - prints CSV"
    ),
]
_Method = Annotated[
    str | None, typer.Option(help="with .fmu: its interpolation; by default the table's")
]
_Platforms = Annotated[
    str | None,
    typer.Option(
        metavar="LIST",
        help="with .fmu: all, or names of linux64,aarch64-linux,win64,darwin64, compiled by "
        "ziglang; by default this machine",
    ),
]
_Version = Annotated[
    int | None, typer.Option(help="an earlier version of the table; by default the newest")
]


def import_table(
    name: Name,
    file: _Read,
    dry_run: _DryRun = False,
    partial: _Partial = False,
    decimal: _Decimal = None,
    ignore: _Ignore = None,
    ignore_extra: _IgnoreExtra = False,
    column: _Columns = None,
    missing_loads_zero: _Zero = False,
    tare: _Tare = 0,
    sheet: _Sheet = None,
    displacements: _Moved = None,
    frame: _Frame = None,
    load_point: _Point = None,
    displacement_point: _Point = None,
    load_cell: _LoadCell = None,
    rig: _Rig = None,
    lag: _Lag = "0",
    note: _Note = None,
    wait_s: _Wait = 10.0,
    as_json: AsJson = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Load a table from a file: all of its rows, or none and every mistake."""
    check_readable(file)  # before a server is called or started
    words = "partial", "ignore_extra", "tare", "frame", "load_point", "displacement_point", "rig"
    given = partial, ignore_extra, tare, frame, load_point, displacement_point, rig
    options: dict[str, Any] = {
        "missing_loads": "zero" if missing_loads_zero else None,
        "sheet": sheet,
        "note": note,
        "wait_s": None if wait_s == 10.0 else wait_s,  # the server's default
        "time_offset_s": None if lag == "0" else lag,
        "displacements": displacements,
        "load_cell": load_cell,
        "mapping": dict(map(_pair, column or ())),
        "ignore": ignore or (),
    }
    options |= {word: value or None for word, value in zip(words, given, strict=True)}
    with connected(server, data) as client:
        reply = client.import_table(name, file, dry_run=dry_run, decimal=decimal, **options)
    print_json(reply) if as_json else _print_import(name, reply)
    raise typer.Exit(1 if reply["errors"] and not partial else 0)


def export_table(
    name: Name,
    file: _Written,
    method: _Method = None,
    platforms: _Platforms = None,
    force: _Unit = None,
    moment: _Unit = None,
    translation: _Unit = None,
    rotation: _Unit = None,
    table_version: _Version = None,
    as_json: AsJson = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Write a table to a file; its ending chooses the format. A .fmu runs in simulation tools.

    A .zip holds the C library that answers from the table: sources, example and CMakeLists.txt.
    """
    printed, ending = str(file) == "-", file.suffix.lower()
    if ending != ".fmu" and (method is not None or platforms is not None):
        raise typer.BadParameter(
            "--method and --platforms are for .fmu files: other formats hold the table"
        )
    targets = _targets(platforms)
    if printed and as_json:
        raise typer.BadParameter("--json describes a written file: name one instead of -")
    format_ = "csv" if printed else "packed" if ending in (".fmu", ".zip") else table_format(file)
    names = ("force", "moment", "translation", "rotation")
    pairs = zip(names, (force, moment, translation, rotation), strict=True)
    units = {quantity: unit for quantity, unit in pairs if unit is not None}
    with connected(server, data) as client:
        content = client.export_table(name, format_, units, table_version)
    if printed:
        sys.stdout.write(content)
        return
    content = content.encode() if isinstance(content, str) else content
    message = f"{file} written."
    if ending == ".zip":
        content = _c_library(name, content)
    if ending == ".fmu":
        content, message = _fmu(file, name, content, method, targets)
    write_whole_bytes(file, content)
    report = {"file": file, "bytes": len(content), "message": message}
    print_json(report) if as_json else out.print(message)


def _targets(platforms: str | None) -> tuple[str, ...]:
    """Return the platforms named, checked before a server is called or started."""
    if platforms is None:
        return ()
    from wrenchbook.service.fmu.export import platforms_of

    return platforms_of(platforms)


def _fmu(
    file: Path, name: str, table: bytes, method: str | None, platforms: tuple[str, ...]
) -> tuple[bytes, str]:
    """Return the FMU of a packed table and a message; the server compiles nothing."""
    # Imported here: no other command needs the compiler.
    from wrenchbook.service.fmu.export import make_fmu
    from wrenchbook.surrogate.kernel.binding import PackedTable

    made = make_fmu(name, PackedTable.from_bytes(table), method, platforms)
    if made.platforms:
        built = ", ".join(made.platforms)
        return made.content, f"{file} written: FMI 2.0, {built}, method {made.method}."
    return made.content, (
        f"{file} written: FMI 2.0, method {made.method}, sources only, since this machine has no C "
        "compiler for a platform of FMI 2.0. Tools that compile sources can use it; or install "
        "gcc, or name a compiler with CC=..., and export again."
    )


def _c_library(name: str, table: bytes) -> bytes:
    """Return a zip of a packed table and the C library that answers from it."""
    from wrenchbook.service.fmu.export import make_library
    from wrenchbook.surrogate.kernel.binding import PackedTable

    return make_library(name, PackedTable.from_bytes(table))


def withdraw(
    name: Name,
    number: _Import = None,
    finding: _Finding = None,
    restore: _Restore = False,
    as_json: AsJson = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Withdraw an import's rows, or those a finding names. Without IMPORT: list the findings."""
    with connected(server, data) as client:
        if number is None:
            warnings = client.component(name)["warnings"]
            reply: dict[str, Any] = {"findings": [one for one in warnings if "import" in one]}
        else:
            reply = client.withdraw_import(name, number, finding, restore=restore)
    if as_json:
        print_json(reply)
    elif number is None:
        for one in reply["findings"]:
            _print_finding(name, one, one["import"])
        if not reply["findings"]:
            out.print("No findings.")
    else:
        out.print(f"{reply['rows']} rows {reply['status']}.")


TABLE_COMMANDS = {"import": import_table, "export": export_table, "withdraw": withdraw}


def _print_finding(name: str, finding: dict[str, Any], number: int | None) -> None:
    out.print(Text(f"{finding['cause']}: {finding['message']}", style="yellow"))
    if number is not None:
        command = f"wrenchbook withdraw {name} {number} --finding {finding['cause']}"
        many = finding["count"] or "all"
        render.plain(out, f"  to withdraw {many} rows of this import: {command}")


def _print_import(name: str, reply: dict[str, Any]) -> None:
    """Print how many of a file's rows were loaded, and why others were not."""
    render.row_errors(out, reply)
    if reply["ignored"]:
        render.plain(out, f"Columns left out: {', '.join(reply['ignored'])}.")
    if above := reply.get("above"):  # servers before 0.2 leave it out
        render.plain(out, f"Lines above the header left out: {'; '.join(above)}.")
    verb = "would be inserted" if reply["dry_run"] else "inserted"
    out.print(f"{reply['inserted']} rows {verb}, {reply['existing']} were there already.")
    if reply["existing"]:
        out.print(
            "Those stay as they are, withdrawn ones too: slopes and second derivatives of this "
            "file are not added to them."
        )
    if rig := reply.get("rig"):  # servers before 0.3 have none
        axes = "left-handed" if rig["left_handed"] else "right-handed"
        cell = f", load cell {rig['load_cell']}" if rig.get("load_cell") else ""
        taken = f"Readings were taken to the interface from rig {rig['name']}, {axes}{cell}."
        render.plain(out, taken)
    for finding in reply.get("findings", ()):  # servers before 0.3 have none
        _print_finding(name, finding, reply.get("import"))
        if finding["rows"]:
            shown = ", ".join(map(str, finding["rows"][:10]))
            more = " and others" if finding["count"] > 10 else ""
            render.plain(out, f"  rows {shown}{more} of the file")
    if (clock := reply.get("clock")) and clock["lag_s"] is not None:
        shown = f"{clock['lag_s']:.4g} +- {clock['uncertainty_s']:.1g}"
        out.print(f"Lag of the displacements: {shown} s; {clock['applied_s']:.4g} s is applied.")
    rows = reply["rows"]
    others = {"refused": "have mistakes", "tare": "are the tare", "unmatched": "have no load"}
    parts = [f"{rows[word]} {what}" for word, what in others.items() if rows[word]]
    if parts:
        out.print(f"Of {rows['read']} rows read {', '.join(parts)}.")
    if not (reply["dry_run"] or reply["errors"] or reply["in_use"]):
        out.print(
            f"The server still builds its table; it answers from the {reply['inserted']} rows soon."
        )


def _pair(text: str) -> tuple[str, str]:
    name, mark, target = text.partition("=")
    if not mark:
        raise typer.BadParameter(f"'{text}' is not of the form 'column in the file=fz [N]'")
    return name.strip(), target.strip()
