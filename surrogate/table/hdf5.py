"""Table files in HDF5, always replaced as a whole.

A file is never changed in place. A new file is written beside it, synced, and renamed over it, so
that a reader opens the old table or the new one and no mixture.

The first 512 bytes, the user block that HDF5 leaves to applications, hold a digest of the rest. It
is checked before HDF5 reads the file: one flipped bit would otherwise be read as another number, or
crash the library's parser.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, TypeVar, cast, get_args

import h5py
import numpy as np
from h5py import h5l  # pyright: ignore[reportAttributeAccessIssue] (compiled, not described)

from .axes import OffAxis
from .meta import (
    SCHEMA_VERSION,
    USER_BLOCK,
    TableMeta,
    is_as_written,
    may_be_foreign,
    sync,
    write_digest,
)
from .rows import LoadRange, Rows, Tolerance, unknown_column
from .space import DEFAULT, LOAD_UNITS, OUTPUT_UNITS, Space

T = TypeVar("T")
M = TypeVar("M", h5py.Group, h5py.Dataset)

FORMAT = "wrenchbook table"
MIB = 1024 * 1024
# Limit of an upload's unpacked size: two million rows of 450 bytes. A compressed file of a few
# bytes can declare any size.
MAX_FOREIGN_BYTES = 1024 * MIB
MAX_DEPTH = 8  # levels of groups above the columns: a file may link a group to itself
MAX_CHUNK_BYTES = 64 * MIB  # a chunk is unpacked in full for any part of it
# Bytes of a source or a fingerprint; each text takes as much as the longest.
MAX_STRING_BYTES = 1024
FOREIGN_PIECE = 20_000  # rows read at once: bounded memory
MAX_LISTED = 8  # names in a message: more would hide its remedy
MAX_SHOWN = 100  # characters of a value in a message: longer ones are cut

KEY_DIGITS = 32  # hexadecimal digits of a row's content key, 16 bytes

_ATTRIBUTES = ("schema_version", "component", "title", "fingerprint", "last_seq", "contract")
_ATTRIBUTES += ("ledger", "linear", "off_axis")  # files of version 0.1 lack these
_UNITS = {
    "wrench": ", ".join(LOAD_UNITS),
    "displacement": ", ".join(OUTPUT_UNITS),
    "uncertainty": ", ".join(OUTPUT_UNITS) + " (95 % half width; NaN: unknown)",
    "compliance": "displacement unit over wrench unit (NaN: unknown)",
    "curvature": "displacement unit over two units of (F, mu) (NaN: unknown)",
}


class TableFileError(ValueError):
    """A file that is no table of a known version; the message has the remedy."""


def write_table(
    path: str | os.PathLike[str], rows: Rows, meta: TableMeta, notes: Sequence[str] = ()
) -> None:
    """Write a table file, which is replaced as a whole.

    `notes`, one text a row, are for an export; the store's files have none.

    The file is made in memory, 0.5 kB a row: libhdf5 ends the process by a segmentation fault after
    a write that a full disk refuses.

    Raises OSError if the folder cannot be written; the earlier file is then unchanged.
    """
    target = Path(path)
    content = BytesIO()
    with h5py.File(content, "w", userblock_size=USER_BLOCK) as file:
        _write_meta(file, meta)
        _write_rows(file, rows)
        if any(notes):
            # Variable lengths: one long note must not make all notes as long.
            kind = h5py.string_dtype("utf-8")
            file.create_dataset("rows/note", data=list(notes), dtype=kind)
    write_digest(content)
    handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.", suffix=".tmp")
    draft = Path(name)
    try:
        with open(handle, "wb") as file:  # noqa: PTH123 (a descriptor)
            file.write(content.getbuffer())
        draft.chmod(0o644)  # a temporary file is private, but other programs may read tables
        sync(draft)
        draft.replace(target)
    except BaseException:
        draft.unlink(missing_ok=True)
        raise
    sync(target.parent)


def read_table(path: str | os.PathLike[str]) -> tuple[Rows, TableMeta]:
    """Read a table.

    Raises FileNotFoundError if there is no such file; TableFileError if it is damaged, foreign, or
    of a newer schema.
    """
    return _read(Path(path), lambda file: (_read_rows(file), _read_meta(file)))


def read_meta(path: str | os.PathLike[str]) -> TableMeta:
    """Read the metadata of a table, after a check of all its bytes.

    Raises the errors of `read_table`.
    """
    return _read(Path(path), _read_meta)


def _read(source: Path, part: Callable[[h5py.File], T]) -> T:
    """Return a part of a table file after a check of its digest."""
    if not source.exists():
        raise FileNotFoundError(source)
    remedy = (
        ". Restore it from a backup, or move it away: rows still in the ledger come back at the "
        "next start."
    )
    with _named_errors(f"{source.name} is not a readable wrenchbook table", remedy):
        if not is_as_written(source):
            raise ValueError("its checksum is wrong: the file is damaged")
        with h5py.File(source, "r") as file:
            _check_schema(file, source)
            return part(file)


@contextmanager
def _named_errors(problem: str, remedy: str) -> Iterator[None]:
    """Raise the errors of the block as TableFileError, with their text between two others."""
    try:
        yield
    except TableFileError:
        raise
    except Exception as error:  # h5py's errors on a damaged file have no common base
        raise TableFileError(f"{problem} ({str(error) or repr(error)}){remedy}") from error


def _write_meta(file: h5py.File, meta: TableMeta) -> None:
    """Write the attributes of a table file."""
    file.attrs["format"] = FORMAT
    for name in _ATTRIBUTES:
        file.attrs[name] = getattr(meta, name)
    names = meta.load_range.space.output_names
    file.attrs["locked"] = " ".join(names[load] for load in meta.locked)
    if not meta.load_range.space.is_default:
        file.attrs["space"] = json.dumps(meta.load_range.space.as_json(), ensure_ascii=False)
    if meta.tolerance is not None:
        file.attrs["tolerance"] = (meta.tolerance.translation, meta.tolerance.rotation)
    if meta.solver_error is not None:
        file.attrs["solver_error"] = json.dumps(dict(meta.solver_error), allow_nan=False)
    for name in ("low", "high"):
        bound = file.create_dataset(f"load_range/{name}", data=getattr(meta.load_range, name))
        bound.attrs["units"] = _UNITS["wrench"]
    if meta.edits is not None:
        kind = h5py.string_dtype("utf-8", KEY_DIGITS)
        group = file.create_group("edits")
        keys = np.array([key.encode() for key, _, _ in meta.edits], dtype=kind)
        _write_column(group, "key", keys)
        _write_column(group, "withdrawn", np.array([gone for _, gone, _ in meta.edits], dtype=bool))
        _write_column(group, "seconds", np.array([when for _, _, when in meta.edits], dtype=float))


def _write_rows(file: h5py.File, rows: Rows) -> None:
    """Write the columns of a table file."""
    group = file.create_group("rows")
    _write_column(group, "seq", rows.seq)
    if rows.session.any():  # files of other programs and of older versions have none
        _write_column(group, "session", rows.session)
    for name, units in _UNITS.items():
        column = getattr(rows, name)
        # A table without curvature has no such column, as in older versions.
        if name != "curvature" or column.size:
            _write_column(group, name, column).attrs["units"] = units
    for name in ("source", "fingerprint"):
        # Fixed lengths, so that the checksum covers the words and not their addresses.
        encoded = np.char.encode(getattr(rows, name).astype(str), "utf-8")
        kind = h5py.string_dtype("utf-8", max(encoded.dtype.itemsize, 1))
        _write_column(group, name, encoded.astype(kind))


def _write_column(group: h5py.Group, name: str, column: np.ndarray) -> h5py.Dataset:
    """Write a column of n rows, with a checksum of each chunk.

    The checksum is for other programs, which ignore the digest.
    """
    checked = {"fletcher32": True, "chunks": True} if len(column) else {}
    return group.create_dataset(name, data=column, **checked)


def _check_schema(file: h5py.File, source: Path) -> None:
    """Raise TableFileError unless the file is a table of a known schema version."""
    if file.attrs.get("format") != FORMAT:
        raise TableFileError(
            f"{source.name} is an HDF5 file, but not a wrenchbook table. To bring rows in from "
            "elsewhere, use `wrenchbook import`."
        )
    attributes: Any = file.attrs
    version = int(attributes["schema_version"])
    if version > SCHEMA_VERSION:
        raise TableFileError(
            f"{source.name} has table schema {version}; this wrenchbook reads up to "
            f"{SCHEMA_VERSION}. Install the newer wrenchbook that wrote it."
        )


def _read_meta(file: h5py.File) -> TableMeta:
    """Return the metadata from the attributes of a table file."""
    low, high = (_numbers(file, f"load_range/{name}") for name in ("low", "high"))
    space = _read_space(file)
    attributes = cast("Any", file.attrs)
    off_axis = str(attributes.get("off_axis", "correct"))
    if off_axis not in get_args(OffAxis):
        choices = ", ".join(get_args(OffAxis))
        raise ValueError(f"its attribute off_axis is {off_axis!r}, not one of {choices}")
    tolerance = attributes.get("tolerance")  # files of version 0.1 lack these three attributes
    return TableMeta(
        component=str(attributes["component"]),
        last_seq=int(attributes["last_seq"]),
        load_range=LoadRange(low, high, space),
        fingerprint=str(attributes["fingerprint"]),
        title=str(attributes["title"]),
        schema_version=int(attributes["schema_version"]),
        contract=str(attributes["contract"]),
        ledger=str(attributes.get("ledger", "")),
        tolerance=Tolerance(*map(float, tolerance)) if tolerance is not None else None,
        linear=bool(attributes.get("linear", False)),
        off_axis=cast("OffAxis", off_axis),
        edits=_read_edits(file),
        solver_error=json.loads(str(attributes.get("solver_error", "null"))),
        locked=tuple(map(space.output_names.index, str(attributes.get("locked", "")).split())),
    )


def _read_space(file: h5py.File) -> Space:
    # Tables of one interface without further inputs have no such attribute.
    text = file.attrs.get("space")
    return DEFAULT if text is None else Space.read(json.loads(str(text)))


def _read_edits(file: h5py.File) -> tuple[tuple[str, bool, float], ...] | None:
    if "edits" not in file:
        return None
    keys = _strings(file, "edits/key").tolist()
    gone = _numbers(file, "edits/withdrawn").astype(bool).tolist()
    return tuple(zip(keys, gone, _numbers(file, "edits/seconds").tolist(), strict=True))


def _dataset(file: h5py.File, name: str) -> h5py.Dataset:
    dataset = file[name]
    if not isinstance(dataset, h5py.Dataset):
        raise KeyError(f"{name} is no dataset")
    return dataset


_ALL = slice(None)


def _numbers(file: h5py.File, name: str, piece: slice = _ALL) -> np.ndarray:
    return np.asarray(_dataset(file, name)[piece])


def _strings(file: h5py.File, name: str, piece: slice = _ALL) -> np.ndarray:
    return np.array(_dataset(file, name).asstr()[piece], dtype=str)


def _read_rows(file: h5py.File, piece: slice = _ALL) -> Rows:
    """Return the rows of a slice of a table file."""
    strings = {name: _strings(file, f"rows/{name}", piece) for name in ("source", "fingerprint")}
    optional = {"curvature", "session"}
    names = [
        name for name in (*_UNITS, "session") if name not in optional or f"rows/{name}" in file
    ]
    numbers = {name: _numbers(file, f"rows/{name}", piece) for name in ("seq", *names)}
    numbers.setdefault("curvature", np.empty((len(numbers["seq"]), 0)))
    for name in ("uncertainty", "compliance"):
        if np.isnan(numbers[name]).all():
            numbers[name] = unknown_column(*numbers[name].shape)
    return Rows(**numbers, **strings, space=_read_space(file))


def foreign_tables(path: str | os.PathLike[str]) -> Iterator[tuple[Rows, list[str]]]:
    """Yield the rows of an uploaded table file in pieces, with their notes.

    Raises TableFileError if the file is damaged, foreign, of a newer schema, points to other files,
    or is larger when read than `MAX_FOREIGN_BYTES`.
    """
    source = Path(path)
    with _named_errors("cannot be read as a wrenchbook table", "; export the table again"):
        with h5py.File(path, "r") as file:
            _check_contained(file)
        if not is_as_written(source):
            raise TableFileError(
                "differs from what wrenchbook wrote (checksum); send the original again, or export "
                "as CSV before you edit it"
            )
        with h5py.File(path, "r") as file:
            _check_schema(file, source)
            _read_meta(file)
            count = len(_dataset(file, "rows/seq"))
            for start in range(0, count, FOREIGN_PIECE):
                piece = slice(start, start + FOREIGN_PIECE)
                rows = _read_rows(file, piece)
                stored = _dataset(file, "rows/note") if "rows/note" in file else None
                notes = [] if stored is None else np.asarray(stored.asstr()[piece]).tolist()
                yield rows, notes or [""] * len(rows)


def _check_contained(file: h5py.File) -> None:
    """Refuse data outside of the file, and datasets that unpack to too much memory."""
    room = MAX_FOREIGN_BYTES
    present = list(file)  # the names: `in file` would follow a link to another file
    for folder in ("rows", "load_range", *(("edits",) if "edits" in present else ())):
        if folder not in present:
            raise TableFileError(f"has no group {folder}; send a file that wrenchbook wrote")
        group = _own_member(file, folder, h5py.Group)
        for name in group:
            place = f"{folder}/{name}"
            dataset = _own_member(file, place, h5py.Dataset)
            _check_chunks(place, dataset)
            size = dataset.dtype.itemsize
            if name != "note" and dataset.dtype.hasobject:
                raise TableFileError(
                    f"has text of variable length in {place}; send a file that wrenchbook wrote"
                )
            if name != "note" and size > MAX_STRING_BYTES:
                raise TableFileError(
                    f"has strings of {size} bytes in {place}, over the limit of "
                    f"{MAX_STRING_BYTES}; shorten them"
                )
            room -= dataset.nbytes
    _check_room(room)


def _own_member(file: h5py.File, name: str, kind: type[M]) -> M:
    """Return a group or a dataset whose data are in this file; refuse one that is elsewhere."""
    member = file[name] if isinstance(file.get(name, getlink=True), h5py.HardLink) else None
    if member is None or (
        isinstance(member, h5py.Dataset) and (member.external or member.is_virtual)
    ):
        raise TableFileError(f"has {name} in another file or behind a link; copy it into this file")
    if not isinstance(member, kind):
        raise TableFileError(
            f"has {name}, but not as a {kind.__name__.lower()}; send a file that wrenchbook wrote"
        )
    return member


def _check_chunks(name: str, dataset: h5py.Dataset) -> None:
    """Refuse a dataset whose chunks take too much memory: each is unpacked in full."""
    size = np.prod(dataset.chunks or (0,), dtype=float) * dataset.dtype.itemsize
    if size > MAX_CHUNK_BYTES:
        raise TableFileError(
            f"has chunks of {size / MIB:.0f} MiB in {name}, over the limit of "
            f"{MAX_CHUNK_BYTES // MIB} MiB; write smaller chunks"
        )


def _check_room(room: int) -> None:
    """Refuse a file that unpacks to more than `MAX_FOREIGN_BYTES`.

    `room`: the unused part of it.
    """
    if room < 0:
        raise TableFileError(
            f"unpacks to {(MAX_FOREIGN_BYTES - room) / MIB:.0f} MiB, over the limit of "
            f"{MAX_FOREIGN_BYTES // MIB} MiB; send the table in parts"
        )


def is_table(path: Path) -> bool:
    """Return whether an HDF5 file is marked as a table of wrenchbook."""
    if not may_be_foreign(path):
        return True
    try:
        with h5py.File(path, "r") as file:
            return file.attrs.get("format") == FORMAT
    except Exception:  # a damaged file: `foreign_tables` reports it
        return True


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
    with _named_errors("cannot be read as HDF5", again), h5py.File(path, "r") as file:
        columns = _named_columns(file)
        if not columns:
            raise TableFileError(
                "has no columns; write each one as a one-dimensional dataset of numbers"
            )
        lengths = {len(dataset) for _, dataset, _ in columns}
        if len(lengths) != 1:
            sizes = (f"{name}: {len(dataset)}" for name, dataset, _ in columns[:MAX_LISTED])
            raise TableFileError(
                f"has columns of several lengths ({', '.join(sizes)}); make them equal"
            )
        names = [name for name, _, _ in columns]
        for start in range(0, lengths.pop() or 1, FOREIGN_PIECE):
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
        _check_room(room)
        _check_chunks(name, dataset)
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

    Raises TableFileError if a part of the file cannot be inspected.
    """
    if not h5py.is_hdf5(path):
        return []
    outside: list[str] = []

    def check(name: str, member: h5py.Group | h5py.Dataset) -> None:
        if isinstance(member, h5py.Dataset) and (member.external or member.is_virtual):
            outside.append(name)

    def check_link(name: bytes, link: h5l.LinkInfo) -> None:
        if link.type not in (h5l.TYPE_HARD, h5l.TYPE_SOFT):
            outside.append(name.decode(errors="replace"))

    again = "; write it again"
    with _named_errors("cannot be searched as HDF5", again), h5py.File(path, "r") as file:
        file.id.links.visit(check_link, info=True)
        file.visititems(check)
    return outside
