"""Compile a function if numba is installed (extra ``fast``), or leave it as it is.

Compiled code is loaded at its first call, which takes seconds, or up to a minute where nothing is
kept on disk yet. A program that computes uses it at once all the same. A server must not wait for
it where it answers: it calls `warm_in_background`, and until that is done `ready` tells whoever
has both to take the array version, which gives the same numbers.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import Any

try:
    import numba
except ImportError:  # the extra is optional: the array versions answer instead
    numba = None

log = logging.getLogger(__name__)

COMPILED = numba is not None

_held_back: set[object] = set()  # the warm-ups that run; none: compiled code answers
_warming = threading.local()


def ready() -> bool:
    """Return whether compiled code answers here and now; true for the thread that warms it up."""
    return COMPILED and (not _held_back or getattr(_warming, "here", False))


def state() -> str:
    """Return ``used``, ``loading`` or ``not used``: which code answers whom else than a warm-up.

    While it is ``loading`` the array versions answer: the same to 1e-12 of the largest, not to the
    last digit. Where it cannot be loaded it stays so.
    """
    if not COMPILED:
        return "not used"
    return "loading" if _held_back else "used"


def warm_in_background(use: Callable[[], object]) -> threading.Thread:
    """Use compiled code once in another thread, and everywhere only after that.

    Where it fails, compiled code is left alone until the program ends: the array versions answer.

    Parameters
    ----------
    use : callable
        Makes every compiled function run once.
    """
    token = object()
    _held_back.add(token)

    def warm() -> None:
        _warming.here = True
        try:
            use()
        except Exception:
            log.exception("compiled code cannot be used; answers take longer")
        else:
            _held_back.discard(token)

    thread = threading.Thread(target=warm, name="warm-up", daemon=True)
    thread.start()
    return thread


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
