"""How a supervisor sees that a process stands still: it beats into a pipe, or is ended.

A process that is stopped, deadlocked or at something endless keeps its connections and its place,
and who is connected to it waits for good. So each writes a byte a second from the very loop that
does its work, first of all once it works; who is silent for too long is killed and started again,
which loses nothing that was acknowledged.
"""

from __future__ import annotations

import contextlib
import os
import select
import subprocess
from typing import Final

BEAT_S: Final = 1.0
# How long a process may be silent: more than the longest that a loop was held up on a machine with
# ten times the work it can do (3 s); clients wait for 30 s and more.
SILENT_S: Final = 20.0
READY_S: Final = 180.0  # a first start compiles for up to a minute, on cores that others use too


class Heartbeat:
    """The end of the pipe that a process beats into.

    Parameters
    ----------
    descriptor : int
        What it was given to write to.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        os.set_blocking(descriptor, False)
        os.set_inheritable(descriptor, False)

    def beat(self) -> None:
        """Say that this process works; never waits, and never fails where nobody listens."""
        with contextlib.suppress(OSError):
            os.write(self._descriptor, b".")


class HeartbeatWatch:
    """One process and its pipe, as the supervisor has them.

    Parameters
    ----------
    child : subprocess.Popen
    pipe : int
        The end to read from.
    """

    def __init__(self, child: subprocess.Popen[bytes], pipe: int) -> None:
        self._child, self._pipe = child, pipe
        self._poll = select.poll()
        self._poll.register(pipe, select.POLLIN)

    def heard(self, seconds: float) -> bool:
        """Wait for a beat; False if none came for so many seconds, or the process has ended.

        Silence is counted in looks of one `BEAT_S`, not by the clock: who was itself stopped, or
        slept with the whole machine, has not looked meanwhile and blames nobody for it.
        """
        for _ in range(max(1, round(seconds / BEAT_S))):
            if self._poll.poll(BEAT_S * 1000):
                return bool(os.read(self._pipe, 4096))
            if self._child.poll() is not None:
                return False
        return False

    def stands_still(self) -> bool:
        """Follow a process that works until it ends (False) or is silent for too long (True)."""
        while self.heard(SILENT_S):
            pass
        # The pipe of one that ends is closed a moment before it has ended.
        return not self._poll.poll(0) and self._child.poll() is None
