"""The engine that needs nothing installed: one subprocess an attempt, on this machine."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from pathlib import Path

from service.files import lock as flock
from service.jobs.attempt import LOCK, LOG, OUTCOME
from service.jobs.engines.engine import EngineError, State

# Several solvers share the cores, so each gets one; what the user has set is left alone.
_THREADS = ("OMP", "OPENBLAS", "MKL", "NUMEXPR")
_ONE_THREAD_EACH = {f"{library}_NUM_THREADS": "1" for library in _THREADS}
_READABLE_LOGS = {"PYTHONUNBUFFERED": "1", "PYTHONFAULTHANDLER": "1"}


class LocalEngine:
    """Runs each attempt as a subprocess in a session of its own, at low priority.

    A solver lives on when the server is killed. It holds the attempt's ``lock`` from before
    its first instruction until its end: the lock is taken here and handed down, so there is
    no moment in which a solver that will run looks like one that died.

    Parameters
    ----------
    slots : int, optional
        Solvers at a time; the cores this program may use by default.
    environment : mapping, optional
        Variables added to those the solvers inherit.
    niceness : int
        Added to the solvers' niceness, so that answers from tables stay fast.
    grace : float
        Seconds between asking a solver to end and killing it.
    """

    def __init__(
        self,
        slots: int | None = None,
        *,
        environment: Mapping[str, str] | None = None,
        niceness: int = 10,
        grace: float = 5.0,
    ) -> None:
        self.slots = slots or _usable_cores()
        self._environment = dict(environment or {})
        self._niceness = niceness
        self._grace = grace
        self._kill_after: dict[Path, float] = {}

    def submit(self, folder: Path) -> None:
        """Start the solver; see `Engine.submit`."""
        folder = folder.absolute()
        lock = flock.take(folder / LOCK)
        if lock is None:
            raise EngineError(f"a solver is at work in {folder} already")
        try:
            child = self._spawn(folder, lock)
        finally:
            os.close(lock)
        # Reaps the child at once when it ends, whether or not anybody polls by then.
        threading.Thread(target=child.wait, name=f"solver {child.pid}", daemon=True).start()

    def attach(self, folder: Path) -> None:
        """Need nothing: lock and files say all there is to know."""

    def poll(self, folder: Path) -> State:
        """Return the attempt's state; see `Engine.poll`."""
        if (folder / OUTCOME).exists():
            return "finished"
        if flock.is_held(folder / LOCK):
            if folder in self._kill_after:
                self._signal(folder)
            return "running"
        # The solver may have ended well between the two looks.
        return "finished" if (folder / OUTCOME).exists() else "lost"

    def cancel(self, folder: Path) -> None:
        """Send SIGTERM to the solver and its children; SIGKILL once `grace` is over."""
        if folder not in self._kill_after:
            self._kill_after[folder] = time.monotonic() + self._grace
            self._signal(folder)

    def close(self) -> None:
        """Forget what was asked to end; solvers that run are left running."""
        self._kill_after.clear()

    def _spawn(self, folder: Path, lock: int) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-P", "-m", "service.jobs.solve_attempt", str(folder)]
        options = ["--lock-descriptor", str(lock), "--niceness", str(self._niceness)]
        variables = _ONE_THREAD_EACH | _READABLE_LOGS | dict(os.environ) | self._environment
        with (folder / LOG).open("ab") as log:
            return subprocess.Popen(
                command + options,
                cwd=folder,
                env=variables,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                pass_fds=(lock,),
                start_new_session=True,
            )

    def _signal(self, folder: Path) -> None:
        # Only while the lock is held is the pid in it surely the solver's.
        pid = _holder(folder / LOCK)
        if pid is None or not flock.is_held(folder / LOCK):
            return
        late = time.monotonic() > self._kill_after[folder]
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(pid, signal.SIGKILL if late else signal.SIGTERM)


def _usable_cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _holder(lock: Path) -> int | None:
    """Return the pid the solver wrote into its lock; None if it has not come to that yet."""
    try:
        return int(lock.read_text())
    except (OSError, ValueError):
        return None
