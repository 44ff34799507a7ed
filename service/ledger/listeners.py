"""Who wants to know about changes."""

import logging
import threading
from collections.abc import Callable

from wrenchbook.service.ledger.records import Change

_log = logging.getLogger(__name__)

Listener = Callable[[Change], None]


class Listeners:
    """Callbacks of one process, told after each commit."""

    def __init__(self) -> None:
        self._callbacks: tuple[Listener, ...] = ()
        self._lock = threading.Lock()

    def add(self, listener: Listener) -> Callable[[], None]:
        """Subscribe, and return the function that unsubscribes (once or more often)."""
        with self._lock:
            self._callbacks = (*self._callbacks, listener)

        def remove() -> None:
            with self._lock:
                self._callbacks = tuple(one for one in self._callbacks if one is not listener)

        return remove

    def tell(self, change: Change) -> None:
        """Call the callbacks."""
        for callback in self._callbacks:
            try:
                callback(change)
            except Exception:
                # The commit has happened: whoever wrote must not be told that it failed.
                _log.exception("a listener of the ledger failed on %s", change)
