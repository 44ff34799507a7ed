"""Commands of tables and their rows: ``import``, ``export``, ``withdraw``, ``compare``, ``rig``."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal
from urllib.parse import quote

import typer
from rich.table import Table

from wrenchbook.service.cli.connect import (
    DEFAULT_SERVER,
    AsJson,
    Data,
    Name,
    Server,
    connected,
    in_folder,
    refuse_alone,
)
from wrenchbook.service.cli.render import Screen, comparison_shown, plain, print_json, show
from wrenchbook.service.client.errors import mistake_line
from wrenchbook.service.client.library import RIG_NAME, check_readable, table_format
from wrenchbook.service.contract import counted
from wrenchbook.service.files.durable import write_atomically

COMPILED = (".fmu", ".zip")  # made by this command from a packed table, not by the server
WAIT_S = 10.0  # s, the default of service.http.imports, which would load FastAPI
MAX_ROWS_SHOWN = 10  # rows of a finding: a line of a terminal
_RIG_METHODS = {"list": "GET", "show": "GET", "add": "PUT", "remove": "DELETE"}
_UNNAMED_RIG = re.compile("[0-9a-f]{8}")  # the server's name for a rig that has none: its digest
_IDENTITY = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]  # the frame of a rig with the interface's axes
_BINARY = (".xlsx", ".xls", ".parquet", ".h5", ".hdf5", ".mat", ".tdms")
_NOT_LOADED = {  # texts by the state of an import's rows
    "refused": "have mistakes",
    "tare": "are the tare",
    "unmatched": "have no load",
    "skipped": "are of skipped cycles",
    "branch": "are off the branch",
    "averaged": "are in the mean of others",
}
_Unit = Annotated[str | None, typer.Option(help="unit in a CSV or XLSX file; SI by default")]
_Point = Annotated[
    str | None, typer.Option(metavar="X,Y,Z", help="of the readings, from the interface's point, m")
]


def import_table(
    name: Name,
    file: Annotated[
        Path,
        typer.Argument(
            help="a CSV, XLSX, XLS, Parquet, JSON, HDF5, MAT, LVM or TDMS table, gzipped or not",
            exists=True,
            dir_okay=False,
        ),
    ],
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="check the file and load nothing")
    ] = False,
    partial: Annotated[
        bool, typer.Option("--partial", help="load the correct rows even if others have mistakes")
    ] = False,
    decimal: Annotated[
        str | None, typer.Option(help="decimal mark of numbers in text: . or ,", metavar="MARK")
    ] = None,
    ignore: Annotated[
        list[str] | None, typer.Option(help="a column to leave out; repeatable")
    ] = None,
    ignore_extra: Annotated[
        bool, typer.Option("--ignore-extra", help="leave out all unknown columns")
    ] = False,
    column: Annotated[
        list[str] | None,
        typer.Option(
            metavar="FILE=TABLE",
            help="meaning of a column: --column 'Load cell=fz [N]'; =-fz [N] for the opposite "
            "sign; a number is the column's position",
        ),
    ] = None,
    unit: Annotated[
        list[str] | None,
        typer.Option(
            help="unit of each --column without [UNIT], in order; by default the unit of the file"
        ),
    ] = None,
    missing_loads_zero: Annotated[
        bool, typer.Option("--missing-loads-zero", help="loads without a column are zero")
    ] = False,
    tare: Annotated[
        int | None,
        typer.Option(
            min=0, help="number of first rows, whose mean is subtracted from the other rows"
        ),
    ] = None,
    sheet: Annotated[
        str | None,
        typer.Option(
            help="sheet of a workbook, by default the first with named columns; group of a TDMS "
            "file"
        ),
    ] = None,
    displacements: Annotated[
        Path | None,
        typer.Option(
            help="log of the displacements, joined by time with FILE, the log of the loads",
            exists=True,
            dir_okay=False,
        ),
    ] = None,
    frame: Annotated[
        str | None,
        typer.Option(help="axes of the rig in the frame of the interface, such as x=-y,y=x,z=z"),
    ] = None,
    load_point: _Point = None,
    displacement_point: _Point = None,
    load_cell: Annotated[
        str | None,
        typer.Option(
            metavar="moving|fixed",
            help="whether the load cell, the point of the moments, moves with the interface",
        ),
    ] = None,
    rig: Annotated[
        str | None,
        typer.Option(
            metavar="FILE|NAME", help="rig profile: a TOML file, or a name of `wrenchbook rig list`"
        ),
    ] = None,
    skip_cycles: Annotated[
        int | None, typer.Option(min=0, help="number of first cycles of the main load to leave out")
    ] = None,
    branch: Annotated[
        str | None,
        typer.Option(metavar="loading|unloading", help="load this branch of each cycle only"),
    ] = None,
    thin: Annotated[
        float | None, typer.Option(help="fraction of the load range within which rows are averaged")
    ] = None,
    mean_cycles: Annotated[
        bool, typer.Option("--mean-cycles", help="replace repeated cycles by their mean")
    ] = False,
    lag: Annotated[
        str | None,
        typer.Option(
            "--lag",
            "--time-offset",
            help="seconds to add to the displacement times; auto: estimated from the two logs",
        ),
    ] = None,
    note: Annotated[str | None, typer.Option(help="note to store with the import")] = None,
    wait_s: Annotated[
        float, typer.Option(help="longest wait until answers come from the rows, s", min=0, max=600)
    ] = WAIT_S,
    as_json: AsJson = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Load a table from a file: all of its rows, or none and every mistake."""
    check_readable(file)  # before a server is called or started
    mapping = _mapping(column or (), unit or ())
    with connected(server, data) as client:
        reply = client.import_table(
            name,
            file,
            dry_run=dry_run,
            decimal=decimal,
            displacements=displacements,
            mapping=mapping,
            ignore=ignore or (),
            ignore_extra=ignore_extra or None,
            missing_loads="zero" if missing_loads_zero else None,
            partial=partial or None,
            tare=tare,
            sheet=sheet,
            frame=frame,
            load_point=load_point,
            displacement_point=displacement_point,
            load_cell=load_cell,
            rig=rig,
            skip_cycles=skip_cycles,
            branch=branch,
            thin=thin,
            mean_cycles=mean_cycles or None,
            time_offset_s=lag,
            note=note,
            wait_s=None if wait_s == WAIT_S else wait_s,
        )
    if as_json:
        print_json(reply)
    else:
        form = reply["format"]
        if displacements is None and form in ("csv", "json") and file.suffix.lower() in _BINARY:
            content = f"{file.name} was read as {form.upper()}: its content is text"
            plain(Screen(), f"{content}, whatever its ending.")
        _print_import(name, reply)
    raise typer.Exit(1 if reply["errors"] and not partial else 0)


