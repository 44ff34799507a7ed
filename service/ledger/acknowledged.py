"""The highest acknowledged numbers of a ledger, and the losses that they show.

SQLite cannot notice a WAL file that was cut off, deleted or replaced by an older copy: the ledger
is intact, but older. After each commit the highest numbers are therefore written to a file beside
the ledger. It is not synced: after a power failure it may be older than the ledger, never newer, so
that it reports no false loss.
"""

import json
import os
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import NamedTuple

from wrenchbook.service.ledger.connection import Connection

_DIGEST_BYTES = 8  # of the digest of the acknowledged numbers


class Numbers(NamedTuple):
    """The highest used numbers: of jobs, and of rows and edits."""

    jobs: int = 0
    rows: int = 0


@dataclass(frozen=True)
class Loss:
    """Acknowledged numbers that the ledger lacked when it was opened, at `seen` (s since epoch)."""

    seen: float
    jobs: range
    rows: range

    @classmethod
    def read(cls, line: bytes) -> "Loss | None":
        """Return the loss in a line of the record; None if the line is incomplete or damaged."""
        with suppress(ValueError, KeyError, TypeError, OverflowError):
            parts = json.loads(line)
            spans = (range(first, last + 1) for first, last in (parts["jobs"], parts["rows"]))
            loss = cls(float(parts["seen"]), *spans)
            loss.sentence()  # raises OverflowError for a damaged number
            return loss
        return None

    def sentence(self) -> str:
        """Return the loss, its probable cause and the remedy."""
        when = time.strftime("%Y-%m-%d %H:%M:%S", time.gmtime(self.seen))
        parts = [
            f"{kind} {span[0]} to {span[-1]}"
            for kind, span in (("jobs", self.jobs), ("rows", self.rows))
            if len(span)
        ]
        return (
            f"{' and '.join(parts)} were acknowledged but are no longer in the ledger "
            f"(noticed {when} UTC): its -wal file was cut, or an older copy was put back. "
            "Rows in table files come back; ask for the others again"
        )


class Acknowledged:
    """The highest numbers that a ledger has acknowledged, in the file ``<ledger>-acknowledged``.

    Losses are recorded in ``<ledger>-lost``.
    """

    def __init__(self, ledger: Path) -> None:
        self._path = ledger.with_name(f"{ledger.name}-acknowledged")
        self._record = ledger.with_name(f"{ledger.name}-lost")
        self._noted = Numbers()

    def note(self, numbers: Numbers) -> None:
        """Write the numbers of a commit; a disk error is ignored, as the commit is done."""
        if numbers.jobs <= self._noted.jobs and numbers.rows <= self._noted.rows:
            return
        # If two processes write at once, either's numbers stay until the next commit.
        self._noted = Numbers(*map(max, numbers, self.read()))
        text = b"%d %d\n" % self._noted
        content = text + blake2b(text, digest_size=_DIGEST_BYTES).digest()
        with suppress(OSError):
            descriptor = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o600)
            try:
                # One write is atomic; `read` ignores what a longer, damaged file has behind it.
                os.pwrite(descriptor, content, 0)
            finally:
                os.close(descriptor)

    def read(self) -> Numbers:
        """Return the last written numbers; zeros if the file is missing or damaged."""
        try:
            content = self._path.read_bytes()
        except OSError:
            return Numbers()
        end = content.find(b"\n") + 1
        text, digest = content[:end], content[end : end + _DIGEST_BYTES]
        if blake2b(text, digest_size=_DIGEST_BYTES).digest() != digest:
            return Numbers()
        return Numbers(*map(int, text.split()))

    def compare(self, noted: Numbers, present: Numbers) -> Numbers | None:
        """Record a loss and return the acknowledged numbers if they are above the present ones."""
        if noted.jobs <= present.jobs and noted.rows <= present.rows:
            return None
        loss = {
            "seen": time.time(),
            "jobs": [present.jobs + 1, max(noted.jobs, present.jobs)],
            "rows": [present.rows + 1, max(noted.rows, present.rows)],
        }
        with suppress(OSError), self._record.open("a", encoding="utf-8") as file:
            file.write(json.dumps(loss) + "\n")
            os.fsync(file.fileno())
        return noted

    def losses(self) -> list[Loss]:
        """Return the losses that no repair has handled yet."""
        try:
            lines = self._record.read_bytes().splitlines()
        except OSError:
            return []
        return [loss for line in lines if (loss := Loss.read(line)) is not None]

    def lost(self, db: Connection) -> Numbers:
        """Return the numbers of lost acknowledged jobs and rows, without rows restored since.

        Edits share the rows' numbers, so that there may be fewer rows.
        """
        losses = self.losses()
        end = max((loss.rows.stop for loss in losses), default=1)
        select = "SELECT coalesce(sum(count), 0) FROM rows WHERE origin = 'table file' AND seq >= ?"
        restored = db.execute(select, (end,)).fetchone()[0]
        lost_rows = sum(len(loss.rows) for loss in losses)
        return Numbers(sum(len(loss.jobs) for loss in losses), max(0, lost_rows - restored))

    def archive_losses(self, move: Callable[[Path], Path]) -> None:
        """Move the record of losses aside with `move`, so that they are no longer reported."""
        if self._record.exists():
            move(self._record)
