"""Parquet files as records of text: columns of numbers and words, as data frames are saved."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from service.formats.mistakes import RowError
from service.formats.options import MOST_ROWS, Options, Told
from service.formats.parsed import ParsedTable
from service.formats.sheet import MOST_COLUMNS, Mark, Record, tables

MOST_UNPACKED = 1024 * 1024 * 1024
MOST_TEXT = 131_072  # characters of one text: as the csv module
BATCH = 8192  # rows as Arrow holds them at once


class ParquetBoundsError(ValueError):
    """The file is larger than may be read, or holds what no table does."""


def parquet_file(path: Path, options: Options, told: Told) -> Iterator[ParsedTable]:
    """Yield the good rows of a Parquet file piece by piece; `told` gets what is wrong.

    `RowError.row` is the place of a row in the file, from 1; the header's is 0.
    """
    # Imported when it is needed: 0.5 s and 60 MB that a server without Parquet never spends.
    import pyarrow.parquet as parquet

    try:
        with parquet.ParquetFile(path, memory_map=False, pre_buffer=False) as file:
            names = _checked(file)
            index = tuple(name for name in names if name.startswith("__index_level_"))
            said = replace(options, ignore=(*options.ignore, *index))  # a data frame's own
            yield from tables(_records(path, file, names), said, told, Mark())
    except Exception as error:  # pyarrow's own, and whatever its buffers meet
        told.mistakes.ruin(RowError(0, "file", f"is no readable Parquet file: {error}"))


def _checked(file: Any) -> list[str]:
    """Return the names of the columns of a file that is not too large."""
    about, schema = file.metadata, file.schema_arrow
    if about.num_rows > MOST_ROWS or len(schema) > MOST_COLUMNS:
        raise ParquetBoundsError(
            f"it has {about.num_rows} rows and {len(schema)} columns; send at most {MOST_ROWS:,} "
            f"and {MOST_COLUMNS}"
        )
    size = sum(about.row_group(at).total_byte_size for at in range(about.num_row_groups))
    if size > MOST_UNPACKED:
        raise ParquetBoundsError(f"it unpacks to more than {MOST_UNPACKED >> 20} MiB")
    return schema.names


def _records(path: Path, file: Any, names: list[str]) -> Iterator[Record]:
    """Yield the header, then each row with its place."""
    yield 0, [_label(field) for field in file.schema_arrow]
    place = 0
    for batch in _batches(path, file):
        for cells in zip(*map(_texts, batch.columns), strict=True):
            place += 1
            yield place, list(cells)


def _batches(path: Path, file: Any) -> Iterator[Any]:
    """Yield the rows of a file some at a time; equal words are held once."""
    import pyarrow as arrow
    import pyarrow.parquet as parquet

    words = [
        field.name
        for field in file.schema_arrow
        if arrow.types.is_string(field.type) or arrow.types.is_large_string(field.type)
    ]
    with parquet.ParquetFile(path, read_dictionary=words, pre_buffer=False) as reader:
        yield from reader.iter_batches(batch_size=BATCH, use_threads=False)


def _label(field: Any) -> str:
    """Return a column's label, with the unit that its own metadata names."""
    about = field.metadata or {}
    unit = about.get(b"unit") or about.get(b"units") or b""
    named = unit and "[" not in field.name and "(" not in field.name
    return f"{field.name} [{unit.decode(errors='replace')}]" if named else field.name


def _texts(column: Any) -> list[str]:
    """Return the cells of a column as text; empty where there is none."""
    import pyarrow as arrow

    if arrow.types.is_nested(column.type) and not arrow.types.is_dictionary(column.type):
        raise ParquetBoundsError(f"a column holds {column.type}; a table's hold numbers and texts")
    if arrow.types.is_dictionary(column.type):
        words = [_text(word) for word in column.dictionary.to_pylist()]
        return ["" if at is None else words[at] for at in column.indices.to_pylist()]
    return [_text(value) for value in column.to_pylist()]


def _text(value: Any) -> str:
    if value is None or value != value:
        return ""
    if isinstance(value, float):
        return repr(value)
    text = value.isoformat() if hasattr(value, "isoformat") else str(value)
    if len(text) > MOST_TEXT:
        raise ParquetBoundsError(f"a text is longer than {MOST_TEXT:,} characters")
    return text
