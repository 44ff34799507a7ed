"""Files of typed columns: Parquet, and HDF5 (the store's own, or a dataset a column)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from wrenchbook.service.formats.cells import ContentError
from wrenchbook.service.formats.columns import ARRAYS, Columns, Layout, WritableRows
from wrenchbook.service.formats.header import array_header, with_unit
from wrenchbook.service.formats.options import MAX_ROWS, Array, Options, ParsedTable, ReadReport
from wrenchbook.service.formats.text import PIECE, CellFormat, Piece, read_columns, read_pieces
from wrenchbook.surrogate.table.foreign import foreign_columns
from wrenchbook.surrogate.table.hdf5 import foreign_tables, is_table
from wrenchbook.surrogate.table.rows import unknown_column
from wrenchbook.surrogate.table.space import Input, Output, Space

MAX_UNPACKED = 1024 * 1024 * 1024  # bytes: 10 million rows of 12 numbers


def read_parquet(path: Path, options: Options, report: ReadReport) -> Iterator[ParsedTable]:
    """Yield the good rows of a Parquet file in pieces; mistakes are added to `report`."""
    # Imported on first use, as it takes 0.5 s and 60 MB.
    import pyarrow as arrow
    import pyarrow.parquet as parquet

    with parquet.ParquetFile(path, memory_map=False, pre_buffer=False) as file:
        metadata, schema = file.metadata, file.schema_arrow
        groups = range(metadata.num_row_groups)
    if metadata.num_rows > MAX_ROWS or len(schema) > options.columns.max_count:
        raise ContentError(
            f"it has {metadata.num_rows} rows and {len(schema)} columns; send at most "
            f"{MAX_ROWS:,} rows and {options.columns.max_count} columns"
        )
    require_unpacked(sum(metadata.row_group(at).total_byte_size for at in groups))

    # The index of a pandas data frame is no column of the table.
    index = tuple(name for name in schema.names if name.startswith("__index_level_"))
    options = replace(options, ignore=(*options.ignore, *index))
    texts, labels = [], []
    for field in schema:
        if arrow.types.is_string(field.type) or arrow.types.is_large_string(field.type):
            texts.append(field.name)
        tags = field.metadata or {}
        unit = tags.get(b"unit") or tags.get(b"units") or b""
        labels.append(with_unit(field.name, unit.decode(errors="replace"), options.columns))

    # Equal texts of a batch are in memory once.
    with parquet.ParquetFile(path, read_dictionary=texts, pre_buffer=False) as file:
        batches = file.iter_batches(batch_size=PIECE, use_threads=False)
        pieces = ((labels, list(map(_values, schema.names, batch.columns))) for batch in batches)
        if metadata.num_rows == 0:
            pieces = iter([(labels, [()] * len(labels))])
        yield from read_columns(pieces, options, report)


def write_parquet(
    path: Path, pieces: Iterable[WritableRows], layout: Layout, metadata: Mapping[str, str]
) -> None:
    """Write pieces of a table as row groups of float64 in SI, with metadata of the file."""
    import pyarrow as arrow
    import pyarrow.parquet as parquet

    fields = [
        arrow.field(column.label, arrow.float64(), metadata={"unit": column.unit})
        for column in layout.numbers
    ]
    fields += [arrow.field(name, arrow.string()) for name in layout.texts]
    schema = arrow.schema(fields, metadata={f"wrenchbook:{key}": v for key, v in metadata.items()})
    with parquet.ParquetWriter(path, schema, compression="zstd") as writer:
        for piece in pieces:
            columns = [
                arrow.array(np.ascontiguousarray(column.values(piece)), from_pandas=True)
                for column in layout.numbers
            ]
            columns += [arrow.array(texts, arrow.string()) for texts in layout.text_columns(piece)]
            writer.write_table(arrow.Table.from_arrays(columns, schema=schema))


def require_unpacked(size: int) -> None:
    """Raise ContentError if a file has more than `MAX_UNPACKED` bytes in memory."""
    if size > MAX_UNPACKED:
        raise ContentError(
            f"it unpacks to {size >> 20:,} MiB, over the limit of {MAX_UNPACKED >> 20:,} MiB; send "
            "it in parts"
        )


def _values(name: str, column: Any) -> Array | list[Any]:
    """Return numbers of an Arrow column as an array (n,), NaN for null, or its values."""
    from pyarrow import types

    kind = column.type
    if types.is_dictionary(kind):
        texts = column.dictionary.to_pylist()
        return [None if at is None else texts[at] for at in column.indices.to_pylist()]
    if types.is_nested(kind):
        raise ContentError(
            f"the column {name!r} holds {str(kind)[:100]}; write each of its parts as a column of "
            "its own"
        )
    if types.is_floating(kind) or types.is_integer(kind):
        return column.to_numpy(zero_copy_only=False)
    return column.to_pylist()


def read_hdf5(path: Path, options: Options, report: ReadReport) -> Iterator[ParsedTable]:
    """Yield the good rows of an HDF5 file in pieces; mistakes are added to `report`."""
    columns = options.columns
    try:
        if not is_table(path):
            yield from read_columns(foreign_columns(path), options, report)
            return
        header = array_header(columns)
        pieces = _stored_pieces(path, columns)
        yield from read_pieces(header, pieces, options, report, CellFormat())
    except (ValueError, RuntimeError, OSError) as error:
        report.mistakes.ruin(0, "file", str(error))


def _stored_pieces(path: Path, columns: Columns) -> Iterator[Piece]:
    """Yield the rows of the store's own tables in the order of `array_header`."""
    read = 0
    for rows, notes in foreign_tables(path):
        if rows.space != columns.space:
            raise ContentError(_space_problem(rows.space, columns.space))
        n = len(rows)
        cells = []
        for key in ARRAYS:
            block = getattr(rows, key)
            width = len(getattr(columns, key))
            cells += [*(block.reshape(n, width) if block.size else unknown_column(n, width)).T]
        cells += [rows.source.tolist(), notes, rows.fingerprint.tolist()]
        yield Piece(range(read + 1, read + n + 1), cells, n)
        read += n


def _space_problem(sent: Space, needed: Space) -> str:
    """Return the first difference of a file's inputs and outputs from the component's."""
    pairs = zip_longest((*sent.inputs, *sent.outputs), (*needed.inputs, *needed.outputs))
    differing = [pair for pair in pairs if pair[0] != pair[1]]
    sent_item, needed_item = differing[0] if differing else (None, None)
    has, needs = _described(sent_item, needed_item), _described(needed_item, sent_item)
    return (
        f"is of another component: it has {has} where this one has {needs}; export the rows as CSV "
        "and name the columns for this component"
    )


def _described(item: Input | Output | None, other: Input | Output | None) -> str:
    """Return an input or output by name and unit, with its reference if these differ."""
    if item is None:
        return "none"
    text = f"{item.name} [{item.unit}]"
    zero = getattr(item, "zero", 0.0)
    return text if zero == getattr(other, "zero", 0.0) else f"{text} with the reference {zero:g}"
