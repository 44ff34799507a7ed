"""Rows as the ledger's table holds them, packed from whole columns at once.

A million rows one by one take a minute; their columns turned into bytes, and only the two digests
made for each, some ten seconds.
"""

from collections.abc import Iterable, Sequence
from hashlib import blake2b

import numpy as np

from wrenchbook.service.ledger.records import seal

PackedRow = tuple[object, ...]
_NAN = np.float64(np.nan)
_WRENCH_BYTES = 6 * 8


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
    """Return rows as `rows.add_many` inserts them: the same bytes as one by one.

    Parameters
    ----------
    component : str
    columns : tuple of ndarray
        Wrench (n, 6), N and N·m, finite; displacement (n, 6), m and rad, NaN where not measured;
        uncertainty (n, 6), NaN where not known; compliance (n, 6, 6), NaN where not known.
    texts : tuple of sequences of str
        Source, fingerprint and note of each row.
    now : float
        When they came, seconds since the epoch.
    """
    wrench, displacement, uncertainty, compliance = columns
    count = len(wrench)
    wrenches, moves = _bytes(wrench), _bytes(displacement)
    flat = compliance.reshape(count, 36)
    doubts = _known(uncertainty, np.asarray(np.isfinite(uncertainty).any(axis=1)))
    tangents = _known(flat, np.asarray(np.isfinite(flat).all(axis=1)))
    name, lengths = _part(component.encode()), _Lengths()
    made = []
    for place in range(count):
        source, fingerprint, note = (column[place] for column in texts)
        load, move, doubt = wrenches[place], moves[place], doubts[place]
        digest = blake2b(name, digest_size=16)
        digest.update(lengths[fingerprint] + lengths[source])
        digest.update(_SIX + load + _SIX + move)
        digest.update(_SIX + doubt if doubt else _NONE)
        key = digest.digest()
        tangent = tangents[place]
        mark = seal(key, tangent, note)
        made.append(
            (component, fingerprint, source, load, move, tangent, doubt, None, now, note, key, mark)
        )
    return made


def _part(content: bytes) -> bytes:
    """Return what `records.content_key` takes in for one part."""
    return len(content).to_bytes(4, "little") + content


_SIX, _NONE = (48).to_bytes(4, "little"), _part(b"")


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
    held = _bytes(column)
    return [one if there else None for one, there in zip(held, known.tolist(), strict=True)]