def _mapping(columns: Sequence[str], units: Sequence[str]) -> dict[str, str]:
    """Return the meaning of each column; units belong to columns without brackets, in order."""
    mapping: dict[str, str] = {}
    for text in columns:
        label, mark, meaning = text.rpartition("=")
        if not mark:
            raise typer.BadParameter(
                f"--column '{text}' has no =; write the file's column, =, and its meaning: "
                f"--column '{text}=fz [N]'"
            )
        if (label := label.strip()) in mapping:
            raise typer.BadParameter(
                f"--column '{label}' is there twice, as {mapping[label]} and {meaning.strip()}; "
                "leave one out"
            )
        mapping[label] = meaning.strip()
    without_unit = [label for label, meaning in mapping.items() if "[" not in meaning]
    if units and len(units) != len(without_unit):
        raise typer.BadParameter(
            f"--unit is there {counted(len(units), 'time')} for {len(without_unit)} --column "
            "without brackets; write each as --column 'COLUMN=fz [kN]'"
        )
    for label, unit in zip(without_unit, units, strict=False):  # without --unit there is none
        mapping[label] += f" [{unit.strip('[]')}]"
    return mapping


def export_table(
    name: Name,
    file: Annotated[
        Path,
        typer.Argument(
            help="a .csv, .xlsx, .parquet, .json, .h5, .hdf5, .wbt, .fmu or .zip file; - prints "
            "CSV",
            callback=in_folder,
        ),
    ],
    method: Annotated[
        str | None, typer.Option(help="with .fmu: interpolation method; by default the table's")
    ] = None,
    platforms: Annotated[
        str | None,
        typer.Option(
            metavar="LIST",
            help="with .fmu: all, or names of linux64,aarch64-linux,win64,darwin64, compiled by "
            "ziglang; by default this machine",
        ),
    ] = None,
    force: _Unit = None,
    moment: _Unit = None,
    translation: _Unit = None,
    rotation: _Unit = None,
    table_version: Annotated[
        int | None, typer.Option(help="an earlier version of the table; by default the newest")
    ] = None,
    bushing: Annotated[
        Literal["displacement", "load"] | None,
        typer.Option(
            metavar="displacement|load",
            help="write a .csv of load over displacement; on the other axes this is zero",
        ),
    ] = None,
    as_json: AsJson = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Write a table to a file; its ending chooses the format. A .fmu runs in simulation tools.

    A .zip holds the C library that answers from the table: sources, example and CMakeLists.txt.
    """
    to_stdout = str(file) == "-"
    ending = file.suffix.lower()
    if ending != ".fmu":
        refuse_alone("a file that ends in .fmu", {"--method": method, "--platforms": platforms})
    format_ = "csv" if to_stdout else table_format(file, dict.fromkeys(COMPILED, "packed"))
    units = {"force": force, "moment": moment, "translation": translation, "rotation": rotation}
    units = {quantity: unit for quantity, unit in units.items() if unit is not None}
    further = {}
    if bushing:
        if format_ != "csv":
            raise typer.BadParameter(
                f"--bushing writes CSV, but {file} has another ending; name a file that ends in "
                ".csv"
            )
        if units or table_version is not None:
            options = ", ".join(f"--{option}" for option in units) or "--table-version"
            raise typer.BadParameter(
                f"--bushing writes the newest table in SI; leave {options} out"
            )
        format_ = "bushing"
        further = {"others": bushing}
    if to_stdout and as_json:
        raise typer.BadParameter(
            "--json describes a written file, but - writes none; leave --json out"
        )
    targets = ()
    if platforms is not None:  # checked before a server is called or started
        from wrenchbook.service.fmu.platforms import platforms_of

        targets = platforms_of(platforms)

    with connected(server, data) as client:
        content = client.export_table(name, format_, units, table_version, **further)
    if to_stdout:
        sys.stdout.write(content)
        return
    content = content.encode() if isinstance(content, str) else content
    message = f"{file} written."
    if ending in COMPILED:
        content, message = _compiled(file, name, content, method, targets)
    write_atomically(file, content)
    show({"file": file, "bytes": len(content), "message": message}, as_json, message)


def _compiled(
    file: Path, name: str, table: bytes, method: str | None, platforms: tuple[str, ...]
) -> tuple[bytes, str]:
    """Return the FMU or C library of a packed table, and a message on it."""
    # Imported on use: no other command needs the compiler.
    from wrenchbook.service.fmu.export import make_fmu, make_library
    from wrenchbook.surrogate.kernel.binding import PackedTable

    packed = PackedTable.from_bytes(table)
    if file.suffix.lower() == ".zip":
        return make_library(name, packed), f"{file} written."
    fmu = make_fmu(name, packed, method, platforms)
    if fmu.platforms:
        built = ", ".join(fmu.platforms)
        return fmu.content, f"{file} written: FMI 2.0, {built}, method {fmu.method}."
    return fmu.content, (
        f"{file} written: FMI 2.0, method {fmu.method}, sources only, since this machine has no C "
        "compiler. Use a tool that compiles sources; or install gcc or name a compiler with "
        "CC=..., and export again."
    )


def withdraw(
    name: Name,
    number: Annotated[
        int | None, typer.Argument(metavar="IMPORT", help="number of the import", min=1)
    ] = None,
    finding: Annotated[
        str | None,
        typer.Option(help="cause of a finding: withdraw the rows of this finding only"),
    ] = None,
    restore: Annotated[bool, typer.Option("--restore", help="restore the rows instead")] = False,
    as_json: AsJson = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Withdraw an import's rows, or those a finding names. Without IMPORT: list the findings."""
    if number is not None:
        with connected(server, data) as client:
            reply = client.withdraw_import(name, number, finding, restore=restore)
        show(reply, as_json, f"{counted(reply['rows'], 'row')} {reply['status']}.")
        return
    refuse_alone("IMPORT", {"--finding": finding, "--restore": restore})
    with connected(server, data) as client:
        warnings = client.component(name)["warnings"]
    findings = [warning for warning in warnings if "import" in warning]
    if as_json:
        print_json({"findings": findings})
        return
    for warning in findings:
        _print_finding(name, warning, warning["import"])
    if not findings:
        plain(Screen(), "No findings.")


def compare(
    name: Name,
    number: Annotated[
        int | None,
        typer.Option("--import", min=1, help="import to compare; by default all measured rows"),
    ] = None,
    against: Annotated[
        int | None, typer.Option(min=1, help="import to compare with; by default the solves")
    ] = None,
    csv: Annotated[
        Path | None, typer.Option(help="write the rows to this file as CSV", callback=in_folder)
    ] = None,
    as_json: AsJson = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """Compare measured rows with the answer of the solves alone, or of another import's rows."""
    with connected(server, data) as client:
        reply = client.comparison(name, number, against)
        text = client.comparison(name, number, against, "csv") if csv else ""
        # The table may have changed between the two calls: the file is of the version shown.
        while csv and (now := client.comparison(name, number, against)) != reply:
            reply, text = now, client.comparison(name, number, against, "csv")
    if csv:
        write_atomically(csv, text.encode())
    show(reply, as_json, lambda: comparison_shown(reply))


def rig(
    action: Annotated[Literal["list", "show", "add", "remove"], typer.Argument()],
    name: Annotated[str, typer.Argument(help="name of the profile")] = "",
    file: Annotated[
        Path | None,
        typer.Argument(help="TOML file of the profile, for add", exists=True, dir_okay=False),
    ] = None,
    as_json: AsJson = False,
    server: Server = DEFAULT_SERVER,
    data: Data = None,
) -> None:
    """List, show, add (or replace) and remove profiles of test rigs, for import --rig NAME."""
    path = "/v1/rigs" if action == "list" else f"/v1/rigs/{quote(name, safe='')}"
    if (action == "list") == bool(name) or (action == "add") != (file is not None):
        form = {"list": "list", "add": "add NAME FILE.toml"}.get(action, f"{action} NAME")
        raise typer.BadParameter(
            f"wrenchbook rig {action} needs other arguments; write: wrenchbook rig {form}"
        )
    if name and not RIG_NAME.fullmatch(name):
        raise typer.BadParameter(
            f"the rig's name {name!r} must begin with a letter or digit, and have at most 64 "
            "letters, digits, '.', '_' and '-'"
        )

    content = None if file is None else file.read_bytes()
    with connected(server, data) as client:
        reply = client.call(_RIG_METHODS[action], path, content, kind="application/toml")
    text = reply.content.decode()
    body: Any = {"name": name, "profile": text} if action == "show" else reply.json()
    if action in ("add", "remove"):
        text = f"The rig {name} is {'stored' if file else 'removed'}."
    if name:
        show(body, as_json, text.rstrip())
        return

    table = Table("name", "origin", "title")
    for profile in body["rigs"]:
        table.add_row(profile["name"], profile["origin"], profile["title"])
    show(body, as_json, lambda: [table])


def _print_finding(name: str, finding: dict[str, Any], number: int | None) -> None:
    """Print a finding of the import `number`, and how to withdraw its rows."""
    plain(Screen(), f"{finding['cause']}: {finding['message']}", style="yellow")
    if number is not None:
        command = f"wrenchbook withdraw {name} {number} --finding {finding['cause']}"
        rows = counted(finding["count"], "row") if finding["count"] else "all rows"
        plain(Screen(), f"  to withdraw {rows} of this import: {command}")


def _print_import(name: str, reply: dict[str, Any]) -> None:
    """Print the mistakes, rows and findings of an import."""
    out = Screen()
    for line in _import_lines(reply):
        plain(out, line)
    for finding in reply["findings"]:
        _print_finding(name, finding, reply["import"])
        if finding["rows"]:
            shown = ", ".join(map(str, finding["rows"][:MAX_ROWS_SHOWN]))
            more = " and others" if finding["count"] > MAX_ROWS_SHOWN else ""
            plain(out, f"  rows {shown}{more} of the file")

    if (clock := reply["clock"]) and clock["lag_s"] is not None:
        lag = f"{clock['lag_s']:.4g} +- {clock['uncertainty_s']:.1g}"
        applied = f"{clock['applied_s']:.4g} s is applied"
        plain(out, f"Lag of the displacements: {lag} s; {applied}.")

    rows = reply["rows"]
    omitted = [f"{rows[state]} {text}" for state, text in _NOT_LOADED.items() if rows.get(state)]
    if omitted:
        plain(out, f"Of {counted(rows['read'], 'row')} read {', '.join(omitted)}.")
    if not (reply["dry_run"] or reply["errors"] or reply["in_use"]):
        new = counted(reply["inserted"], "new row")
        plain(out, f"The server still builds its table; it answers from {new} soon.")


def _import_lines(reply: dict[str, Any]) -> list[str]:
    """Return the lines of an import's mistakes, omitted columns, sheets, rows and rig."""
    lines = [mistake_line(cause) for cause in reply["causes"]]
    if reply["ignored"]:
        lines.append(f"Columns left out: {', '.join(reply['ignored'])}.")
    if reply["above"]:
        lines.append(f"Lines above the header left out: {'; '.join(reply['above'])}.")
    if len(sheets := reply["sheets"]) > 1:
        lines.append(f"Sheet {reply['sheet']} was read, of {', '.join(sheets)}.")
    verb = "would be inserted" if reply["dry_run"] else "inserted"
    existing = reply["existing"]
    were = "was" if existing == 1 else "were"
    lines.append(f"{counted(reply['inserted'], 'row')} {verb}, {existing} {were} there already.")
    if beyond := reply.get("beyond_range"):
        are = "is" if beyond == 1 else "are"
        lines.append(f"{counted(beyond, 'row')} {are} outside the load range.")
    if existing:
        lines.append(
            "Equal rows count once, within the file too; slopes and second derivatives of this "
            f"file are not added to them. Withdrawn rows that count again: {reply['restored']}."
        )
    if rig := reply["rig"]:
        lines.append(rig_line(rig))
    return lines


def rig_line(rig: dict[str, Any]) -> str:
    """Return the line of an import's rig: its axes and points, or those of the options alone."""
    load_cell = rig.get("load_cell")
    is_named = not _UNNAMED_RIG.fullmatch(rig["name"])
    if load_cell and not is_named and rig["frame"] == _IDENTITY:
        point = "moving" if load_cell == "moving" else "undeformed"
        return f"Moments were taken about the {point} interface point (--load-cell {load_cell})."
    source = f" from rig {rig['name']}" if is_named else ""
    axes = "left-handed" if rig["left_handed"] else "right-handed"
    at = f", load cell {load_cell}" if load_cell else ""
    return f"Readings were taken to the interface{source}, {axes}{at}."


TABLE_COMMANDS = {
    "import": import_table,
    "export": export_table,
    "withdraw": withdraw,
    "compare": compare,
    "rig": rig,
}
