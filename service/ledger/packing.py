"""Bytes of wrenches and rows: canonical packing, content keys and seals.

A million rows packed one by one take a minute; `packed_columns` packs whole columns in 10 s.
"""

import math
import struct
from collections.abc import Iterable, Sequence
from hashlib import blake2b

import numpy as np

from wrenchbook.service.ledger.records import Matrix6, NewRow, Vector6

PackedRow = tuple[object, ...]
_NAN = np.float64(np.nan)
_WRENCH_BYTES = 6 * 8
_SIX = struct.Struct("<6d")
_THIRTY_SIX = struct.Struct("<36d")


def pack6(values: Sequence[float], name: str = "wrench", *, partial: bool = False) -> bytes:
    """Return the canonical bytes of six finite floats: little-endian float64, no minus zero.

    Parameters
    ----------
    partial : bool
        Whether some of them, not all, may be NaN: not measured.

    Raises
    ------
    ValueError
        If there are not six numbers or one is not finite.
    """
    if len(values) != 6:
        raise ValueError(f"{name} needs 6 numbers, got {len(values)}")
    # One NaN for all: equal rows must have equal bytes.
    floats = [math.nan if value != value else float(value) + 0.0 for value in values]
    known = [value for value in floats if value == value] if partial else floats
    if not known or not all(map(math.isfinite, known)):
        raise ValueError(f"{name} must be finite, got {floats}")
    return _SIX.pack(*floats)


def unpack6(packed: bytes) -> Vector6:
    """Return the six floats of `pack6`."""
    return _SIX.unpack(packed)


def pack36(matrix: Sequence[Sequence[float]]) -> bytes:
    """Return the bytes of a 6x6 matrix by rows; raises ValueError as `pack6` does."""
    if len(matrix) != 6:
        raise ValueError(f"compliance needs 6 rows, got {len(matrix)}")
    return b"".join(pack6(line, "compliance row") for line in matrix)


def unpack36(packed: bytes) -> Matrix6:
    """Return the six rows of `pack36`."""
    flat = _THIRTY_SIX.unpack(packed)
    return tuple(flat[start : start + 6] for start in range(0, 36, 6))


def content_key(*parts: bytes) -> bytes:
    """Return 16 bytes that are the same only for the same parts."""
    digest = blake2b(digest_size=16)
    for part in parts:
        digest.update(len(part).to_bytes(4, "little"))
        digest.update(part)
    return digest.digest()


def seal(key: bytes, compliance: bytes | None, origin: str) -> bytes:
    """Return 16 bytes over what a row's key leaves out."""
    return content_key(key, compliance or b"", origin.encode())


def row_values(
    component: str, fingerprint: str, row: NewRow, job: int | None, now: float
) -> PackedRow:
    """Return a row's values in the order of `rows.CONTENT`; raises ValueError as `pack6` does.

    Only a measured row, of no job, may have NaN for outputs that were not measured.
    """
    fingerprint = fingerprint if row.fingerprint is None else row.fingerprint
    wrench = pack6(row.wrench)
    measured = job is None and row.source != "fea"
    displacement = pack6(row.displacement, "displacement", partial=measured)
    compliance = None if row.compliance is None else pack36(row.compliance)
    # An output whose uncertainty is not known is NaN, which is not 0: exact.
    uncertainty = (
        None if row.uncertainty is None else pack6(row.uncertainty, "uncertainty", partial=True)
    )
    content = (component, fingerprint, row.source, wrench, displacement)
    key = row_key(*content, uncertainty)
    mark = seal(key, compliance, row.origin)
    return (*content, compliance, uncertainty, job, now, row.origin, key, mark)


def row_key(
    component: str,
    fingerprint: str,
    source: str,
    wrench: bytes,
    displacement: bytes,
    uncertainty: bytes | None,
) -> bytes:
    """Return the content key of a row."""
    # The compliance is left out: a table exported to CSV comes back without it and is still the
    # same row.
    words = (component.encode(), fingerprint.encode(), source.encode())
    return content_key(*words, wrench, displacement, uncertainty or b"")


def packed(wrenches: np.ndarray) -> list[bytes]:
    """Return each wrench as the ledger packs it: little-endian, no minus zero.

    The wrenches have shape (n, 6), N and N·m.
    """
    block = (np.asarray(wrenches, dtype="<f8") + 0.0).tobytes()
    return [block[at : at + _WRENCH_BYTES] for at in range(0, len(block), _WRENCH_BYTES)]


def unpacked(wrenches: Iterable[bytes]) -> np.ndarray:
    """Return packed wrenches as an array of shape (n, 6), N and N·m."""
    return np.frombuffer(b"".join(wrenches), dtype="<f8").reshape(-1, 6).astype(float)


def packed_columns(
    component: str,
    columns: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    texts: tuple[Sequence[str], Sequence[str], Sequence[str]],
    now: float,
) -> list[PackedRow]:
    """Return rows as `rows.add_hidden` inserts them: the same bytes as one by one.

    Parameters
    ----------
    component : str
    columns : tuple of ndarray
        Wrench (n, 6), N and N·m, finite; displacement (n, 6), m and rad, NaN where not measured;
        uncertainty (n, 6), NaN where not known; compliance (n, 6, 6), NaN where not known.
    texts : tuple of sequences of str
        Source, fingerprint and note of each row.
    now : float
        Time of the import, seconds since the epoch.
    """
    wrench, displacement, uncertainty, compliance = columns
    count = len(wrench)
    wrenches, moves = _bytes(wrench), _bytes(displacement)
    flat = compliance.reshape(count, 36)
    bars = _known(uncertainty, np.asarray(np.isfinite(uncertainty).any(axis=1)))
    tangents = _known(flat, np.asarray(np.isfinite(flat).all(axis=1)))
    name, lengths = _part(component.encode()), _Lengths()
    made = []
    for place in range(count):
        source, fingerprint, note = (column[place] for column in texts)
        load, move, bar = wrenches[place], moves[place], bars[place]
        digest = blake2b(name, digest_size=16)
        digest.update(lengths[fingerprint] + lengths[source])
        digest.update(_SIX_LENGTH + load + _SIX_LENGTH + move)
        digest.update(_SIX_LENGTH + bar if bar else _NONE)
        key = digest.digest()
        tangent = tangents[place]
        mark = seal(key, tangent, note)
        made.append(
            (component, fingerprint, source, load, move, tangent, bar, None, now, note, key, mark)
        )
    return made


def _part(content: bytes) -> bytes:
    """Return what `content_key` hashes for one part."""
    return len(content).to_bytes(4, "little") + content


_SIX_LENGTH, _NONE = (48).to_bytes(4, "little"), _part(b"")


class _Lengths(dict[str, bytes]):
    """Words as parts of a key; a table has few of them."""

    def __missing__(self, word: str) -> bytes:
        found = self[word] = _part(word.encode())
        return found


def _bytes(column: np.ndarray) -> list[bytes]:
    """Return the canonical bytes of each row: no minus zero, one NaN."""
    plain = np.where(np.isnan(column), _NAN, column + 0.0).astype("<f8")
    width = 8 * column.shape[1]
    whole = plain.tobytes()
    return [whole[start : start + width] for start in range(0, len(whole), width)]


def _known(column: np.ndarray, known: np.ndarray) -> list[bytes | None]:
    if not known.any():
        return [None] * len(column)
    return [one if there else None for one, there in zip(_bytes(column), known, strict=True)]
