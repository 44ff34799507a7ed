"""Tables on disk: one HDF5 file each, replaced as a whole.

A file is never changed in place. A new one is written beside it, synced, and put in its place by
one rename, so that a reader finds the old table or the new one and nothing between.

The first 512 bytes, which HDF5 leaves to others as its user block, hold a digest of all the rest.
It is checked before HDF5 sees the file: one flipped bit would otherwise be read as another number,
or lead the library's parser astray.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Any, BinaryIO, get_args

import h5py
import numpy as np

from .axes import OffAxis
from .rows import LOAD_UNITS, OUTPUT_UNITS, LoadRange, Rows, Tolerance, unknown_column

SCHEMA_VERSION = 2  # 1 had no digest
FORMAT = "wrenchbook table"
# What an upload may unpack to. A row takes 450 bytes, so that this is half a million rows; a
# compressed file of a few bytes can declare any size.
MOST_FOREIGN_BYTES = 256 * 1024 * 1024

CONTRACT = (
    "SI: N, N·m, m, rad. Order: force then moment; translation then rotation. The wrench acts ON "
    "the deformable component, at the interface reference point, expressed in the undeformed "
    "interface frame; the moment is spatial. The displacement is of the same point in the same "
    "frame; the rotation is a rotation vector, applied as R0 exp(r)."
)

PIECE = 1 << 20  # bytes of a file in memory at once for its digest
KEY_DIGITS = 32  # of a row's content key, 16 bytes
USER_BLOCK = 512  # the smallest HDF5 takes
_DIGEST_MARK = b"wrenchbook table, blake2b of what follows byte 512: "
_HDF5_MARK = b"\x89HDF\r\n\x1a\n"

_UNITS = {
    "wrench": ", ".join(LOAD_UNITS),
    "displacement": ", ".join(OUTPUT_UNITS),
    "uncertainty": ", ".join(OUTPUT_UNITS) + " (95 % half width; NaN: unknown)",
    "compliance": "displacement unit over wrench unit (NaN: unknown)",
}


class TableFileError(ValueError):
    """A file that is no table this version can read; the text says what to do."""


@dataclass(frozen=True)
class TableMeta:
    """What a table file says about its rows.

    Attributes
    ----------
    component : str
    last_seq : int
        The ledger's number up to which rows are in the file.
    load_range : LoadRange
        N and N·m.
    fingerprint : str
        Of the component's present set-up; each row carries its own.
    title : str
    schema_version : int
    contract : str
        Order, units, frame and sign in words.
    tolerance : Tolerance or None, m and rad
        The component's own; with `linear` and `off_axis` what a surrogate is built with.
    linear : bool
        Whether the component is linear.
    off_axis : {"correct", "ignore", "exclude"}
        What becomes of rows that are clean for no axis.
    ledger : str
        Digest of the ledger's rows up to `last_seq`: a file that another ledger wrote, or this
        one before it lost rows, is told by it.
    edits : tuple of (str, bool, float), or None
        The newest withdrawal or restoring of each row that had one: the row's content key in
        hexadecimal, whether it is withdrawn, when (seconds since the epoch). Withdrawn rows are
        not among the file's rows, so nothing else tells a ledger that was put back from an older
        copy. None if they were not known.
    """

    component: str
    last_seq: int
    load_range: LoadRange
    fingerprint: str = ""
    title: str = ""
    schema_version: int = SCHEMA_VERSION
    contract: str = CONTRACT
    tolerance: Tolerance | None = None
    linear: bool = False
    off_axis: OffAxis = "correct"
    ledger: str = ""
    edits: tuple[tuple[str, bool, float], ...] | None = None


def write_table(path: str | os.PathLike[str], rows: Rows, meta: TableMeta) -> None:
    """Write a table and put it in the place of the one before, all or nothing.

    Raises
    ------
    OSError
        If the folder cannot be written; the file that was there is untouched.
    """
    target = Path(path)
    handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.", suffix=".tmp")
    os.close(handle)
    draft = Path(name)
    try:
        with h5py.File(draft, "w", userblock_size=USER_BLOCK) as file:
            _write_meta(file, meta)
            _write_rows(file, rows)
        _write_digest(draft)
        draft.chmod(0o644)  # a temporary file is private, a table is for other programs too
        _sync(draft)
        draft.replace(target)
    except BaseException:
        draft.unlink(missing_ok=True)
        raise
    _sync(target.parent)


def read_table(path: str | os.PathLike[str]) -> tuple[Rows, TableMeta]:
    """Read a table.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    TableFileError
        If it is damaged, foreign, or of a newer schema.
    """
    source = Path(path)
    if not source.exists():
        raise FileNotFoundError(source)
    try:
        _check_digest(source)
        with h5py.File(source, "r") as file:
            _check_schema(file, source)
            return _read_rows(file), _read_meta(file)
    except TableFileError:
        raise
    except Exception as error:  # h5py has no base of what it raises on a file that is not sound
        raise _unreadable(source, str(error) or repr(error)) from error


def _unreadable(source: Path, why: str) -> TableFileError:
    return TableFileError(
        f"{source.name} is not a readable wrenchbook table ({why}). Restore it from a "
        "backup, or move it away: rows still in the ledger come back at the next start."
    )


def _write_digest(path: Path) -> None:
    with path.open("r+b") as file:
        file.write(_DIGEST_MARK + _digest(file))


def _check_digest(path: Path) -> None:
    """Refuse a table that is not byte for byte what was written; others are HDF5's to judge."""
    with path.open("rb") as file:
        head = file.read(USER_BLOCK)
        marked = head.startswith(_DIGEST_MARK)
        if marked and head[len(_DIGEST_MARK) :].rstrip(b"\0") == _digest(file):
            return
        # Files of the first schema begin with HDF5's mark and have no digest. So do other
        # programs' files; without either mark nothing tells what the bytes are.
        if marked or not head.startswith(_HDF5_MARK):
            raise _unreadable(path, "its bytes are not those that were written")


