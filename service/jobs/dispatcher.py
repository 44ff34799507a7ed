"""The dispatcher: brings waiting jobs to an engine and their answers to the ledger.

Engines, `local` and `dask`, run attempts; the ledger decides which. Any thread may call an engine,
one at a time, and no call waits for another machine. An engine has:

- ``name``, in the ledger: only dispatchers with this engine take over its attempts.
- ``slots``, the attempts that it takes at once, and ``trouble``, why it can run none (or None).
- ``submit`` starts or queues an attempt; after OSError or `EngineError` nothing runs.
- ``attach`` follows an attempt of a dead dispatcher; one that the engine does not know is ``lost``,
  or submitted again under its key.
- ``poll`` returns ``submitted``, ``running`` while a solver works, ``finished`` once the folder
  holds result.json and all other files, ``lost`` if no solver can still write one. The engine
  repeats attempts after a death of workers or machines, and writes the result.json of an attempt
  that it ends itself, at its deadline. The last line of the log has the cause of a solver's death.
- ``cancel`` ends the solver soon, of any attempt and any number of times.
- ``forget`` drops an ended attempt; ``close`` releases resources, and running attempts go on.
"""

import contextlib
import functools
import logging
import os
import secrets
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from wrenchbook.service.fields.store import FieldStore
from wrenchbook.service.files import lock as flock
from wrenchbook.service.jobs.attempt import (
    ALIVE,
    LOG,
    OUTLIVE_SECONDS,
    Attempt,
    BadOutcomeError,
    Outcome,
    attempt_folder,
    last_output,
    prepare,
    read_outcome,
    solver_began,
    solver_seconds,
    tidy,
)
from wrenchbook.service.ledger import Heartbeat, JobRecord, Ledger, StaleAttemptError
from wrenchbook.service.library.component import BrokenComponentError, estimate_of
from wrenchbook.service.tables.solver_errors import SolverErrors

if TYPE_CHECKING:  # only a server with a cluster has Dask, and waits for its import
    from wrenchbook.service.jobs.dask import DaskEngine
    from wrenchbook.service.jobs.solver_pool import LocalEngine

    Engine: TypeAlias = LocalEngine | DaskEngine

_log = logging.getLogger(__name__)

# Pause between polls for changes without an event: commits of other processes, the end of solvers
# that another dispatcher started, and the grace period of solvers that must end.
POLL_SECONDS = 0.02
# Pause between checks of all attempts and of jobs of dead dispatchers: a query a second costs
# little.
RECOVER_SECONDS = 1.0
# Pause before a failed action is repeated: a full disk or a process limit lasts.
TROUBLE_SECONDS = 1.0
START_AGAIN_SECONDS = 5.0  # pause before the next attempt of a job whose solver could not begin
STOP_SECONDS = 15.0  # time that `stop` waits for solvers to end
MAX_CLAIMED = 100  # jobs claimed in one transaction, which then takes a few milliseconds
ORPHANS = 200  # cancelled jobs examined at start-up for solvers that still run
# A dispatcher never takes over attempts of another engine, whose state it cannot see. But if no
# dispatcher of that engine returns within this time, the job waits again, for any engine.
ABANDONED_SECONDS = 60.0
# Interval of the heartbeats of a dispatcher with attempts: each is a commit.
HEARTBEAT_SECONDS = 2.0
# Four missed heartbeats. With a check a second, a lost lease is detected within ten seconds.
LEASE_SECONDS = 8.0

# Ratio of a deadline to the estimated seconds: a load may take 4 times the iterations of a usual
# one, the estimate is right to a factor of two, and a machine may be slower or busier by as much
# again and more.
DEADLINE_MARGIN = 100.0
MIN_DEADLINE = 3600.0  # s: a solve of seconds on a machine that is almost stopped
# s, without an estimate of a check: solves take hours, but no known one a day
UNKNOWN_DEADLINE = 24 * 3600.0


