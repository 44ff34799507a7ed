"""Which dispatchers are alive, and what happens to the attempts of those that have died."""

import contextlib
import logging
import os
import secrets
import time
from collections.abc import Callable
from pathlib import Path

from wrenchbook.service.files import lock as flock
from wrenchbook.service.jobs.engines.engine import Engine
from wrenchbook.service.ledger import Beat, JobRecord, Ledger, StaleAttemptError

BEAT_SECONDS = 2.0  # between the heartbeats of a dispatcher that has attempts to look after
# Four beats missed. With a look a second, a lease that is lost is found within ten seconds.
LEASE_SECONDS = 8.0


class Lease:
    """The name under which a dispatcher owns running jobs, for as long as it lives.

    Parameters
    ----------
    folder : path
        Where all dispatchers of a data directory keep their lock files.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.name = f"{os.getpid()}-{secrets.token_hex(4)}"
        self._folder = folder
        self._lock = flock.take(self._file(self.name))
        self._seen: dict[str, tuple[int, float]] = {}

    def is_lost(self, owner: str, engine: str, beat: Beat | None) -> bool:
        """Return whether an owner of attempts has died, or does not look after them any more.

        A file that is not locked proves it at once. Otherwise the heartbeat does, by whether it has
        changed while this dispatcher looked on: no clock of another one is trusted.

        Parameters
        ----------
        engine : str
            Of the attempts. All dispatchers of `local` have their lock files here.
        beat : Beat or None
            The owner's last heartbeat; None if it has ended its lease.
        """
        file = self._file(owner)
        there = file.exists()
        if there and not flock.is_locked(file):
            return True
        if not there and (engine == "local" or beat is None):
            return True
        now, number = time.monotonic(), -1 if beat is None else beat.beat
        seen = self._seen.get(owner)
        if seen is None or seen[0] != number:
            self._seen[owner] = number, now
            return False
        return now - seen[1] > LEASE_SECONDS

    def remove(self, owner: str) -> None:
        """Remove the lock file of a dispatcher that is dead; one that is merely late keeps it."""
        self._seen.pop(owner, None)
        if not flock.is_locked(self._file(owner)):
            self._file(owner).unlink(missing_ok=True)

    def close(self) -> None:
        """Die: whatever is still owned under this name is free to be adopted."""
        if self._lock is not None:
            self._file(self.name).unlink(missing_ok=True)
            os.close(self._lock)
            self._lock = None

    def _file(self, name: str) -> Path:
        return self._folder / f"{name}.lock"


_log = logging.getLogger(__name__)

ORPHANS = 200  # cancelled jobs examined at start-up for solvers that still run
# A dispatcher never takes over attempts of another engine: it cannot see whether they live. But
# if no dispatcher of that engine comes back within a minute, the job waits again, for any engine.
ABANDONED_SECONDS = 60.0


class Recovery:
    """Finds leases that are lost.

    Parameters
    ----------
    take_over : callable
        Called with each job that was adopted.
    """

    def __init__(
        self, ledger: Ledger, engine: Engine, take_over: Callable[[JobRecord], None]
    ) -> None:
        self._ledger = ledger
        self._engine = engine
        self._take_over = take_over
        self._abandoned: dict[tuple[int, int], float] = {}

    def orphans(self) -> list[JobRecord]:
        """Return cancelled jobs of this engine whose solver may still run."""
        found = self._ledger.jobs(status="cancelled", limit=ORPHANS)
        return [job for job in found if job.attempt and job.engine == self._engine.name]

    def adopt_lost(self, lease: Lease) -> None:
        """Take over what dead dispatchers of this engine left; give up what another engine's did.

        Raises
        ------
        LedgerUnavailableError
            If the ledger cannot be written now; what is not adopted yet is found again.
        """
        others = [job for job in self._ledger.running() if job.owner != lease.name]
        beats = self._ledger.leases() if others else {}
        lost = {
            job.owner
            for job in others
            if job.owner and lease.is_lost(job.owner, job.engine or "local", beats.get(job.owner))
        }
        orphaned = [job for job in others if job.owner in lost]
        for job in orphaned:
            if job.engine == self._engine.name:
                self._adopt(job, lease)
        self._give_up_abandoned([job for job in orphaned if job.engine != self._engine.name])
        kept = {job.owner for job in orphaned if job.engine != self._engine.name}
        for owner in lost - kept:
            lease.remove(owner)
            self._ledger.end_lease(owner)

    def _adopt(self, job: JobRecord, lease: Lease) -> None:
        assert job.owner is not None
        adopted = self._ledger.adopt(job.id, job.attempt, job.owner, lease.name)
        if adopted is not None:
            _log.info("job %d attempt %d taken over from %s", job.id, job.attempt, job.owner)
            self._take_over(adopted)

    def _give_up_abandoned(self, jobs: list[JobRecord]) -> None:
        now = time.monotonic()
        since = {(job.id, job.attempt): now for job in jobs}
        self._abandoned = {key: self._abandoned.get(key, now) for key in since}
        for job in jobs:
            if now - self._abandoned[job.id, job.attempt] > ABANDONED_SECONDS:
                _log.warning(
                    "job %d waits again: no dispatcher supervises attempt %d on engine %s any more",
                    job.id, job.attempt, job.engine,
                )  # fmt: skip
                with contextlib.suppress(StaleAttemptError):
                    self._ledger.release(job.id, job.attempt)
