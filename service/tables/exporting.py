"""A component's table as a file: any form, any version, written piece by piece."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from wrenchbook.service.formats import (
    Layout,
    UnitError,
    chosen_units,
    csv_text,
    json_text,
    layout,
    write_hdf5,
    write_parquet,
    write_xlsx,
)
from wrenchbook.service.ledger import Ledger, NotedRows, TableAt
from wrenchbook.service.library.component import Component
from wrenchbook.service.tables.rows import (
    CONTRACT_WORDS,
    ExportRows,
    export_rows,
    joined_rows,
    table_meta,
)
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.rows import Rows

ExportFormat = Literal["csv", "xlsx", "parquet", "hdf5", "json"]
Pieces = Iterator[ExportRows]
IN_SI = ("parquet", "hdf5", "json")
ENDINGS: dict[str, str] = {
    "csv": "csv",
    "xlsx": "xlsx",
    "parquet": "parquet",
    "hdf5": "h5",
    "json": "json",
}


@dataclass(frozen=True)
class ExportRequest:
    """Format and options of an export.

    Attributes
    ----------
    format : str
    units : mapping
        Any of force, moment, translation, rotation to a unit.
    version : int or None
        Of the table; the newest if None.
    comments : bool
        Whether a CSV begins with comment lines (``#``) that describe it.
    """

    format: ExportFormat
    units: Mapping[str, str]
    version: int | None = None
    comments: bool = False


def export_table(
    ledger: Ledger,
    component: Component,
    request: ExportRequest,
    path: Path,
    error: SolverError | None = None,
) -> int:
    """Write a component's table into a file and return the version it is of.

    Parameters
    ----------
    error : SolverError, optional
        Error estimate of the rows' solver, m and rad: an HDF5 export has it.

    Raises
    ------
    UnitError
        If a unit does not measure its quantity, or the form is always in SI.
    UnknownVersionError
        If the table has no such version.
    SheetFullError
        If a sheet cannot hold it.
    """
    check_units(request)
    setup = {"space": component.space, "fingerprint": component.fingerprint}
    with ledger.table_at(component.name, request.version, **setup) as table:
        spans = ledger.import_spans(component.name)
        pieces = (export_rows(lot, spans) for lot in table.lots)
        if request.format == "hdf5":
            none = export_rows(NotedRows(Rows.empty(component.space), ()))
            rows = joined_rows([none, *pieces])
            meta = table_meta(component, table.version, error)
            path.write_bytes(write_hdf5(rows, rows.seq, meta))
        else:
            _WRITERS[request.format](path, pieces, component, table, request)
        return table.version


def check_units(request: ExportRequest) -> None:
    """Refuse unknown units, and units other than SI for formats that programs read."""
    chosen = chosen_units(request.units)
    if request.format in IN_SI and any(unit != of.si for of, (unit, _) in chosen.items()):
        raise UnitError(f"{request.format} is always in SI; leave the units out, or take CSV")


def _about(component: Component, table: TableAt) -> dict[str, str]:
    return {
        "component": component.name,
        "title": component.title,
        "table_version": str(table.version),
        "fingerprint": component.fingerprint,
        "contract": CONTRACT_WORDS,
    }


def _layout(component: Component, table: TableAt, units: Mapping[str, str]) -> Layout:
    uncertainty, compliance, curvature, note, fingerprint = table.known
    present = {"source": True, "note": note, "fingerprint": fingerprint}
    texts = [name for name, known in present.items() if known]
    more: dict[str, Any] = {"origin": True, "space": component.space, "curvature": curvature}
    return layout(uncertainty, compliance, texts, units, **more)


def _csv(
    path: Path, pieces: Pieces, component: Component, table: TableAt, request: ExportRequest
) -> None:
    about = _about(component, table).items() if request.comments else ()
    comments = [f"{word}: {meaning}" for word, meaning in about]
    with path.open("w", encoding="utf-8", newline="") as file:
        file.writelines(csv_text(pieces, _layout(component, table, request.units), comments))


def _json(
    path: Path, pieces: Pieces, component: Component, table: TableAt, _: ExportRequest
) -> None:
    about: dict[str, Any] = {"component": component.name, "table_version": table.version}
    if not component.space.is_default:
        about |= {"inputs": component.space.input_names, "outputs": component.space.output_names}
    with path.open("w", encoding="utf-8") as file:
        file.writelines(json_text(pieces, about | {"contract": CONTRACT_WORDS}))


def _columns(
    path: Path, pieces: Pieces, component: Component, table: TableAt, request: ExportRequest
) -> None:
    write = write_xlsx if request.format == "xlsx" else write_parquet
    write(path, pieces, _layout(component, table, request.units), _about(component, table))


_WRITERS = {"csv": _csv, "json": _json, "xlsx": _columns, "parquet": _columns}