def _digest(file: BinaryIO) -> bytes:
    file.seek(USER_BLOCK)
    whole = blake2b(digest_size=32)
    while piece := file.read(PIECE):
        whole.update(piece)
    file.seek(0)
    return whole.hexdigest().encode()


def _sync(path: Path) -> None:
    """Flush a file, or the names in a folder, to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _write_meta(file: h5py.File, meta: TableMeta) -> None:
    file.attrs["format"] = FORMAT
    file.attrs["schema_version"] = meta.schema_version
    file.attrs["component"] = meta.component
    file.attrs["title"] = meta.title
    file.attrs["fingerprint"] = meta.fingerprint
    file.attrs["last_seq"] = meta.last_seq
    file.attrs["contract"] = meta.contract
    file.attrs["ledger"] = meta.ledger
    file.attrs["linear"] = meta.linear
    file.attrs["off_axis"] = meta.off_axis
    if meta.tolerance is not None:
        file.attrs["tolerance"] = (meta.tolerance.translation, meta.tolerance.rotation)
    for name in ("low", "high"):
        bound = file.create_dataset(f"load_range/{name}", data=getattr(meta.load_range, name))
        bound.attrs["units"] = _UNITS["wrench"]
    if meta.edits is not None:
        _write_edits(file.create_group("edits"), meta.edits)


def _write_edits(group: h5py.Group, edits: Sequence[tuple[str, bool, float]]) -> None:
    kind = h5py.string_dtype("utf-8", KEY_DIGITS)
    _write_column(group, "key", np.array([key.encode() for key, _, _ in edits], dtype=kind))
    _write_column(group, "withdrawn", np.array([gone for _, gone, _ in edits], dtype=bool))
    _write_column(group, "seconds", np.array([when for _, _, when in edits], dtype=float))


def _write_rows(file: h5py.File, rows: Rows) -> None:
    group = file.create_group("rows")
    _write_column(group, "seq", rows.seq)
    for name, units in _UNITS.items():
        _write_column(group, name, getattr(rows, name)).attrs["units"] = units
    for name in ("source", "fingerprint"):
        # Of one length, so that the checksum is over the words and not over where they are.
        words = np.char.encode(getattr(rows, name).astype(str), "utf-8")
        kind = h5py.string_dtype("utf-8", max(words.dtype.itemsize, 1))
        _write_column(group, name, words.astype(kind))


def _write_column(group: h5py.Group, name: str, column: np.ndarray) -> h5py.Dataset:
    """Write a column of n rows, with a checksum a chunk for readers that know no digest."""
    checked = {"fletcher32": True, "chunks": True} if len(column) else {}
    return group.create_dataset(name, data=column, **checked)


def _check_schema(file: h5py.File, source: Path) -> None:
    if file.attrs.get("format") != FORMAT:
        raise TableFileError(
            f"{source.name} is an HDF5 file, but not a wrenchbook table. To bring rows in from "
            "elsewhere, use `wrenchbook import`."
        )
    version = int(_attribute(file, "schema_version"))
    if version > SCHEMA_VERSION:
        raise TableFileError(
            f"{source.name} has table schema {version}; this wrenchbook reads up to "
            f"{SCHEMA_VERSION}. Install the newer wrenchbook that wrote it."
        )


def _attribute(file: h5py.File, name: str) -> Any:
    return file.attrs[name]


def _read_meta(file: h5py.File) -> TableMeta:
    low, high = (_numbers(file, f"load_range/{name}") for name in ("low", "high"))
    tolerance: Any = file.attrs.get("tolerance")  # files of 0.1 say nothing of these three
    return TableMeta(
        component=str(_attribute(file, "component")),
        last_seq=int(_attribute(file, "last_seq")),
        load_range=LoadRange(low, high),
        fingerprint=str(_attribute(file, "fingerprint")),
        title=str(_attribute(file, "title")),
        schema_version=int(_attribute(file, "schema_version")),
        contract=str(_attribute(file, "contract")),
        ledger=str(file.attrs.get("ledger", "")),
        tolerance=Tolerance(*map(float, tolerance)) if tolerance is not None else None,
        linear=bool(file.attrs.get("linear", False)),
        off_axis=_off_axis(str(file.attrs.get("off_axis", "correct"))),
        edits=_read_edits(file),
    )


def _off_axis(word: str) -> OffAxis:
    words: dict[str, OffAxis] = {one: one for one in get_args(OffAxis)}
    return words[word]


def _read_edits(file: h5py.File) -> tuple[tuple[str, bool, float], ...] | None:
    if "edits" not in file:
        return None
    keys = _words(file, "edits/key").tolist()
    gone = _numbers(file, "edits/withdrawn").astype(bool).tolist()
    return tuple(zip(keys, gone, _numbers(file, "edits/seconds").tolist(), strict=True))


def _dataset(file: h5py.File, name: str) -> h5py.Dataset:
    found = file[name]
    if not isinstance(found, h5py.Dataset):
        raise KeyError(f"{name} is no dataset")
    return found


def _numbers(file: h5py.File, name: str) -> np.ndarray:
    return np.asarray(_dataset(file, name)[...])


def _words(file: h5py.File, name: str) -> np.ndarray:
    return np.array(_dataset(file, name).asstr()[...], dtype=str)


def _read_rows(file: h5py.File) -> Rows:
    words = {name: _words(file, f"rows/{name}") for name in ("source", "fingerprint")}
    numbers = {name: _numbers(file, f"rows/{name}") for name in ("seq", *_UNITS)}
    for name in ("uncertainty", "compliance"):
        if np.isnan(numbers[name]).all():
            numbers[name] = unknown_column(*numbers[name].shape)
    return Rows(**numbers, **words)


def read_foreign_table(path: str | os.PathLike[str]) -> Rows:
    """Read the rows of a table file that somebody else has sent.

    Raises
    ------
    TableFileError
        If it is damaged, foreign, of a newer schema, points to other files, or is larger when read
        than `MOST_FOREIGN_BYTES`.
    """
    try:
        with h5py.File(path, "r") as file:
            _check_contained(file)
    except (OSError, KeyError, TypeError, AttributeError) as error:
        raise TableFileError(f"is not a readable wrenchbook table ({error})") from error
    return read_table(path)[0]


def _check_contained(file: h5py.File) -> None:
    """Refuse data outside of the file, and datasets that unpack to more than memory should hold."""
    room = MOST_FOREIGN_BYTES
    for folder in ("rows", "load_range", *(("edits",) if "edits" in file.keys() else ())):  # noqa: SIM118
        group = file[folder] if isinstance(file.get(folder, getlink=True), h5py.HardLink) else None
        if not isinstance(group, h5py.Group):
            raise TableFileError(f"has no group {folder}: it is no wrenchbook table")
        for name in group:
            found = (
                group[name] if isinstance(group.get(name, getlink=True), h5py.HardLink) else None
            )
            if not isinstance(found, h5py.Dataset) or found.external or found.is_virtual:
                raise TableFileError(
                    f"holds {folder}/{name} outside of itself or not as a dataset; send a file "
                    "that wrenchbook has written"
                )
            room -= found.nbytes
    if room < 0:
        raise TableFileError(
            f"unpacks to more than {MOST_FOREIGN_BYTES >> 20} MiB; send the table in parts"
        )
