"""The file that an FMU reads its table from: `c/wb_table.c` tells its form and reads it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

MARK = b"WBFMU001"
GUID_BYTES = 40
MOST_BYTES = 256 * 1024 * 1024  # c/wb_table.c refuses more; every instance holds its own copy
_FLOAT, _INT = 0, 1
_BASIS, _PRIME = np.uint64(14695981039346656037), 1099511628211  # FNV-1a, 64 bits


class Stream:
    """Arrays, one after another, each with its kind and its count."""

    def __init__(self) -> None:
        self._pieces: list[bytes] = []
        self.size = 0

    def floats(self, *arrays: ArrayLike) -> None:
        """Append arrays of float64, each flattened."""
        for array in arrays:
            self._put(_FLOAT, np.ascontiguousarray(array, dtype="<f8"))

    def ints(self, *arrays: ArrayLike) -> None:
        """Append arrays of int32, each flattened; a number is an array of one."""
        for array in arrays:
            self._put(_INT, np.ascontiguousarray(array, dtype="<i4"))

    def _put(self, kind: int, array: np.ndarray) -> None:
        content = array.tobytes()
        head = np.array([kind, array.size], dtype="<i8").tobytes()
        piece = head + content + bytes(-len(content) % 8)
        self._pieces.append(piece)
        self.size += len(piece)

    @property
    def content(self) -> bytes:
        """All arrays."""
        return b"".join(self._pieces)


def file_of(guid: str, content: bytes) -> bytes:
    """Return the whole file: mark, checksum, GUID and arrays."""
    name = guid.encode().ljust(GUID_BYTES, b"\0")
    checked = name + content
    return MARK + checksum(checked).to_bytes(8, "little") + checked


def checksum(content: bytes) -> int:
    """Return FNV-1a over words of 64 bits, as the FMU computes it."""
    total, most = int(_BASIS), 1 << 64
    for word in np.frombuffer(content, dtype="<u8").tolist():
        total = (total ^ word) * _PRIME % most
    return total
