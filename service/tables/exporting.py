"""A component's table as a file: any form, any version, written piece by piece."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

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
from wrenchbook.service.ledger import Ledger
from wrenchbook.service.ledger.table_at import TableAt
from wrenchbook.service.library.component import Component
from wrenchbook.service.tables.rows import (
    CONTRACT_WORDS,
    ExportRows,
    export_rows,
    joined_rows,
    own_rows,
    table_meta,
)
from wrenchbook.surrogate.solver_error import SolverError

ExportFormat = Literal["csv", "xlsx", "parquet", "hdf5", "json"]
IN_SI = ("parquet", "hdf5", "json")
ENDINGS: dict[str, str] = {
    "csv": "csv",
    "xlsx": "xlsx",
    "parquet": "parquet",
    "hdf5": "h5",
    "json": "json",
    "mat": "mat",
}


@dataclass(frozen=True)
class Wanted:
    """How an export is to be.

    Attributes
    ----------
    format : str
    units : mapping
        Any of force, moment, translation, rotation to a unit.
    version : int or None
        Of the table; the newest if None.
    comments : bool
        Whether a CSV begins with lines that say what it is, each after a ``#``.
    """

    format: ExportFormat
    units: Mapping[str, str]
    version: int | None = None
    comments: bool = False


def export_table(
    ledger: Ledger,
    component: Component,
    wanted: Wanted,
    path: Path,
    error: SolverError | None = None,
) -> int:
    """Write a component's table into a file and return the version it is of.

    Parameters
    ----------
    error : SolverError, optional
        What the rows' solver may be wrong by, m and rad: an HDF5 export tells it.

    Raises
    ------
    UnitError
        If a unit does not measure its quantity, or the form is always in SI.
    UnknownVersionError
        If the table has no such version.
    SheetFullError
        If a sheet cannot hold it.
    """
    check_units(wanted)
    with ledger.table_at(component.name, wanted.version) as table:
        spans = ledger.import_spans(component.name)
        pieces = (export_rows(own_rows(component, lot), spans) for lot in table.lots)
        if wanted.format == "hdf5":
            _hdf5(path, pieces, component, table, error)
        else:
            _WRITERS[wanted.format](path, pieces, component, table, wanted)
        return table.version


def check_units(wanted: Wanted) -> None:
    """Refuse units that mean nothing, and any but SI for a form that programs read."""
    chosen = chosen_units(wanted.units)
    if wanted.format in IN_SI and any(unit != of.si for of, (unit, _) in chosen.items()):
        raise UnitError(f"{wanted.format} is always in SI; leave the units out, or take CSV")


def _about(component: Component, table: TableAt) -> dict[str, str]:
    return {
        "component": component.name,
        "title": component.title,
        "table_version": str(table.version),
        "fingerprint": component.fingerprint,
        "contract": CONTRACT_WORDS,
    }


def _layout(table: TableAt, units: Mapping[str, str]) -> Layout:
    uncertainty, compliance, note, fingerprint = table.known
    said = {"source": True, "note": note, "fingerprint": fingerprint}
    texts = [name for name, known in said.items() if known]
    return layout(uncertainty, compliance, texts, units, origin=True)


Writer = Callable[[Path, Iterator[ExportRows], Component, TableAt, Wanted], None]


def _csv(
    path: Path, pieces: Iterator[ExportRows], component: Component, table: TableAt, wanted: Wanted
) -> None:
    about = _about(component, table).items() if wanted.comments else ()
    comments = [f"{word}: {meaning}" for word, meaning in about]
    with path.open("w", encoding="utf-8", newline="") as file:
        file.writelines(csv_text(pieces, _layout(table, wanted.units), comments))


def _json(
    path: Path, pieces: Iterator[ExportRows], component: Component, table: TableAt, _: Wanted
) -> None:
    about = {
        "component": component.name,
        "table_version": table.version,
        "contract": CONTRACT_WORDS,
    }
    with path.open("w", encoding="utf-8") as file:
        file.writelines(json_text(pieces, about))


def _xlsx(
    path: Path, pieces: Iterator[ExportRows], component: Component, table: TableAt, wanted: Wanted
) -> None:
    write_xlsx(path, pieces, _layout(table, wanted.units), _about(component, table))


def _parquet(
    path: Path, pieces: Iterator[ExportRows], component: Component, table: TableAt, _: Wanted
) -> None:
    write_parquet(path, pieces, _layout(table, {}), _about(component, table))


def _hdf5(
    path: Path,
    pieces: Iterator[ExportRows],
    component: Component,
    table: TableAt,
    error: SolverError | None,
) -> None:
    rows = joined_rows([export_rows([], []), *pieces])
    path.write_bytes(write_hdf5(rows, rows.seq, table_meta(component, table.version, error)))


_WRITERS: dict[str, Writer] = {
    "csv": _csv,
    "json": _json,
    "xlsx": _xlsx,
    "parquet": _parquet,
}
