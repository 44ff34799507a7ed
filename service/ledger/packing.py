"""Bytes of wrenches and rows: canonical packing, content keys and seals."""

import math
import struct
from collections.abc import Iterable, Sequence
from hashlib import blake2b
from itertools import repeat
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
    return _bytes(_plain(wrenches)).tolist()


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

    By columns a million rows take 1.2 s of processor time, 0.7 s of it in blake2b.
    """
    rows = block.rows
    if np.isinf(rows.compliance).any():
        raise ValueError("compliance must be finite, or NaN where it is not known")
    # An output whose uncertainty is not known is NaN, which is not 0: exact.
    uncertainties = _known(rows.uncertainty, np.any(np.isfinite(rows.uncertainty), axis=1))
    tangents, thirds = _complete(rows.compliance), _complete(rows.curvature)
    setups, sources, notes = rows.fingerprint.tolist(), rows.source.tolist(), block.note
    # The bytes of `row_key`: texts, then the numbers behind their lengths, joined by columns.
    texts = {text: _part(text.encode()) for text in {*setups, *sources, *notes}}
    name = _part(component.encode())
    heads = {(a, b): name + texts[a] + texts[b] for a, b in set(zip(setups, sources, strict=True))}
    loads, moves = _plain(rows.wrench), _plain(rows.displacement)
    sizes = [8 * column.shape[1] for column in (loads, moves)]
    numbers = np.empty(
        len(rows),
        [("a", "<u4"), ("load", f"V{sizes[0]}"), ("b", "<u4"), ("move", f"V{sizes[1]}")],
    )
    numbers["a"], numbers["b"] = sizes
    numbers["load"], numbers["move"] = _bytes(loads), _bytes(moves)
    of_move, unknown = _length(sizes[1]), _part(b"")
    keys = [
        blake2b(
            heads[setup, source] + content + (of_move + bounds if bounds else unknown),
            digest_size=_KEY_BYTES,
        ).digest()
        for setup, source, content, bounds in zip(
            setups, sources, _bytes(numbers).tolist(), uncertainties, strict=True
        )
    ]
    of_key, rest = _length(_KEY_BYTES), {note: unknown + texts[note] for note in set(notes)}
    seals = [
        blake2b(of_key + key + rest[note], digest_size=_KEY_BYTES).digest()
        if tangent is None and third is None
        else seal(key, tangent, note, third)
        for key, tangent, note, third in zip(keys, tangents, notes, thirds, strict=True)
    ]
    columns = setups, sources, _bytes(loads).tolist(), _bytes(moves).tolist(), tangents, thirds
    facts = repeat(job), repeat(now), notes, keys, seals
    return list(zip(repeat(component), *columns, uncertainties, *facts))


def row_keys(component: str, block: NotedRows) -> list[bytes]:
    """Return the content key of each row."""
    return [record[-2] for record in row_records(component, block, 0.0)]


def _plain(numbers: np.ndarray) -> np.ndarray:
    """Return numbers (n, k) as float64 in C order, with one NaN and no minus zero."""
    return np.where(np.isnan(numbers), _NAN, np.asarray(numbers) + 0.0).astype("<f8", "C")


def _bytes(lines: np.ndarray) -> np.ndarray:
    """Return the lines of an array in C order as opaque bytes, shape (n,)."""
    size = lines.dtype.itemsize * math.prod(lines.shape[1:])
    return lines.view(f"V{size}").reshape(len(lines)) if size else np.zeros(len(lines), "V1")


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
