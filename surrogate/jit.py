"""Compile a function if numba is installed (extra ``fast``), or leave it as it is."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

try:
    import numba
except ImportError:  # the extra is optional: the array versions answer instead
    numba = None

COMPILED = numba is not None


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return the function, compiled at its first call and kept on disk for the next process.

    Where no folder can be written for it, it is compiled anew by each process. What is kept names
    the module it was compiled in, and loading it imports that; so the room keeps its own under each
    of its names, `surrogate` and `wrenchbook.surrogate`.
    """
    if numba is None:
        return function
    function.__qualname__ = f"{__package__}.{function.__qualname__}"
    try:
        return numba.njit(cache=True, nogil=True, error_model="numpy")(function)
    except RuntimeError:  # numba finds no folder that it may write to
        return numba.njit(nogil=True, error_model="numpy")(function)
