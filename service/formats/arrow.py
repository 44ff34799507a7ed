"""Tables in binary formats: Parquet, as data frames are saved, HDF5, and MATLAB's.

HDF5 is the table store's own, or has a dataset a column; MATLAB's files have a variable a column.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat, whosmat

from wrenchbook.service.formats.cells import Digits, text_problem
from wrenchbook.service.formats.columns import Columns, Layout, WritableRows
from wrenchbook.service.formats.options import MOST_ROWS, Options, ReadReport
from wrenchbook.service.formats.preamble import Record
from wrenchbook.service.formats.rows import Array, ParsedTable, Problem, good_rows
from wrenchbook.service.formats.text import read_records
from wrenchbook.surrogate.table.hdf5 import foreign_columns, foreign_tables, is_table, write_table
from wrenchbook.surrogate.table.meta import TableMeta
from wrenchbook.surrogate.table.rows import Rows

MOST_UNPACKED = 1024 * 1024 * 1024
MOST_TEXT = 131_072  # characters of one text: as the csv module
BATCH = 8192  # rows in memory of Arrow at once


class ParquetBoundsError(ValueError):
    """The file exceeds a limit, or has columns that no table has."""


def read_parquet(path: Path, options: Options, report: ReadReport) -> Iterator[ParsedTable]:
    """Yield the good rows of a Parquet file piece by piece; `report` gets the mistakes."""
    # Imported on first use: 0.5 s and 60 MB.
    import pyarrow.parquet as parquet

    try:
        with parquet.ParquetFile(path, memory_map=False, pre_buffer=False) as file:
            names = _checked_names(file, options.columns.most)
            index = tuple(name for name in names if name.startswith("__index_level_"))
            own = replace(options, ignore=(*options.ignore, *index))  # of a data frame
            records = _records(path, file)
            yield from read_records(records, own, report)
    except Exception as error:  # pyarrow raises many classes on damaged files
        report.mistakes.ruin(0, "file", f"is no readable Parquet file: {error}")


def write_parquet(
    path: Path, pieces: Iterable[WritableRows], layout: Layout, about: Mapping[str, str]
) -> None:
    """Write pieces of a table as row groups of float64 in SI; `about` becomes the metadata.

    The unit of each column is in its name and in its metadata.
    """
    import pyarrow as arrow
    import pyarrow.parquet as parquet

    fields = [
        arrow.field(column.label, arrow.float64(), metadata={"unit": column.unit})
        for column in layout.numbers
    ]
    fields += [arrow.field(name, arrow.string()) for name in layout.texts]
    schema = arrow.schema(fields, metadata={f"wrenchbook:{key}": v for key, v in about.items()})
    with parquet.ParquetWriter(path, schema, compression="zstd") as writer:
        for piece in pieces:
            columns = [
                arrow.array(np.ascontiguousarray(column.values(piece)), from_pandas=True)
                for column in layout.numbers
            ]
            columns += [arrow.array(words, arrow.string()) for words in layout.words(piece)]
            writer.write_table(arrow.Table.from_arrays(columns, schema=schema))


def _checked_names(file: Any, most: int) -> list[str]:
    """Return the names of the columns; raises ParquetBoundsError."""
    about, schema = file.metadata, file.schema_arrow
    if about.num_rows > MOST_ROWS or len(schema) > most:
        raise ParquetBoundsError(
            f"it has {about.num_rows} rows and {len(schema)} columns; send at most {MOST_ROWS:,} "
            f"and {most}"
        )
    size = sum(about.row_group(at).total_byte_size for at in range(about.num_row_groups))
    if size > MOST_UNPACKED:
        raise ParquetBoundsError(f"it unpacks to more than {MOST_UNPACKED >> 20} MiB")
    return schema.names


def _records(path: Path, file: Any) -> Iterator[Record]:
    """Yield the header as record 0, then the rows; equal texts of a batch are in memory once."""
    import pyarrow as arrow
    import pyarrow.parquet as parquet

    schema = file.schema_arrow
    yield 0, [_label(field) for field in schema]
    texts = [
        field.name
        for field in schema
        if arrow.types.is_string(field.type) or arrow.types.is_large_string(field.type)
    ]
    row = 0
    with parquet.ParquetFile(path, read_dictionary=texts, pre_buffer=False) as reader:
        for batch in reader.iter_batches(batch_size=BATCH, use_threads=False):
            for cells in zip(*map(_cells, batch.columns), strict=True):
                row += 1
                yield row, list(cells)


def _label(field: Any) -> str:
    """Return the label of a column, with the unit of its metadata."""
    about = field.metadata or {}
    unit = about.get(b"unit") or about.get(b"units") or b""
    named = unit and "[" not in field.name and "(" not in field.name
    return f"{field.name} [{unit.decode(errors='replace')}]" if named else field.name


def _cells(column: Any) -> list[str]:
    """Return the cells of a column as text, empty for null."""
    import pyarrow as arrow

    if arrow.types.is_nested(column.type) and not arrow.types.is_dictionary(column.type):
        raise ParquetBoundsError(f"a column holds {column.type}; a table's hold numbers and texts")
    if arrow.types.is_dictionary(column.type):
        words = [_cell(word) for word in column.dictionary.to_pylist()]
        return ["" if at is None else words[at] for at in column.indices.to_pylist()]
    return [_cell(value) for value in column.to_pylist()]


def _cell(value: Any) -> str:
    if value is None or value != value:
        return ""
    if isinstance(value, float | int | Decimal):
        return Digits(value)
    text = value.isoformat() if hasattr(value, "isoformat") else str(value)
    if len(text) > MOST_TEXT:
        raise ParquetBoundsError(f"a text is longer than {MOST_TEXT:,} characters")
    return text


def read_hdf5(path: Path, options: Options, report: ReadReport) -> Iterator[ParsedTable]:
    """Yield the good rows of an HDF5 file piece by piece; `report` gets the mistakes."""
    columns = options.columns
    if not is_table(path):
        yield from _read_columns(foreign_columns(path), options, report)
        return
    try:
        for rows, notes in foreign_tables(path):
            if rows.space != columns.space:
                names = ", ".join((*columns.wrench, *columns.displacement))
                message = f"is a table of another component's inputs, outputs or units, not {names}"
                report.mistakes.ruin(0, "file", message)
                return
            piece = ParsedTable(
                wrench=rows.wrench,
                displacement=rows.displacement,
                uncertainty=rows.uncertainty,
                compliance=rows.compliance,
                source=tuple(str(text).strip() for text in rows.source),
                note=tuple(note.strip() for note in notes),
                fingerprint=tuple(str(text).strip() for text in rows.fingerprint),
                row=np.arange(1, len(rows) + 1) + report.read,
                curvature=rows.curvature,
            )
            good = np.ones(len(piece), dtype=bool)
            for at, key, message in (*_number_problems(piece, columns), *_text_problems(piece)):
                good[at] = False
                report.mistakes.add(int(piece.row[at]), key, message)
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
    """Yield the good rows of a MATLAB file (level 5); `report` gets the mistakes."""
    yield from _read_columns(_mat_columns(path), options, report)


def _read_columns(
    pieces: Iterator[tuple[list[str], list[Array]]], options: Options, report: ReadReport
) -> Iterator[ParsedTable]:
    """Yield the good rows of columns with labels."""
    try:
        records = _column_records(pieces, options.columns.most)
        yield from read_records(records, options, report)
    except (ValueError, OSError) as error:
        report.mistakes.ruin(0, "file", str(error))


def _column_records(pieces: Iterator[tuple[list[str], list[Array]]], most: int) -> Iterator[Record]:
    """Yield the header as record 0, then the rows."""
    row = 0
    for names, columns in pieces:
        if not row:
            if len(names) > most:
                raise ValueError(f"has {len(names)} columns; a table has at most {most}")
            yield 0, names
        for cells in zip(*(column.tolist() for column in columns), strict=True):
            row += 1
            if row > MOST_ROWS:
                raise ValueError(f"has more than {MOST_ROWS:,} rows; send it in parts")
            yield row, [_cell(cell) for cell in cells]


def _mat_columns(path: Path) -> Iterator[tuple[list[str], list[Array]]]:
    """Yield the labels and columns of a MATLAB file: its vectors, or those of its only struct.

    Raises
    ------
    ValueError
        If the file is damaged or has no vectors of one length.
    """
    try:
        size = sum(8 * math.prod(shape) for _, shape, _ in whosmat(path))
        if size > MOST_UNPACKED:
            raise ValueError(f"it unpacks to more than {MOST_UNPACKED >> 20} MiB")
        found = loadmat(path, squeeze_me=True)
    except Exception as error:  # scipy raises many classes on damaged files
        raise ValueError(f"is no readable MATLAB file: {error}") from error
    found = {name: one for name, one in found.items() if not name.startswith("__")}
    only = next(iter(found.values()), None) if len(found) == 1 else None
    if isinstance(only, np.ndarray) and only.dtype.names and only.ndim == 0:
        found = {name: only[name].item() for name in only.dtype.names}
    columns = {name: np.asarray(one) for name, one in found.items() if np.ndim(one)}
    wrong = [name for name, one in columns.items() if one.ndim != 1 or one.dtype.kind not in "iufb"]
    lengths = {len(one) for one in columns.values()}
    if wrong or len(lengths) != 1:
        why = f"{wrong[0]} is none" if wrong else f"their lengths are {sorted(lengths)}"
        raise ValueError(
            f"is no table of numeric vectors of one length, a variable or a field a column: {why}"
        )
    yield list(columns), list(columns.values())


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


def _number_problems(piece: ParsedTable, columns: Columns) -> Iterator[Problem]:
    """Yield wrong uncertainties and incomplete tangents."""
    bounds = piece.uncertainty
    for at, output in np.argwhere(np.isinf(bounds) | (bounds < 0.0)).tolist():
        message = (
            f"{bounds[at, output]}: an uncertainty of {columns.displacement[output]} is 0 or more"
        )
        yield at, f"uncertainty[{output}]", message
    count = len(columns.compliance)
    tangents: Array = piece.compliance.reshape(-1, count)
    broken = ~np.isfinite(tangents).all(axis=1) & ~np.isnan(tangents).all(axis=1)
    for at in np.flatnonzero(broken).tolist():
        message = f"is not {count} finite numbers; a row has all {count} tangents or none (NaN)"
        yield at, "compliance", message


def _text_problems(piece: ParsedTable) -> Iterator[Problem]:
    columns = {"source": piece.source, "fingerprint": piece.fingerprint, "note": piece.note}
    for key, texts in columns.items():
        for at, text in enumerate(texts):
            if problem := text_problem(text):
                yield at, key, problem
