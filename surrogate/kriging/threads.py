"""One thread for linear algebra: a kriging is made of many small matrices.

A product or a factor of some hundred rows takes less than the threads' meeting, which on a busy
machine takes fifty times as long as the work (measured: 37 ms for 0.5 ms).
"""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext

try:
    from threadpoolctl import ThreadpoolController
except ImportError:  # it may be missing in a simulator: slower, and other last digits
    ThreadpoolController = None

_BLAS = ThreadpoolController and ThreadpoolController().select(user_api="blas")


def one_thread() -> AbstractContextManager[object]:
    """Return a context in which this program's linear algebra runs on one thread."""
    return _BLAS.limit(limits=1) if _BLAS else nullcontext()
