"""Commands that carry tables in and out."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

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
_Unit = Annotated[str | None, typer.Option(help="csv, xlsx: the unit to write in; SI otherwise")]
_Read = Annotated[
    Path,
    typer.Argument(
        help="a CSV, XLSX, Parquet, JSON or HDF5 table, gzipped or not", exists=True, dir_okay=False
    ),
]
_DryRun = Annotated[bool, typer.Option(help="only check")]
_Partial = Annotated[
    bool, typer.Option("--partial", help="load the good rows though others have mistakes")
]
_Decimal = Annotated[
    str | None, typer.Option(help="the decimal mark of a CSV: . or ,", metavar="MARK")
]
_Ignore = Annotated[list[str] | None, typer.Option(help="a column to leave out; repeatable")]
_IgnoreExtra = Annotated[bool, typer.Option("--ignore-extra", help="leave out all unknown columns")]
_Columns = Annotated[
    list[str] | None,
    typer.Option(
        metavar="FILE=TABLE",
        help="what a column is: --column 'Load cell=fz [N]', or =-fz [N] to turn its sign",
    ),
]
_Zero = Annotated[
    bool, typer.Option("--missing-loads-zero", help="loads without a column were zero")
]
_Tare = Annotated[
    int, typer.Option(min=0, help="rows at the beginning whose mean is taken off the others")
]
_Sheet = Annotated[str | None, typer.Option(help="XLSX: its name; the first otherwise")]
_Moved = Annotated[
    Path | None,
    typer.Option(
        help="a second log, joined by time; FILE is then the log of the loads",
        exists=True,
        dir_okay=False,
    ),
]
_Offset = Annotated[float, typer.Option(help="added to the displacements' times, s")]
_Note = Annotated[str | None, typer.Option(help="kept with the import")]
_Written = Annotated[
    Path,
    typer.Argument(
        help="a .csv, .xlsx, .parquet, .json, .h5, .hdf5, .mat, .wbt or .fmu file; - prints CSV"
    ),
]
_Method = Annotated[
    str | None, typer.Option(help="with .fmu: how it answers; the table's default otherwise")
]
_Version = Annotated[
    int | None, typer.Option(help="the table as it was at this version; now otherwise")
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
    time_offset: _Offset = 0.0,
    note: _Note = None,
    as_json: AsJson = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Load a table from outside: all its rows, or none and the reasons."""
    check_readable(file)  # before a server is asked, or started, for nothing
    said: dict[str, Any] = {
        "partial": partial or None,
        "ignore_extra": ignore_extra or None,
        "missing_loads": "zero" if missing_loads_zero else None,
        "tare": tare or None,
        "sheet": sheet,
        "note": note,
        "time_offset_s": time_offset or None,
        "displacements": displacements,
        "mapping": dict(map(_pair, column or ())),
        "ignore": ignore or (),
    }
    with connected(server, data) as client:
        reply = client.import_table(name, file, dry_run=dry_run, decimal=decimal, **said)
    (print_json if as_json else _tell)(reply)
    raise typer.Exit(1 if reply["errors"] and not partial else 0)


def export_table(
    name: Name,
    file: _Written,
    method: _Method = None,
    force: _Unit = None,
    moment: _Unit = None,
    translation: _Unit = None,
    rotation: _Unit = None,
    table_version: _Version = None,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Write a table to a file; its ending chooses the format. A .fmu runs in simulation tools."""
    printed, fmu = str(file) == "-", file.suffix.lower() == ".fmu"
    if method is not None and not fmu:
        raise typer.BadParameter("--method is for .fmu files: other formats hold rows only")
    format_ = "csv" if printed else "packed" if fmu else table_format(file)
    names = ("force", "moment", "translation", "rotation")
    pairs = zip(names, (force, moment, translation, rotation), strict=True)
    units = {quantity: unit for quantity, unit in pairs if unit is not None}
    with connected(server, data) as client:
        content = client.export_table(name, format_, units, table_version)
    if printed:
        sys.stdout.write(content)
        return
    content = content.encode() if isinstance(content, str) else content
    told = f"{file} written."
    if fmu:
        from wrenchbook.service.cli.fmu import fmu_of  # the compiler: no other command waits for it

        content, told = fmu_of(file, name, content, method)
    write_whole_bytes(file, content)
    out.print(told)


TABLE_COMMANDS = {"import": import_table, "export": export_table}


def _tell(reply: dict[str, Any]) -> None:
    """Say what became of a file's rows."""
    render.row_errors(out, reply["errors"])
    if reply["ignored"]:
        render.plain(out, f"Columns left out: {', '.join(reply['ignored'])}.")
    if above := reply.get("above"):  # servers before 0.2 do not tell it
        render.plain(out, f"Lines above the header left out: {'; '.join(above)}.")
    verb = "would be inserted" if reply["dry_run"] else "inserted"
    out.print(f"{reply['inserted']} rows {verb}, {reply['existing']} were there already.")
    rows = reply["rows"]
    others = {"refused": "have mistakes", "tare": "are the tare", "unmatched": "have no load"}
    told = [f"{rows[word]} {what}" for word, what in others.items() if rows[word]]
    if told:
        out.print(f"Of {rows['read']} rows read {', '.join(told)}.")
    if not (reply["dry_run"] or reply["errors"] or reply["in_use"]):
        out.print("The server still builds its table; it answers from the new rows shortly.")


def _pair(text: str) -> tuple[str, str]:
    name, mark, target = text.partition("=")
    if not mark:
        raise typer.BadParameter(f"'{text}' is not of the form 'column in the file=fz [N]'")
    return name.strip(), target.strip()
