"""The one thread of a process that notices changes by other processes, and wakes who needs them."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from wrenchbook.service.ledger.ledger import Ledger
from wrenchbook.service.ledger.records import LedgerError

_log = logging.getLogger(__name__)

LOOK_S = 0.02  # between looks: PRAGMA data_version, or the date of a file, takes microseconds
TROUBLE_S = 1.0  # before a listener that failed is called again

Stamp = Callable[[], object]


@dataclass(eq=False)
class _Entry:
    listener: Callable[[], object]
    stamp: Stamp
    last: object
    not_before: float = 0.0


class Watcher:
    """Calls listeners after commits of any process, at once after those of its own ledger.

    Files of the data directory that are no part of the ledger are watched along: see `on_change`.
    """

    def __init__(self, ledger: Ledger) -> None:
        self._ledger = ledger
        self._entries: tuple[_Entry, ...] = ()
        self._lock = threading.Lock()
        self._wake, self._stopping = threading.Event(), threading.Event()
        self._end_notices: Callable[[], None] = lambda: None
        self._thread = threading.Thread(target=self._run, name="watcher", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._end_notices = self._ledger.on_change(self._wake.set)
        self._thread.start()

    def stop(self) -> None:
        """End the thread; no listener is called from then on."""
        self._end_notices()
        self._stopping.set()
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join()

    def on_change(
        self, listener: Callable[[], object], stamp: Stamp | None = None
    ) -> Callable[[], None]:
        """Call `listener` after each commit, or whenever what `stamp` returns has changed.

        It is called in the watcher's thread and must be quick; a listener that fails is called
        again. Returns a function that ends the subscription.
        """
        stamp = stamp or self.version
        entry = _Entry(listener, stamp, stamp())
        with self._lock:
            self._entries = (*self._entries, entry)

        def remove() -> None:
            with self._lock:
                self._entries = tuple(kept for kept in self._entries if kept is not entry)

        return remove

    def version(self) -> int | None:
        """Return a number that differs after each commit; None while the ledger is unreadable."""
        try:
            return self._ledger.version()
        except LedgerError:
            return None

    def _run(self) -> None:
        while not self._stopping.is_set():
            self._wake.wait(LOOK_S)
            self._wake.clear()
            stamps: dict[Stamp, object] = {}
            for entry in self._entries:
                if time.monotonic() < entry.not_before or self._stopping.is_set():
                    continue
                try:
                    if entry.stamp not in stamps:
                        stamps[entry.stamp] = entry.stamp()
                    if stamps[entry.stamp] != entry.last:
                        entry.last = stamps[entry.stamp]
                        entry.listener()
                except Exception:
                    _log.exception("a listener for changes failed; it is called again")
                    entry.last, entry.not_before = object(), time.monotonic() + TROUBLE_S
