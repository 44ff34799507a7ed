"""MATLAB files of level 5: vectors or a struct's fields, each a column."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat, whosmat

from wrenchbook.service.formats.cells import ContentError
from wrenchbook.service.formats.columnar import require_unpacked
from wrenchbook.service.formats.options import Array, Options, ParsedTable, ReadReport
from wrenchbook.service.formats.text import PIECE, read_columns
from wrenchbook.surrogate.table.foreign import matlab_object

_MAX_NAMED = 8  # variables in a message: more would hide its remedy


def read_mat(path: Path, options: Options, report: ReadReport) -> Iterator[ParsedTable]:
    """Yield the good rows of a MATLAB file (level 5): its vectors, or its only struct's."""
    columns = _vectors(_mat_variables(path))
    starts = range(0, len(next(iter(columns.values()))) or 1, PIECE)
    parts = ([column[at : at + PIECE] for column in columns.values()] for at in starts)
    yield from read_columns(((list(columns), part) for part in parts), options, report)


def _mat_variables(path: Path) -> dict[str, Any]:
    """Return the variables of a MATLAB file by name; raises ContentError if it cannot be read."""
    try:
        size = sum(8 * math.prod(shape) for _, shape, _ in whosmat(path))
    except TypeError:  # an object of MATLAB has no shape and no name
        name, _, kind, _ = loadmat(path, variable_names=["None"])["None"].item()
        raise ContentError(matlab_object(name.decode(), kind.decode())) from None
    require_unpacked(size)
    values = loadmat(path, squeeze_me=True, mat_dtype=True)  # logical as bool: no number
    return {name: value for name, value in values.items() if not name.startswith("__")}


def _vectors(values: dict[str, Any]) -> dict[str, Array]:
    """Return a file's variables, or its only struct's fields, as vectors; raises ContentError."""
    struct = next(iter(values.values()), None) if len(values) == 1 else None
    if isinstance(struct, np.ndarray) and struct.dtype.names:
        values = {name: struct[name].tolist() for name in struct.dtype.names}
        if struct.ndim:  # an array of records
            values = {name: _record_values(column) for name, column in values.items()}
    columns = {name: np.asarray(value) for name, value in values.items() if np.ndim(value)}
    if not columns:  # a single row, or none
        columns = {
            name: np.array([value])
            for name, value in values.items()
            if isinstance(value, int | float)
        }
    form = "must hold numeric vectors of one length, one for each column"
    each = "save each column as a variable of its own, such as fx_N = A(:, 1)"
    if not columns:
        raise ContentError(f"{form}, but has no numbers; {each}")
    for name, column in columns.items():
        if column.ndim != 1 or column.dtype.kind not in "iufb":
            kind = f"shape {column.shape}, type {column.dtype}"
            raise ContentError(f"{form}, but {name} is not one ({kind}); {each}")
    if len({len(column) for column in columns.values()}) > 1:
        lengths = [f"{name} {len(column)}" for name, column in columns.items()]
        only = "save only those of the table: save('t.mat', 'fx_N', 'ux_mm')"
        raise ContentError(
            f"{form}, but their lengths are {', '.join(lengths[:_MAX_NAMED])}; {only}"
        )
    return columns


def _record_values(column: Sequence[Any]) -> Array:
    """Return a field of an array of records, (n,): NaN where a record has none."""
    several = any(np.size(value) > 1 for value in column)
    numbers = [value if np.size(value) else np.nan for value in column]
    return np.array(numbers, dtype=object if several else None)
