"""Table files in memory: what the readers make of a text, and texts of tables."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from wrenchbook.service.formats.columnar import read_hdf5 as hdf5_file
from wrenchbook.service.formats.columns import Layout, WritableRows, layout
from wrenchbook.service.formats.csv import csv_text
from wrenchbook.service.formats.csv import read_csv as csv_file
from wrenchbook.service.formats.json import json_text
from wrenchbook.service.formats.json import read_json as json_file
from wrenchbook.service.formats.options import FileMistake, Options, ParsedTable, ReadReport
from wrenchbook.service.formats.read import read_table_file
from wrenchbook.surrogate.table.hdf5 import write_table
from wrenchbook.surrogate.table.meta import TableMeta
from wrenchbook.surrogate.table.rows import Rows, joined


@dataclass(frozen=True)
class ReadTable(ParsedTable):
    """The good rows of a file, none if a mistake is about the whole file, and all mistakes."""

    errors: tuple[FileMistake, ...] = ()


def read_table(pieces: list[ParsedTable], report: ReadReport) -> ReadTable:
    """Return the pieces of a file as one table."""
    pieces = [] if report.mistakes.is_ruined else pieces
    times = [piece.time for piece in pieces if piece.time is not None]
    columns = dict(vars(joined(pieces or [Rows.empty()])))
    columns["note"] = tuple(chain.from_iterable(piece.note for piece in pieces))
    columns["time"] = np.concatenate(times) if times else None
    return ReadTable(**columns, errors=report.mistakes.listed())


def _read(reader: Any, kind: str, content: str | bytes, **options: Any) -> ReadTable:
    report = ReadReport(format=kind)
    if isinstance(content, str):
        content = content.encode("utf-8", "surrogatepass")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "upload"
        path.write_bytes(content)
        return read_table(list(reader(path, Options(**options), report)), report)


read_csv = partial(_read, csv_file, "csv")
read_hdf5 = partial(_read, hdf5_file, "hdf5")
read_json = partial(_read, json_file, "json")


def layout_of(table: Any, units: Mapping[str, str] | None = None) -> Layout:
    """Return the columns of a table that hold anything."""
    known = [bool(np.isfinite(column).any()) for column in (table.uncertainty, table.compliance)]
    texts = [
        name
        for name in ("source", "note", "fingerprint")
        if any(map(str, getattr(table, name, ())))
    ]
    return layout(*known, texts, units)


def write_csv(table: Any, units: Mapping[str, str] | None = None) -> str:
    return "".join(csv_text([table], layout_of(table, units)))


def write_json(table: Any, about: Mapping[str, Any] | None = None) -> str:
    return "".join(json_text([table], about or {}))


ZERO = Options(missing_loads="zero")


def read(content: bytes, options: Options = ZERO) -> tuple[ReadTable, ReadReport]:
    """What an import makes of a file of any format; loads without a column were zero."""
    report = ReadReport()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "upload"
        path.write_bytes(content)
        pieces = list(read_table_file(path, options, report))
    return read_table(pieces, report), report


def written(write: Any, table: ReadTable, units: Mapping[str, str] | None = None) -> bytes:
    """The file that one of the writers makes."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "export"
        write(path, [table], layout_of(table, units), {"contract": "SI", "component": "rig"})
        return path.read_bytes()


def write_hdf5(table: WritableRows, seq: Sequence[int], meta: TableMeta) -> bytes:
    """Return the content of the file of a table; `seq` are the rows' numbers in the ledger."""
    curvature = getattr(table, "curvature", None)
    rows = Rows.of(
        table.wrench,
        table.displacement,
        meta.load_range.space,
        seq=np.array(seq, dtype=np.int64),
        uncertainty=table.uncertainty,
        compliance=table.compliance,
        source=list(table.source),
        fingerprint=list(getattr(table, "fingerprint", ())),
        **({} if curvature is None else {"curvature": curvature}),
    )
    with tempfile.TemporaryDirectory(prefix="wrenchbook-") as folder:
        path = Path(folder) / "table.h5"
        write_table(path, rows, meta, notes=[str(note) for note in getattr(table, "note", ())])
        return path.read_bytes()