class Lease:
    """The name under which a dispatcher owns running jobs as long as it lives.

    All dispatchers of a data directory have their lock files in `folder`.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.name = f"{os.getpid()}-{secrets.token_hex(4)}"
        self._folder = folder
        self._lock = flock.take(self._file(self.name))
        # By owner: the number of its last heartbeat, and when this was first seen, monotonic s.
        self._known: dict[str, tuple[int, float]] = {}

    def is_lost(self, owner: str, engine: str, heartbeat: Heartbeat | None) -> bool:
        """Return whether an owner of attempts has died, or has abandoned them.

        An unlocked file proves it at once; all dispatchers of `local` have their files in the
        folder. Otherwise the heartbeat does, if it has not changed while this dispatcher ran, so
        that no other machine's clock matters. An owner without a heartbeat has ended its lease.
        """
        file = self._file(owner)
        has_file = file.exists()
        if has_file and not flock.is_locked(file):
            return True
        if not has_file and (engine == "local" or heartbeat is None):
            return True
        now = time.monotonic()
        number = -1 if heartbeat is None else heartbeat.number
        known = self._known.get(owner)
        if known is None or known[0] != number:
            self._known[owner] = number, now
            return False
        return now - known[1] > LEASE_SECONDS

    def remove(self, owner: str) -> None:
        """Remove the lock file of a dispatcher that is dead; one that is merely late keeps it."""
        self._known.pop(owner, None)
        if not flock.is_locked(self._file(owner)):
            self._file(owner).unlink(missing_ok=True)

    def close(self) -> None:
        """Release the lease: other dispatchers may take over its jobs."""
        if self._lock is not None:
            self._file(self.name).unlink(missing_ok=True)
            os.close(self._lock)
            self._lock = None

    def _file(self, name: str) -> Path:
        return self._folder / f"{name}.lock"


class Dispatcher:
    """Runs the jobs of a ledger on an engine, in a thread of its own.

    Several dispatchers, in one process or many, may share a ledger and its jobs folder: each
    handles the jobs it claimed, and takes over those of a dead dispatcher of the same engine, whose
    solvers may still be running.

    `bundles`: returns the folder of a component by its name; its errors fail the job.
    `jobs_folder`: has the attempts' folders, ``<job>/<attempt>``, and ``owners``.
    `fields`, `errors`: store deformed surfaces and estimates of the solver's own error.
    `setups`: returns the present fingerprint of a component: a job that was accepted for an earlier
    one, before an upgrade for example, is submitted again for it.

    `stop` does not close the engine.
    """

    def __init__(
        self,
        ledger: Ledger,
        engine: "Engine",
        bundles: Callable[[str], Path],
        jobs_folder: str | Path,
        fields: FieldStore | None = None,
        errors: SolverErrors | None = None,
        *,
        setups: Callable[[str], str] = lambda _: "",
    ) -> None:
        self._failing: str | None = None
        self._unstarted: str | None = None
        self._ledger = ledger
        self._engine = engine
        self._bundles = bundles
        self._setups = setups
        self._jobs_folder = Path(jobs_folder).absolute()
        self._fields = fields
        self._errors = errors
        self._lease: Lease | None = None
        self._attempts: dict[str, Attempt] = {}  # by task key, as the next dictionary
        # Polled often: their end may come without an event, or an action is due soon.
        self._pressing: dict[str, Attempt] = {}
        self._begun: dict[tuple[int, int], float] = {}
        self._abandoned: dict[tuple[int, int], float] = {}
        self._reported: deque[str] = deque()
        self._wake = threading.Event()
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def trouble(self) -> str | None:
        """The obstacle to running jobs at present, such as a full disk; None without one."""
        return self._failing or self._unstarted or self._engine.trouble

    # -- from other threads -----------------------------------------------------------------

    def start(self) -> None:
        """Take over the attempts of dead dispatchers, then run jobs until `stop`."""
        if self._thread is not None:
            raise RuntimeError("the dispatcher is already running; call stop first")
        self._stopping.clear()
        self._version = None
        self._may_claim = True
        self._changed = True
        self._next_poll = self._next_sweep = self._next_heartbeat = 0.0
        self._orphans_stopped = False
        self._ends = self._ledger.on_change(self._on_change), self._engine.listen(self._on_end)
        self._thread = threading.Thread(target=self._loop, name="dispatcher", daemon=True)
        self._thread.start()

    def stop(self, *, keep_solvers: bool = False) -> None:
        """Stop; every job is then done, failed, cancelled or waiting again.

        With `keep_solvers` the solvers continue, and their jobs with them: the next dispatcher on
        this jobs folder takes them over. Otherwise they are ended, which may take the engine's
        grace period.
        """
        if self._thread is None:
            return
        self._stopping.set()
        self._wake.set()
        self._thread.join()
        self._thread = None
        try:
            deadline = time.monotonic() + STOP_SECONDS
            attempts = [] if keep_solvers else list(self._attempts.values())
            for attempt in attempts:
                self._engine.cancel(attempt)
            for attempt in attempts:
                while self._engine.poll(attempt) in ALIVE and time.monotonic() < deadline:
                    self._wake.clear()
                    self._wake.wait(POLL_SECONDS)
                if not attempt.leaving and self._engine.poll(attempt) not in ALIVE:
                    with contextlib.suppress(StaleAttemptError):
                        record(self._ledger, attempt, None, self._fields, self._errors)
        finally:
            for end in self._ends:
                end()
            # The next dispatcher records the remaining ends.
            for registry in (self._attempts, self._pressing, self._begun):
                registry.clear()
            if self._lease is not None:
                with contextlib.suppress(Exception):  # the lease ends in any case
                    self._ledger.end_lease(self._lease.name)
                self._lease.close()
                self._lease = None

    def _on_change(self) -> None:
        if threading.current_thread() is not self._thread:
            self._changed = True
            self._wake.set()

    def _on_end(self, task: str) -> None:
        self._reported.append(task)
        self._wake.set()

    # -- the loop ---------------------------------------------------------------------------

    def _loop(self) -> None:
        """Repeat `_step` until the dispatcher is stopped, after a pause if it fails."""
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
                self._next_sweep = 0.0
                self._stopping.wait(TROUBLE_SECONDS)
            else:
                self._wake.wait(POLL_SECONDS)

    def _step(self, lease: Lease) -> None:
        """Look once for changes, follow the attempts, and claim jobs for free slots."""
        now = time.monotonic()
        if now >= self._next_sweep:
            self._sweep(lease)
            self._next_sweep = now + RECOVER_SECONDS
        if self._changed or now >= self._next_poll:
            self._changed = False
            version = self._ledger.version()
            if version != self._version:
                self._version = version
                self._may_claim = True
                self._leave_unwanted(lease)
            self._next_poll = now + POLL_SECONDS
        while self._reported:
            attempt = self._attempts.get(self._reported.popleft())
            if attempt is not None:
                self._poll(attempt)
        for attempt in list(self._pressing.values()):
            self._poll(attempt)
        if self._begun:
            self._send_heartbeat(lease)
        while self._may_claim:
            free = self._engine.slots - sum(
                attempt.died is None for attempt in self._attempts.values()
            )
            if free <= 0:
                break
            self._claim(lease, min(free, MAX_CLAIMED))

    def _sweep(self, lease: Lease) -> None:
        """Stop orphaned solvers, adopt lost attempts, and poll every attempt."""
        if not self._orphans_stopped:
            for job in self._ledger.jobs(status="cancelled", limit=ORPHANS):
                if not job.attempt or job.engine != self._engine.name:
                    continue
                attempt = self._attempt_of(job)
                self._engine.cancel(attempt)
                if self._engine.poll(attempt) in ALIVE:
                    attempt.adopted = attempt.leaving = True
                    self._add(attempt)
                else:
                    self._engine.forget(attempt)
            self._orphans_stopped = True
        self._adopt_lost(lease)
        for attempt in list(self._attempts.values()):
            self._poll(attempt)
        if self._attempts and time.monotonic() >= self._next_heartbeat:
            self._send_heartbeat(lease)
        self._may_claim = True  # a job that had to wait may be due

    def _send_heartbeat(self, lease: Lease) -> None:
        self._ledger.send_heartbeat(lease.name, self._engine.name, self._begun)
        self._begun.clear()
        self._next_heartbeat = time.monotonic() + HEARTBEAT_SECONDS

    def _leave_unwanted(self, lease: Lease) -> None:
        """End attempts that are cancelled, or that another dispatcher has taken over."""
        owned = self._ledger.attempts_of(lease.name) if self._attempts else set()
        for attempt in list(self._attempts.values()):
            if attempt.key in owned or attempt.leaving:
                continue
            job = self._ledger.job(attempt.job)
            if job.status == "running" and job.attempt == attempt.attempt:
                _log.warning("job %d belongs to %s: this one was late", job.id, job.owner)
                self._drop(attempt)
            else:
                attempt.leaving = True
                self._pressing[attempt.task] = attempt
                self._engine.cancel(attempt)

    def _adopt_lost(self, lease: Lease) -> None:
        """Take over attempts of dead dispatchers of this engine; release those of another engine.

        Attempts that cannot be adopted because the ledger cannot be written now are found again.
        """
        others = [job for job in self._ledger.running() if job.owner != lease.name]
        leases = self._ledger.leases() if others else {}
        lost = {
            job.owner
            for job in others
            if job.owner and lease.is_lost(job.owner, job.engine or "local", leases.get(job.owner))
        }
        foreign: list[JobRecord] = []
        for job in others:
            if job.owner is None or job.owner not in lost:
                continue
            if job.engine != self._engine.name:
                foreign.append(job)
            elif adopted := self._ledger.adopt(job.id, job.attempt, job.owner, lease.name):
                _log.info("job %d attempt %d taken over from %s", job.id, job.attempt, job.owner)
                attempt = self._attempt_of(adopted)
                with contextlib.suppress(Exception):  # without it the attempt may still be adopted
                    self._complete(attempt, self._bundles(job.component))
                self._engine.attach(attempt)
                attempt.accepted = attempt.adopted = True
                attempt.witnessed = self._engine.poll(attempt) in ALIVE
                self._add(attempt)

        now = time.monotonic()
        keys = [(job.id, job.attempt) for job in foreign]
        self._abandoned = {key: self._abandoned.get(key, now) for key in keys}
        for job in foreign:
            if now - self._abandoned[job.id, job.attempt] > ABANDONED_SECONDS:
                _log.warning(
                    "job %d waits again: no dispatcher supervises attempt %d on engine %s any more",
                    job.id, job.attempt, job.engine,
                )  # fmt: skip
                with contextlib.suppress(StaleAttemptError):
                    self._ledger.release(job.id, job.attempt)
        for owner in lost - {job.owner for job in foreign}:
            lease.remove(owner)
            self._ledger.end_lease(owner)

    # -- attempts ---------------------------------------------------------------------------

    def _attempt_of(self, job: JobRecord) -> Attempt:
        return Attempt.of(job, attempt_folder(self._jobs_folder, job.id, job.attempt))

    def _complete(self, attempt: Attempt, bundle: Path) -> None:
        """Add the component's folder and the resources of its solve."""
        check = estimate_of(bundle)
        memory, seconds = check.get("memory_bytes"), check.get("nonlinear_seconds")
        attempt.deadline = UNKNOWN_DEADLINE
        if isinstance(memory, int) and isinstance(seconds, int | float):
            attempt.memory = memory
            attempt.deadline = max(MIN_DEADLINE, DEADLINE_MARGIN * seconds)
        attempt.bundle = str(bundle.absolute())

    def _add(self, attempt: Attempt) -> None:
        self._attempts[attempt.task] = attempt
        if attempt.adopted:
            self._pressing[attempt.task] = attempt

    def _drop(self, attempt: Attempt) -> None:
        self._engine.forget(attempt)
        del self._attempts[attempt.task]
        self._pressing.pop(attempt.task, None)
        self._begun.pop(attempt.key, None)
        self._may_claim = True

    def _poll(self, attempt: Attempt) -> None:
        """Record the beginning and the end of an attempt in the ledger."""
        state = self._engine.poll(attempt)
        if state == "running" and not attempt.began:
            seconds = solver_seconds(attempt.folder) or 0.0
            attempt.began, self._begun[attempt.key] = True, time.time() - seconds
        if self._unstarted and solver_began(attempt.folder):
            self._unstarted = None
        if state in ALIVE:
            return
        if attempt.leaving:
            self._drop(attempt)
            return

        # Whether the end of a solver without an outcome counts as a failure of its job.
        counts = attempt.witnessed and (attempt.began or solver_began(attempt.folder))
        if attempt.died is None and state == "lost" and counts:
            attempt.died = time.monotonic()
            self._pressing[attempt.task] = attempt
            self._may_claim = True
        if attempt.died is not None and time.monotonic() - attempt.died < OUTLIVE_SECONDS:
            return

        record_loss = self._ledger.release
        if counts:
            cause = last_output(attempt.folder)
            record_loss = functools.partial(self._ledger.lose, cause=cause)
        elif attempt.witnessed and attempt.accepted:
            record_loss = functools.partial(self._ledger.release, delay=START_AGAIN_SECONDS)
            if state == "lost":
                cause = last_output(attempt.folder) or "it printed nothing"
                log = attempt.folder / LOG
                self._unstarted = f"solvers stop before they start: {cause}. See {log}"
                _log.error("job %d: %s", attempt.job, self._unstarted)
        with contextlib.suppress(StaleAttemptError):
            record(self._ledger, attempt, record_loss, self._fields, self._errors)
        self._drop(attempt)

    def _claim(self, lease: Lease, limit: int) -> None:
        """Claim up to `limit` jobs, and submit those whose component is unchanged."""
        jobs = self._ledger.claim_many(lease.name, self._engine.name, limit)
        self._may_claim = len(jobs) == limit
        # Registered from now on: after a failure below, the next poll finds attempts without a
        # solver and releases them.
        attempts = [self._attempt_of(job) for job in jobs]
        for attempt in attempts:
            self._add(attempt)
        for attempt in attempts:
            try:
                bundle = self._bundles(attempt.component)
                fingerprint = self._setups(attempt.component) or attempt.fingerprint
            except Exception as error:
                remedy = "Add it again and retry the job, or leave the job."
                if isinstance(error, BrokenComponentError):  # its text has the remedy
                    remedy = "Then retry the job."
                message = f"The component {attempt.component} cannot be solved. {error}"
                missing = {"kind": "component_missing", "message": message, "remedy": remedy}
                self._ledger.fail(*attempt.key, missing)
                self._drop(attempt)
                continue
            if fingerprint != attempt.fingerprint:
                _log.info("job %d is asked again: its component has changed", attempt.job)
                self._ledger.renew(*attempt.key, fingerprint)
                self._drop(attempt)
                continue
            self._complete(attempt, bundle)
            setup = attempt.component, attempt.fingerprint
            attempt.estimate = self._errors is not None and self._errors.claim(*setup)
            prepare(attempt)
            self._engine.submit(attempt)
            attempt.accepted = True


