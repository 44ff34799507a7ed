"""The dispatcher: brings waiting jobs to an engine and their answers to the ledger."""

import contextlib
import functools
import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from service.jobs.attempt import LOCK, LOG, attempt_folder, last_words, prepare, solver_began
from service.jobs.engines.engine import Engine
from service.jobs.lease import Lease
from service.jobs.record_outcome import settle, spec_of
from service.ledger import Change, Job, Ledger, StaleAttemptError

_log = logging.getLogger(__name__)

LOOK_SECONDS = 0.01  # between looks at solvers and, for other processes' jobs, at the ledger
RECOVER_SECONDS = 1.0  # between looks for jobs whose dispatcher has died
TROUBLE_SECONDS = 1.0  # before trying again what failed: a full disk, no more processes
ORPHANS = 200  # cancelled jobs looked at, at start-up, for solvers nobody has stopped
# A death counts once its dispatcher has outlived it so long: what takes the solver and then the
# server, one kill of both or a machine going down, is nothing the job has done.
OUTLIVE_SECONDS = 1.0
START_AGAIN_SECONDS = 5.0  # before the next attempt of a job whose solver could not even begin
STOP_SECONDS = 15.0  # how long `stop` waits for solvers to end


@dataclass
class _Run:
    """An attempt this dispatcher looks after.

    `leaving` once nobody wants its answer, `witnessed` if its solver has lived in this
    dispatcher's time, `died` is when it was first seen dead (monotonic seconds).
    """

    job: Job
    folder: Path
    leaving: bool = False
    witnessed: bool = True
    died: float | None = None


