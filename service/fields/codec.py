"""Arrays in a file of their own: exact or rounded to a stated step, compressed, with a digest.

A file is `MAGIC`, the length of a JSON header (four bytes, little-endian), the header and the
compressed columns one after the other. The header has each column's shape and steps and a digest
of all, so that a file that was cut off or damaged is not taken for numbers.

A column is rounded to whole multiples of a step, 2^-bits of its largest number or finer, by the
last index of the array; the multiples are stored as differences from one entry to the next, byte by
byte: neighbouring nodes of a mesh move alike, so the high bytes are zero and compress well.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from hashlib import blake2b
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

MAGIC = b"wrenchbook fields 1\n"
EXACT = 0  # bits of a column that is stored as it is
MOST_BYTES = 1 << 28  # of one column unpacked: no header may ask for all memory
_MOST_BITS = 50  # differences of multiples must fit 64 bits, and multiples a float64
_LEAST_EXPONENT = -1074  # of a float64
_KINDS = {"f8": "<f8", "i4": "<i4"}

Array = NDArray[Any]


class DamagedFieldsError(Exception):
    """A file that is not, byte for byte, what was written."""


class Column(NamedTuple):
    """An array, shape (n, ...), SI or indices, and to how many bits of its largest it is kept."""

    values: Array
    bits: int = EXACT


def pack(meta: Mapping[str, Any], columns: Mapping[str, Column]) -> bytes:
    """Return the file of some arrays and of JSON values for its header.

    Raises
    ------
    ValueError
        If a number is not finite.
    """
    entries, payloads = [], []
    for name, column in columns.items():
        entry, payload = _packed(name, column)
        entries.append(entry)
        payloads.append(payload)
    body = b"".join(payloads)
    header: dict[str, Any] = {"meta": dict(meta), "columns": entries}
    header["digest"] = _digest(header, body)
    text = json.dumps(header, allow_nan=False).encode()
    return MAGIC + len(text).to_bytes(4, "little") + text + body


def read_meta(content: bytes) -> dict[str, Any]:
    """Return the JSON values of a file's header, without its columns.

    Raises
    ------
    DamagedFieldsError
        If it is no such file.
    """
    return _header(content)[0]["meta"]


def unpack(content: bytes) -> tuple[dict[str, Any], dict[str, Array]]:
    """Return what was packed: the header's words, and each array by its name.

    Each has the shape (n, ...) and the unit, SI or indices, that it was packed with.

    Raises
    ------
    DamagedFieldsError
        If the file is not as it was written.
    """
    header, start = _header(content)
    body, digest = content[start:], header.pop("digest", None)
    try:
        whole = digest == _digest(header, body)
    except ValueError:  # a number of the header is infinite or NaN
        whole = False
    if not whole:
        raise DamagedFieldsError("its checksum is wrong: the file is damaged")
    found, place = {}, 0
    for entry in header["columns"]:
        found[entry["name"]] = _unpacked(entry, body[place : place + entry["bytes"]])
        place += entry["bytes"]
    return header["meta"], found


def _header(content: bytes) -> tuple[dict[str, Any], int]:
    start = len(MAGIC) + 4
    if content[: len(MAGIC)] != MAGIC:
        raise DamagedFieldsError("it does not begin as a file of fields does")
    length = int.from_bytes(content[len(MAGIC) : start], "little")
    try:
        header = json.loads(content[start : start + length])
        if not isinstance(header["meta"], dict) or not isinstance(header["columns"], list):
            raise ValueError("its header is of another form")
    except (ValueError, KeyError, TypeError) as error:
        raise DamagedFieldsError(f"its header cannot be read: {error}") from error
    return header, start + length


def _digest(header: Mapping[str, Any], body: bytes) -> str:
    text = json.dumps(header, sort_keys=True, allow_nan=False).encode()
    return blake2b(body, key=blake2b(text, digest_size=32).digest(), digest_size=16).hexdigest()


def _packed(name: str, column: Column) -> tuple[dict[str, Any], bytes]:
    values, bits = column
    if not np.isfinite(values).all():
        raise ValueError(f"{name} has numbers that are not finite")
    entry: dict[str, Any] = {"name": name, "shape": list(values.shape)}
    if bits == EXACT:
        kind = "i4" if values.dtype.kind in "iu" else "f8"
        whole = np.ascontiguousarray(values, dtype=_KINDS[kind])
        entry |= {"kind": kind}
    else:
        steps = _steps(values, min(bits, _MOST_BITS))
        multiples = np.rint(values / steps).astype("<i8")
        whole = np.diff(multiples, axis=0, prepend=np.zeros_like(multiples[:1]))
        if bits <= 30:  # a difference of two takes one bit more
            whole = whole.astype("<i4")
        entry |= {"kind": f"i{whole.itemsize}", "steps": np.ravel(steps).tolist()}
    payload = _compressed(_by_bytes(whole))
    return entry | {"bytes": len(payload)}, payload


def _steps(values: Array, bits: int) -> Array:
    """Return a step for each last index, shape (k,): a power of two, so that nothing is lost."""
    size = np.abs(values).max(axis=tuple(range(values.ndim - 1)), initial=0.0)
    _, exponent = np.frexp(size)  # size < 2^exponent
    return np.where(size > 0, np.ldexp(1.0, np.maximum(exponent - bits, _LEAST_EXPONENT)), 1.0)


def _unpacked(entry: Mapping[str, Any], payload: bytes) -> Array:
    shape, kind = tuple(entry["shape"]), np.dtype(f"<{entry['kind']}")
    size = int(np.prod(shape, dtype=object)) * kind.itemsize
    if not 0 <= size <= MOST_BYTES:
        raise DamagedFieldsError(f"its column {entry['name']} claims {size} bytes")
    try:
        raw = zlib.decompressobj().decompress(payload, size) if size else b""
    except zlib.error as error:
        raise DamagedFieldsError(f"its column {entry['name']} cannot be unpacked") from error
    if len(raw) != size:
        raise DamagedFieldsError(f"its column {entry['name']} is cut off")
    flat = np.frombuffer(raw, np.uint8).reshape(kind.itemsize, -1).T
    whole = np.ascontiguousarray(flat).view(kind).reshape(shape)
    if "steps" not in entry:
        return whole
    return np.cumsum(whole, axis=0, dtype=np.int64) * np.array(entry["steps"])


def _compressed(content: bytes) -> bytes:
    """Compress by Huffman's code alone: of such bytes no longer words come twice."""
    packer = zlib.compressobj(1, zlib.DEFLATED, zlib.MAX_WBITS, 9, zlib.Z_HUFFMAN_ONLY)
    return packer.compress(content) + packer.flush()


def _by_bytes(whole: Array) -> bytes:
    """Return all first bytes, then all second ones, ...: like bytes stand together."""
    flat = np.ascontiguousarray(whole).view(np.uint8).reshape(-1, whole.itemsize)
    return np.ascontiguousarray(flat.T).tobytes()
