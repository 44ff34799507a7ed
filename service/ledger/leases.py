"""The fourth part of the ledger: who looks after running attempts, and that they still live."""

import time
from collections.abc import Mapping

from wrenchbook.service.ledger import jobs, states
from wrenchbook.service.ledger.connections import Connections
from wrenchbook.service.ledger.records import Beat, Job
from wrenchbook.service.ledger.schema import Connection

# Owners that were killed while they had nothing to look after; one that lives beats again.
FORGOTTEN_SECONDS = 24 * 3600.0


class Leases:
    """What `Ledger` does with the owners of attempts."""

    _db: Connections

    def beat(
        self, owner: str, engine: str, began: Mapping[tuple[int, int], float] | None = None
    ) -> list[Job]:
        """Say that `owner` lives and looks after its attempts.

        Parameters
        ----------
        began : mapping, optional
            By job and attempt, the time in seconds since the epoch at which a solver was seen at
            it; attempts that are over, or another owner's by now, are passed over.

        Returns
        -------
        list of Job
            Those that are running rather than submitted from now on.
        """
        with self._db.writing() as db:
            write_beat(db, owner, engine, time.time())
            begun = []
            for (job_id, attempt), at in (began or {}).items():
                job = jobs.get(db, job_id)
                if (job.status, job.attempt, job.owner) == ("running", attempt, owner):
                    begun.append(jobs.save(db, states.begun(job, at)))
        return begun

    def leases(self) -> dict[str, Beat]:
        """Return the heartbeat of each owner."""
        with self._db.reading() as db:
            found = db.execute("SELECT owner, engine, beat, at FROM leases").fetchall()
        return {owner: Beat(*rest) for owner, *rest in found}

    def attempts_of(self, owner: str) -> set[tuple[int, int]]:
        """Return job and attempt of all that `owner` looks after; cheaper than `running`."""
        with self._db.reading() as db:
            return set(db.execute("SELECT id, attempt FROM jobs WHERE owner = ?", (owner,)))

    def end_lease(self, owner: str) -> None:
        """Forget an owner that has ended; what it still owns is free to be adopted."""
        with self._db.writing() as db:
            db.execute("DELETE FROM leases WHERE owner = ?", (owner,))
            db.execute(
                "DELETE FROM leases WHERE at < ?"
                " AND owner NOT IN (SELECT owner FROM jobs WHERE owner IS NOT NULL)",
                (time.time() - FORGOTTEN_SECONDS,),
            )


def write_beat(db: Connection, owner: str, engine: str, now: float) -> None:
    """Write one beat more of an owner."""
    db.execute(
        "INSERT INTO leases (owner, engine, beat, at) VALUES (?, ?, 1, ?)"
        " ON CONFLICT (owner) DO UPDATE SET engine = excluded.engine, beat = beat + 1,"
        " at = excluded.at",
        (owner, engine, now),
    )
