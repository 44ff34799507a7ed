"""The running program: its command line, the digest of its code, cores and memory."""

from __future__ import annotations

import ctypes
import hashlib
import os
import sys
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_ROOT = Path(__file__).resolve().parents[2]


def child_command(module: str, *arguments: str) -> list[str]:
    """Return the command line that runs a module, such as ``wrenchbook.fea.check``, as a child."""
    return [sys.executable, "-P", "-m", module, *arguments]


def usable_cores() -> int:
    """Return the number of cores this program may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def solver_version() -> str:
    """Return version (or ``unknown``) and code digest of the solver: ``0.2.0+1f3a5b7c9d0e``."""
    try:
        number = version("wrenchbook")
    except PackageNotFoundError:
        number = "unknown"
    return f"{number}+{code_digest('fea', 'service/jobs')[:12]}"


@cache
def code_digest(*folders: str) -> str:
    """Return a digest, 16 hexadecimal digits, of all Python files of folders: ``service/jobs``."""
    digest = hashlib.sha256()
    for folder in folders:
        for path in sorted((_ROOT / folder).rglob("*.py")):
            digest.update(path.relative_to(_ROOT).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


_ARENA_MAX = -8  # M_ARENA_MAX of glibc's malloc.h
# Otherwise each thread has its own heap of 64 MiB of address space: the forty of a server take 1.3
# GB, 0.4 GB with few, and with limited address space no thread could start.
MAX_HEAPS = 4


def free_memory() -> None:
    """Return freed memory to the system where the C library can (glibc); else do nothing.

    Memory from reading a large file is scattered over the threads' heaps, and stays allocated until
    this call: 60 MB after a CSV of 100,000 rows.
    """
    with suppress(OSError, AttributeError):  # another C library
        ctypes.CDLL(None).malloc_trim(0)


def keep_few_heaps() -> None:
    """Let the threads that start from now on share heaps where the C library can (glibc)."""
    with suppress(OSError, AttributeError):  # another C library
        ctypes.CDLL(None).mallopt(_ARENA_MAX, MAX_HEAPS)
