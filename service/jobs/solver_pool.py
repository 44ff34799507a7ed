"""The engine without further installation: solvers as processes of this machine.

A solver process lives from one attempt to the next. It is started with one end of a socket pair,
which transmits, for each attempt, its folder and two open files: the attempt's lock, taken, and its
log. The solver replies with one letter when it has begun and one when it has ended; when the socket
is closed, as at the server's death, it ends after its attempt (`service.jobs.solver`).
"""

import contextlib
import logging
import os
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Mapping
from pathlib import Path

from wrenchbook.fea.failure import exit_text
from wrenchbook.service.files import lock as flock
from wrenchbook.service.files.program import child_command, usable_cores
from wrenchbook.service.jobs import attempt as attempts
from wrenchbook.service.jobs.attempt import LOCK, LOG, OUTCOME, Attempt, Outcome, State

_log = logging.getLogger(__name__)

# Several solvers share the cores, so each gets one; the user's own variables are kept.
_ENVIRONMENT = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMEXPR")}
_ENVIRONMENT |= {"PYTHONUNBUFFERED": "1", "PYTHONFAULTHANDLER": "1"}  # readable logs

# Attempts of a solver process. A start costs 0.6 s of processor time for the imports and 0.3 s for
# the first solve of a component; shared by 200 attempts that is 1 % of the shortest solves, 0.4 s.
# Slow leaks of memory end with the process.
MAX_ATTEMPTS = 200
# Times of a solver that works, on two busy cores: 1 ms, at most 15 ms, until it confirms an
# attempt, and from its result.json to its message that it is free. One that takes a hundred times
# as long is stopped or damaged, and another one is started in its place.
CONFIRM_SECONDS = 5.0
FREE_SECONDS = 2.0
# Time for a killed solver to exit. One that is blocked in the kernel, by a dead file server for
# example, takes longer, but executes no further instruction.
EXIT_SECONDS = 2.0
# At this niceness a busy solver gets a tenth of a core that another process wants (sched(7)).
NICENESS = 10
GRACE_SECONDS = 5.0  # between SIGTERM and SIGKILL, in which a solver writes its outcome


class SolverProcess:
    """A solver process, and its present attempt."""

    def __init__(
        self,
        process: subprocess.Popen[bytes],
        channel: socket.socket,
        environment: Mapping[str, str],
        attempt: Attempt | None,
    ) -> None:
        self.process = process
        self.channel = channel
        self.environment = environment
        self.attempt = attempt
        self.component: tuple[str, str] | None = None
        self.has_begun = False  # the present attempt
        self.answered = threading.Event()  # set when it has begun the attempt or has exited
        self.exited = threading.Event()

    def send(self, attempt: Attempt, lock: int, log: int) -> None:
        """Send an attempt with its lock and its log.

        Raises OSError if the solver has exited.
        """
        self.has_begun = False
        self.answered.clear()
        self.component = attempt.bundle, attempt.fingerprint
        socket.send_fds(self.channel, [os.fsencode(attempt.folder.absolute())], [lock, log])

    def signal(self, number: int) -> None:
        """Send a signal to the solver and its children."""
        if not self.exited.is_set():
            signal_group(self.process.pid, number)


