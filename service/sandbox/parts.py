"""What both sides share: limits, errors, and the file format of a result.

A result is a sequence of parts in a file. A part is the length of its head, the head (JSON: fields;
name, type and shape of each array) and the arrays' bytes. No result can run code in the reader: at
worst its numbers are wrong.
"""

from __future__ import annotations

import math
import mmap
import os
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, BinaryIO, Final

import numpy as np
import orjson

MIB: Final = 1 << 20
MOST_FIELDS: Final = 256 * MIB  # JSON of a part: the notes and names of a million rows
MOST_PARTS: Final = 100_000
_LENGTH: Final = struct.Struct("<Q")
_TYPES: Final = frozenset({"<f8", "<i8", "<i4", "|u1", "|b1"})
_ALIGNED: Final = 8


@dataclass(frozen=True)
class Limits:
    """Resource limits of one file.

    Parameters
    ----------
    memory : int
        Bytes in addition to what the process has when it begins: a million rows of a table with
        tangents are 350 MB, at most two copies at a time.
    seconds : float
        Of processor time, and of elapsed time.
    output : int
        Bytes of each file that the process writes, its result included.
    """

    memory: int = 1024 * MIB
    seconds: float = 60.0
    output: int = 1024 * MIB


class SandboxError(ValueError):
    """A file that cannot be read within its limits; nothing was changed.

    Attributes
    ----------
    kind : str
        ``memory``, ``time``, ``size`` (of its content), ``crash`` (the parser died or its result is
        malformed), or the name of the exception that the parser raised.
    """

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind


class SandboxBusyError(RuntimeError):
    """No place became free within a minute."""


@dataclass(frozen=True)
class Part:
    """JSON fields, and arrays of plain numbers by name.

    The arrays of a result are read-only views of its file; their pages come into memory as they
    are read.
    """

    fields: Mapping[str, Any] = field(default_factory=dict)
    arrays: Mapping[str, np.ndarray] = field(default_factory=dict)


def write_parts(file: BinaryIO, parts: Iterable[Part]) -> None:
    """Write parts as they come, one in memory at a time."""
    for part in parts:
        arrays = {
            name: np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
            for name, array in part.arrays.items()
        }
        described = [[name, array.dtype.str, array.shape] for name, array in arrays.items()]
        head = orjson.dumps({"fields": part.fields, "arrays": described})
        head += b" " * (-(len(head) + _LENGTH.size) % _ALIGNED)
        file.write(_LENGTH.pack(len(head)))
        file.write(head)
        for array in arrays.values():
            file.write(array.data if array.size else b"")
            file.write(b"\0" * (-array.nbytes % _ALIGNED))
    file.flush()


def read_parts(descriptor: int) -> list[Part]:
    """Return the parts in a file.

    Raises
    ------
    SandboxError
        If the file is not of parts alone.
    """
    size = os.fstat(descriptor).st_size
    if not size:
        return []
    content = mmap.mmap(descriptor, size, access=mmap.ACCESS_READ)
    parts, at = [], 0
    while at < size:
        if len(parts) == MOST_PARTS:
            raise _malformed("the answer has too many parts")
        part, at = _read_part(content, at, size)
        parts.append(part)
    return parts


def _read_part(content: mmap.mmap, at: int, size: int) -> tuple[Part, int]:
    if size - at < _LENGTH.size:
        raise _malformed("the answer ends within a part")
    (length,) = _LENGTH.unpack_from(content, at)
    at += _LENGTH.size
    if length > min(MOST_FIELDS, size - at):
        raise _malformed("the head of a part is too long")
    try:
        head = orjson.loads(content[at : at + length])
        described = [(str(name), str(kind), tuple(shape)) for name, kind, shape in head["arrays"]]
        fields = dict(head["fields"])
    except (orjson.JSONDecodeError, KeyError, TypeError, ValueError):
        raise _malformed("the head of a part is not of its form") from None
    arrays, at = {}, at + length
    for name, kind, shape in described:
        arrays[name], at = _read_array(content, at, size, kind, shape)
    return Part(fields, arrays), at


def _read_array(
    content: mmap.mmap, at: int, size: int, kind: str, shape: tuple[Any, ...]
) -> tuple[np.ndarray, int]:
    if kind not in _TYPES or not all(type(length) is int and length >= 0 for length in shape):
        raise _malformed("an array is of no known type or shape")
    count, dtype = math.prod(shape), np.dtype(kind)
    if count * dtype.itemsize > size - at:
        raise _malformed("an array is longer than the answer")
    array = np.frombuffer(content, dtype, count, at) if count else np.empty(0, dtype)
    end = at + array.nbytes
    return array.reshape(shape), end + -end % _ALIGNED


def _malformed(why: str) -> SandboxError:
    return SandboxError("crash", f"Its reader's answer cannot be used: {why}.")
