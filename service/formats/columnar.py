"""Files of typed columns: Parquet, HDF5 (the store's own, or a dataset a column), MATLAB, TDMS."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import zip_longest
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
from wrenchbook.surrogate.table.space import Space

MAX_UNPACKED = 1024 * 1024 * 1024  # bytes: 10 million rows of 12 numbers
TDMS_HEAD_BYTES = 28  # of a segment: tag, flags, version, and two lengths
TDMS_BIG_ENDIAN = 1 << 6  # the flag of segments whose numbers begin with the highest byte
_MAX_NAMED = 8  # variables or channels in a message: more would hide its remedy


def read_parquet(path: Path, options: Options, report: ReadReport) -> Iterator[ParsedTable]:
    """Yield the good rows of a Parquet file in pieces; mistakes are added to `report`."""
    # Imported on first use, as it takes 0.5 s and 60 MB.
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
        _check_unpacked(sum(metadata.row_group(at).total_byte_size for at in groups))
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
            pieces = (
                (labels, list(map(_values, schema.names, batch.columns))) for batch in batches
            )
            if metadata.num_rows == 0:
                pieces = iter([(labels, [()] * len(labels))])
            yield from read_columns(pieces, options, report)
    except ContentError as error:
        report.mistakes.ruin(0, "file", str(error))
    except Exception as error:  # pyarrow raises many classes for damaged files
        report.mistakes.ruin(0, "file", f"cannot be read as Parquet ({error}); write it again")


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


def _check_unpacked(size: int) -> None:
    """Refuse a file of more than `MAX_UNPACKED` bytes in memory.

    Raises ContentError if it is larger.
    """
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
    has = f"{sent_item.name} [{sent_item.unit}]" if sent_item else "none"
    needs = f"{needed_item.name} [{needed_item.unit}]" if needed_item else "none"
    return (
        f"is of another component: it has {has} where this one has {needs}; export the rows as CSV "
        "and name the columns for this component"
    )


def read_mat(path: Path, options: Options, report: ReadReport) -> Iterator[ParsedTable]:
    """Yield the good rows of a MATLAB file (level 5): its vectors, or its only struct's."""
    try:
        columns = _vectors(_mat_variables(path))
        starts = range(0, len(next(iter(columns.values()))) or 1, PIECE)
        parts = ([column[at : at + PIECE] for column in columns.values()] for at in starts)
        yield from read_columns(((list(columns), part) for part in parts), options, report)
    except ValueError as error:
        report.mistakes.ruin(0, "file", str(error))


def _mat_variables(path: Path) -> dict[str, Any]:
    """Return the variables of a MATLAB file by name.

    Raises ContentError if it cannot be read.
    """
    try:
        try:
            size = sum(8 * math.prod(shape) for _, shape, _ in whosmat(path))
        except TypeError:  # an object of MATLAB has no shape and no name
            name, _, kind, _ = loadmat(path, variable_names=["None"])["None"].item()
            raise ContentError(matlab_object(name.decode(), kind.decode())) from None
        _check_unpacked(size)
        values = loadmat(path, squeeze_me=True, mat_dtype=True)  # logical as bool: no number
    except ContentError:
        raise
    except Exception as error:  # scipy raises many classes for damaged files
        raise ContentError(
            f"cannot be read as a MATLAB file: {error}; save it again with save('t.mat', '-v7')"
        ) from error
    return {name: value for name, value in values.items() if not name.startswith("__")}


def _vectors(values: dict[str, Any]) -> dict[str, Array]:
    """Return variables, or a single struct's fields, as vectors of one length.

    Raises ContentError if they are no such vectors.
    """
    struct = next(iter(values.values()), None) if len(values) == 1 else None
    if isinstance(struct, np.ndarray) and struct.dtype.names:
        values = {name: struct[name].tolist() for name in struct.dtype.names}
        if struct.ndim:  # an array of records
            values = {name: _record_values(column) for name, column in values.items()}
    columns = {name: np.asarray(value) for name, value in values.items() if np.ndim(value)}
    if not columns:  # a single row, or none
        scalars = {n: v for n, v in values.items() if isinstance(v, int | float)}
        columns = {name: np.array([value]) for name, value in scalars.items()}
    form = "must hold numeric vectors of one length, one for each column"
    each = "save each column as a variable of its own, such as fx_N = A(:, 1)"
    if not columns:
        raise ContentError(f"{form}, but has no numbers; {each}")
    for name, column in columns.items():
        if column.ndim != 1 or column.dtype.kind not in "iufb":
            kind = f"shape {column.shape}, type {column.dtype}"
            raise ContentError(f"{form}, but {name} is not one ({kind}); {each}")
    if len({len(column) for column in columns.values()}) > 1:
        lengths = ", ".join([f"{n} {len(c)}" for n, c in columns.items()][:_MAX_NAMED])
        only = "save only those of the table: save('t.mat', 'fx_N', 'ux_mm')"
        raise ContentError(f"{form}, but their lengths are {lengths}; {only}")
    return columns


