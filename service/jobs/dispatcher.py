"""The dispatcher: brings waiting jobs to an engine and their answers to the ledger."""

import contextlib
import functools
import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path

from wrenchbook.service.fields.store import FieldStore
from wrenchbook.service.jobs.attempt import LOG, last_words, prepare, solver_began, solver_seconds
from wrenchbook.service.jobs.engines.engine import ALIVE, Engine
from wrenchbook.service.jobs.lease import BEAT_SECONDS, Lease, Recovery
from wrenchbook.service.jobs.record_outcome import component_missing, settle
from wrenchbook.service.jobs.supervised import SupervisedAttempt, attempt_of, completed
from wrenchbook.service.ledger import Change, JobRecord, Ledger, StaleAttemptError
from wrenchbook.service.tables.solver_errors import SolverErrors

_log = logging.getLogger(__name__)

# Between looks for what has no event: commits of other processes, the end of solvers that another
# dispatcher started, and the grace of those that are to end.
LOOK_SECONDS = 0.02
RECOVER_SECONDS = 1.0  # between looks at all attempts, and for jobs whose dispatcher has died
TROUBLE_SECONDS = 1.0  # before trying again what failed: a full disk, no more processes
# A death counts once its dispatcher has outlived it so long: what takes the solver and then the
# server, one kill of both or a machine going down, is nothing the job has done.
OUTLIVE_SECONDS = 1.0
START_AGAIN_SECONDS = 5.0  # before the next attempt of a job whose solver could not even begin
STOP_SECONDS = 15.0  # how long `stop` waits for solvers to end
MOST_CLAIMED = 100  # in one transaction, which takes a few milliseconds then


