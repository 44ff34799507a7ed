"""Solvers that live from one attempt to the next, as processes of this machine.

A solver is started with one end of a socket pair. Over it come, for each attempt, its folder and
two open files: the attempt's lock, taken, and its log. It answers with one letter when it is at it
and one when it has ended; when the socket is closed, as it is when the server dies, it ends itself
after the attempt it is at (`service.jobs.warm_solver`).
"""

import contextlib
import json
import os
import signal
import socket
import subprocess
import threading
from collections.abc import Callable, Mapping
from pathlib import Path

from wrenchbook.service.files.program import child_command
from wrenchbook.service.jobs.attempt import LOG, OUTCOME
from wrenchbook.service.jobs.engines.engine import Attempt

# A solver that waits for work confirms an attempt at once. One that does not is stopped or
# damaged, and another one is started in its place.
TAKEN_SECONDS = 5.0
ENDING_SECONDS = 2.0  # between an attempt's result.json and its solver's word that it is free

Ended = Callable[[Attempt], None]


class SolverProcess:
    """A solver process, and the attempt that it is at."""

    def __init__(self, process: subprocess.Popen[bytes], line: socket.socket) -> None:
        self.process = process
        self.line = line
        self.environment: Mapping[str, str] = {}
        self.attempt: Attempt | None = None
        self.component: tuple[str, str] | None = None
        self.has_taken = False
        self.answered = threading.Event()  # or is gone
        self.gone = threading.Event()

    def hand(self, attempt: Attempt, lock: int, log: int) -> None:
        """Send an attempt with its lock and its log; raises OSError if the solver is gone."""
        self.has_taken = False
        self.answered.clear()
        self.component = component_of(attempt)
        request = {"folder": str(attempt.folder.absolute()), "memory": attempt.memory}
        socket.send_fds(self.line, [json.dumps(request).encode() + b"\n"], [lock, log])

    def signal(self, number: int) -> None:
        """Send a signal to the solver and what it started."""
        if not self.gone.is_set():
            signal_group(self.process.pid, number)

    def dismiss(self) -> None:
        """Let it end once it has nothing to do."""
        with contextlib.suppress(OSError):
            self.line.shutdown(socket.SHUT_RDWR)


