"""The file of a packed table (`.wbt`): a header, a directory of named arrays, JSON, the arrays.

The header is 64 bytes: magic, format number, byte order, CRC-32 of all other bytes, sizes. Each
entry of the directory is 128 bytes, in the order of the names; arrays begin at multiples of 64
bytes, so that a mapped file is read in place. The same table gives the same bytes.
surrogate/kernel/wb_file.c and wb_open.c read the same in C.
"""

from __future__ import annotations

import json
import mmap
import os
import secrets
import stat
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

MAGIC = b"\x89WBT\r\n\x1a\n"  # as in PNG: a transfer that changes line ends damages it
FORMAT = 7  # no other number is read: the file is derived data, and is built again from the rows
SUFFIX = ".wbt"
ALIGNED = 64  # bytes: a cache line
CHECKSUM = slice(16, 24)  # place of the checksum in the header; it covers all other bytes
BLOCK = 1 << 20  # bytes read at once for the checksum: bounded memory for large files
# Columns of the array ``solver/flags``, and of the array ``flags`` of a group: see `packed.arrays`.
SOLVER_BY_TANGENT, SOLVER_BARS_COMPLETE = 0, 4
GROUP_METHOD, GROUP_EXACT, GROUP_CAN_ANSWER = 0, 1, 2

_BYTE_ORDER = 0x01020304
_TYPES = {1: np.dtype("<f8"), 2: np.dtype("<i4"), 3: np.dtype("<i8"), 4: np.dtype("u1")}
_CODES = {dtype: code for code, dtype in _TYPES.items()}
_HEADER = np.dtype(
    [
        ("magic", "S8"),
        ("format", "<u4"),
        ("byte_order", "<u4"),
        ("checksum", "<u8"),
        ("size", "<u8"),
        ("directory", "<u8"),
        ("arrays", "<u8"),
        ("json", "<u8"),
        ("json_size", "<u8"),
    ]
)
_ENTRY = np.dtype(
    [
        ("name", "S64"),
        ("type", "<u4"),
        ("dimensions", "<u4"),
        ("shape", "<u8", (4,)),
        ("offset", "<u8"),
        ("bytes", "<u8"),
        ("unused", "<u8"),
    ]
)


class PackedTableError(ValueError):
    """A file that is no packed table, is damaged, or has another format; the message says which."""


class Packed(NamedTuple):
    """The contents of a packed table."""

    # read-only views of the file's bytes; `packed.arrays` describes each
    arrays: dict[str, NDArray[Any]]
    meta: dict[str, Any]  # the JSON block
    content: memoryview  # the file's bytes


def pieces(arrays: Mapping[str, NDArray[Any]], meta: Mapping[str, Any]) -> list[bytes]:
    """Return the file of a packed table as pieces of bytes.

    `arrays`: of float64, int32, int64 or uint8, of at most four dimensions.
    `meta`: JSON-able values.

    Raises PackedTableError if an array has another type, too many dimensions or too long a name.
    """
    text = json.dumps(meta, sort_keys=True, ensure_ascii=False, allow_nan=False).encode() + b"\0"
    names = sorted(arrays, key=str.encode)
    directory = np.zeros(len(names), dtype=_ENTRY)
    offset = _aligned(_HEADER.itemsize + directory.nbytes + len(text))
    contents: list[bytes] = []
    for entry, name in zip(directory, names, strict=True):
        array = np.asarray(arrays[name])
        code = _CODES.get(array.dtype.newbyteorder("<"))
        if code is None or array.ndim > 4 or len(name.encode()) >= 64:
            raise PackedTableError(
                f"array {name} is {array.dtype} of shape {array.shape}; convert it to float64, "
                "int32, int64 or uint8 of at most 4 dimensions, with a name below 64 bytes"
            )
        content = np.ascontiguousarray(array, dtype=_TYPES[code]).tobytes()
        entry["name"], entry["type"], entry["dimensions"] = name.encode(), code, array.ndim
        entry["shape"][: array.ndim] = array.shape
        entry["offset"], entry["bytes"] = offset, len(content)
        contents.append(content.ljust(_aligned(len(content)), b"\0"))
        offset += len(contents[-1])
    head = directory.tobytes() + text
    head = head.ljust(_aligned(_HEADER.itemsize + len(head)) - _HEADER.itemsize, b"\0")
    text_at = _HEADER.itemsize + directory.nbytes
    header = np.zeros(1, dtype=_HEADER)
    header[0] = (
        *(MAGIC, FORMAT, _BYTE_ORDER, 0, offset),
        *(_HEADER.itemsize, len(names), text_at, len(text) - 1),
    )
    header["checksum"] = _checksum(header.tobytes(), (head, *contents))
    return [header.tobytes(), head, *contents]