class Dispatcher:
    """Runs the jobs of a ledger on an engine, in one thread of its own.

    Several dispatchers, in one process or many, may share a ledger and its jobs folder: each looks
    after the jobs it claimed, and takes over those of one of the same engine that died, whose
    solvers may well be still running.

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
    fields : FieldStore, optional
        Where deformed surfaces are kept.
    errors : SolverErrors, optional
        Where estimates of the solver's own error are kept; without it none are made.
    deadline : float, optional
        Seconds a solve may take; by default what the component's check makes of it.
    """

    def __init__(
        self,
        ledger: Ledger,
        engine: Engine,
        bundles: Callable[[str], Path],
        jobs_folder: str | Path,
        fields: FieldStore | None = None,
        errors: SolverErrors | None = None,
        *,
        deadline: float | None = None,
    ) -> None:
        self._failing: str | None = None
        self._unstarted: str | None = None
        self._ledger = ledger
        self._engine = engine
        self._bundles = bundles
        self._jobs_folder = Path(jobs_folder).absolute()
        self._fields, self._errors = fields, errors
        self._deadline = deadline
        self._lease: Lease | None = None
        self._runs: dict[tuple[int, int], SupervisedAttempt] = {}
        self._pressing: dict[tuple[int, int], SupervisedAttempt] = {}
        self._tasks: dict[str, SupervisedAttempt] = {}
        self._begun: dict[tuple[int, int], float] = {}
        self._heard: deque[str] = deque()
        self._wake = threading.Event()
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None
        self._recovery = Recovery(ledger, engine, self._take_over)

    @property
    def trouble(self) -> str | None:
        """What keeps jobs from running at present, such as a full disk; None if nothing does."""
        return self._failing or self._unstarted or self._engine.trouble

    # -- from other threads -----------------------------------------------------------------

    def start(self) -> None:
        """Take over what a dead dispatcher left, then run jobs until `stop`."""
        if self._thread is not None:
            raise RuntimeError("the dispatcher runs already")
        self._stopping.clear()
        self._seen, self._may_claim, self._changed = None, True, True
        self._next_look = self._next_sweep = self._next_beat = 0.0
        self._orphans_stopped = False
        self._ends = self._ledger.on_change(self._on_change), self._engine.listen(self._on_end)
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
        self._stopping.set()
        self._wake.set()
        self._thread.join()
        self._thread = None
        try:
            if not keep_solvers:
                self._end_runs()
        finally:
            for end in self._ends:
                end()
            # What could not be settled is left to the next dispatcher.
            for one in (self._runs, self._pressing, self._tasks, self._begun):
                one.clear()
            self._close_lease()

    def _on_change(self, change: Change) -> None:
        if threading.current_thread() is not self._thread:
            self._changed = True
            self._wake.set()

    def _on_end(self, task: str) -> None:
        self._heard.append(task)
        self._wake.set()

    # -- the loop ---------------------------------------------------------------------------

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
                self._may_claim, self._next_sweep = True, 0.0
                self._stopping.wait(TROUBLE_SECONDS)
            else:
                self._wake.wait(LOOK_SECONDS)

    def _step(self, lease: Lease) -> None:
        now = time.monotonic()
        if now >= self._next_sweep:
            self._sweep(lease)
            self._next_sweep = now + RECOVER_SECONDS
        if self._changed or now >= self._next_look:
            self._read_changes(lease)
            self._next_look = now + LOOK_SECONDS
        while self._heard:
            run = self._tasks.get(self._heard.popleft())
            if run is not None:
                self._look(run)
        for run in list(self._pressing.values()):
            self._look(run)
        if self._begun:
            self._beat(lease)
        while self._may_claim and (free := self._engine.slots - self._busy()) > 0:
            self._claim(lease, min(free, MOST_CLAIMED))

    def _busy(self) -> int:
        return len(self._runs) - sum(run.died is not None for run in self._pressing.values())

    def _sweep(self, lease: Lease) -> None:
        if not self._orphans_stopped:
            for job in self._recovery.orphans():
                self._stop_orphan(job)
            self._orphans_stopped = True
        self._recovery.adopt_lost(lease)
        for run in list(self._runs.values()):
            self._look(run)
        if self._runs and time.monotonic() >= self._next_beat:
            self._beat(lease)
        self._may_claim = True  # a job that had to wait may be due

    def _beat(self, lease: Lease) -> None:
        self._ledger.beat(lease.name, self._engine.name, self._begun)
        self._begun.clear()
        self._next_beat = time.monotonic() + BEAT_SECONDS

    def _read_changes(self, lease: Lease) -> None:
        self._changed = False
        version = self._ledger.version()
        if version != self._seen:
            self._seen, self._may_claim = version, True
            if self._runs:
                self._leave_unwanted(lease)

    def _leave_unwanted(self, lease: Lease) -> None:
        mine = self._ledger.attempts_of(lease.name)
        for run in [one for one in self._runs.values() if one.key not in mine]:
            if run.leaving:
                continue
            job = self._ledger.job(run.job.id)
            if job.status == "running" and job.attempt == run.job.attempt:
                _log.warning("job %d is looked after by %s: this one was late", job.id, job.owner)
                self._drop(run)
            else:
                run.leaving = True
                self._pressing[run.key] = run
                self._engine.cancel(run.attempt)

    # -- attempts ---------------------------------------------------------------------------

    def _add(self, run: SupervisedAttempt) -> None:
        self._runs[run.key] = self._tasks[run.attempt.task] = run
        if run.is_pressing:
            self._pressing[run.key] = run

    def _drop(self, run: SupervisedAttempt) -> None:
        self._engine.forget(run.attempt)
        del self._runs[run.key]
        for kept in (self._pressing, self._begun):
            kept.pop(run.key, None)
        self._tasks.pop(run.attempt.task, None)
        self._may_claim = True

    def _take_over(self, job: JobRecord) -> None:
        attempt = attempt_of(job, self._jobs_folder)
        with contextlib.suppress(Exception):  # without it the attempt may still be found
            attempt = completed(attempt, job, self._bundles(job.component), self._deadline)
        self._engine.attach(attempt)
        alive = self._engine.poll(attempt) in ALIVE
        self._add(SupervisedAttempt(job, attempt, taken=True, witnessed=alive, adopted=True))

    def _stop_orphan(self, job: JobRecord) -> None:
        attempt = attempt_of(job, self._jobs_folder)
        self._engine.cancel(attempt)
        if self._engine.poll(attempt) in ALIVE:
            self._add(SupervisedAttempt(job, attempt, adopted=True, leaving=True))
        else:
            self._engine.forget(attempt)

    def _look(self, run: SupervisedAttempt) -> None:
        state = self._engine.poll(run.attempt)
        if state == "running" and not run.began:
            seconds = solver_seconds(run.folder) or 0.0
            run.began, self._begun[run.key] = True, time.time() - seconds
        if self._unstarted and solver_began(run.folder):
            self._unstarted = None
        if state in ALIVE:
            return
        if not run.leaving:
            if run.died is None and state == "lost" and run.counts:
                run.died = time.monotonic()
                self._pressing[run.key] = run
                self._may_claim = True
            if run.died is not None and time.monotonic() - run.died < OUTLIVE_SECONDS:
                return
            with contextlib.suppress(StaleAttemptError):
                died = self._died(run)
                self._settle(run, died)
        self._drop(run)

    def _settle(
        self, run: SupervisedAttempt, died: Callable[[int, int], JobRecord] | None = None
    ) -> None:
        kept = {"fields": self._fields, "errors": self._errors}
        settle(self._ledger, run.job, run.folder, died=died, **kept)

    def _died(self, run: SupervisedAttempt) -> Callable[[int, int], JobRecord]:
        if run.counts:
            return functools.partial(self._ledger.lose, cause=last_words(run.folder))
        if not run.witnessed or not run.taken:
            return self._ledger.release
        words = last_words(run.folder) or "it printed nothing"
        self._unstarted = f"solvers end before they begin: {words}. See {run.folder / LOG}"
        _log.error("job %d: %s", run.job.id, self._unstarted)
        return functools.partial(self._ledger.release, delay=START_AGAIN_SECONDS)

    def _claim(self, lease: Lease, most: int) -> None:
        jobs = self._ledger.claim_many(lease.name, self._engine.name, most)
        self._may_claim = len(jobs) == most
        # Known from here on: whatever fails below, the next look finds attempts without a
        # solver and gives them back.
        runs = [SupervisedAttempt(job, attempt_of(job, self._jobs_folder)) for job in jobs]
        for run in runs:
            self._add(run)
        for run in runs:
            self._submit(run)

    def _submit(self, run: SupervisedAttempt) -> None:
        try:
            bundle = self._bundles(run.job.component)
        except Exception as error:
            self._ledger.fail(*run.key, component_missing(run.job, error))
            self._drop(run)
            return
        named = run.job.component, run.job.fingerprint
        estimate = self._errors is not None and self._errors.claim(*named)
        run.attempt = completed(run.attempt, run.job, bundle, self._deadline, estimate=estimate)
        prepare(run.folder, run.attempt.spec)
        self._engine.submit(run.attempt)
        run.taken = True

    def _end_runs(self) -> None:
        deadline = time.monotonic() + STOP_SECONDS
        for run in self._runs.values():
            self._engine.cancel(run.attempt)
        for run in self._runs.values():
            while self._engine.poll(run.attempt) in ALIVE and time.monotonic() < deadline:
                self._wake.clear()
                self._wake.wait(LOOK_SECONDS)
            if not run.leaving and self._engine.poll(run.attempt) not in ALIVE:
                with contextlib.suppress(StaleAttemptError):
                    self._settle(run)

    def _close_lease(self) -> None:
        if self._lease is not None:
            with contextlib.suppress(Exception):  # it dies all the same
                self._ledger.end_lease(self._lease.name)
            self._lease.close()
            self._lease = None