class SolverPool:
    """The solvers of one engine: at most as many wait for work as may work at a time.

    Parameters
    ----------
    slots : int
    ended : callable
        Called with attempts that their solvers have left, well or dead; from the pool's threads.
    options : sequence of str
        Of `service.jobs.warm_solver`.
    """

    def __init__(self, slots: int, ended: Ended, *options: str) -> None:
        self._slots = slots
        self._ended = ended
        self._options = options
        self._solvers: list[SolverProcess] = []  # those longest without work first
        self._processes: set[int] = set()
        self._changed = threading.Condition()

    def run(self, attempt: Attempt, lock: int, log: int, environment: Mapping[str, str]) -> None:
        """Have a solver take an attempt: one that has its component, any other, or a new one.

        Raises
        ------
        OSError
            If no process can be started; no solver is at the attempt then.
        """
        while (solver := self._reserve(attempt, environment)) is not None:
            with contextlib.suppress(OSError):
                solver.hand(attempt, lock, log)
                solver.answered.wait(TAKEN_SECONDS)
                if solver.has_taken:
                    return
            # It must not begin late what another solver is at.
            with self._changed:
                solver.attempt = None
                self._drop(solver)
            solver.signal(signal.SIGKILL)
            solver.gone.wait()
        self._start(attempt, lock, log, environment)

    def signal(self, attempt: Attempt, number: int) -> bool:
        """Send a signal to the solver that is at an attempt; return whether there is one here."""
        with self._changed:
            for solver in self._solvers:
                if solver.attempt is not None and solver.attempt.folder == attempt.folder:
                    solver.signal(number)
                    return True
        return False

    @property
    def processes(self) -> frozenset[int]:
        """The pids of all solvers that have not ended, those that are about to as well."""
        with self._changed:
            return frozenset(self._processes)

    def close(self) -> None:
        """Let all solvers end: those that wait now, the others after their attempt."""
        with self._changed:
            for solver in self._solvers:
                solver.dismiss()
            self._solvers.clear()

    def _reserve(self, attempt: Attempt, environment: Mapping[str, str]) -> SolverProcess | None:
        with self._changed:
            if not self._changed.wait_for(lambda: not self._ending(), ENDING_SECONDS):
                for solver in self._ending():
                    solver.signal(signal.SIGKILL)  # stopped, most likely; its outcome is there
                    self._drop(solver)
            idle = [solver for solver in self._solvers if solver.attempt is None]
            for solver in [one for one in idle if one.environment != environment]:
                idle.remove(solver)
                self._drop(solver)
            component = component_of(attempt)
            ready = [solver for solver in idle if solver.component == component]
            # Another component's solver keeps what it has while there is room for one more.
            if not ready and len(self._solvers) >= self._slots:
                ready = idle
            if not ready:
                return None
            ready[0].attempt = attempt
            return ready[0]

    def _ending(self) -> list[SolverProcess]:
        """Return those that will wait for work in a moment, their outcome being there.

        None if a solver waits already.
        """
        if any(solver.attempt is None for solver in self._solvers):
            return []
        return [
            one for one in self._solvers if one.attempt and (one.attempt.folder / OUTCOME).exists()
        ]

    def _start(self, attempt: Attempt, lock: int, log: int, environment: Mapping[str, str]) -> None:
        ours, theirs = socket.socketpair()
        with theirs:
            command = child_command(
                "wrenchbook.service.jobs.warm_solver", "--line", str(theirs.fileno())
            )
            try:
                process = subprocess.Popen(
                    [*command, *self._options],
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
        solver = SolverProcess(process, ours)
        solver.environment, solver.attempt = environment, attempt
        with self._changed:
            self._solvers.append(solver)
            self._processes.add(process.pid)
        # Sent before the solver listens: one that cannot begin leaves the lock as it dies.
        with contextlib.suppress(OSError):
            solver.hand(attempt, lock, log)
        threading.Thread(target=self._watch, args=(solver,), daemon=True).start()

    def _watch(self, solver: SolverProcess) -> None:
        """Follow one solver until it has ended, and reap it."""
        with solver.line, contextlib.suppress(OSError):
            while word := solver.line.recv(1):
                if word == b"t":
                    solver.has_taken = True
                    solver.answered.set()
                else:
                    self._free(solver, stays=word == b"e")
        solver.process.wait()
        self._bury(solver)

    def _free(self, solver: SolverProcess, *, stays: bool) -> None:
        with self._changed:
            over, solver.attempt = solver.attempt, None
            if stays and solver in self._solvers and len(self._solvers) <= self._slots:
                self._solvers.remove(solver)
                self._solvers.append(solver)  # those longest without work are first
            else:
                self._drop(solver)
            self._changed.notify_all()
        if over is not None:
            self._ended(over)

    def _drop(self, solver: SolverProcess) -> None:
        if solver in self._solvers:
            self._solvers.remove(solver)
        solver.dismiss()

    def _bury(self, solver: SolverProcess) -> None:
        code = solver.process.returncode
        with self._changed:
            over, solver.attempt = solver.attempt, None
            self._processes.discard(solver.process.pid)
            if solver in self._solvers:
                self._solvers.remove(solver)
            solver.gone.set()
            solver.answered.set()
            self._changed.notify_all()
        if over is None:
            return
        if code < 0 and not (over.folder / OUTCOME).exists():
            _add_cause(over.folder / LOG, -code)
        self._ended(over)


def component_of(attempt: Attempt) -> tuple[str, str]:
    """Return what a solver that keeps this attempt's component keeps."""
    return attempt.spec.bundle, attempt.spec.fingerprint


def signal_group(group: int, number: int) -> None:
    """Send a signal to a process group, if there is one."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(group, number)


def _add_cause(log: Path, number: int) -> None:
    try:
        name = signal.Signals(number).name
    except ValueError:
        name = f"signal {number}"
    memory = "; often the machine has no memory left" if number == signal.SIGKILL else ""
    with contextlib.suppress(OSError), log.open("a", encoding="utf-8") as file:
        file.write(f"the solver was ended by {name}{memory}\n")
