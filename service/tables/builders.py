"""Threads that build tables: one table's build never waits for another's."""

from __future__ import annotations

import threading
from collections.abc import Callable

LARGE = 3000  # rows: a table of more takes over a second to build
SMALL_LANES = 2  # small builds at once next to a large one: all share one interpreter


class Builders:
    """Lanes that bring up whatever table has row_changes, each table in one lane at a time.

    A table that is requested while it is being built is built once more, after that, however often
    it was requested. Large tables have one lane, since two at once would each take twice as long;
    small ones pass them in the others.

    Parameters
    ----------
    bring_up : callable
        Brings one table up, by its name; must not raise.
    """

    def __init__(self, bring_up: Callable[[str], None]) -> None:
        self._bring_up = bring_up
        self._waiting: dict[str, int] = {}
        self._running: set[str] = set()
        self._changed = threading.Condition()
        self._stopping = False
        self._lanes = [
            threading.Thread(target=self._work, args=(large,), name=f"tables-{number}", daemon=True)
            for number, large in enumerate([True] + [False] * SMALL_LANES)
        ]

    def start(self) -> None:
        """Start the lanes."""
        for lane in self._lanes:
            lane.start()

    def stop(self) -> None:
        """Finish what is being built, and nothing else."""
        with self._changed:
            self._stopping = True
            self._changed.notify_all()
        for lane in self._lanes:
            if lane.is_alive():
                lane.join()

    def ask(self, name: str, rows: int) -> None:
        """Have a table brought up that has about so many rows."""
        with self._changed:
            self._waiting[name] = rows
            self._changed.notify_all()

    def busy(self) -> list[str]:
        """Return the tables that are being built or wait for it."""
        with self._changed:
            return sorted(self._running | set(self._waiting))

    def _work(self, takes_large: bool) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._stopping or self._next(takes_large))
                name = self._next(takes_large)
                if self._stopping or name is None:
                    return
                del self._waiting[name]
                self._running.add(name)
            try:
                self._bring_up(name)
            finally:
                with self._changed:
                    self._running.discard(name)
                    self._changed.notify_all()

    def _next(self, takes_large: bool) -> str | None:
        """Return the first requested table that this kind of lane may take: a large one first."""
        free = [name for name in self._waiting if name not in self._running]
        large = [name for name in free if self._waiting[name] > LARGE]
        small = [name for name in free if self._waiting[name] <= LARGE]
        return next(iter([*large, *small] if takes_large else small), None)
