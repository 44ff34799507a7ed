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
MAX_CHUNK_BYTES = 64 * MIB  # a chunk is unpacked in full for any part of it
# Bytes of a source or a fingerprint; each text takes as much as the longest.
MAX_STRING_BYTES = 1024
FOREIGN_PIECE = 20_000  # rows read at once: bounded memory

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
    with named_errors(f"{source.name} is not a readable wrenchbook table", remedy):
        if not is_as_written(source):
            raise ValueError("its checksum is wrong: the file is damaged")
        with h5py.File(source, "r") as file:
            _check_schema(file, source)
            return part(file)


@contextmanager
def named_errors(problem: str, remedy: str) -> Iterator[None]:
    """Raise the errors of the block as TableFileError, with their text between two others."""
    try:
        yield
    except TableFileError:
        raise
    except Exception as error:  # h5py's errors on a damaged file have no common base
        why = str(error) or repr(error)
        if isinstance(error, OSError) and error.errno is None:  # of the HDF5 library
            why = "the file is damaged, or not HDF5"
        raise TableFileError(f"{problem} ({why}){remedy}") from error


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
    with named_errors("cannot be read as a wrenchbook table", "; export the table again"):
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
            check_chunks(place, dataset)
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
    check_room(room)


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


def check_chunks(name: str, dataset: h5py.Dataset) -> None:
    """Refuse a dataset whose chunks take too much memory: each is unpacked in full."""
    size = np.prod(dataset.chunks or (0,), dtype=float) * dataset.dtype.itemsize
    if size > MAX_CHUNK_BYTES:
        raise TableFileError(
            f"has chunks of {size / MIB:.0f} MiB in {name}, over the limit of "
            f"{MAX_CHUNK_BYTES // MIB} MiB; write smaller chunks"
        )


def check_room(room: int) -> None:
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
