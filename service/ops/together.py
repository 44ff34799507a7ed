"""The counts of several processes as one: each writes its own down, and all read all."""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Callable
from pathlib import Path

from service.files.durable import write_whole_bytes
from service.ops.counts import Counts

log = logging.getLogger(__name__)

FOLDER = "counts"
WRITE_S = 0.5  # between writings: what a killed process loses of its counts


class SharedCounts:
    """The counts of this process and of those beside it.

    A scraper must never see a count go down, whichever process it meets: so each writes its own
    before it tells the sum, and one that is started again goes on from what it wrote last.

    Parameters
    ----------
    folder : path
        Made if there is none.
    number : int
        Which process this is; no other one has it.
    counts : Counts
        This process' own; what it counted before it was started again is added.
    listeners : callable
        How many follow the events here.
    """

    def __init__(
        self, folder: Path, number: int, counts: Counts, listeners: Callable[[], int]
    ) -> None:
        self._folder, self._own = folder, folder / f"{number}.json"
        self._counts, self._listeners = counts, listeners
        folder.mkdir(parents=True, exist_ok=True)
        counts.add_all(_read(self._own)[0])
        self._writing = threading.Lock()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._keep, name="counts", daemon=True)
        self._thread.start()

    def together(self) -> tuple[Counts, int]:
        """Return the sum of all processes' counts, and how many follow the events."""
        self._write()
        total, listeners = Counts(), 0
        for path in sorted(self._folder.glob("*.json")):
            found, more = _read(path)
            total.add_all(found)
            listeners += more
        return total, listeners

    def stop(self) -> None:
        """Write no longer."""
        self._stopping.set()
        self._thread.join()
        self._write()

    def _keep(self) -> None:
        while not self._stopping.wait(WRITE_S):
            self._write()

    def _write(self) -> None:
        with self._writing:
            told = {"counts": self._counts.as_words(), "listeners": self._listeners()}
            try:
                write_whole_bytes(self._own, json.dumps(told).encode(), durable=False)
            except OSError as error:
                log.debug("counts are not written: %s", error)


def _read(path: Path) -> tuple[Counts, int]:
    try:
        told = json.loads(path.read_bytes())
        return Counts.of_words(told["counts"]), told["listeners"]
    except (OSError, ValueError, KeyError, TypeError):
        return Counts(), 0
