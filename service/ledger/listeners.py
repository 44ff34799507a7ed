"""Who wants to know about changes: callbacks, and threads that wait for one."""

import logging
import threading
from collections.abc import Callable

from service.ledger.records import Change

_log = logging.getLogger(__name__)

Listener = Callable[[Change], None]


class Listeners:
    """Callbacks and waiting threads of one process, told after each commit."""

    def __init__(self) -> None:
        self._callbacks: tuple[Listener, ...] = ()
        self._condition = threading.Condition()
        self.count = 0

    def add(self, listener: Listener) -> Callable[[], None]:
        """Subscribe, and return the function that unsubscribes (once or more often)."""
        with self._condition:
            self._callbacks = (*self._callbacks, listener)

        def remove() -> None:
            with self._condition:
                self._callbacks = tuple(one for one in self._callbacks if one is not listener)

        return remove

    def tell(self, change: Change) -> None:
        """Wake the waiting threads and call the callbacks."""
        with self._condition:
            self.count += 1
            self._condition.notify_all()
            callbacks = self._callbacks
        for callback in callbacks:
            try:
                callback(change)
            except Exception:
                # The commit has happened: whoever wrote must not be told that it failed.
                _log.exception("a listener of the ledger failed on %s", change)

    def wait_beyond(self, count: int, timeout: float) -> None:
        """Block until `count` is no longer the number of changes told, or the time is up."""
        with self._condition:
            self._condition.wait_for(lambda: self.count != count, timeout)
