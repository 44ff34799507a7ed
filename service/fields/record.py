"""The stored fields of one solve: files of arrays, exact or rounded, with a digest.

A solver leaves two files in the attempt's folder: the geometry, which all rows of a component
share, and the row's fields. Displacements are rounded to 2^-44 of their largest number, stresses to
2^-24 and slopes to 2^-20, which suffice for interpolation; a linear component's slopes are its
complete answer and rounded to 2^-44.

A file is `MAGIC`, the length of a JSON header (four bytes, little-endian), the header and the
compressed columns one after the other. The header has each column's shape and steps and a digest
of all, so that a file that was cut off or damaged is not taken for numbers. The README has the
rounding and the packing of a column.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from hashlib import blake2b
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wrenchbook.service.files.durable import write_atomically

GEOMETRY, ROW = "geometry.fields", "row.fields"  # the solver's names of both files
FINE, STRESS, SLOPES = 44, 24, 20  # bits of displacements, stresses and slopes, see above
MAGIC = b"wrenchbook fields 1\n"
EXACT = 0  # number of bits that means: stored without rounding
MAX_COLUMN_BYTES = 1 << 28  # of one unpacked column: no header may request all memory
_MAX_BITS = 50  # differences of multiples must fit 64 bits, and multiples a float64
_MAX_BITS_32 = 30  # bits of multiples whose differences, with one bit more, fit 32 bits
_MIN_EXPONENT = -1074  # the least exponent of a float64

Array = NDArray[Any]


class DamagedFieldsError(Exception):
    """A file differs from what was written."""


class Column(NamedTuple):
    """An array, shape (n, ...), SI or indices, and the number of stored bits."""

    values: Array
    bits: int = EXACT


def pack(meta: Mapping[str, Any], columns: Mapping[str, Column]) -> bytes:
    """Return the file of arrays and JSON values; raises ValueError unless numbers are finite."""
    entries, payloads = zip(*(_pack_column(*item) for item in columns.items()), strict=True)
    body = b"".join(payloads)
    header: dict[str, Any] = {"meta": dict(meta), "columns": entries}
    header["digest"] = _digest(header, body)
    text = json.dumps(header, allow_nan=False).encode()
    return MAGIC + len(text).to_bytes(4, "little") + text + body


def read_meta(content: bytes) -> dict[str, Any]:
    """Return the JSON values of a file's header, without its columns."""
    return _header(content)[0]["meta"]


def unpack(content: bytes) -> tuple[dict[str, Any], dict[str, Array]]:
    """Return the header's JSON values and the arrays by name; raises DamagedFieldsError."""
    header, start = _header(content)
    body = content[start:]
    digest = header.pop("digest", None)
    try:
        intact = digest == _digest(header, body)
    except ValueError:  # a number of the header is infinite or NaN
        intact = False
    if not intact:
        raise DamagedFieldsError("its checksum is wrong, so the file is damaged")
    columns = {}
    start = 0
    for entry in header["columns"]:
        columns[entry["name"]] = _unpack_column(entry, body[start : start + entry["bytes"]])
        start += entry["bytes"]
    return header["meta"], columns


def _header(content: bytes) -> tuple[dict[str, Any], int]:
    """Return a file's header and the offset of its columns; raises DamagedFieldsError."""
    start = len(MAGIC) + 4
    if content[: len(MAGIC)] != MAGIC:
        begins = f"begins with {content[:20]!r}" if content else "is empty"
        raise DamagedFieldsError(f"it {begins}, so it is not a file of fields")
    length = int.from_bytes(content[len(MAGIC) : start], "little")
    try:
        header = json.loads(content[start : start + length])
    except ValueError as error:
        raise DamagedFieldsError(f"its header of {length} bytes is damaged: {error}") from error
    parts = header if isinstance(header, dict) else {}
    if not isinstance(parts.get("meta"), dict) or not isinstance(parts.get("columns"), list):
        raise DamagedFieldsError("its header is damaged: it lacks the members meta or columns")
    return header, start + length


def _digest(header: Mapping[str, Any], body: bytes) -> str:
    text = json.dumps(header, sort_keys=True, allow_nan=False).encode()
    return blake2b(body, key=blake2b(text, digest_size=32).digest(), digest_size=16).hexdigest()


def _pack_column(name: str, column: Column) -> tuple[dict[str, Any], bytes]:
    """Return a column's entry in the header, and its compressed bytes."""
    values, bits = column
    if not np.isfinite(values).all():
        count = int((~np.isfinite(values)).sum())
        raise ValueError(f"{count} of the {values.size} numbers of {name} are not finite")
    entry: dict[str, Any] = {"name": name, "shape": list(values.shape)}
    if bits == EXACT:
        kind = "i4" if values.dtype.kind in "iu" else "f8"
        numbers = np.ascontiguousarray(values, dtype=f"<{kind}")
        entry |= {"kind": kind}
    else:
        # A step for each last index: a power of two, so that nothing is lost.
        size = np.abs(values).max(axis=tuple(range(values.ndim - 1)), initial=0.0)
        exponent = np.frexp(size)[1] - min(bits, _MAX_BITS)  # size < 2^exponent before
        steps = np.where(size > 0, np.ldexp(1.0, np.maximum(exponent, _MIN_EXPONENT)), 1.0)
        multiples = np.rint(values / steps).astype("<i8")
        numbers = np.diff(multiples, axis=0, prepend=np.zeros_like(multiples[:1]))
        if bits <= _MAX_BITS_32:
            numbers = numbers.astype("<i4")
        entry |= {"kind": f"i{numbers.itemsize}", "steps": np.ravel(steps).tolist()}
    # All first bytes, then all second ones, and so on: similar bytes are neighbours. Huffman's code
    # alone is as small as with a search for repeated strings, which are rare here.
    planes = np.ascontiguousarray(numbers).view(np.uint8).reshape(-1, numbers.itemsize).T
    packer = zlib.compressobj(1, zlib.DEFLATED, zlib.MAX_WBITS, 9, zlib.Z_HUFFMAN_ONLY)
    payload = packer.compress(np.ascontiguousarray(planes).tobytes()) + packer.flush()
    return entry | {"bytes": len(payload)}, payload