class Dispatcher:
    """Runs the jobs of a ledger on an engine, in one thread of its own.

    Several dispatchers, in one process or many, may share a ledger and its jobs folder on
    one machine: each looks after the jobs it claimed, and takes over those of one that died,
    whose solvers may well be still running.

    Parameters
    ----------
    ledger : Ledger
        Where jobs come from and rows go to.
    engine : Engine
        Where solvers run; `stop` does not close it.
    bundles : callable
        Gives the folder of a component by its name; what it raises fails the job.
    jobs_folder : path
        Holds the attempts' folders, ``<job>/<attempt>``, and ``owners``.

    """

    def __init__(
        self,
        ledger: Ledger,
        engine: Engine,
        bundles: Callable[[str], Path],
        jobs_folder: str | Path,
    ) -> None:
        self._failing: str | None = None
        self._unstarted: str | None = None
        self._ledger = ledger
        self._engine = engine
        self._bundles = bundles
        self._jobs_folder = Path(jobs_folder).absolute()
        self._lease: Lease | None = None
        self._runs: dict[tuple[int, int], _Run] = {}
        self._wake = threading.Event()
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None
        self._seen: int | None = None
        self._may_claim = True
        self._next_recovery = 0.0

    @property
    def trouble(self) -> str | None:
        """What keeps jobs from running at present, such as a full disk; None if nothing does."""
        return self._failing or self._unstarted

    # -- from other threads -----------------------------------------------------------------

    def start(self) -> None:
        """Take over what a dead dispatcher left, then run jobs until `stop`."""
        if self._thread is not None:
            raise RuntimeError("the dispatcher runs already")
        self._stopping.clear()
        self._seen, self._may_claim, self._next_recovery = None, True, 0.0
        self._unsubscribe = self._ledger.on_change(self._on_change)
        self._thread = threading.Thread(target=self._loop, name="dispatcher", daemon=True)
        self._thread.start()

    def stop(self, *, keep_solvers: bool = False) -> None:
        """End; every job is then done, failed, cancelled or waiting again.

        Parameters
        ----------
        keep_solvers : bool
            Leave the solvers running and their jobs with them: the next dispatcher on this
            jobs folder goes on with them. Otherwise they are ended, which may take the
            engine's grace.
        """
        if self._thread is None:
            return
        self._unsubscribe()
        self._stopping.set()
        self._wake.set()
        self._thread.join()
        self._thread = None
        try:
            if not keep_solvers:
                self._end_runs()
        finally:
            # What could not be settled is left to the next dispatcher.
            self._runs.clear()
            if self._lease is not None:
                self._lease.close()
                self._lease = None

    # -- the loop ---------------------------------------------------------------------------

    def _on_change(self, change: Change) -> None:
        self._wake.set()

    def _loop(self) -> None:
        while not self._stopping.is_set():
            self._wake.clear()
            try:
                if self._lease is None:
                    self._lease = Lease(self._jobs_folder / "owners")
                self._step(self._lease)
                self._failing = None
            except Exception as error:
                if str(error) != self._failing:
                    _log.exception("the dispatcher tries again every %s s", TROUBLE_SECONDS)
                self._failing = str(error) or repr(error)
                self._may_claim = True
                self._stopping.wait(TROUBLE_SECONDS)
            else:
                self._wake.wait(LOOK_SECONDS)

    def _step(self, lease: Lease) -> None:
        if time.monotonic() >= self._next_recovery:
            self._recover(lease)
        version = self._ledger.version()
        if version != self._seen:
            self._leave_unwanted(lease)
            self._seen, self._may_claim = version, True
        for run in list(self._runs.values()):
            self._look(run)
        while self._may_claim and self._busy() < self._engine.slots:
            self._claim(lease)

    def _busy(self) -> int:
        return sum(run.died is None for run in self._runs.values())

    def _recover(self, lease: Lease) -> None:
        if self._next_recovery == 0.0:
            self._stop_orphans()
        for job in self._ledger.running():
            dead = job.owner
            if dead is None or dead == lease.name or lease.is_alive(dead):
                continue
            if self._ledger.adopt(job.id, job.attempt, dead, lease.name):
                _log.info("job %d attempt %d taken over from %s", job.id, job.attempt, dead)
                self._take_over(job)
            lease.remove(dead)
        self._may_claim = True  # a job that had to wait may be due
        self._next_recovery = time.monotonic() + RECOVER_SECONDS

    def _take_over(self, job: Job) -> None:
        folder = self._folder(job)
        self._engine.attach(folder)
        alive = self._engine.poll(folder) == "running"
        self._runs[job.id, job.attempt] = _Run(job, folder, witnessed=alive)

    def _stop_orphans(self) -> None:
        # Cancelled while no dispatcher lived: the solver has not heard of it.
        for job in self._ledger.jobs(status="cancelled", limit=ORPHANS):
            folder = self._folder(job)
            if job.attempt and self._engine.poll(folder) == "running":
                self._engine.attach(folder)
                self._engine.cancel(folder)
                self._runs[job.id, job.attempt] = _Run(job, folder, leaving=True)

    def _leave_unwanted(self, lease: Lease) -> None:
        running = self._ledger.running()
        mine = {(job.id, job.attempt) for job in running if job.owner == lease.name}
        for key, run in self._runs.items():
            if key not in mine and not run.leaving:
                run.leaving = True
                self._engine.cancel(run.folder)

    def _look(self, run: _Run) -> None:
        if self._unstarted and solver_began(run.folder):
            self._unstarted = None
        state = self._engine.poll(run.folder)
        if state == "running":
            return
        if not run.leaving:
            if run.died is None and state == "lost" and self._counts(run):
                run.died = time.monotonic()
                self._may_claim = True
            if run.died is not None and time.monotonic() - run.died < OUTLIVE_SECONDS:
                return
            with contextlib.suppress(StaleAttemptError):
                settle(self._ledger, run.job, run.folder, died=self._died(run))
        del self._runs[run.job.id, run.job.attempt]
        self._may_claim = True

    def _counts(self, run: _Run) -> bool:
        """Tell whether a solver that left nothing has died by itself, for all that is known."""
        return run.witnessed and solver_began(run.folder)

    def _died(self, run: _Run) -> Callable[[int, int], Job]:
        if self._counts(run):
            return self._ledger.lose
        if not run.witnessed or not (run.folder / LOCK).exists():
            return self._ledger.release
        words = last_words(run.folder) or "it printed nothing"
        self._unstarted = f"solvers end before they begin: {words}. See {run.folder / LOG}"
        _log.error("job %d: %s", run.job.id, self._unstarted)
        return functools.partial(self._ledger.release, delay=START_AGAIN_SECONDS)

    def _claim(self, lease: Lease) -> None:
        job = self._ledger.claim(lease.name)
        if job is None:
            self._may_claim = False
            return
        # Known from here on: whatever fails below, the next look finds an attempt without a
        # solver and gives it back.
        run = self._runs[job.id, job.attempt] = _Run(job, self._folder(job))
        try:
            bundle = self._bundles(job.component)
        except Exception as error:
            self._ledger.fail(job.id, job.attempt, _component_missing(job, error))
            del self._runs[job.id, job.attempt]
            return
        prepare(run.folder, spec_of(job, bundle))
        self._engine.submit(run.folder)

    def _end_runs(self) -> None:
        deadline = time.monotonic() + STOP_SECONDS
        for run in self._runs.values():
            self._engine.cancel(run.folder)
        for run in self._runs.values():
            while self._engine.poll(run.folder) == "running" and time.monotonic() < deadline:
                time.sleep(LOOK_SECONDS)
            if not run.leaving and self._engine.poll(run.folder) != "running":
                with contextlib.suppress(StaleAttemptError):
                    settle(self._ledger, run.job, run.folder)

    def _folder(self, job: Job) -> Path:
        return attempt_folder(self._jobs_folder, job.id, job.attempt)


def _component_missing(job: Job, error: Exception) -> dict[str, str]:
    return {
        "kind": "component_missing",
        "message": f"there is no component {job.component} to solve any more: {error}",
        "remedy": "add the component again and retry the job, or leave it",
    }
