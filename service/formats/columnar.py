"""Files of typed columns: Parquet, HDF5 (the store's own, or a dataset a column), MATLAB, TDMS."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat, whosmat

from wrenchbook.service.formats.cells import ContentError
from wrenchbook.service.formats.columns import ARRAYS, Columns, Layout, WritableRows
from wrenchbook.service.formats.header import array_header, named_columns, readings_of, with_unit
from wrenchbook.service.formats.options import MAX_ROWS, Array, Options, ParsedTable, ReadReport
from wrenchbook.service.formats.text import PIECE, CellFormat, Piece, read_columns, read_pieces
from wrenchbook.service.formats.xlsx import chosen_sheet
from wrenchbook.surrogate.table.hdf5 import foreign_columns, foreign_tables, is_table, matlab_object
from wrenchbook.surrogate.table.rows import unknown_column

MAX_UNPACKED = 1024 * 1024 * 1024


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
            raise ContentError(
                f"it has {metadata.num_rows} rows and {len(schema)} columns; send at most "
                f"{MAX_ROWS:,} rows and {options.columns.most} columns"
            )
        if sum(metadata.row_group(at).total_byte_size for at in groups) > MAX_UNPACKED:
            raise ContentError(f"it unpacks to over {MAX_UNPACKED >> 20} MiB; send parts")
        index = tuple(name for name in schema.names if name.startswith("__index_level_"))
        ignore = (*options.ignore, *index)  # of a data frame
        strings = arrow.types.is_string, arrow.types.is_large_string
        texts = [field.name for field in schema if any(is_(field.type) for is_ in strings)]
        labels = []
        for field in schema:  # its unit may stand in the metadata
            tags = field.metadata or {}
            unit = tags.get(b"unit") or tags.get(b"units") or b""
            labels.append(with_unit(field.name, unit.decode(errors="replace"), options.columns))
        # Equal texts of a batch are in memory once.
        with parquet.ParquetFile(path, read_dictionary=texts, pre_buffer=False) as file:
            batches = file.iter_batches(batch_size=PIECE, use_threads=False)
            pieces = ((labels, [_values(column) for column in batch.columns]) for batch in batches)
            options = replace(options, ignore=ignore)
            if metadata.num_rows == 0:
                pieces = iter([(labels, [()] * len(labels))])
            yield from read_columns(pieces, options, report)
    except ContentError as error:
        report.mistakes.ruin(0, "file", str(error))
    except Exception as error:  # pyarrow raises many classes on damaged files
        report.mistakes.ruin(0, "file", f"cannot be read as Parquet ({error}); write it again")


def write_parquet(
    path: Path, pieces: Iterable[WritableRows], layout: Layout, metadata: Mapping[str, str]
) -> None:
    """Write pieces of a table as row groups of float64 in SI; with metadata of the file."""
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


def _values(column: Any) -> Array | list[Any]:
    """Return numbers of an Arrow column as an array, NaN for null, or its values."""
    from pyarrow import types

    kind = column.type
    if types.is_dictionary(kind):
        texts = column.dictionary.to_pylist()
        return [None if at is None else texts[at] for at in column.indices.to_pylist()]
    if types.is_nested(kind):
        raise ContentError(f"a column holds {kind}; write each of its parts as a column of its own")
    if types.is_floating(kind) or types.is_integer(kind):
        return column.to_numpy(zero_copy_only=False)
    return column.to_pylist()


def read_hdf5(path: Path, options: Options, report: ReadReport) -> Iterator[ParsedTable]:
    """Yield the good rows of an HDF5 file piece by piece; `report` gets the mistakes."""
    columns = options.columns
    try:
        if not is_table(path):
            yield from read_columns(foreign_columns(path), options, report)
            return
        header, pieces = array_header(columns), _stored_pieces(path, columns)
        yield from read_pieces(header, pieces, options, report, CellFormat())
    except (ValueError, RuntimeError, OSError) as error:
        report.mistakes.ruin(0, "file", str(error))


def _stored_pieces(path: Path, columns: Columns) -> Iterator[Piece]:
    """Yield the rows of the store's own tables in the order of `array_header`."""
    read = 0
    for rows, notes in foreign_tables(path):
        if rows.space != columns.space:
            names = ", ".join((*columns.wrench, *columns.displacement))
            raise ContentError(f"has inputs, outputs or units of another component; write {names}")
        n, cells = len(rows), []
        for key in ARRAYS:
            block, width = getattr(rows, key), len(getattr(columns, key))
            cells += [*(block.reshape(n, width) if block.size else unknown_column(n, width)).T]
        yield Piece(
            range(read + 1, read + n + 1),
            [*cells, rows.source.tolist(), notes, rows.fingerprint.tolist()],
            n,
        )
        read += n


def read_mat(path: Path, options: Options, report: ReadReport) -> Iterator[ParsedTable]:
    """Yield the good rows of a MATLAB file (level 5): its vectors, or its only struct's."""
    try:
        columns = _vectors(_mat_variables(path))
        starts = range(0, len(next(iter(columns.values()))), PIECE)
        parts = ([column[at : at + PIECE] for column in columns.values()] for at in starts)
        yield from read_columns(((list(columns), part) for part in parts), options, report)
    except ValueError as error:
        report.mistakes.ruin(0, "file", str(error))