class LocalEngine(attempts.Listeners):
    """Runs attempts in persistent processes, each in a session of its own, at low priority.

    A solver keeps its imports, the component and its factorisations for the next attempt. If the
    server is killed, it ends after its present attempt. The engine takes the attempt's ``lock`` and
    passes it to the solver, which holds it to the end: a free lock means that no solver works.

    `slots`, by default one a core, is the number of attempts that a caller submits at once; solvers
    beyond it end with their attempt. `environment` is added to the variables that solvers
    inherit; a solver that was started with other variables is replaced, and so is one after
    `max_attempts`. `niceness` lowers their priority, `grace` seconds pass between SIGTERM and
    SIGKILL. Without `outlived_by_solvers` they are killed when this process dies. Several
    threads may call its methods, each for attempts of its own.
    """

    name = "local"
    trouble: str | None = None  # this machine is always available

    def __init__(
        self,
        slots: int | None = None,
        *,
        environment: Mapping[str, str] | None = None,
        niceness: int = NICENESS,
        grace: float = GRACE_SECONDS,
        max_attempts: int = MAX_ATTEMPTS,
        outlived_by_solvers: bool = True,
    ) -> None:
        self.slots = slots or usable_cores()
        self._environment = dict(environment or {})
        self._grace = grace
        self._options = ["--niceness", str(niceness), "--attempts", str(max_attempts)]
        self._options += [] if outlived_by_solvers else ["--end-with-engine"]
        # By the folder of an attempt; monotonic s.
        self._kill_after: dict[Path, float] = {}
        self._began: dict[Path, float] = {}
        self._overdue: set[Path] = set()
        self._solvers: list[SolverProcess] = []  # the solver longest without work is first
        self._processes: set[int] = set()
        self._changed = threading.Condition()

    @property
    def solvers(self) -> frozenset[int]:
        """The pids of its solvers that have not ended, including those that wait for work."""
        with self._changed:
            return frozenset(self._processes)

    def submit(self, attempt: Attempt) -> None:
        """Give the attempt to a solver with its component, else to any free or a new solver."""
        lock = flock.take(attempt.folder / LOCK)
        if lock is None:
            raise attempts.EngineError(
                f"a solver already works in {attempt.folder}; wait for its end, or end the process "
                f"that its file {LOCK} names"
            )
        environment = _ENVIRONMENT | dict(os.environ) | self._environment
        try:
            with (attempt.folder / LOG).open("ab") as log:
                while (solver := self._reserve(attempt, environment)) is not None:
                    with contextlib.suppress(OSError):
                        solver.send(attempt, lock, log.fileno())
                        solver.answered.wait(CONFIRM_SECONDS)
                        if solver.has_begun:
                            return
                    # The attempt must not begin late, after another solver's attempt.
                    with self._changed:
                        solver.attempt = None
                        self._drop(solver)
                    solver.signal(signal.SIGKILL)
                    solver.exited.wait(EXIT_SECONDS)
                self._start(attempt, lock, log.fileno(), environment)
        finally:
            os.close(lock)

    def attach(self, attempt: Attempt) -> None:
        """Do nothing: lock and files have the complete state."""

    def poll(self, attempt: Attempt) -> State:
        """Return the attempt's state; see `service.jobs.dispatcher`."""
        folder = attempt.folder
        if (folder / OUTCOME).exists():
            return "finished"
        if flock.is_locked(folder / LOCK):
            self._end_if_due(attempt)
            return "running" if attempts.solver_began(folder) else "submitted"
        # The solver may have ended regularly between the two polls.
        if (folder / OUTCOME).exists():
            return "finished"
        if folder in self._overdue:
            late = Outcome.failed(
                "deadline",
                f"the solve exceeded its deadline of {attempt.deadline:.3g} s and was stopped",
                "see log.txt for its progress; use a coarser mesh or a smaller load, or retry the "
                "job when the machine is less busy",
            )
            attempts.write_outcome(attempt, late)
            return "finished"
        return "lost"

    def cancel(self, attempt: Attempt) -> None:
        """Send SIGTERM to the solver and its children; `poll` repeats it, and kills after `grace`.

        The solver may not have begun yet, and then gets no signal.
        """
        if attempt.folder not in self._kill_after:
            self._kill_after[attempt.folder] = time.monotonic() + self._grace
            self._signal(attempt, signal.SIGTERM)

    def forget(self, attempt: Attempt) -> None:
        """Delete all state of an attempt."""
        self._kill_after.pop(attempt.folder, None)
        self._began.pop(attempt.folder, None)
        self._overdue.discard(attempt.folder)

    def close(self) -> None:
        """End the waiting solvers; working ones end after their attempt."""
        self._kill_after.clear()
        with self._changed:
            for solver in list(self._solvers):
                self._drop(solver)

    def _end_if_due(self, attempt: Attempt) -> None:
        """Signal the solver of an attempt that was cancelled or is beyond its deadline."""
        folder = attempt.folder
        now = time.monotonic()
        if folder in self._kill_after:
            late = now > self._kill_after[folder]
            self._signal(attempt, signal.SIGKILL if late else signal.SIGTERM)
        elif attempt.deadline is not None and attempts.solver_began(folder):
            if folder not in self._began:
                self._began[folder] = now - (attempts.solver_seconds(folder) or 0.0)
            if now - self._began[folder] > attempt.deadline:
                # Not SIGTERM: its outcome, "cancelled", would be tried again.
                self._overdue.add(folder)
                self._signal(attempt, signal.SIGKILL)

    def _signal(self, attempt: Attempt, number: int) -> None:
        """Send a signal to the solver of an attempt, whichever server started it."""
        lock = attempt.folder / LOCK
        if not attempts.solver_began(attempt.folder):
            return  # there is no process to signal yet: `poll` repeats it
        with self._changed:
            for solver in self._solvers:
                if solver.attempt is not None and solver.attempt.folder == attempt.folder:
                    solver.signal(number)
                    return
        # Another server's solver. Only while the file is locked is its pid certainly the solver's.
        with contextlib.suppress(OSError, ValueError):
            pid = int(lock.read_text())
            if flock.is_locked(lock):
                signal_group(pid, number)

    def _reserve(self, attempt: Attempt, environment: Mapping[str, str]) -> SolverProcess | None:
        """Return a solver that waits for work, now reserved for the attempt.

        None if none waits, or if only those of other components do and there is room for one more.
        """
        with self._changed:
            if not self._changed.wait_for(lambda: not self._ending(), FREE_SECONDS):
                for solver in self._ending():
                    pid = solver.process.pid
                    _log.warning("solver %d is killed: its attempt has ended, but not it", pid)
                    solver.signal(signal.SIGKILL)
                    self._drop(solver)
            idle = [solver for solver in self._solvers if solver.attempt is None]
            for solver in [solver for solver in idle if solver.environment != environment]:
                idle.remove(solver)
                self._drop(solver)
            component = attempt.bundle, attempt.fingerprint
            ready = [solver for solver in idle if solver.component == component]
            # Another component's solver keeps its state while there is room for one more.
            if not ready and len(self._solvers) >= self.slots:
                ready = idle
            if not ready:
                return None
            ready[0].attempt = attempt
            return ready[0]

    def _ending(self) -> list[SolverProcess]:
        """Return solvers that will wait for work in a moment, as their outcome exists.

        The list is empty if a solver waits already.
        """
        at_work = [(solver, solver.attempt) for solver in self._solvers if solver.attempt]
        if len(at_work) < len(self._solvers):
            return []
        return [solver for solver, attempt in at_work if (attempt.folder / OUTCOME).exists()]

    def _start(self, attempt: Attempt, lock: int, log: int, environment: Mapping[str, str]) -> None:
        """Start a solver process with an attempt, whose open lock and log it takes over."""
        ours, theirs = socket.socketpair()
        with theirs:
            channel = "--channel", str(theirs.fileno())
            try:
                process = subprocess.Popen(
                    child_command("wrenchbook.service.jobs.solver", *channel, *self._options),
                    env=environment,
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=log,
                    pass_fds=(theirs.fileno(),),
                    start_new_session=True,
                )
            except BaseException:
                ours.close()
                raise
        solver = SolverProcess(process, ours, environment, attempt)
        with self._changed:
            self._solvers.append(solver)
            self._processes.add(process.pid)
        # Sent before the solver listens: one that cannot begin leaves the lock as it dies.
        with contextlib.suppress(OSError):
            solver.send(attempt, lock, log)
        threading.Thread(target=self._watch, args=(solver,), daemon=True).start()

    def _watch(self, solver: SolverProcess) -> None:
        """Follow one solver until it has ended, and reap it."""
        with solver.channel, contextlib.suppress(OSError):
            while message := solver.channel.recv(1):
                if message == attempts.BEGUN:
                    solver.has_begun = True
                    solver.answered.set()
                else:
                    self._free(solver, stays=message == attempts.FREE)
        solver.process.wait()
        with self._changed:
            attempt = solver.attempt
            solver.attempt = None
            self._processes.discard(solver.process.pid)
            if solver in self._solvers:
                self._solvers.remove(solver)
            solver.exited.set()
            solver.answered.set()
            self._changed.notify_all()
        if attempt is not None:
            code = solver.process.returncode
            if code < 0 and not (attempt.folder / OUTCOME).exists():
                with contextlib.suppress(OSError), (attempt.folder / LOG).open("a") as log:
                    log.write(f"the solver {exit_text(code)}\n")
            self._report(attempt.task)

    def _free(self, solver: SolverProcess, *, stays: bool) -> None:
        """Take the attempt from a solver, which waits for the next one if it `stays`."""
        with self._changed:
            attempt = solver.attempt
            solver.attempt = None
            if stays and solver in self._solvers and len(self._solvers) <= self.slots:
                self._solvers.remove(solver)
                self._solvers.append(solver)  # the solver longest without work is first
            else:
                self._drop(solver)
            self._changed.notify_all()
        if attempt is not None:
            self._report(attempt.task)

    def _drop(self, solver: SolverProcess) -> None:
        """Let a solver end once it has no work."""
        if solver in self._solvers:
            self._solvers.remove(solver)
        with contextlib.suppress(OSError):
            solver.channel.shutdown(socket.SHUT_RDWR)


def signal_group(group: int, number: int) -> None:
    """Send a signal to a process group, if there is one."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(group, number)
