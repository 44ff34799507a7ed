"""HDF5 tables: the store's own, or a dataset a column; MATLAB files, a variable a column."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat, whosmat

from wrenchbook.service.formats.arrow import MAX_UNPACKED, cell_text
from wrenchbook.service.formats.cells import text_problem
from wrenchbook.service.formats.columns import TEXTS, Columns, WritableRows
from wrenchbook.service.formats.options import Options, ReadReport
from wrenchbook.service.formats.rows import Array, ParsedTable, Problem, good_rows
from wrenchbook.service.formats.text import PIECE, Cells, read_columns
from wrenchbook.surrogate.table.hdf5 import foreign_columns, foreign_tables, is_table, write_table
from wrenchbook.surrogate.table.meta import TableMeta
from wrenchbook.surrogate.table.rows import Rows


def read_hdf5(path: Path, options: Options, report: ReadReport) -> Iterator[ParsedTable]:
    """Yield the good rows of an HDF5 file piece by piece; `report` gets the mistakes."""
    columns = options.columns
    try:
        if not is_table(path):
            yield from read_columns(_cells(foreign_columns(path)), options, report)
            return
        for rows, notes in foreign_tables(path):
            if rows.space != columns.space:
                names = ", ".join((*columns.wrench, *columns.displacement))
                message = f"is a table of another component's inputs, outputs or units, not {names}"
                report.mistakes.ruin(0, "file", message)
                return
            piece = vars(rows) | {
                "seq": np.arange(1, len(rows) + 1) + report.read,
                "source": np.strings.strip(rows.source),
                "fingerprint": np.strings.strip(rows.fingerprint),
                "note": [note.strip() for note in notes],
            }
            good = np.ones(len(rows), dtype=bool)
            for at, key, message in (*_number_problems(piece, columns), *_text_problems(piece)):
                good[at] = False
                report.mistakes.add(int(piece["seq"][at]), key, message)
            yield good_rows(piece, good, options, report)
            report.read += len(rows)
            if report.is_beyond_limits():
                return
    except (ValueError, RuntimeError, OSError) as error:
        report.mistakes.ruin(0, "file", str(error))
        return
    if not report.read:
        report.mistakes.ruin(0, "file", "there is no row")


def read_mat(path: Path, options: Options, report: ReadReport) -> Iterator[ParsedTable]:
    """Yield the good rows of a MATLAB file (level 5): its vectors, or those of its only struct."""
    try:
        try:
            size = sum(8 * math.prod(shape) for _, shape, _ in whosmat(path))
            if size > MAX_UNPACKED:
                raise ValueError(f"it unpacks to more than {MAX_UNPACKED >> 20} MiB")
            values = loadmat(path, squeeze_me=True)
        except Exception as error:  # scipy raises many classes on damaged files
            raise ValueError(f"is no readable MATLAB file: {error}") from error
        values = {name: value for name, value in values.items() if not name.startswith("__")}
        only = next(iter(values.values()), None) if len(values) == 1 else None
        if isinstance(only, np.ndarray) and only.dtype.names and only.ndim == 0:
            values = {name: only[name].item() for name in only.dtype.names}
        columns = {name: np.asarray(value) for name, value in values.items() if np.ndim(value)}
        wrong = [
            name for name, one in columns.items() if one.ndim != 1 or one.dtype.kind not in "iufb"
        ]
        lengths = {len(column) for column in columns.values()}
        if wrong or len(lengths) != 1:
            why = f"{wrong[0]} is none" if wrong else f"their lengths are {sorted(lengths)}"
            raise ValueError(
                "is no table of numeric vectors of one length, a variable or a field a column: "
                f"{why}"
            )
        starts = range(0, lengths.pop(), PIECE)
        parts = ([one[at : at + PIECE] for one in columns.values()] for at in starts)
        yield from read_columns(_cells((list(columns), part) for part in parts), options, report)
    except ValueError as error:
        report.mistakes.ruin(0, "file", str(error))


def _cells(
    pieces: Iterator[tuple[list[str], list[Array]]],
) -> Iterator[tuple[list[str], list[Cells]]]:
    """Yield columns of numbers as float64, of all else as text."""
    for labels, columns in pieces:
        yield (
            labels,
            [
                column.astype(np.float64)
                if column.dtype.kind in "iuf"
                else [cell_text(value) for value in column.tolist()]
                for column in columns
            ],
        )


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


def _number_problems(piece: Mapping[str, Any], columns: Columns) -> Iterator[Problem]:
    """Yield wrong uncertainties and incomplete tangents."""
    bounds = piece["uncertainty"]
    for at, output in np.argwhere(np.isinf(bounds) | (bounds < 0.0)).tolist():
        message = (
            f"{bounds[at, output]}: an uncertainty of {columns.displacement[output]} is 0 or more"
        )
        yield at, f"uncertainty[{output}]", message
    count = len(columns.compliance)
    tangents: Array = piece["compliance"].reshape(-1, count)
    broken = ~np.isfinite(tangents).all(axis=1) & ~np.isnan(tangents).all(axis=1)
    for at in np.flatnonzero(broken).tolist():
        message = f"is not {count} finite numbers; a row has all {count} tangents or none (NaN)"
        yield at, "compliance", message


def _text_problems(piece: Mapping[str, Any]) -> Iterator[Problem]:
    for key in TEXTS:
        for at, text in enumerate(piece[key]):
            if problem := text_problem(text):
                yield at, key, problem
