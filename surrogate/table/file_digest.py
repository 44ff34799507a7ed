"""The digest in front of a table file: one flipped bit in it is noticed before it is read.

HDF5 leaves the first 512 bytes, its user block, to others: there stands a digest of all the rest.
"""

from __future__ import annotations

import os
from hashlib import blake2b
from pathlib import Path
from typing import BinaryIO

PIECE = 1 << 20  # bytes of a file in memory at once for its digest
USER_BLOCK = 512  # the smallest HDF5 takes
_DIGEST_MARK = b"wrenchbook table, blake2b of what follows byte 512: "
_HDF5_MARK = b"\x89HDF\r\n\x1a\n"


def write_digest(path: Path) -> None:
    """Put the digest of a file into its user block."""
    with path.open("r+b") as file:
        file.write(_DIGEST_MARK + _digest(file))


def is_as_written(path: Path) -> bool:
    """Return whether a file is byte for byte what was written; without a digest HDF5 may judge."""
    with path.open("rb") as file:
        head = file.read(USER_BLOCK)
        if head.startswith(_DIGEST_MARK):
            return head[len(_DIGEST_MARK) :].rstrip(b"\0") == _digest(file)
    # Files of the first schema begin with HDF5's mark and have no digest. So do other programs'
    # files; without either mark nothing tells what the bytes are.
    return head.startswith(_HDF5_MARK)


def may_be_foreign(path: Path) -> bool:
    """Return whether an HDF5 file may be of another program, which no digest of ours precedes.

    It begins with HDF5's mark, or MATLAB's. HDF5 never sees a file that a digest should precede
    without one: a damaged file can keep its library busy without end.
    """
    with path.open("rb") as file:
        return file.read(USER_BLOCK).startswith((_HDF5_MARK, b"MATLAB 7.3"))


def sync(path: Path) -> None:
    """Flush a file, or the names in a folder, to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _digest(file: BinaryIO) -> bytes:
    file.seek(USER_BLOCK)
    whole = blake2b(digest_size=32)
    while piece := file.read(PIECE):
        whole.update(piece)
    file.seek(0)
    return whole.hexdigest().encode()
