"""The durable record of jobs and rows; see `Ledger`."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence

from wrenchbook.service.ledger import jobs, rows, states
from wrenchbook.service.ledger.connection import Connection
from wrenchbook.service.ledger.imports import ImportTable
from wrenchbook.service.ledger.packing import pack_vector
from wrenchbook.service.ledger.records import (
    Beat,
    Change,
    JobRecord,
    LedgerRow,
    NewRow,
    OpenJob,
    Status,
)
from wrenchbook.service.ledger.tables import TableRows

# Leases of owners that were killed without a job are deleted then.
FORGOTTEN_SECONDS = 24 * 3600.0


class Ledger(jobs.Jobs, TableRows, ImportTable):
    """Jobs and rows in one SQLite file, for many threads and several processes at once.

    A method that returned has committed to disk; one that raised changed nothing. Parameters and
    errors are those of `Database`.
    """

    def accept(
        self,
        component: str,
        fingerprint: str,
        wrench: Sequence[float],
        *,
        priority: int = 0,
        reopen_cancelled: bool = True,
        asked_by: str = "",
    ) -> tuple[JobRecord, bool]:
        """Return the job for this wrench, and whether it is new.

        There is one job for one (component, fingerprint, wrench), whatever its status: a
        waiting, running, done or failed one is returned as it is (a waiting one with the
        higher of both priorities), a cancelled one goes back to waiting, and so does a done
        one whose row was withdrawn or is damaged.

        Raises
        ------
        ValueError
            If the wrench is not six finite numbers.
        LedgerUnavailableError
            If the job could not be written; it is then not accepted.
        """
        key = pack_vector(wrench)
        with self.reading() as db:
            found = jobs.find_same(db, component, fingerprint, key)
            gone = found is not None and jobs.lacks_its_row(db, found)
        if (
            found
            and states.accepted_again(found, priority, reopen_cancelled, gone, asked_by) == found
        ):
            return found, False
        with self.writing() as db:
            same = (component, fingerprint, key)
            job, created = jobs.accept(db, same, priority, reopen_cancelled, asked_by)
        self._committed(job)
        return job, created

    def accept_many(
        self,
        component: str,
        fingerprint: str,
        wrenches: Iterable[Sequence[float]],
        *,
        priority: int = 0,
        reopen_cancelled: bool = True,
        asked_by: str = "",
    ) -> list[JobRecord]:
        """Accept jobs in one transaction, all or none; one job a wrench, in their order."""
        keys = [pack_vector(wrench) for wrench in wrenches]
        return self.accept_chosen(
            component,
            fingerprint,
            lambda _: keys,
            priority=priority,
            reopen_cancelled=reopen_cancelled,
            asked_by=asked_by,
        )

    def accept_chosen(
        self,
        component: str,
        fingerprint: str,
        choose: Callable[[list[OpenJob]], Sequence[bytes]],
        *,
        priority: int = 0,
        reopen_cancelled: bool = True,
        asked_by: str = "",
    ) -> list[JobRecord]:
        """Accept the packed wrenches that `choose` picks once it has seen the open jobs.

        Choosing and accepting are one transaction, so a limit on open jobs holds however many
        processes accept at once.
        """
        with self.writing() as db:
            keys = choose(jobs.opened(db, component, fingerprint))
            accepted = [
                jobs.accept(
                    db, (component, fingerprint, key), priority, reopen_cancelled, asked_by
                )[0]
                for key in keys
            ]
        self._committed(*accepted)
        return accepted

    def claim(self, owner: str, engine: str = "local") -> JobRecord | None:
        """Start the next waiting job's next attempt under `owner`; None if none waits."""
        claimed = self.claim_many(owner, engine, 1)
        return claimed[0] if claimed else None

    def claim_many(self, owner: str, engine: str, most: int) -> list[JobRecord]:
        """Start the next attempts of the next waiting jobs, in one transaction.

        Each gets a task key; it is submitted, not running, until `beat` reports its begin. The
        claim counts as a heartbeat of the owner.
        """
        now = time.time()
        with self.reading() as db:
            if not jobs.next_waiting(db, now, 1):
                return []
        with self.writing() as db:
            waiting = jobs.next_waiting(db, now, most)
            claimed = [jobs.save(db, states.claimed(job, owner, engine, now)) for job in waiting]
            if claimed:
                _write_beat(db, owner, engine, now)
        self._committed(*claimed)
        return claimed

    def adopt(self, job_id: int, attempt: int, previous: str, owner: str) -> JobRecord | None:
        """Take a running attempt over from a dead owner; None if another one was faster."""
        with self.writing() as db:
            job = jobs.get(db, job_id)
            if (job.status, job.attempt, job.owner) != ("running", attempt, previous):
                return None
            job = jobs.save(db, states.adopted(job, owner))
        self._committed(job)
        return job

    def commit(
        self,
        job_id: int,
        attempt: int,
        displacement: Sequence[float],
        *,
        compliance: Sequence[Sequence[float]] | None = None,
        curvature: Sequence[float] | None = None,
        uncertainty: Sequence[float] | None = None,
        source: str = "fea",
        origin: str = "",
        seconds: float | None = None,
    ) -> LedgerRow:
        """Write the row of a job and the job's end in one transaction, exactly once.

        A job that is done already keeps the row it has, and that one is returned. Its solver took
        `seconds`, if known.

        Raises
        ------
        StaleAttemptError
            If the attempt is not the running one.
        ValueError
            If a number is not finite or a length is wrong.
        """
        with self.writing() as db:
            job = jobs.get(db, job_id)
            if job.row is not None:
                return rows.get(db, job.row)
            states.check_attempt(job, attempt)
            new = NewRow(
                job.wrench,
                displacement,
                source,
                compliance,
                uncertainty,
                origin,
                curvature=curvature,
            )
            now = time.time()
            row = rows.add(db, job.component, job.fingerprint, new, job.id, now)
            job = jobs.save(db, states.committed(job, row.seq, now, seconds))
        self._committed(job, rows=1)
        return row

    def fail(
        self, job_id: int, attempt: int, error: dict[str, str], seconds: float | None = None
    ) -> JobRecord:
        """End a running attempt as failed; `error` holds kind, message and remedy."""
        now = time.time()
        return self._end(job_id, attempt, lambda job: states.failed(job, error, now, seconds))

    def lose(self, job_id: int, attempt: int, cause: str = "") -> JobRecord:
        """Record that an attempt's solver died: waiting for longer and longer, then failed."""
        return self._end(job_id, attempt, lambda job: states.lost(job, time.time(), cause))

    def release(self, job_id: int, attempt: int, *, delay: float = 0.0) -> JobRecord:
        """Give an attempt back that did not die by itself; it does not count as lost.

        The next one starts after `delay` seconds.
        """
        later = time.time() + delay if delay else None
        return self._end(job_id, attempt, lambda job: states.released(job, later))

    def cancel(self, job_id: int) -> JobRecord:
        """Cancel a waiting or running job; its dispatcher then stops the solver."""
        return self._move(job_id, lambda job: states.cancelled(job, time.time()))

    def cancel_many(self, component: str | None, status: Status) -> int:
        """Cancel all jobs of a status (of one component), and return how many there were.

        Raises
        ------
        InvalidTransitionError
            If jobs of that status cannot be cancelled; then none is.
        """
        with self.writing() as db:
            found = jobs.listed(db, component, status, limit=-1)  # no limit, to SQLite
            for job in found:
                jobs.save(db, states.cancelled(job, time.time()))
        self._committed(*found)
        return len(found)

    def retry(self, job_id: int) -> JobRecord:
        """Let a failed or cancelled job wait again."""
        return self._move(job_id, states.retried)

    def beat(
        self, owner: str, engine: str, began: Mapping[tuple[int, int], float] | None = None
    ) -> list[JobRecord]:
        """Write a heartbeat of `owner`, which runs its attempts.

        Parameters
        ----------
        began : mapping, optional
            By job and attempt, the time in seconds since the epoch at which a solver was seen at
            it; attempts that have ended, or have another owner now, are ignored.

        Returns
        -------
        list of Job
            Those that are running rather than submitted from now on.
        """
        with self.writing() as db:
            _write_beat(db, owner, engine, time.time())
            begun = []
            for (job_id, attempt), at in (began or {}).items():
                job = jobs.get(db, job_id)
                if (job.status, job.attempt, job.owner) == ("running", attempt, owner):
                    begun.append(jobs.save(db, states.begun(job, at)))
        return begun

    def leases(self) -> dict[str, Beat]:
        """Return the heartbeat of each owner."""
        with self.reading() as db:
            found = db.execute("SELECT owner, engine, beat, at FROM leases").fetchall()
        return {owner: Beat(*rest) for owner, *rest in found}

    def attempts_of(self, owner: str) -> set[tuple[int, int]]:
        """Return job and attempt of all attempts of `owner`; cheaper than `running`."""
        with self.reading() as db:
            return set(db.execute("SELECT id, attempt FROM jobs WHERE owner = ?", (owner,)))

    def end_lease(self, owner: str) -> None:
        """Delete the lease of an owner that has ended; its attempts can then be adopted."""
        with self.writing() as db:
            db.execute("DELETE FROM leases WHERE owner = ?", (owner,))
            db.execute(
                "DELETE FROM leases WHERE at < ?"
                " AND owner NOT IN (SELECT owner FROM jobs WHERE owner IS NOT NULL)",
                (time.time() - FORGOTTEN_SECONDS,),
            )

    def _end(self, job_id: int, attempt: int, step: Callable[[JobRecord], JobRecord]) -> JobRecord:
        def checked(job: JobRecord) -> JobRecord:
            states.check_attempt(job, attempt)
            return step(job)

        return self._move(job_id, checked)

    def _move(self, job_id: int, step: Callable[[JobRecord], JobRecord]) -> JobRecord:
        with self.writing() as db:
            job = jobs.save(db, step(jobs.get(db, job_id)))
        self._committed(job)
        return job

    def _committed(self, *touched: JobRecord, rows: int = 0) -> None:
        if touched:
            jobs.log_jobs(touched)
            numbers = tuple(dict.fromkeys(job.id for job in touched))
            self.notify(Change(touched[0].component, numbers, rows))


def _write_beat(db: Connection, owner: str, engine: str, now: float) -> None:
    db.execute(
        "INSERT INTO leases (owner, engine, beat, at) VALUES (?, ?, 1, ?)"
        " ON CONFLICT (owner) DO UPDATE SET engine = excluded.engine, beat = beat + 1,"
        " at = excluded.at",
        (owner, engine, now),
    )
