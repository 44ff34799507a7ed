"""Running a program such that it never outlives us or its time, nor do programs it starts."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

_GRACE = 2.0  # seconds between asking to end and killing; engines wait 5 s for us
_LOOK_EVERY = 0.25  # seconds
# Reads until this program writes a line (all is well) or is gone, even by SIGKILL.
_GUARD = 'read -r _ || kill -s KILL -- "-$0"'


class OutOfTime(Exception):  # noqa: N818 - an outcome, named as what happened
    """The program did not end in time and has been ended."""


def run_command(
    command: Sequence[str],
    folder: Path,
    printed: Path,
    timeout: float,
    watch: Callable[[], None] | None = None,
) -> int:
    """Run a program in `folder` and return its exit code, minus the signal if one ended it.

    The environment (OMP_NUM_THREADS and the like) is passed on as it is. When this returns or
    raises, whatever it raises, the program and all that it started in its process group are gone;
    they are also gone soon after this program is killed.

    Parameters
    ----------
    command
        The program and its arguments.
    printed
        File for its standard output and errors.
    timeout
        Seconds.
    watch
        Called a few times a second while it runs.

    Raises
    ------
    OSError
        If the program cannot be started.
    OutOfTime
        If `timeout` is over.
    """
    deadline = time.monotonic() + timeout
    child = _start(command, folder, printed)
    try:
        with _guarded(child.pid):
            return _wait(child, deadline, watch)
    finally:
        _end(child)


def _start(command: Sequence[str], folder: Path, printed: Path) -> subprocess.Popen[bytes]:
    with printed.open("wb") as file:
        return subprocess.Popen(
            command,
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=file,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )


def _wait(child: subprocess.Popen[bytes], deadline: float, watch: Callable[[], None] | None) -> int:
    while True:
        left = deadline - time.monotonic()
        if left <= 0.0:
            raise OutOfTime
        with contextlib.suppress(subprocess.TimeoutExpired):
            return child.wait(min(left, _LOOK_EVERY))
        if watch is not None:
            watch()


@contextlib.contextmanager
def _guarded(group: int) -> Iterator[None]:
    """Kill a process group if this program is gone before the block ends."""
    guard = subprocess.Popen(
        ["/bin/sh", "-c", _GUARD, str(group)],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # what ends our own process group must not end the guard
    )
    try:
        yield
    finally:
        with contextlib.suppress(BrokenPipeError):
            guard.communicate(b"\n")


def _end(child: subprocess.Popen[bytes]) -> None:
    """End what is left of the child's process group."""
    if child.poll() is None:
        _signal(child.pid, signal.SIGTERM)
        with contextlib.suppress(subprocess.TimeoutExpired):
            child.wait(_GRACE)
    _signal(child.pid, signal.SIGKILL)
    child.wait()


def _signal(group: int, number: int) -> None:
    # Nobody left in it: gone; macOS says "not permitted" of a group of zombies.
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(group, number)
