"""Columns of HDF5 files of other programs: pandas, MATLAB, netCDF.

Apart from `hdf5`, which reads and writes this project's own tables.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from h5py import h5l  # pyright: ignore[reportAttributeAccessIssue] (compiled, not described)

from .hdf5 import (
    FOREIGN_PIECE,
    MAX_FOREIGN_BYTES,
    TableFileError,
    check_chunks,
    check_room,
    named_errors,
)

MAX_DEPTH = 8  # levels of groups above the columns: a file may link a group to itself
MAX_LEVELS = 64  # of groups in a file: HDF5 walks from the root to each, 3,000 levels took a minute
MAX_LISTED = 8  # names in a message: more would hide its remedy
MAX_SHOWN = 100  # characters of a value in a message: longer ones are cut


def foreign_columns(path: Path) -> Iterator[tuple[list[str], list[np.ndarray]]]:
    """Yield the labels and columns of an HDF5 file of any program, some rows at a time.

    Columns are the datasets of one dimension in the root or in its only group, a dataset of named
    fields, or a matrix whose attribute ``columns`` names its columns. An attribute ``unit`` or
    ``units`` joins the label. Packed values are unpacked as the CF conventions say (see
    `_unpacking`).

    Raises TableFileError if the file is damaged, points to other files, is larger when read than
    `MAX_FOREIGN_BYTES`, or has no such columns of one length.
    """
    if outside := leads_out(path):
        names = ", ".join(outside[:MAX_LISTED])
        raise TableFileError(f"refers to data in other files ({names}); copy them into this file")
    again = "; write it again"
    with named_errors("cannot be read as HDF5", again), h5py.File(path, "r") as file:
        columns = _named_columns(file)
        if not columns:
            raise TableFileError(
                "has no columns; write each one as a one-dimensional dataset of numbers"
            )
        lengths = {len(dataset): name for name, dataset, _ in reversed(columns)}
        if len(lengths) != 1:
            sizes = [f"{name}: {length}" for length, name in reversed(lengths.items())][:MAX_LISTED]
            raise TableFileError(
                f"has columns of several lengths ({', '.join(sizes)}); make them equal"
            )
        names = [name for name, _, _ in columns]
        for start in range(0, len(columns[0][1]) or 1, FOREIGN_PIECE):
            piece = slice(start, start + FOREIGN_PIECE)
            yield names, [read(dataset[piece]) for _, dataset, read in columns]


NamedColumn = tuple[str, Any, Callable[[np.ndarray], np.ndarray]]
"""A label, the dataset, and the function that returns the column for a slice of the dataset."""


class _Vector:
    """A dataset of shape (1, n), as MATLAB writes a column, or (n, 1)."""

    def __init__(self, dataset: h5py.Dataset) -> None:
        self._data = dataset

    def __len__(self) -> int:
        return int(self._data.size or 0)

    def __getitem__(self, piece: slice) -> np.ndarray:
        return np.asarray(
            self._data[0, piece] if self._data.shape[0] == 1 else self._data[piece, 0]
        )


def matlab_object(name: str, kind: str) -> str:
    """Return the message on a variable of MATLAB that cannot be read, with the remedy."""
    only = f"has {name}, a {kind} object, which only MATLAB reads"
    if kind not in ("table", "timetable"):
        return f"{only}; save it as double, or leave it out"
    table = f"timetable2table({name},'ConvertRowTimes',false)" if kind == "timetable" else name
    return f"{only}; make it a struct: S = table2struct({table},'ToScalar',true); save('t.mat','S')"


def _other_form(name: str, member: h5py.Group | h5py.Dataset) -> str | None:
    """Return the remedy for a table of pandas or MATLAB that is not stored as columns."""
    if "pandas_type" in member.attrs:
        file = f"'table.h5', '{name}'"
        return f"is of pandas' to_hdf; send pandas.read_hdf({file}).to_parquet('table.parquet')"
    if name.startswith("#"):  # MATLAB's own groups
        return None
    if "MATLAB_object_decode" in member.attrs:
        return matlab_object(name, "".join(_texts(member, "MATLAB_class")))
    if isinstance(member, h5py.Dataset) and member.dtype == h5py.ref_dtype:
        at = name.partition("/")[0]
        return (
            f"has MATLAB records in {at}; convert them to a struct of vectors: S = "
            f"table2struct(struct2table({at}),'ToScalar',true); save('t.mat','S')"
        )
    return None


def _named_columns(file: h5py.File) -> list[NamedColumn]:
    """Return the columns of a file.

    They are those of the root, of the only group, or of a dataset with named columns.
    """
    if problem := file.visititems(_other_form):
        raise TableFileError(problem)
    group: h5py.Group = file
    # Names of MATLAB's references begin with #.
    inside = [dataset for name, dataset in file.items() if not name.startswith("#")]
    for _ in range(MAX_DEPTH):
        if len(inside) == 1 and isinstance(inside[0], h5py.Group):
            group = inside[0]
            inside = list(inside[0].values())
    if inside and all(isinstance(member, h5py.Group) for member in inside):
        if len(inside) == 1:
            raise TableFileError(
                f"has its columns below more than {MAX_DEPTH} groups; write them into one group"
            )
        groups = ", ".join(list(group)[:MAX_LISTED])
        raise TableFileError(
            f"has columns in several groups ({groups}); send each as a file of its own"
        )
    columns: list[NamedColumn] = []
    room = MAX_FOREIGN_BYTES
    for name, dataset in group.items():
        if not isinstance(dataset, h5py.Dataset) or dataset.ndim == 0:
            continue
        room -= dataset.nbytes
        check_room(room)
        check_chunks(name, dataset)
        columns += _columns_of(name, dataset)
    return columns


def _columns_of(name: str, dataset: h5py.Dataset) -> list[NamedColumn]:
    """Return the columns of one dataset: itself, its named fields, or the columns of its matrix."""
    fields = dataset.dtype.names
    if fields and dataset.ndim == 1:
        labels = _labels(dataset, list(fields))
        return [
            (label, dataset, _unpacking(dataset, name, field))
            for label, field in zip(labels, fields, strict=True)
        ]
    titles = _texts(dataset, "columns", "names")
    if dataset.ndim == 2 and len(titles) == dataset.shape[1]:
        labels = _labels(dataset, titles)
        parts = (_unpacking(dataset, name, (slice(None), k)) for k in range(len(labels)))
        return [(label, dataset, part) for label, part in zip(labels, parts, strict=True)]
    is_text = h5py.check_string_dtype(dataset.dtype) is not None
    is_vector = dataset.ndim == 2 and 1 in dataset.shape and not is_text
    if not (dataset.ndim == 1 or is_vector) or not (is_text or dataset.dtype.kind in "iufb"):
        raise TableFileError(
            f"has {name} of shape {dataset.shape} and type {dataset.dtype}; write each column as a "
            "one-dimensional dataset of numbers or strings (data frames: to_parquet or to_csv)"
        )
    (label,) = _labels(dataset, [name])
    if "MATLAB_empty" in dataset.attrs:  # it holds the array's shape
        return [(label, np.empty(0), np.asarray)]
    if "logical" in _texts(dataset, "MATLAB_class"):
        return [
            (label, _Vector(dataset) if is_vector else dataset, lambda piece: piece.astype(bool))
        ]
    column = dataset.asstr() if is_text else _Vector(dataset) if is_vector else dataset
    return [(label, column, np.asarray if is_text else _unpacking(dataset, name, ...))]


def _labels(dataset: h5py.Dataset, names: list[str]) -> list[str]:
    """Return names with the units of a dataset's attribute, unless they have units."""
    units = _texts(dataset, "units", "unit")
    if len(units) != len(names):
        return names
    return [
        f"{name} [{unit}]" if unit and "[" not in name and "(" not in name else name
        for name, unit in zip(names, units, strict=True)
    ]


