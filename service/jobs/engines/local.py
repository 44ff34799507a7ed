"""The engine that needs nothing installed: solvers as processes of this machine."""

import os
import signal
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from wrenchbook.service.files import lock as flock
from wrenchbook.service.files.program import usable_cores
from wrenchbook.service.jobs.attempt import (
    LOCK,
    LOG,
    OUTCOME,
    solver_began,
    solver_seconds,
    write_outcome,
)
from wrenchbook.service.jobs.engines.engine import Attempt, EngineError, Listener, State
from wrenchbook.service.jobs.engines.solver_pool import SolverPool, signal_group

# Several solvers share the cores, so each gets one; what the user has set is left alone.
_THREADS = ("OMP", "OPENBLAS", "MKL", "NUMEXPR")
_ONE_THREAD_EACH = {f"{library}_NUM_THREADS": "1" for library in _THREADS}
_READABLE_LOGS = {"PYTHONUNBUFFERED": "1", "PYTHONFAULTHANDLER": "1"}

# A start costs 0.6 s of processor time for the imports and 0.3 s for the first solve of a
# component; shared by 200 attempts that is 1 % of the shortest solves, 0.4 s. What leaks too slowly
# to be noticed is gone after as many.
LIVES = 200


class LocalEngine:
    """Runs attempts in processes that live on, each in a session of its own, at low priority.

    A solver keeps the interpreter, what it imported, the component and its symbolic and first
    factorisation for the next attempt. It lives on when the server is killed, until the attempt
    it is at has ended, and holds the attempt's ``lock`` from before its first instruction until
    then: the lock is taken here and handed over, so there is no moment in which an attempt that
    will run looks like one whose solver died.

    Parameters
    ----------
    slots : int, optional
        Solvers at a time; the cores this program may use by default.
    environment : mapping, optional
        Variables added to those the solvers inherit. Whatever of it changes, also in this
        process, holds for the next attempt: a solver started under another one is renewed.
    niceness : int
        Added to the solvers' niceness, so that answers from tables stay fast.
    grace : float
        Seconds between asking a solver to end and killing it.
    lives : int
        Attempts after which a solver is renewed; 1 gives each a fresh process.
    """

    name = "local"
    trouble = None  # this machine is always there

    def __init__(
        self,
        slots: int | None = None,
        *,
        environment: Mapping[str, str] | None = None,
        niceness: int = 10,
        grace: float = 5.0,
        lives: int = LIVES,
    ) -> None:
        self.slots = slots or usable_cores()
        self._environment = dict(environment or {})
        self._grace = grace
        self._kill_after: dict[Path, float] = {}
        self._began: dict[Path, float] = {}
        self._overdue: set[Path] = set()
        self._listeners: tuple[Listener, ...] = ()
        options = ("--niceness", str(niceness), "--lives", str(lives))
        self._pool = SolverPool(self.slots, self._tell, *options)

    @property
    def solvers(self) -> frozenset[int]:
        """The pids of its solvers that have not ended, those that wait for work as well."""
        return self._pool.processes

    def submit(self, attempt: Attempt) -> None:
        """Have a solver take the attempt; see `Engine.submit`."""
        lock = flock.take(attempt.folder / LOCK)
        if lock is None:
            raise EngineError(f"a solver is at work in {attempt.folder} already")
        variables = _ONE_THREAD_EACH | _READABLE_LOGS | dict(os.environ) | self._environment
        try:
            with (attempt.folder / LOG).open("ab") as log:
                self._pool.run(attempt, lock, log.fileno(), variables)
        finally:
            os.close(lock)

    def attach(self, attempt: Attempt) -> None:
        """Do nothing: lock and files hold the whole state."""

    def poll(self, attempt: Attempt) -> State:
        """Return the attempt's state; see `Engine.poll`."""
        folder = attempt.folder
        if (folder / OUTCOME).exists():
            return "finished"
        if flock.is_locked(folder / LOCK):
            self._end_if_due(attempt)
            return "running" if solver_began(folder) else "submitted"
        # The solver may have ended well between the two looks.
        if (folder / OUTCOME).exists():
            return "finished"
        if folder in self._overdue:
            write_outcome(folder, attempt.spec, {"status": "failed", "error": _overdue(attempt)})
            return "finished"
        return "lost"

    def cancel(self, attempt: Attempt) -> None:
        """Send SIGTERM to the solver and its children; SIGKILL once `grace` is over."""
        if attempt.folder not in self._kill_after:
            self._kill_after[attempt.folder] = time.monotonic() + self._grace
            self._signal(attempt, signal.SIGTERM)

    def forget(self, attempt: Attempt) -> None:
        """Let go of what is kept of an attempt."""
        self._kill_after.pop(attempt.folder, None)
        self._began.pop(attempt.folder, None)
        self._overdue.discard(attempt.folder)

    def listen(self, listener: Listener) -> Callable[[], None]:
        """Report solvers that ended; see `Engine.listen`."""
        self._listeners = (*self._listeners, listener)

        def stop() -> None:
            self._listeners = tuple(one for one in self._listeners if one is not listener)

        return stop

    def close(self) -> None:
        """End the solvers that wait; those at work end after their attempt."""
        self._kill_after.clear()
        self._pool.close()

    def _tell(self, attempt: Attempt) -> None:
        for listener in self._listeners:
            listener(attempt.task)

    def _end_if_due(self, attempt: Attempt) -> None:
        folder, now = attempt.folder, time.monotonic()
        if folder in self._kill_after:
            late = now > self._kill_after[folder]
            self._signal(attempt, signal.SIGKILL if late else signal.SIGTERM)
        elif attempt.deadline is not None and solver_began(folder):
            if folder not in self._began:
                self._began[folder] = now - (solver_seconds(folder) or 0.0)
            if now - self._began[folder] > attempt.deadline:
                # Not SIGTERM: its outcome, "cancelled", would be tried again.
                self._overdue.add(folder)
                self._signal(attempt, signal.SIGKILL)

    def _signal(self, attempt: Attempt, number: int) -> None:
        # Before it began there is no process to signal: `poll` repeats it.
        if not solver_began(attempt.folder) or self._pool.signal(attempt, number):
            return
        # Another server's solver. Only while the file is locked is its pid surely the solver's.
        pid = _holder(attempt.folder / LOCK)
        if pid is not None and flock.is_locked(attempt.folder / LOCK):
            signal_group(pid, number)


def _holder(lock: Path) -> int | None:
    """Return the pid the solver wrote into its lock; None if it has not come to that yet."""
    try:
        return int(lock.read_text())
    except (OSError, ValueError):
        return None


def _overdue(attempt: Attempt) -> dict[str, str]:
    return {
        "kind": "deadline",
        "message": f"the solve took longer than its deadline of {attempt.deadline:.3g} s "
        "and was ended",
        "remedy": "see log.txt for how far it came; use a coarser mesh or a smaller load, "
        "or retry the job when the machine has less to do",
    }