def _checksum(header: bytes, blocks: Iterable[bytes | memoryview]) -> int:
    checksum = zlib.crc32(header[CHECKSUM.stop :], zlib.crc32(header[: CHECKSUM.start]))
    for block in blocks:
        checksum = zlib.crc32(block, checksum)
    return checksum


def write_file(path: Path, content: list[bytes]) -> None:
    """Write pieces to a file, which is replaced as a whole.

    Raises OSError if the file cannot be written.
    """
    # Files of tempfile have mode 0600.
    partial = path.with_name(f".{path.name}-{secrets.token_hex(8)}")
    try:
        with partial.open("xb") as file:
            file.writelines(content)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def read(content: bytes | bytearray | memoryview | mmap.mmap) -> Packed:
    """Return the contents of a packed table's bytes.

    Raises PackedTableError if the bytes are no packed table, damaged, or of another format.
    """
    buffer = memoryview(content)
    _check(buffer[: _HEADER.itemsize].tobytes(), len(buffer), (buffer[_HEADER.itemsize :],))
    return _views(buffer)


def map_file(path: str | os.PathLike[str]) -> Packed:
    """Return the contents of a packed table's file, mapped: the system reads pages on first use.

    The checksum is computed from the same open file that is mapped.

    Raises OSError if the file cannot be read, PackedTableError as `read`.
    """
    with open(path, "rb", opener=_without_waiting) as file:  # mmap takes the file's descriptor
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise PackedTableError("this is a folder or a device, not a file; name a .wbt file")
        size = file.seek(0, os.SEEK_END)
        file.seek(0)
        head = file.read(_HEADER.itemsize)
        _check(head, size, iter(lambda: file.read(BLOCK), b""))
        return _views(memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)))


def _without_waiting(path: str, flags: int) -> int:
    """Open a path without blocking on a pipe that no process writes to; pipes are refused later."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def _aligned(size: int) -> int:
    return -(-size // ALIGNED) * ALIGNED


def _check(head: bytes, size: int, following: Iterable[bytes | memoryview]) -> None:
    """Raise PackedTableError if header, size or checksum are wrong.

    `head`: the header; `following`: blocks of all other bytes.
    """
    if len(head) < _HEADER.itemsize or head[: len(MAGIC)] != MAGIC:
        raise PackedTableError(
            "this is not a packed table (.wbt); load rows with wrenchbook import, and save a table "
            "with Table.save"
        )
    header = np.frombuffer(head, dtype=_HEADER)[0]
    if header["byte_order"] != _BYTE_ORDER:
        raise PackedTableError(
            f"the table is damaged: its byte-order mark is {header['byte_order']:#010x}, not "
            f"{_BYTE_ORDER:#010x}; download it again"
        )
    if header["format"] != FORMAT:
        remedy = "use a newer wrenchbook" if header["format"] > FORMAT else "download it again"
        raise PackedTableError(
            f"the table has format {header['format']}; this program reads {FORMAT}: {remedy}"
        )
    if header["size"] != size:
        raise PackedTableError(f"the file has {size} of {header['size']} bytes; download it again")
    if _checksum(head, following) != header["checksum"]:
        raise PackedTableError("the table is damaged: its checksum is wrong; download it again")


def _views(buffer: memoryview) -> Packed:
    """Return the directory's arrays as views of a checked file's bytes, and its JSON block."""
    try:
        header = np.frombuffer(buffer, dtype=_HEADER, count=1)[0]
        at, count = int(header["directory"]), int(header["arrays"])
        arrays = {}
        for entry in np.frombuffer(buffer, dtype=_ENTRY, count=count, offset=at):
            shape = tuple(entry["shape"][: entry["dimensions"]].tolist())
            dtype = _TYPES[int(entry["type"])]
            items = int(entry["bytes"]) // dtype.itemsize
            view = np.frombuffer(buffer, dtype=dtype, count=items, offset=int(entry["offset"]))
            arrays[entry["name"].decode()] = view.reshape(shape)
        start = int(header["json"])
        meta = json.loads(buffer[start : start + int(header["json_size"])].tobytes())
        for view in arrays.values():
            view.flags.writeable = False
        return Packed(arrays, meta, buffer)
    except (LookupError, TypeError, ValueError) as error:
        raise PackedTableError(
            "the table's list of arrays is damaged, though its checksum is right; build it again"
        ) from error