def record(
    ledger: Ledger,
    attempt: Attempt,
    record_loss: Callable[[int, int], object] | None = None,
    fields: FieldStore | None = None,
    errors: SolverErrors | None = None,
) -> None:
    """Record the end of an attempt in the ledger, after the last solver in its folder has ended.

    Safe to repeat. `record_loss` is the ledger's call for a solver that left no outcome,
    `Ledger.release` by default.

    Raises StaleAttemptError if the job has continued without this attempt.
    """
    try:
        outcome = read_outcome(attempt)
    except BadOutcomeError as error:
        _log.warning("taken for a lost attempt: %s", error)
        outcome = None
    setup = (attempt.component, attempt.fingerprint)
    seconds = solver_seconds(attempt.folder)
    if errors is not None:  # before the row: then the table's version with the row has it
        errors.record(*setup, outcome and outcome.solver_error)
    if outcome is None:
        (record_loss or ledger.release)(*attempt.key)
    elif outcome.status == "done":
        if fields is not None:  # without its row it does no harm, and it is found by its wrench
            fields.take(attempt.folder, *setup, attempt.wrench)
        _commit(ledger, attempt, outcome, seconds)
    elif outcome.status == "failed":
        error = outcome.error
        if isinstance(error, dict) and {"kind", "message", "remedy"} <= error.keys():
            error = {name: str(error[name]) for name in ("kind", "message", "remedy")}
        else:
            error = _bad_answer("it failed without kind, message and remedy of the error")
        ledger.fail(*attempt.key, error, seconds)
    else:
        ledger.release(*attempt.key)


def _commit(ledger: Ledger, attempt: Attempt, outcome: Outcome, seconds: float | None) -> None:
    """Commit the row of a done attempt and tidy its folder; an unusable answer fails the job."""
    origin = f"job {attempt.job}"
    if isinstance(outcome.program, str):
        origin += f", wrenchbook {outcome.program}"
    try:
        ledger.commit(
            *attempt.key,
            outcome.displacement or (),
            compliance=outcome.compliance,
            curvature=outcome.curvature,
            origin=origin,
            seconds=seconds,
        )
    except (ValueError, TypeError) as error:
        ledger.fail(*attempt.key, _bad_answer(str(error)))
        return
    with contextlib.suppress(OSError):
        tidy(attempt.folder)


def _bad_answer(why: str) -> dict[str, str]:
    return {
        "kind": "bad_answer",
        "message": f"the solver's answer cannot be used: {why}",
        "remedy": "see result.json and log.txt among the job's files (GET /v1/jobs/NUMBER/files)",
    }
