"""What has been acknowledged, noted beside the ledger: tells that its newest part is gone.

A WAL file that was cut off, deleted or put back from a copy leaves a ledger that is whole and
older: SQLite cannot tell, and jobs that clients were promised would be gone without a word. So the
numbers that were given out last are noted in a small file of their own after each commit. It is not
synced, as the ledger is: after a power cut it may be older than the ledger, and then tells nothing,
but never newer, so it tells no loss that was none.
"""

import json
import os
import time
from collections.abc import Callable
from contextlib import suppress
from hashlib import blake2b
from pathlib import Path
from typing import Any, NamedTuple

SEQUENCES = ("jobs", "rows")  # of sqlite_sequence: jobs' numbers, and rows' and edits'
_DIGEST = 8  # bytes


class Numbers(NamedTuple):
    """The highest numbers given out: a job's, a row's or an edit's."""

    jobs: int = 0
    rows: int = 0


class Acknowledged:
    """The note beside a ledger.

    Parameters
    ----------
    ledger : path
        The ledger's file; the note is ``<file>-acknowledged``, what was lost ``<file>-lost``.
    """

    def __init__(self, ledger: Path) -> None:
        self._path = ledger.with_name(f"{ledger.name}-acknowledged")
        self._losses = ledger.with_name(f"{ledger.name}-lost")
        self._noted = Numbers()

    def note(self, numbers: Numbers) -> None:
        """Note what was committed; a disk that takes no note has taken the commit all the same."""
        if numbers.jobs <= self._noted.jobs and numbers.rows <= self._noted.rows:
            return
        # Another process may have noted more. Two that write at once leave the note of either: at
        # worst too little is known until the next commit.
        known = self.read()
        self._noted = Numbers(*map(max, numbers, known))
        with suppress(OSError):
            self._write(self._noted)

    def read(self) -> Numbers:
        """Return what was noted; nothing if there is no whole note."""
        try:
            words = self._path.read_bytes()
        except OSError:
            return Numbers()
        text, digest = words[:-_DIGEST], words[-_DIGEST:]
        if blake2b(text, digest_size=_DIGEST).digest() != digest:
            return Numbers()
        return Numbers(*(int(word) for word in text.split()))

    def compare(self, present: Numbers) -> Numbers | None:
        """Return what the note has above what the ledger has now, if it has; keep a word of it."""
        noted = self.read()
        if noted.jobs <= present.jobs and noted.rows <= present.rows:
            return None
        loss = {
            "seen": time.time(),
            "jobs": [present.jobs + 1, max(noted.jobs, present.jobs)],
            "rows": [present.rows + 1, max(noted.rows, present.rows)],
        }
        with suppress(OSError), self._losses.open("a", encoding="utf-8") as file:
            file.write(json.dumps(loss) + "\n")
            os.fsync(file.fileno())
        return noted

    def losses(self) -> list[str]:
        """Return in words what was lost and has not been settled yet."""
        return [_in_words(loss) for loss in self._unsettled()]

    def lost(self) -> tuple[Numbers, int]:
        """Return how many numbers of jobs and rows were lost, and a row's highest one of these."""
        losses = self._unsettled()
        count = {
            what: sum(loss[what][1] - loss[what][0] + 1 for loss in losses) for what in SEQUENCES
        }
        return Numbers(**count), max((loss["rows"][1] for loss in losses), default=0)

    def _unsettled(self) -> list[dict[str, Any]]:
        try:
            lines = self._losses.read_text(encoding="utf-8").splitlines()
        except OSError:
            return []
        found = []
        for line in lines:
            with suppress(ValueError, KeyError, TypeError):
                loss = json.loads(line)
                _in_words(loss)  # fails for a line that is not whole
                found.append(loss)
        return found

    def settle(self, move: Callable[[Path], Path]) -> Path | None:
        """Have the word of what was lost moved aside; returns where to, None if there is none."""
        return move(self._losses) if self._losses.exists() else None

    def _write(self, numbers: Numbers) -> None:
        text = b"%d %d\n" % numbers
        words = text + blake2b(text, digest_size=_DIGEST).digest()
        descriptor = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            # Never shorter than before: the numbers only grow. One write, so it is whole or not.
            os.pwrite(descriptor, words, 0)
        finally:
            os.close(descriptor)


def _in_words(loss: dict[str, Any]) -> str:
    seen = time.strftime("%Y-%m-%d %H:%M:%S", time.gmtime(loss["seen"]))
    parts = [
        f"{what} {first} to {last}"
        for what in ("jobs", "rows")
        for first, last in [loss[what]]
        if last >= first
    ]
    return (
        f"{' and '.join(parts)} were acknowledged and are not in the ledger any more (seen {seen} "
        "UTC): its -wal file was cut off or removed, or an older copy was put back. Rows that are "
        "in a table's file come back by themselves; ask for the other wrenches again"
    )
