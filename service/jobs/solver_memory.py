"""What a solver may take of the machine's memory, and when it has grown too large."""

import math
import os
import resource
import sys
from pathlib import Path

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
