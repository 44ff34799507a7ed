"""Blocks of wrenches that wait to be sent: in memory, then in a temporary file."""

from __future__ import annotations

import tempfile
import time
from collections import deque
from typing import IO

WRENCH = 48  # bytes: six float64
MOST_HELD = 100_000  # wrenches in memory, 4.8 MB
READ_BACK = 32  # blocks brought back at a time: `add` waits for no more than that
MOST_SPILLED = 20_000_000  # wrenches in the file, 1 GB: five and a half hours at 1 kHz


class Blocks:
    """A queue of blocks, of which the oldest are in memory and the rest in a file.

    Not for several threads at once: its owner holds a lock.

    Parameters
    ----------
    size : int
        Wrenches of a whole block.

    Attributes
    ----------
    count, spilled : int
        Wrenches that wait, and how many of them in the file.
    last : int
        The number of the newest whole block, from 0; -1 if there was none.
    """

    def __init__(self, size: int) -> None:
        self.count = self.spilled = 0
        self.last = -1
        self._size = size * WRENCH
        self._open = bytearray()  # the block that is being filled
        self._since = 0.0
        self._held: deque[bytes] = deque()
        self._held_bytes = 0
        self._file: IO[bytes] | None = None
        self._lengths: deque[int] = deque()  # of the blocks in the file, oldest first
        self._read_at = self._write_at = 0

    def add(self, packed: bytes) -> bool:
        """Add a wrench; return whether that made a block whole.

        Raises
        ------
        OSError
            If there is no room; it was not added.
        """
        if len(self._open) + WRENCH >= self._size:
            self._put(bytes(self._open) + packed)
            self._open.clear()
            self.count += 1
            return True
        if not self._open:
            self._since = time.monotonic()
        self._open += packed
        self.count += 1
        return False

    def seal(self) -> None:
        """Make a whole block of what there is of one."""
        if self._open:
            self._put(bytes(self._open))
            self._open.clear()

    def seal_older_than(self, seconds: float) -> None:
        """Do so if its first wrench has waited that long, and nothing else waits."""
        if self._open and not self._held and time.monotonic() - self._since >= seconds:
            self.seal()

    def first(self) -> bytes | None:
        """Return the oldest whole block, which stays; None if there is none."""
        if not self._held:
            self._read_back()
        return self._held[0] if self._held else None

    def drop_first(self) -> None:
        """Forget the oldest whole block."""
        block = self._held.popleft()
        self._held_bytes -= len(block)
        self.count -= len(block) // WRENCH

    def all(self) -> bytes:
        """Return all that waits."""
        rest = b""
        if self._file is not None:
            self._file.seek(self._read_at)
            rest = self._file.read(self._write_at - self._read_at)
        return b"".join(self._held) + rest + bytes(self._open)

    def close(self) -> None:
        """Forget the file."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def _put(self, block: bytes) -> None:
        if self._lengths or self._held_bytes + len(block) > MOST_HELD * WRENCH:
            self._spill(block)
        else:
            self._held.append(block)
            self._held_bytes += len(block)
        self.last += 1

    def _spill(self, block: bytes) -> None:
        if self._write_at + len(block) > MOST_SPILLED * WRENCH:
            raise OSError(f"the temporary file has its {MOST_SPILLED:,} wrenches")
        if self._file is None:
            self._file = tempfile.TemporaryFile(prefix="wrenchbook-", buffering=0)  # noqa: SIM115
        self._file.seek(self._write_at)
        written = self._file.write(block)
        if written != len(block):
            raise OSError("the disk of the temporary files is full")
        self._write_at += len(block)
        self._lengths.append(len(block))
        self.spilled += len(block) // WRENCH

    def _read_back(self) -> None:
        """Bring blocks of the file into memory, and begin it anew once it is read."""
        for _ in range(min(READ_BACK, len(self._lengths))):
            assert self._file is not None
            self._file.seek(self._read_at)
            block = self._file.read(self._lengths.popleft())
            self._read_at += len(block)
            self.spilled -= len(block) // WRENCH
            self._held.append(block)
            self._held_bytes += len(block)
        if not self._lengths and self._file is not None and self._write_at:
            self._file.truncate(0)
            self._read_at = self._write_at = 0