def _record_values(column: Sequence[Any]) -> Array:
    """Return a field of an array of records, (n,): NaN where a record has none."""
    several = any(np.size(value) > 1 for value in column)
    numbers = [value if np.size(value) else np.nan for value in column]
    return np.array(numbers, dtype=object if several else None)


def _require_whole_segments(path: Path) -> None:
    """Raise ContentError if a TDMS file ends within a segment, whose rows nptdms drops in silence.

    Each segment begins with "TDSm", flags, version and the number of bytes behind this head (NI,
    "TDMS File Format Internal Structure"). A program that stopped leaves the number as -1.
    """
    size = path.stat().st_size
    start = 0
    with path.open("rb") as file:
        while start < size:
            file.seek(start)
            head = file.read(TDMS_HEAD_BYTES)
            if len(head) == TDMS_HEAD_BYTES and head[:4] == b"TDSm":
                (flags,) = struct.unpack("<I", head[4:8])
                order = ">" if flags & TDMS_BIG_ENDIAN else "<"
                (length,) = struct.unpack(f"{order}Q", head[12:20])
                start += TDMS_HEAD_BYTES + length
            else:
                start = size + 1
    if start > size:
        raise ContentError(
            "ends within a segment, because its writing or copying was cut off; copy it again, or "
            "export the complete rows as CSV"
        )


def read_tdms(path: Path, options: Options, report: ReadReport) -> Iterator[ParsedTable]:
    """Yield the good rows of a TDMS file: of the sheet's group, or the first with most columns.

    The channels are columns in the unit of ``unit_string``; waveforms have a time.
    """
    # Imported on first use, from the extra `rig`.
    from nptdms import TdmsFile

    try:
        _require_whole_segments(path)
        with TdmsFile.open(path) as file:
            groups = {g.name: [c for c in g.channels() if len(c)] for g in file.groups()}
            scores = {
                name: named_columns([c.name for c in group], options.columns, options.mapping)
                for name, group in groups.items()
                if group
            }
            best = {name for name, score in scores.items() if score == max(scores.values())}
            sheet = chosen_sheet(list(scores), options.sheet, best.__contains__, report)
            report.ignored += [c.name for c in file[sheet].channels() if not len(c)]
            yield from read_columns(_tdms_pieces(groups[sheet], options), options, report)
    except ContentError as error:
        report.mistakes.ruin(0, "file", str(error))
    except Exception as error:  # nptdms raises many classes for damaged files
        message = f"cannot be read as TDMS: {error}; export it again, or as CSV"
        report.mistakes.ruin(0, "file", message)


def _tdms_pieces(
    channels: Sequence[Any], options: Options
) -> Iterator[tuple[list[str], list[np.ndarray]]]:
    """Yield labels and channels, some rows at a time; with a time if all channels are waveforms."""
    lengths = {len(channel) for channel in channels}
    columns = options.columns
    if len(channels) > columns.most:
        raise ContentError(
            f"its group has {len(channels)} channels, but at most {columns.most} are read; leave "
            "some out"
        )
    if len(lengths) != 1:
        sizes = ", ".join(f"{c.name} {len(c)}" for c in channels[:_MAX_NAMED])
        raise ContentError(f"its channels differ in length ({sizes}); resample them to one time")
    labels = [with_unit(c.name, c.properties.get("unit_string", ""), columns) for c in channels]
    waveform = ("start_time", "start_offset", "increment")
    times = {
        tuple(c.properties.get(f"wf_{key}") for key in waveform): c.name
        for c in channels
        if c.properties.get("wf_increment")
    }
    if len(times) > 1:
        (first_time, first_name), (next_time, next_name) = list(times.items())[:2]
        trios = zip(waveform, first_time, next_time, strict=True)
        differing = ", ".join(f"wf_{key} {a} and {b}" for key, a, b in trios if a != b)
        raise ContentError(
            f"the waveforms of {first_name} and {next_name} have different times ({differing}); "
            "resample them to one time"
        )
    names = [reading.column for label in labels for reading in readings_of(label, columns)]
    named = any(name.startswith("time") for name in (*names, *options.mapping.values()))
    _, start, step = next(iter(times), (None, None, 0.0))
    labels += ["time [s]"] if times and not named else []
    for at in range(0, lengths.pop(), PIECE):
        piece = [channel[at : at + PIECE] for channel in channels]
        piece += [(start or 0.0) + step * np.arange(at, at + len(piece[0]))]
        yield labels, piece[: len(labels)]