def _unpack_column(entry: Mapping[str, Any], payload: bytes) -> Array:
    """Return the array of a column from its header entry and compressed bytes."""
    name = entry["name"]
    shape = tuple(entry["shape"])
    kind = np.dtype(f"<{entry['kind']}")
    size = int(np.prod(shape, dtype=object)) * kind.itemsize
    if not 0 <= size <= MAX_COLUMN_BYTES:
        raise DamagedFieldsError(
            f"its column {name} claims {size} bytes, more than {MAX_COLUMN_BYTES}"
        )
    try:
        raw = zlib.decompressobj().decompress(payload, size) if size else b""
    except zlib.error as error:
        raise DamagedFieldsError(f"its column {name} cannot be unpacked: {error}") from error
    if len(raw) != size:
        raise DamagedFieldsError(f"its column {name} is cut off: {len(raw)} of {size} bytes")
    planes = np.frombuffer(raw, np.uint8).reshape(kind.itemsize, -1).T
    numbers = np.ascontiguousarray(planes).view(kind).reshape(shape)
    if "steps" not in entry:
        return numbers
    return np.cumsum(numbers, axis=0, dtype=np.int64) * np.array(entry["steps"])


class SurfaceGeometry(NamedTuple):
    """The undeformed surface, and the points of stresses; in the interface frame."""

    vertices: Array  # (v, 3), m
    triangles: Array  # (t, 3)
    full_vertices: int  # number of vertices of the surface before it was simplified
    places: Array  # (p, 3), m
    materials: Array  # (p,)
    regions: tuple[str, ...]  # the materials' regions
    digest: str  # digest of all this: a row's fields belong to the geometry with the same digest


class RowFields(NamedTuple):
    """The fields of one row; shapes as in `fea.recovery.fields.SolveFields`.

    `meta` has ``wrench``, ``linear``, ``geometry`` (its digest), ``largest``, ``at``, ``region``,
    and ``weight`` (true) where the fields at zero load are those of the component's weight.
    """

    displacement: Array  # (v, 3), m
    displacement_slopes: Array  # (v, 3, 6), m/N and m/(N·m)
    stress: Array  # (p, 6), Pa
    stress_slopes: Array  # (p, 6, 6), Pa/N and Pa/(N·m)
    meta: dict[str, Any]


def write_files(folder: Path, wrench: tuple[float, ...], fields: Any) -> None:
    """Write the files `GEOMETRY` and `ROW` into a folder, each atomically and durably.

    `fields` is a `fea.recovery.fields.SolveFields`, not imported: readers of the files import no
    finite elements.

    Raises OSError if they cannot be written, ValueError unless all numbers are finite.
    """
    names = "vertices", "triangles", "places", "materials"
    geometry = pack(
        {"whole_vertices": fields.full_vertices, "regions": list(fields.regions)},
        {name: Column(getattr(fields, name)) for name in names},
    )
    meta = {
        "wrench": list(wrench),
        "linear": fields.linear,
        "geometry": digest_of(geometry),
        "largest": fields.largest,
        "at": list(fields.largest_at),
        "region": fields.largest_region,
    }
    if fields.weight:
        meta["weight"] = True
    slopes = FINE if fields.linear else SLOPES
    columns = {
        "displacement": Column(fields.displacement, FINE),
        "displacement_slopes": Column(fields.displacement_slopes, slopes),
        "stress": Column(fields.stress, STRESS),
        "stress_slopes": Column(fields.stress_slopes, slopes),
    }
    row = pack(meta, columns)
    write_atomically(folder / GEOMETRY, geometry)
    write_atomically(folder / ROW, row)


def digest_of(geometry: bytes) -> str:
    """Return the digest that identifies a geometry's file."""
    return blake2b(geometry, digest_size=12).hexdigest()


def read_geometry(content: bytes) -> SurfaceGeometry:
    """Return the geometry of a file; raises DamagedFieldsError if it is damaged."""
    meta, columns = unpack(content)
    vertices, regions = int(meta["whole_vertices"]), tuple(meta["regions"])
    return SurfaceGeometry(
        **columns, full_vertices=vertices, regions=regions, digest=digest_of(content)
    )


def read_row(content: bytes) -> RowFields:
    """Return the fields of a row's file; raises DamagedFieldsError if it is damaged."""
    meta, columns = unpack(content)
    return RowFields(**columns, meta=meta)
