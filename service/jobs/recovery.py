"""What a dispatcher does about attempts whose own dispatcher is gone."""

import contextlib
import logging
import time
from collections.abc import Callable

from wrenchbook.service.jobs.engines.engine import Engine
from wrenchbook.service.jobs.lease import Lease
from wrenchbook.service.ledger import Job, Ledger, StaleAttemptError

_log = logging.getLogger(__name__)

ORPHANS = 200  # cancelled jobs looked at, at start-up, for solvers nobody has stopped
# A dispatcher never takes over what another engine has: it could not tell whether that lives. But
# if no dispatcher of that engine comes back within a minute, the job waits again, for any engine.
ABANDONED_SECONDS = 60.0


class Recovery:
    """Finds leases that are lost.

    Parameters
    ----------
    take_over : callable
        Called with each job that was adopted.
    """

    def __init__(self, ledger: Ledger, engine: Engine, take_over: Callable[[Job], None]) -> None:
        self._ledger = ledger
        self._engine = engine
        self._take_over = take_over
        self._abandoned: dict[tuple[int, int], float] = {}

    def orphans(self) -> list[Job]:
        """Return jobs of this engine whose solver may not have heard that they are cancelled."""
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

    def _adopt(self, job: Job, lease: Lease) -> None:
        assert job.owner is not None
        adopted = self._ledger.adopt(job.id, job.attempt, job.owner, lease.name)
        if adopted is not None:
            _log.info("job %d attempt %d taken over from %s", job.id, job.attempt, job.owner)
            self._take_over(adopted)

    def _give_up_abandoned(self, jobs: list[Job]) -> None:
        now = time.monotonic()
        since = {(job.id, job.attempt): now for job in jobs}
        self._abandoned = {key: self._abandoned.get(key, now) for key in since}
        for job in jobs:
            if now - self._abandoned[job.id, job.attempt] > ABANDONED_SECONDS:
                _log.warning(
                    "job %d waits again: nobody looks after attempt %d on the engine %s any more",
                    job.id, job.attempt, job.engine,
                )  # fmt: skip
                with contextlib.suppress(StaleAttemptError):
                    self._ledger.release(job.id, job.attempt)
