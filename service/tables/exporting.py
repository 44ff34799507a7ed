"""A component's table as a file in any format and version, written piece by piece."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from wrenchbook.service.contract import CONTRACT_TEXT
from wrenchbook.service.formats.columnar import write_parquet
from wrenchbook.service.formats.columns import layout
from wrenchbook.service.formats.csv import csv_text
from wrenchbook.service.formats.json import json_text
from wrenchbook.service.formats.units import UnitError, chosen_units
from wrenchbook.service.formats.xlsx import write_xlsx
from wrenchbook.service.ledger import Ledger, TableAt
from wrenchbook.service.library.component import Component
from wrenchbook.service.tables.rows import ExportRows, table_meta
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.hdf5 import write_table
from wrenchbook.surrogate.table.rows import Rows, joined

FileFormat = Literal["csv", "xlsx", "parquet", "hdf5", "json"]
IN_SI = ("parquet", "hdf5", "json")
ENDINGS = {"csv": "csv", "xlsx": "xlsx", "parquet": "parquet", "hdf5": "h5", "json": "json"}


@dataclass(frozen=True)
class ExportRequest:
    """Format and options of an export."""

    format: FileFormat
    units: Mapping[str, str]  # units of force, moment, translation, rotation
    version: int | None = None  # version of the table; the newest if None
    comments: bool = False  # whether a CSV begins with lines (``#``) that describe it


def export_table(
    ledger: Ledger,
    component: Component,
    request: ExportRequest,
    path: Path,
    error: SolverError | None = None,
) -> int:
    """Write a component's table into a file and return its version.

    An HDF5 export has `error`, the error estimate of the rows' solver.

    Raises UnitError as `check_units`, UnknownVersionError if there is no such version, and
    SheetFullError if a sheet is too small for the rows or a cell for a text.
    """
    check_units(request)
    space = component.space
    setup = {"space": space, "fingerprint": component.fingerprint}
    with ledger.table_at(component.name, request.version, **setup) as table:
        spans = ledger.import_spans(component.name)
        pieces = (ExportRows(lot, spans) for lot in table.lots)
        if request.format == "hdf5":
            lots = list(table.lots)
            rows = joined([Rows.empty(space), *(lot.rows for lot in lots)])
            notes = [note for lot in lots for note in lot.note]
            write_table(path, rows, table_meta(component, table.version, error), notes=notes)
        elif request.format == "json":
            members = {"component": component.name, "table_version": table.version}
            if not space.is_default:
                members |= {"inputs": space.input_names, "outputs": space.output_names}
            with path.open("w", encoding="utf-8") as file:
                file.writelines(json_text(pieces, members | {"contract": CONTRACT_TEXT}))
        else:
            _write_columns(path, pieces, component, table, request)
        return table.version


def check_units(request: ExportRequest) -> None:
    """Check the units of an export.

    Raises UnitError if a unit is unknown, or not SI in a format that programs read.
    """
    for quantity, (unit, _) in chosen_units(request.units).items():
        if request.format in IN_SI and unit != quantity.si:
            remedy = "leave the units out, or use CSV"
            raise UnitError(f"{request.format} is always in SI, not in {unit}; {remedy}")


def _write_columns(
    path: Path,
    pieces: Iterator[ExportRows],
    component: Component,
    table: TableAt,
    request: ExportRequest,
) -> None:
    """Write a CSV, XLSX or Parquet file with the columns that any row has."""
    uncertainty, compliance, curvature, note, fingerprint = table.known
    present = {"source": True, "note": note, "fingerprint": fingerprint}
    columns = layout(
        uncertainty,
        compliance,
        [name for name, known in present.items() if known],
        request.units,
        origin=True,
        space=component.space,
        curvature=curvature,
    )
    properties = {
        "component": component.name,
        "title": component.title,
        "table_version": str(table.version),
        "fingerprint": component.fingerprint,
        "contract": CONTRACT_TEXT,
    }
    if request.format == "csv":
        comments = [f"{key}: {text}" for key, text in properties.items() if request.comments]
        with path.open("w", encoding="utf-8", newline="") as file:
            file.writelines(csv_text(pieces, columns, comments))
    else:
        write = write_xlsx if request.format == "xlsx" else write_parquet
        write(path, pieces, columns, properties)
