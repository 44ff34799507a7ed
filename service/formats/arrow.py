"""Parquet tables, as data frames are saved. The unit of a column is in its label or metadata."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from wrenchbook.service.formats.cells import Digits
from wrenchbook.service.formats.columns import Layout, WritableRows
from wrenchbook.service.formats.options import MAX_ROWS, Options, ReadReport
from wrenchbook.service.formats.rows import ParsedTable
from wrenchbook.service.formats.text import PIECE, Cells, read_columns

MAX_UNPACKED = 1024 * 1024 * 1024
MAX_TEXT = 131_072  # characters of one text: as the csv module


class ParquetBoundsError(ValueError):
    """The file exceeds a limit, or has columns that no table has."""


def read_parquet(path: Path, options: Options, report: ReadReport) -> Iterator[ParsedTable]:
    """Yield the good rows of a Parquet file piece by piece; `report` gets the mistakes."""
    # Imported on first use: 0.5 s and 60 MB.
    import pyarrow as arrow
    import pyarrow.parquet as parquet

    try:
        with parquet.ParquetFile(path, memory_map=False, pre_buffer=False) as file:
            metadata, schema = file.metadata, file.schema_arrow
            groups = range(metadata.num_row_groups)
        if metadata.num_rows > MAX_ROWS or len(schema) > options.columns.most:
            raise ParquetBoundsError(
                f"it has {metadata.num_rows} rows and {len(schema)} columns; send at most "
                f"{MAX_ROWS:,} and {options.columns.most}"
            )
        if sum(metadata.row_group(at).total_byte_size for at in groups) > MAX_UNPACKED:
            raise ParquetBoundsError(f"it unpacks to more than {MAX_UNPACKED >> 20} MiB")
        index = tuple(name for name in schema.names if name.startswith("__index_level_"))
        ignore = (*options.ignore, *index)  # of a data frame
        strings = arrow.types.is_string, arrow.types.is_large_string
        texts = [field.name for field in schema if any(is_(field.type) for is_ in strings)]
        labels = [_label(field) for field in schema]
        # Equal texts of a batch are in memory once.
        with parquet.ParquetFile(path, read_dictionary=texts, pre_buffer=False) as file:
            batches = file.iter_batches(batch_size=PIECE, use_threads=False)
            pieces = ((labels, [_cells(column) for column in batch.columns]) for batch in batches)
            own = replace(options, ignore=ignore)
            if metadata.num_rows == 0:
                pieces = iter([(labels, [()] * len(labels))])
            yield from read_columns(pieces, own, report)
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


def _label(field: Any) -> str:
    """Return the label of a column, with the unit of its metadata."""
    about = field.metadata or {}
    unit = about.get(b"unit") or about.get(b"units") or b""
    named = unit and "[" not in field.name and "(" not in field.name
    return f"{field.name} [{unit.decode(errors='replace')}]" if named else field.name


def _cells(column: Any) -> Cells:
    """Return numbers as float64, NaN for null; other cells as text, empty for null."""
    from pyarrow import types

    kind = column.type
    if types.is_dictionary(kind):
        words = [cell_text(word) for word in column.dictionary.to_pylist()]
        return ["" if at is None else words[at] for at in column.indices.to_pylist()]
    if types.is_nested(kind):
        raise ParquetBoundsError(f"a column holds {kind}; a table's hold numbers and texts")
    if types.is_floating(kind) or types.is_integer(kind):
        return column.to_numpy(zero_copy_only=False).astype(np.float64)
    return [cell_text(value) for value in column.to_pylist()]


def cell_text(value: Any) -> str:
    """Return a stored value as the text of a cell, empty for none."""
    if value is None or value != value:
        return ""
    if isinstance(value, Decimal):
        return Digits(value)
    text = value.isoformat() if hasattr(value, "isoformat") else str(value)
    if len(text) > MAX_TEXT:
        raise ParquetBoundsError(f"a text is longer than {MAX_TEXT:,} characters")
    return text
