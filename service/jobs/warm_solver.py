"""A solver that lives: ``python -m wrenchbook.service.jobs.warm_solver --line DESCRIPTOR``.

The engine `local` starts it with one end of a socket pair, over which attempts come one after the
other (`service.jobs.engines.solver_pool`). Each is solved as `service.jobs.solve_attempt` does; the
interpreter, what it imported and the component stay. It ends itself after the attempt at which the
engine closed the socket or died, after an attempt that was cancelled or ran out of memory (what
such an attempt left half done is used no more), when it has grown, and after a number of attempts.
"""

import argparse
import contextlib
import functools
import json
import os
import signal
import socket
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from wrenchbook.service.files.program import Growth, limit_memory
from wrenchbook.service.jobs import solve_attempt
from wrenchbook.service.jobs.solve_attempt import (
    CANCELLED,
    SOLVE_VARIABLE,
    begin,
    keep_sigterm_waiting,
)

TAKEN, FREE, LEAVES = b"t", b"e", b"r"

# Without work for so long it gives its memory back; starting again costs a second.
IDLE_SECONDS = 300.0

_MOST_BYTES = 1 << 16  # of one attempt: a path and a number


@dataclass(frozen=True)
class _Request:
    """An attempt as it comes: its folder, the estimate of its memory, its lock and its log."""

    folder: Path
    memory: int | None
    lock: int
    log: int


class WarmSolver:
    """Solves what comes over the line.

    Parameters
    ----------
    line : socket
        Closed by the other side when there is no more.
    lives : int
        Attempts after which it ends.
    """

    def __init__(self, line: socket.socket, lives: int) -> None:
        self._line = line
        self._lives = lives
        self._kept = None
        self._growth = Growth()

    def run(self) -> None:
        """Solve until there is nothing to solve, or it is time to be renewed."""
        self._line.settimeout(IDLE_SECONDS)
        stays = True
        while stays and (request := self._next()) is not None:
            stays = self._solve(request)

    def _next(self) -> _Request | None:
        """Wait for an attempt; None if there will be none."""
        try:
            text, files, _, _ = socket.recv_fds(self._line, _MOST_BYTES, 2)
        except OSError:  # a long time without work, or the server is gone
            return None
        if not text or len(files) != 2:
            return None
        for file in files:
            # Programs that the solver starts must not keep the lock when the solver is gone.
            os.set_inheritable(file, False)
        request = json.loads(text)
        return _Request(Path(request["folder"]), request["memory"], *files)

    def _solve(self, request: _Request) -> bool:
        """Solve an attempt; return whether to stay for another one."""
        _print_to(request.log)
        os.close(request.log)
        os.chdir(request.folder)
        _hear_nothing_old()
        begin(request.lock)
        self._say(TAKEN)
        solve = None
        if not os.environ.get(SOLVE_VARIABLE):
            solve = functools.partial(
                self._embedded().solve, folder=request.folder, memory=request.memory
            )
        code = solve_attempt.main(request.folder, solve)
        self._lives -= 1
        stays = code != CANCELLED and self._lives > 0 and not self._worn()
        _leave()
        os.close(request.lock)
        return self._say(FREE if stays else LEAVES) and stays

    def _embedded(self):
        """Return the keeper of the component; its import is half a second, paid when needed."""
        if self._kept is None:
            from wrenchbook.service.jobs.kept_component import KeptComponent

            self._kept = KeptComponent()
        return self._kept

    def _worn(self) -> bool:
        if self._kept is None:
            return self._growth.is_leak(None, 0)
        return self._kept.spoiled or self._growth.is_leak(self._kept.ready, self._kept.estimated)

    def _say(self, word: bytes) -> bool:
        """Notify the engine, if there is one still."""
        try:
            self._line.sendall(word)
        except OSError:
            return False
        return True


def _print_to(file: int) -> None:
    """Send what is printed from here on to an open file."""
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    for descriptor in (1, 2):
        os.dup2(file, descriptor)


def _leave() -> None:
    """Let go of an attempt's folder, log and memory limit."""
    with contextlib.suppress(OSError):  # a full disk keeps what was printed
        sys.stdout.flush()
    nowhere = os.open(os.devnull, os.O_WRONLY)
    _print_to(nowhere)
    os.close(nowhere)
    os.chdir("/")
    limit_memory(None)


def _hear_nothing_old() -> None:
    """Forget a SIGTERM that was meant for the attempt before."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # discards one that is pending
    keep_sigterm_waiting()


def command_line(arguments: Sequence[str] | None = None) -> None:
    """Run as the program: lower the priority, solve what comes."""
    keep_sigterm_waiting()
    parser = argparse.ArgumentParser(
        prog="python -m wrenchbook.service.jobs.warm_solver", description=__doc__
    )
    parser.add_argument("--line", type=int, required=True, help="open socket, the solver's end")
    parser.add_argument("--lives", type=int, required=True, help="attempts before it ends")
    parser.add_argument("--niceness", type=int, default=0)
    options = parser.parse_args(arguments)
    os.set_inheritable(options.line, False)
    os.nice(options.niceness)
    with socket.socket(fileno=options.line) as line:
        WarmSolver(line, options.lives).run()


if __name__ == "__main__":
    command_line()
