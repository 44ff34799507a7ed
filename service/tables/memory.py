"""Memory of this process: few heaps, and what is free given back to the system."""

from __future__ import annotations

import ctypes
from contextlib import suppress

_ARENA_MAX = -8  # M_ARENA_MAX of glibc's malloc.h
# Each thread has a heap of its own otherwise, of 64 MiB of address space: the forty of a server
# take 1.3 GB, 0.4 GB with few, and where addresses are limited no thread could be started.
MOST_HEAPS = 4


def give_back() -> None:
    """Return freed memory to the system where the C library can (glibc); else do nothing.

    What reading a large file has used is scattered over the threads' heaps, and stays this
    process' own until it is asked for: 60 MB after a CSV of 100,000 rows.
    """
    with suppress(OSError, AttributeError):  # another C library
        ctypes.CDLL(None).malloc_trim(0)


def keep_few_heaps() -> None:
    """Let the threads that start from now on share heaps where the C library can (glibc)."""
    with suppress(OSError, AttributeError):  # another C library
        ctypes.CDLL(None).mallopt(_ARENA_MAX, MOST_HEAPS)