def _mat_variables(path: Path) -> dict[str, Any]:
    """Return the variables of a MATLAB file by name; ContentError if it cannot be read."""
    try:
        try:
            size = sum(8 * math.prod(shape) for _, shape, _ in whosmat(path))
        except TypeError:  # an object of MATLAB has no shape and no name
            name, _, kind, _ = loadmat(path, variable_names=["None"])["None"].item()
            raise ContentError(matlab_object(name.decode(), kind.decode())) from None
        if size > MAX_UNPACKED:
            raise ContentError(f"it unpacks to over {MAX_UNPACKED >> 20} MiB; send parts")
        values = loadmat(path, squeeze_me=True)
    except ContentError:
        raise
    except Exception as error:  # scipy raises many classes on damaged files
        raise ContentError(f"cannot be read as a MATLAB file: {error}") from error
    return {name: value for name, value in values.items() if not name.startswith("__")}


def _vectors(values: dict[str, Any]) -> dict[str, Array]:
    """Return variables, or a single struct's fields, as vectors of one length; ContentError."""
    only = next(iter(values.values()), None) if len(values) == 1 else None
    if isinstance(only, np.ndarray) and only.dtype.names:
        values = {name: only[name].tolist() for name in only.dtype.names}
        for name, column in values.items() if only.ndim else ():  # an array of records
            several = any(np.size(value) > 1 for value in column)
            numbers = [value if np.size(value) else np.nan for value in column]
            values[name] = np.array(numbers, dtype=object if several else None)
    columns = {name: np.asarray(value) for name, value in values.items() if np.ndim(value)}
    if not columns:  # a single row, or none
        scalars = {n: v for n, v in values.items() if isinstance(v, int | float)}
        columns = {name: np.array([value]) for name, value in scalars.items()}
    wrong = [name for name, c in columns.items() if c.ndim != 1 or c.dtype.kind not in "iufb"]
    lengths = {len(column) for column in columns.values()}
    if wrong or len(lengths) != 1:
        each = "save each column as a variable of its own, such as fx_N = A(:, 1)"
        no_vector = f"{wrong[0]} is not a numeric vector; {each}" if wrong else ""
        listed = ", ".join(f"{name} {len(column)}" for name, column in list(columns.items())[:9])
        why = no_vector or f"their lengths are {listed or 'unknown'}"
        form = "needs numeric vectors of one length, one a column"
        raise ContentError(f"{form}: {why}")
    return columns


def read_tdms(path: Path, options: Options, report: ReadReport) -> Iterator[ParsedTable]:
    """Yield the good rows of a TDMS file: of the sheet's group, or the first with most columns.

    The channels are columns in the unit of ``unit_string``; waveforms have a time.
    """
    # Imported on first use, and of the extra `rig`.
    from nptdms import TdmsFile

    try:
        with TdmsFile.open(path) as file:
            groups = {g.name: [c for c in g.channels() if len(c)] for g in file.groups()}
            scores = {
                name: named_columns([c.name for c in group], options.columns, options.mapping)
                for name, group in groups.items()
                if group
            }
            most = {name for name, score in scores.items() if score == max(scores.values())}
            sheet = chosen_sheet(list(scores), options.sheet, most.__contains__, report)
            report.ignored += [c.name for c in file[sheet].channels() if not len(c)]
            yield from read_columns(_tdms_pieces(groups[sheet], options), options, report)
    except ContentError as error:
        report.mistakes.ruin(0, "file", str(error))
    except Exception as error:  # nptdms raises many classes on damaged files
        report.mistakes.ruin(0, "file", f"cannot be read as TDMS: {error}")


def _tdms_pieces(
    channels: Sequence[Any], options: Options
) -> Iterator[tuple[list[str], list[np.ndarray]]]:
    """Yield labels and channels, some rows at a time, with a time if only waveforms have one."""
    lengths, columns = {len(channel) for channel in channels}, options.columns
    if len(lengths) != 1 or len(channels) > columns.most:
        sizes = ", ".join(f"{c.name}: {len(c)}" for c in channels[:8])
        message = f"it must have at most {columns.most} channels of one length, not {sizes}"
        raise ContentError(f"{message}; resample them to one length")
    labels = [with_unit(c.name, c.properties.get("unit_string", ""), columns) for c in channels]
    times = {
        tuple(c.properties.get(f"wf_{key}") for key in ("start_time", "start_offset", "increment"))
        for c in channels
        if c.properties.get("wf_increment")
    }
    if len(times) > 1:
        raise ContentError(
            "the channels' waveforms have different times; resample them to one time"
        )
    names = [name for label in labels for name, _, _ in readings_of(label, columns)]
    named = any(name.startswith("time") for name in (*names, *options.mapping.values()))
    _, start, step = next(iter(times), (None, None, 0.0))
    labels += ["time [s]"] if times and not named else []
    for at in range(0, lengths.pop(), PIECE):
        piece = [channel[at : at + PIECE] for channel in channels]
        piece += [(start or 0.0) + step * np.arange(at, at + len(piece[0]))]
        yield labels, piece[: len(labels)]
