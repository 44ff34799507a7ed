"""The running program: its command line, the digest of its code, cores and memory."""

from __future__ import annotations

import ctypes
import hashlib
import math
import os
import resource
import signal
import subprocess
import sys
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path


def child_command(module: str, *arguments: str) -> list[str]:
    """Return the command line that runs a module, such as ``wrenchbook.fea.check``, as a child."""
    return [sys.executable, "-P", "-m", module, *arguments]


def run_child(module: str, *arguments: str) -> int:
    """Run a module in a process of its own, which a SIGTERM of this one ends too.

    Returns its exit status. For a program that does nothing else meanwhile.
    """
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    return subprocess.run(child_command(module, *arguments), check=False).returncode


def usable_cores() -> int:
    """Return the number of cores this program may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


_ROOT = Path(__file__).resolve().parents[2]


def solver_version() -> str:
    """Return version and code digest of the solver, such as ``0.2.0+1f3a5b7c9d0e``.

    The version is ``unknown`` in a checkout that is not installed.
    """
    try:
        number = version("wrenchbook")
    except PackageNotFoundError:
        number = "unknown"
    return f"{number}+{code_digest('fea', 'service/jobs')[:12]}"


@cache
def code_digest(*folders: str) -> str:
    """Return a digest, 16 hexadecimal digits, of the Python files below some folders.

    Parameters
    ----------
    folders
        Such as ``surrogate`` or ``service/jobs``.
    """
    found = hashlib.sha256()
    for folder in folders:
        for path in sorted((_ROOT / folder).rglob("*.py")):
            found.update(path.relative_to(_ROOT).as_posix().encode() + b"\0" + path.read_bytes())
    return found.hexdigest()[:16]


_ARENA_MAX = -8  # M_ARENA_MAX of glibc's malloc.h
# Each thread has a heap of its own otherwise, of 64 MiB of address space: the forty of a server
# take 1.3 GB, 0.4 GB with few, and where addresses are limited no thread could be started.
MOST_HEAPS = 4


def give_back() -> None:
    """Return freed memory to the system where the C library can (glibc); else do nothing.

    What reading a large file has used is scattered over the threads' heaps, and stays this
    process' own until then: 60 MB after a CSV of 100,000 rows.
    """
    with suppress(OSError, AttributeError):  # another C library
        ctypes.CDLL(None).malloc_trim(0)


def keep_few_heaps() -> None:
    """Let the threads that start from now on share heaps where the C library can (glibc)."""
    with suppress(OSError, AttributeError):  # another C library
        ctypes.CDLL(None).mallopt(_ARENA_MAX, MOST_HEAPS)


MARGIN_VARIABLE = "WRENCHBOOK_MEMORY_MARGIN"

# Times the estimate of `wrenchbook check`: two for the estimate, which is right to a factor of two,
# and two for address space, which is what the limit counts and of which part is never used.
# Measured: shipped components take 0.2 GB of address space beyond the interpreter's, estimated
# 0.25 to 0.31 GB.
MEMORY_MARGIN = 4.0

# An attempt leaves behind its component and nothing else; the memory of the solver itself swings by
# 30 MB from one attempt to the next. More than one solve beyond the first attempt's is a leak.
LEAST_GROWTH = 256 << 20


class Growth:
    """Watches whether a solver's memory grows from attempt to attempt."""

    def __init__(self) -> None:
        self._component: object = None
        self._first: int | None = None

    def is_leak(self, component: object, estimated: int) -> bool:
        """Return whether the process is too large after an attempt.

        Parameters
        ----------
        component
            What it keeps; its first attempt sets what is usual.
        estimated : int
            Bytes of one solve, 0 if unknown.
        """
        now = _pages(1) if sys.platform == "linux" else 0
        if self._first is None or component is not self._component:
            self._component, self._first = component, now
        return now > self._first + max(estimated, LEAST_GROWTH)


def limit_memory(estimated: int | None) -> int | None:
    """Hold this process to what it has now and a solve of that estimate with its margin, bytes.

    None lifts the limit. Returns the bytes allowed beyond what there is; None if there is no limit.

    Raises
    ------
    MarginError
        If ``WRENCHBOOK_MEMORY_MARGIN`` is no number above 0.
    """
    hard = resource.getrlimit(resource.RLIMIT_AS)[1]
    soft, allowed = hard, None
    if estimated and sys.platform == "linux":  # elsewhere the limit is not heeded, or refused
        allowed = int(estimated * _margin())
        soft = _pages(0) + allowed
        if hard != resource.RLIM_INFINITY:
            soft = min(soft, hard)
    resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
    return allowed


class MarginError(Exception):
    """The margin that the operator has set is no number above 0."""

    kind = "bad_setting"
    remedy = f"set {MARGIN_VARIABLE} to a number above 0, or unset it"


def _margin() -> float:
    words = os.environ.get(MARGIN_VARIABLE, str(MEMORY_MARGIN))
    try:
        margin = float(words)
    except ValueError:
        margin = 0.0
    if not 0.0 < margin < math.inf:
        raise MarginError(f"{MARGIN_VARIABLE} is {words!r}, not a number above 0")
    return margin


def _pages(place: int) -> int:
    """Return the address space (0) or the memory (1) of this process, bytes."""
    return int(Path("/proc/self/statm").read_text().split()[place]) * resource.getpagesize()