def _texts(dataset: h5py.Group | h5py.Dataset, *keys: str) -> list[str]:
    """Return the texts of the first attribute there is, of one text or several."""
    value: Any = next((dataset.attrs[key] for key in keys if key in dataset.attrs), ())
    several = [value] if isinstance(value, str | bytes) else list(value)
    return [
        text.decode(errors="replace") if isinstance(text, bytes) else str(text) for text in several
    ]


_SCALING = ("scale_factor", "add_offset")
_BLANK = ("_FillValue", "missing_value")
_VALID = ("valid_min", "valid_max", "valid_range")


def _unpacking(dataset: h5py.Dataset, name: str, part: Any) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function that reads a field or a column `part` of a dataset's piece, unpacked.

    CF conventions 1.11, 2.5.1 and 8.1: a stored value that is ``_FillValue`` or ``missing_value``,
    or is beyond ``valid_range``, is missing (NaN); any other is multiplied by ``scale_factor``, and
    ``add_offset`` is added.

    Raises TableFileError if such an attribute is no number or has several values, or if integers
    are packed and their valid range has no integers.
    """
    stored_type = dataset.dtype[part] if isinstance(part, str) else dataset.dtype
    keys = [key for key in (*_SCALING, *_BLANK, *_VALID, "_Unsigned") if key in dataset.attrs]
    attributes: dict[str, np.ndarray] = {
        key: np.ravel(np.asarray(dataset.attrs[key])) for key in keys
    }
    packed = stored_type.kind in "iu" and not attributes.keys().isdisjoint(_SCALING)
    for key, values in attributes.items():
        count = {"missing_value": len(values) or 1, "valid_range": 2}.get(key, 1)
        is_numeric = values.dtype.kind in "iuf" and len(values) == count
        if not is_numeric or (key in _SCALING and not np.isfinite(values).all()):
            raise TableFileError(
                f"holds {name} with the attribute {key} = {str(values.tolist())[:MAX_SHOWN]}, not "
                f"{'two numbers' if count == 2 else 'one number'}; unpack the values and remove "
                f"{key}"
            )
        # The netCDF guide defines such limits on unpacked values, netCDF4 for Python on packed
        # values.
        if key in _VALID and packed and values.dtype.kind == "f":
            raise TableFileError(
                f"has packed integers {name} with {key} = {str(values.tolist())[:MAX_SHOWN]}, "
                f"which is ambiguous; write {key} as a packed integer, or remove it"
            )
    if not attributes:
        return lambda piece: piece[part]
    factor = float(attributes.get("scale_factor", [1])[0])
    offset = float(attributes.get("add_offset", [0])[0])
    blanks = [*attributes.get("_FillValue", ()), *attributes.get("missing_value", ())]
    valid_low, valid_high = attributes.get("valid_range", [-np.inf, np.inf])
    low = attributes.get("valid_min", [valid_low])[0]
    high = attributes.get("valid_max", [valid_high])[0]
    if stored_type.kind == "f":  # 0.1 in 32 bits is larger than 0.1 in 64 bits
        low, high = stored_type.type(low), stored_type.type(high)

    def unpacked(piece: np.ndarray) -> np.ndarray:
        stored = piece[part]
        # A fill value of 32 bits does not equal the same number in 64 bits.
        fills = np.asarray(blanks, stored.dtype if stored.dtype.kind == "f" else None)
        missing = np.isin(stored, fills) | (stored < low) | (stored > high)
        return np.where(missing, np.nan, stored * factor + offset)

    return unpacked


def leads_out(path: Path) -> list[str]:
    """Return the names in an HDF5 file of any kind that refer to data in another file.

    An uploaded mesh is such a file too, and must not read this machine's files.

    Raises TableFileError if a part of the file cannot be inspected, or its groups are nested deeper
    than `MAX_LEVELS`.
    """
    if not h5py.is_hdf5(path):
        return []
    outside: list[str] = []

    def check(name: str, member: h5py.Group | h5py.Dataset) -> None:
        if isinstance(member, h5py.Dataset) and (member.external or member.is_virtual):
            outside.append(name)

    def check_link(name: bytes, link: h5l.LinkInfo) -> bool | None:
        if link.type not in (h5l.TYPE_HARD, h5l.TYPE_SOFT):
            outside.append(name.decode(errors="replace"))
        return name.count(b"/") >= MAX_LEVELS or None  # True ends the visit

    again = "; write it again"
    with named_errors("cannot be searched as HDF5", again), h5py.File(path, "r") as file:
        if file.id.links.visit(check_link, info=True):
            raise TableFileError(
                f"has groups in more than {MAX_LEVELS} levels; write the data into fewer"
            )
        file.visititems(check)
    return outside
