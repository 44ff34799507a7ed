"""Bytes of wrenches and rows: canonical packing, content keys and seals."""

import math
import struct
from collections.abc import Iterable, Sequence
from hashlib import blake2b
from typing import Any

import numpy as np

from wrenchbook.service.ledger.records import NotedRows, Vector

_NAN = np.float64(np.nan)
_KEY_BYTES = 16
MIN_NUMBERS = 6
"""Numbers of a wrench or displacement: six an interface, and further inputs."""


def pack_vector(values: Sequence[float]) -> bytes:
    """Return the canonical bytes of a wrench: little-endian float64, no minus zero.

    Raises ValueError if there are fewer than six numbers or one is not finite.
    """
    if len(values) < MIN_NUMBERS:
        raise ValueError(f"wrench needs 6 numbers or more, got {len(values)}")
    floats = [float(value) + 0.0 for value in values]
    if not all(map(math.isfinite, floats)):
        raise ValueError(f"wrench must be finite, got {floats}")
    return struct.pack(f"<{len(floats)}d", *floats)


def unpack_vector(packed: bytes) -> Vector:
    """Return the floats of `pack_vector`."""
    return struct.unpack(f"<{len(packed) // 8}d", packed)


def packed(wrenches: np.ndarray) -> list[bytes]:
    """Return each wrench (n, inputs), N and N·m, as the ledger packs it; NaN is one NaN."""
    plain = np.where(np.isnan(wrenches), _NAN, np.asarray(wrenches) + 0.0).astype("<f8")
    block, width = plain.tobytes(), 8 * plain.shape[1]
    return [block[start : start + width] for start in range(0, len(block), width)]


def unpacked(wrenches: Iterable[bytes], inputs: int = MIN_NUMBERS) -> np.ndarray:
    """Return packed wrenches as an array of shape (n, inputs), N and N·m."""
    return np.frombuffer(b"".join(wrenches), dtype="<f8").reshape(-1, inputs).astype(float)


def content_key(*parts: bytes) -> bytes:
    """Return 16 bytes that are the same only for the same parts."""
    return blake2b(b"".join(map(_part, parts)), digest_size=_KEY_BYTES).digest()


def row_key(
    component: str,
    fingerprint: str,
    source: str,
    wrench: bytes,
    displacement: bytes,
    uncertainty: bytes | None,
) -> bytes:
    """Return the content key of a row.

    Compliance and curvature are left out: a table that comes back from a file without them is
    still the same table.
    """
    texts = component.encode(), fingerprint.encode(), source.encode()
    return content_key(*texts, wrench, displacement, uncertainty or b"")


def seal(key: bytes, compliance: bytes | None, origin: str, curvature: bytes | None) -> bytes:
    """Return 16 bytes over the key and what it leaves out; rows of 0.2 have no curvature."""
    parts = key, compliance or b"", origin.encode()
    return content_key(*parts, *(() if curvature is None else (curvature,)))


def row_records(
    component: str, block: NotedRows, now: float, job: int | None = None
) -> list[tuple[Any, ...]]:
    """Return rows as the columns `rows.CONTENT`; raises ValueError for an infinite tangent.

    One by one a million rows would take a minute; by columns they take 10 s.
    """
    rows = block.rows
    if np.isinf(rows.compliance).any():
        raise ValueError("compliance must be finite, or NaN where it is not known")
    wrenches, displacements = packed(rows.wrench), packed(rows.displacement)
    # An output whose uncertainty is not known is NaN, which is not 0: exact.
    uncertainties = _known(rows.uncertainty, np.any(np.isfinite(rows.uncertainty), axis=1))
    tangents = _complete(rows.compliance)
    thirds = _complete(rows.curvature)
    sources, fingerprints = rows.source.tolist(), rows.fingerprint.tolist()
    name = _part(component.encode())
    notes = block.note
    texts = {text: _part(text.encode()) for text in {*sources, *fingerprints, *notes}}
    of_load, of_move = (_length(8 * shape.shape[1]) for shape in (rows.wrench, rows.displacement))
    unknown, of_key, records = _part(b""), _length(_KEY_BYTES), []
    for load, move, uncertainty, tangent, third, source, fingerprint, note in zip(
        wrenches,
        displacements,
        uncertainties,
        tangents,
        thirds,
        sources,
        fingerprints,
        notes,
        strict=True,
    ):
        # The bytes of `row_key` and `seal`, joined once.
        parts = name + texts[fingerprint] + texts[source] + of_load + load + of_move + move
        parts += of_move + uncertainty if uncertainty else unknown
        key = blake2b(parts, digest_size=_KEY_BYTES).digest()
        if tangent is None and third is None:
            parts = of_key + key + unknown + texts[note]
            mark = blake2b(parts, digest_size=_KEY_BYTES).digest()
        else:
            mark = seal(key, tangent, note, third)
        content = component, fingerprint, source, load, move, tangent, third, uncertainty
        records.append((*content, job, now, note, key, mark))
    return records


def row_keys(component: str, block: NotedRows) -> list[bytes]:
    """Return the content key of each row."""
    return [record[-2] for record in row_records(component, block, 0.0)]


def _part(content: bytes) -> bytes:
    return _length(len(content)) + content


def _length(size: int) -> bytes:
    return size.to_bytes(4, "little")


def _known(column: np.ndarray, known: np.ndarray) -> list[bytes | None]:
    if not known.any():
        return [None] * len(column)
    return [value if there else None for value, there in zip(packed(column), known, strict=True)]


def _complete(column: np.ndarray) -> list[bytes | None]:
    """Return the bytes of those rows that have all numbers of a column; None for others."""
    if not column.size:
        return [None] * len(column)
    flat = column.reshape(len(column), -1)
    return _known(flat, np.all(np.isfinite(flat), axis=1))
