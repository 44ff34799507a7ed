"""The durable record of jobs and rows: what `Ledger` says happened has happened."""

import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from wrenchbook.service.ledger import jobs, rows, states
from wrenchbook.service.ledger.bulk import Imports
from wrenchbook.service.ledger.care import Care
from wrenchbook.service.ledger.connections import Connections
from wrenchbook.service.ledger.job_log import log_jobs
from wrenchbook.service.ledger.leases import Leases, write_beat
from wrenchbook.service.ledger.listeners import Listener, Listeners
from wrenchbook.service.ledger.recordings import LedgerRecordings
from wrenchbook.service.ledger.records import Change, Job, LedgerRow, NewRow, OpenJob, Status, pack6
from wrenchbook.service.ledger.table_rows import TableRows


class Ledger(TableRows, Imports, LedgerRecordings, Leases, Care):
    """Jobs, rows and recordings in one SQLite file, for many threads and several processes at once.

    A method that returned has committed to disk; one that raised changed nothing.

    Parameters
    ----------
    path : path
        The file; it and its folder are made if there are none.
    patient : bool
        Go on without a file that cannot be used now, on a full disk say: `trouble` then tells
        why, every use raises LedgerUnavailableError, and each write tries to open it again.

    Raises
    ------
    LedgerFileError
        If the file is foreign, damaged or of a newer schema, and `patient` is false.
    """

    def __init__(self, path: str | Path, *, patient: bool = False) -> None:
        self.path = Path(path).absolute()
        super().__init__(Connections(self.path, patient=patient), Listeners())

    # -- the life of a job ------------------------------------------------------------------

    def accept(
        self,
        component: str,
        fingerprint: str,
        wrench: Sequence[float],
        *,
        priority: int = 0,
        reopen_cancelled: bool = True,
        asked_by: str = "",
    ) -> tuple[Job, bool]:
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
        key = pack6(wrench)
        with self._db.reading() as db:
            found = jobs.find_same(db, component, fingerprint, key)
            gone = found is not None and jobs.lacks_its_row(db, found)
        if found and states.asked_again(found, priority, reopen_cancelled, gone, asked_by) == found:
            return found, False
        with self._db.writing() as db:
            same = (component, fingerprint, key)
            job, created = jobs.accept(db, same, priority, reopen_cancelled, asked_by)
        self._tell(job)
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
    ) -> list[Job]:
        """Accept jobs in one transaction, all or none; one job a wrench, in their order."""
        keys = [pack6(wrench) for wrench in wrenches]
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
    ) -> list[Job]:
        """Accept the packed wrenches that `choose` picks once it has seen the open jobs.

        Choosing and accepting are one transaction, so a limit on open jobs holds however many
        processes accept at once.
        """
        with self._db.writing() as db:
            keys = choose(jobs.opened(db, component, fingerprint))
            accepted = [
                jobs.accept(
                    db, (component, fingerprint, key), priority, reopen_cancelled, asked_by
                )[0]
                for key in keys
            ]
        self._tell(*accepted)
        return accepted

    def claim(self, owner: str, engine: str = "local") -> Job | None:
        """Start the next waiting job's next attempt under `owner`; None if none waits."""
        claimed = self.claim_many(owner, engine, 1)
        return claimed[0] if claimed else None

    def claim_many(self, owner: str, engine: str, most: int) -> list[Job]:
        """Start the next attempts of the next waiting jobs, in one transaction.

        Each gets a task key; it is submitted, not running, until `beat` says that it began. The
        claim counts as a beat of the owner.
        """
        now = time.time()
        with self._db.reading() as db:
            if not jobs.next_waiting(db, now, 1):
                return []
        with self._db.writing() as db:
            waiting = jobs.next_waiting(db, now, most)
            claimed = [jobs.save(db, states.claimed(job, owner, engine, now)) for job in waiting]
            if claimed:
                write_beat(db, owner, engine, now)
        self._tell(*claimed)
        return claimed

    def adopt(self, job_id: int, attempt: int, previous: str, owner: str) -> Job | None:
        """Take a running attempt over from a dead owner; None if another one was faster."""
        with self._db.writing() as db:
            job = jobs.get(db, job_id)
            if (job.status, job.attempt, job.owner) != ("running", attempt, previous):
                return None
            job = jobs.save(db, states.adopted(job, owner))
        self._tell(job)
        return job

    def commit(
        self,
        job_id: int,
        attempt: int,
        displacement: Sequence[float],
        *,
        compliance: Sequence[Sequence[float]] | None = None,
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
        with self._db.writing() as db:
            job = jobs.get(db, job_id)
            if job.row is not None:
                return rows.get(db, job.row)
            states.check_attempt(job, attempt)
            new = NewRow(job.wrench, displacement, source, compliance, uncertainty, origin)
            now = time.time()
            row = rows.add(db, job.component, job.fingerprint, new, job.id, now)
            job = jobs.save(db, states.committed(job, row.seq, now, seconds))
        self._tell(job, rows=1)
        return row

    def fail(
        self, job_id: int, attempt: int, error: dict[str, str], seconds: float | None = None
    ) -> Job:
        """End a running attempt as failed; `error` holds kind, message and remedy."""
        now = time.time()
        return self._end(job_id, attempt, lambda job: states.failed(job, error, now, seconds))

    def lose(self, job_id: int, attempt: int, cause: str = "") -> Job:
        """Record that an attempt's solver died: waiting for longer and longer, then failed."""
        return self._end(job_id, attempt, lambda job: states.lost(job, time.time(), cause))

    def release(self, job_id: int, attempt: int, *, delay: float = 0.0) -> Job:
        """Give an attempt back that did not die by itself; it does not count as lost.

        The next one starts after `delay` seconds.
        """
        later = time.time() + delay if delay else None
        return self._end(job_id, attempt, lambda job: states.released(job, later))

    def cancel(self, job_id: int) -> Job:
        """Cancel a waiting or running job; its dispatcher then stops the solver."""
        return self._move(job_id, lambda job: states.cancelled(job, time.time()))

    def cancel_many(self, component: str | None, status: Status) -> int:
        """Cancel all jobs of a status (of one component), and return how many there were.

        Raises
        ------
        InvalidTransitionError
            If jobs of that status cannot be cancelled; then none is.
        """
        with self._db.writing() as db:
            found = jobs.listed(db, component, status, limit=-1)  # no limit, to SQLite
            for job in found:
                jobs.save(db, states.cancelled(job, time.time()))
        self._tell(*found)
        return len(found)

    def retry(self, job_id: int) -> Job:
        """Let a failed or cancelled job wait again."""
        return self._move(job_id, states.retried)

    # -- reading jobs -----------------------------------------------------------------------

    def job(self, job_id: int) -> Job:
        """Return a job; raises UnknownJobError."""
        with self._db.reading() as db:
            return jobs.get(db, job_id)

    def jobs(
        self,
        component: str | None = None,
        status: Status | None = None,
        limit: int = 100,
        below: int | None = None,
    ) -> list[Job]:
        """Return jobs, newest first, those of a number below `below` if given."""
        with self._db.reading() as db:
            return jobs.listed(db, component, status, limit, below)

    def open_jobs(self, component: str, fingerprint: str) -> list[OpenJob]:
        """Return the waiting and running jobs of one setup, oldest first."""
        with self._db.reading() as db:
            return jobs.opened(db, component, fingerprint)

    def jobs_for(
        self, component: str, fingerprint: str, wrenches: Iterable[bytes]
    ) -> dict[bytes, Job]:
        """Return, by packed wrench, the jobs there are for any of these wrenches."""
        with self._db.reading() as db:
            return jobs.find_many(db, component, fingerprint, wrenches)

    def running(self) -> list[Job]:
        """Return all running jobs, oldest first."""
        with self._db.reading() as db:
            return jobs.running(db)

    def unfinished(self, after: int | None = None) -> list[Job]:
        """Return all open jobs, and with `after` also those that ended of a number above it."""
        with self._db.reading() as db:
            return jobs.unfinished(db, after)

    def ended(self, job_ids: Iterable[int]) -> set[int]:
        """Return those of some jobs that neither wait nor run."""
        with self._db.reading() as db:
            return jobs.ended(db, job_ids)

    def counts(self, component: str | None = None) -> dict[str, int]:
        """Return the number of jobs of each of the five statuses."""
        with self._db.reading() as db:
            return jobs.counts(db, component)

    # -- following --------------------------------------------------------------------------

    def version(self) -> int:
        """Return a number that differs after any commit of this or another process.

        Takes microseconds. Only equality of two numbers from the same Ledger means anything.
        """
        return self._db.version()

    def on_change(self, listener: Listener) -> Callable[[], None]:
        """Call `listener` after each commit of this Ledger, in the thread that committed.

        It must be quick. Returns a function that ends the subscription. Commits of other
        processes are seen by polling `version`.
        """
        return self._listeners.add(listener)

    def trouble(self) -> str | None:
        """Return why the file can be neither read nor written now; None if it can."""
        return self._db.trouble()

    def close(self) -> None:
        """Close the file; idempotent."""
        self._db.close()

    def _end(self, job_id: int, attempt: int, step: Callable[[Job], Job]) -> Job:
        def checked(job: Job) -> Job:
            states.check_attempt(job, attempt)
            return step(job)

        return self._move(job_id, checked)

    def _move(self, job_id: int, step: Callable[[Job], Job]) -> Job:
        with self._db.writing() as db:
            job = jobs.save(db, step(jobs.get(db, job_id)))
        self._tell(job)
        return job

    def _tell(self, *touched: Job, rows: int = 0) -> None:
        if touched:
            log_jobs(touched)
            numbers = tuple(dict.fromkeys(job.id for job in touched))
            self._listeners.tell(Change(touched[0].component, numbers, rows))
