"""The metadata of a table file besides its rows: their description, and its digest.

HDF5 leaves the first 512 bytes, its user block, to applications. Tables store a digest of the rest
there, so that a flipped bit is noticed before the file is read.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Any, BinaryIO

from .axes import OffAxis
from .rows import LoadRange, Tolerance

SCHEMA_VERSION = 2  # version 1 had no digest
CONTRACT = (
    "SI: N, N·m, m, rad. Order: force then moment; translation then rotation. The wrench acts ON "
    "the deformable component at the interface reference point where it is now (it moves with the "
    "section), in axes fixed to the undeformed interface frame; the moment is about that point. "
    "The displacement is of the same point in the same axes; the rotation is a rotation vector, "
    "applied as R0 exp(r)."
)

PIECE = 1 << 20  # bytes of a file in memory at once for its digest
USER_BLOCK = 512  # bytes: the smallest user block of HDF5
_DIGEST_MARK = b"wrenchbook table, blake2b of what follows byte 512: "
_HDF5_MARK = b"\x89HDF\r\n\x1a\n"


@dataclass(frozen=True)
class TableMeta:
    """The metadata of a table file about its rows."""

    component: str
    last_seq: int  # the ledger's number of the last row in the file
    load_range: LoadRange  # N and N·m
    fingerprint: str = ""  # of the component's present setup; each row has its own
    title: str = ""
    schema_version: int = SCHEMA_VERSION
    contract: str = CONTRACT  # order, units, frame and sign in words
    # m and rad: the component's; like `linear` and `off_axis` an option of the surrogate
    tolerance: Tolerance | None = None
    linear: bool = False  # whether the component is linear
    off_axis: OffAxis = "correct"  # treatment of multi-axis rows
    # Digest of the ledger's rows up to `last_seq`. It recognises a file of another ledger, or of
    # this ledger before it lost rows.
    ledger: str = ""
    # The newest withdrawal or restoring of each row that had one: the row's content key in
    # hexadecimal, whether it is withdrawn, when (seconds since the epoch). Withdrawn rows are not
    # among the file's rows, so nothing else shows that the ledger was replaced by an older copy.
    # None if unknown.
    edits: tuple[tuple[str, bool, float], ...] | None = None
    # The estimated error of the rows' solver, as `surrogate.solver_error` reads it; None if no
    # solve has estimated it.
    solver_error: Mapping[str, Any] | None = None
    # indices in `LOADS` of the loads on locked freedoms: answers leave these loads out. The file
    # has the names of the freedoms; a file of an older version has none, and no load is locked.
    locked: tuple[int, ...] = ()


def write_digest(file: BinaryIO) -> None:
    """Write the digest of a file into its user block."""
    file.write(_DIGEST_MARK + _digest(file))


def is_as_written(path: Path) -> bool:
    """Return whether a file is byte for byte as written; True for files without a digest."""
    with path.open("rb") as file:
        head = file.read(USER_BLOCK)
        if head.startswith(_DIGEST_MARK):
            return head[len(_DIGEST_MARK) :].rstrip(b"\0") == _digest(file)
    # Files of the first schema begin with HDF5's mark and have no digest, as do other programs'
    # files. Without either mark the file is unknown.
    return head.startswith(_HDF5_MARK)


def may_be_foreign(path: Path) -> bool:
    """Return whether an HDF5 file may be another program's, without a digest.

    It begins with HDF5's mark, or MATLAB's. HDF5 never opens a table whose digest is missing: a
    damaged file can keep its library busy without end.
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
    """Return the digest of a file's bytes after its user block."""
    file.seek(USER_BLOCK)
    digest = blake2b(digest_size=32)
    while piece := file.read(PIECE):
        digest.update(piece)
    file.seek(0)
    return digest.hexdigest().encode()
