"""What a child may take, and how it is made to hold that."""

from __future__ import annotations

import contextlib
import math
import resource
import signal
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Final

MIB: Final = 1 << 20
_OPEN_FILES: Final = 64  # its own pipes, its file, what an HDF5 or a zip opens beside them


@dataclass(frozen=True)
class Limits:
    """What reading one file may take.

    Parameters
    ----------
    memory : int
        Bytes beside what the child has when it begins: a million rows of a table with tangents
        are 350 MB, and are held twice at most.
    seconds : float
        Of processor time, and of time.
    output : int
        Bytes of each file that the child writes, its answer first of all.
    """

    memory: int = 1024 * MIB
    seconds: float = 60.0
    output: int = 1024 * MIB


def hold(limits: Limits) -> None:
    """Put limits on this process and all it will do, for good.

    The kernel ends it at the deadline, whatever it is at: no code of Python has a say in that.
    """
    _lower(resource.RLIMIT_CORE, 0)
    _lower(resource.RLIMIT_FSIZE, limits.output)
    _lower(resource.RLIMIT_NOFILE, _OPEN_FILES)
    _lower(resource.RLIMIT_CPU, math.ceil(limits.seconds))
    taken = _address_space()
    if taken is not None:
        _lower(resource.RLIMIT_AS, taken + limits.memory)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGALRM, signal.SIGXCPU})
    signal.setitimer(signal.ITIMER_REAL, limits.seconds)


def _lower(what: int, to: int) -> None:
    """Lower a limit, both the one that holds and the one to which it could be raised again."""
    hard = resource.getrlimit(what)[1]
    if hard != resource.RLIM_INFINITY:
        to = min(to, hard)
    # macOS refuses some limits on memory; time, files and the deadline hold there all the same.
    with contextlib.suppress(*((ValueError, OSError) if sys.platform == "darwin" else ())):
        resource.setrlimit(what, (to, to))


def _address_space() -> int | None:
    """Return the bytes of address space this process has taken; None where nobody tells."""
    try:
        pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[0]
    except OSError:
        return None
    return int(pages) * resource.getpagesize()
