"""How much of this machine a program may use."""

import os


def usable_cores() -> int:
    """Return the number of cores this program may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
