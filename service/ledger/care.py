"""The part of the ledger that operators need: sizes, copies, checks, healing, what waits."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from wrenchbook.service.ledger import healing
from wrenchbook.service.ledger.acknowledged import Acknowledged, Numbers
from wrenchbook.service.ledger.connections import Connections
from wrenchbook.service.ledger.records import LedgerRow, NewRow
from wrenchbook.service.ledger.statistics import Statistics, recent_seconds, statistics


class Ahead(NamedTuple):
    """Jobs of one component that start before another: how many wait, how long one takes, s."""

    component: str
    waiting: int
    seconds: float | None


class Care:
    """What `Ledger` does for its operators."""

    _db: Connections
    path: Path

    def statistics(self) -> Statistics:
        """Return what there is of jobs, in one committed state."""
        with self._db.reading() as db:
            return statistics(db)

    def rows_of(self, seqs: Sequence[int]) -> dict[int, LedgerRow]:
        """Return those of these rows that are there and as they were written, by number."""
        with self._db.reading() as db:
            return healing.sound_rows(db, seqs)

    def sizes(self) -> dict[str, int]:
        """Return the bytes of the ledger's file and of its log."""
        files = {"ledger": self.path, "log": self.path.with_name(f"{self.path.name}-wal")}
        return {word: file.stat().st_size if file.exists() else 0 for word, file in files.items()}

    def checkpoint(self) -> bool:
        """Bring the log into the file and empty it; False if somebody reads just now."""
        return self._db.checkpoint()

    def copy(self, target: Path) -> None:
        """Write all that is committed now into a new file, while others read and write."""
        self._db.copy(target)

    def losses(self) -> list[str]:
        """Return what was acknowledged and is gone, in words."""
        return Acknowledged(self.path).losses()

    def lost(self) -> Numbers:
        """Return how many acknowledged jobs and rows are gone, without rows put back since.

        Edits share the rows' numbers, so that there may be fewer rows.
        """
        gone, last = Acknowledged(self.path).lost()
        with self._db.reading() as db:
            back = "SELECT count(*) FROM rows WHERE origin = 'table file' AND seq > ?"
            return Numbers(gone.jobs, max(0, gone.rows - db.execute(back, (last,)).fetchone()[0]))

    def ahead(self, job_id: int, priority: int, now: float) -> list[Ahead]:
        """Return the waiting jobs that start before one, by component, with what one takes."""
        with self._db.reading() as db:
            found = db.execute(
                "SELECT component, count(*) FROM jobs WHERE status = 'waiting'"
                " AND (priority > :priority OR (priority = :priority AND id < :id))"
                " AND coalesce(not_before, 0) <= :now GROUP BY component",
                {"priority": priority, "id": job_id, "now": now},
            ).fetchall()
            return [Ahead(name, n, _mean(recent_seconds(db, name))) for name, n in found]

    def solve_seconds(self, component: str) -> float | None:
        """Return the mean time of the newest done solves of a component, s; None without any."""
        with self._db.reading() as db:
            return _mean(recent_seconds(db, component))

    def attempts(self, job_ids: Iterable[int]) -> dict[int, tuple[str, int, float | None]]:
        """Return of each of these jobs that there is: status, newest attempt, when it ended."""
        wanted = list(job_ids)
        with self._db.reading() as db:
            return healing.attempts(db, wanted)

    def unsound(self) -> dict[int, str]:
        """Return the rows that are not as they were written, with their component. All are read."""
        with self._db.reading() as db:
            return healing.unsound(db)

    def heal(self, component: str, seq: int, row: NewRow) -> bool:
        """Write a damaged row as it was, from another copy; False if it is not damaged."""
        with self._db.writing() as db:
            return healing.heal(db, component, seq, row)


def _mean(seconds: list[float]) -> float | None:
    return sum(seconds) / len(seconds) if seconds else None
