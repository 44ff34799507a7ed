"""How a child answers: parts of JSON fields and plain arrays, one after the other in a file.

A part is the length of its head, the head (JSON: its fields; name, type and shape of each array),
and the arrays' bytes. What a stranger's file has made of the child can at worst be wrong numbers.
"""

from __future__ import annotations

import mmap
import os
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, BinaryIO, Final

import numpy as np
import orjson

REQUEST_LENGTH: Final = struct.Struct("<I")  # of a request, which comes through a socket
_LENGTH: Final = struct.Struct("<Q")
_TYPES: Final = frozenset({"<f8", "<i8", "<i4", "|u1", "|b1"})
_ALIGNED: Final = 8
MOST_FIELDS: Final = 256 << 20  # bytes of JSON a part: the notes and names of a million rows
MOST_PARTS: Final = 100_000


class AnswerError(ValueError):
    """A child's answer is not of the form; its reader is at fault, or a stranger's."""


@dataclass(frozen=True)
class Part:
    """Fields, as JSON has them, and plain numbers by name.

    Arrays that have been answered lie in the answer's file and cannot be written to; they come
    into memory as they are read.
    """

    fields: Mapping[str, Any] = field(default_factory=dict)
    arrays: Mapping[str, np.ndarray] = field(default_factory=dict)


def write_parts(file: BinaryIO, parts: Iterable[Part]) -> None:
    """Write parts as they come, each from its own memory."""
    for part in parts:
        arrays = {
            name: np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
            for name, array in part.arrays.items()
        }
        told = [[name, array.dtype.str, array.shape] for name, array in arrays.items()]
        head = orjson.dumps({"fields": part.fields, "arrays": told})
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
    AnswerError
        If the file is not of parts alone.
    """
    size = os.fstat(descriptor).st_size
    if not size:
        return []
    content = mmap.mmap(descriptor, size, access=mmap.ACCESS_READ)
    parts, at = [], 0
    while at < size:
        if len(parts) == MOST_PARTS:
            raise AnswerError("the answer has too many parts")
        part, at = _read_part(content, at, size)
        parts.append(part)
    return parts


def _read_part(content: mmap.mmap, at: int, size: int) -> tuple[Part, int]:
    if size - at < _LENGTH.size:
        raise AnswerError("the answer ends within a part")
    (length,) = _LENGTH.unpack_from(content, at)
    at += _LENGTH.size
    if length > min(MOST_FIELDS, size - at):
        raise AnswerError("the head of a part is too long")
    try:
        head = orjson.loads(content[at : at + length])
        told = [(str(name), str(kind), tuple(shape)) for name, kind, shape in head["arrays"]]
        fields = dict(head["fields"])
    except (orjson.JSONDecodeError, KeyError, TypeError, ValueError):
        raise AnswerError("the head of a part is not of its form") from None
    arrays, at = {}, at + length
    for name, kind, shape in told:
        arrays[name], at = _read_array(content, at, size, kind, shape)
    return Part(fields, arrays), at


def _read_array(
    content: mmap.mmap, at: int, size: int, kind: str, shape: tuple[Any, ...]
) -> tuple[np.ndarray, int]:
    if kind not in _TYPES or not all(type(length) is int and length >= 0 for length in shape):
        raise AnswerError("an array is of no known type or shape")
    count = 1
    for length in shape:
        count *= length
    of = np.dtype(kind)
    if count * of.itemsize > size - at:
        raise AnswerError("an array is longer than the answer")
    array = np.frombuffer(content, of, count, at) if count else np.empty(0, of)
    end = at + count * of.itemsize
    return array.reshape(shape), end + -end % _ALIGNED
