"""Query statistics: queries that a table did not cover, by cells of its load range.

Queries are counted a thousand times a second, so the counts are in a dictionary of bounded size.
Every second, and when the map is read, this process adds its counts to the ledger's database.
"""

from __future__ import annotations

import json
import logging
import threading
import time
from collections import deque
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import numpy as np

from wrenchbook.service.contract import COVERAGE
from wrenchbook.service.ledger import Ledger, LedgerError
from wrenchbook.service.ledger.audit import note
from wrenchbook.service.ledger.connection import Connection
from wrenchbook.surrogate.table.rows import LoadRange

log = logging.getLogger(__name__)

MAX_COMPONENTS: Final = 500
MAX_CELLS: Final = 2000  # cells of a component; queries of further cells count as `elsewhere`
MAX_LATEST: Final = 200
# Wrenches counted of a batch; in a larger one every k-th counts k times.
MAX_OF_A_BATCH: Final = 10_000
CELL: Final = 0.2  # part of half a load's range: five cells to each side of zero
_BEYOND: Final = 10  # cells from zero, OUTERMOST in page/js/demand.js; that cell counts all beyond
SAVE_S: Final = 1.0  # s between two additions of a process' counts to the database

Cell = tuple[int, ...]


class CellCount(NamedTuple):
    """Numbers of the queries in a cell by their coverage."""

    thin: float = 0
    outside: float = 0


@dataclass
class QueryCounts:
    """The map of one component.

    `since` is the time of the first query, s since the epoch; `cells` are the counts by cell,
    `elsewhere` counts queries beyond `MAX_CELLS` cells, `latest` has the newest wrenches.
    """

    since: float | None = None
    cells: dict[Cell, CellCount] = field(default_factory=dict)
    elsewhere: int = 0
    latest: deque[dict[str, Any]] = field(default_factory=lambda: deque(maxlen=MAX_LATEST))

    def count(self, cell: Cell, thin: float, outside: float) -> None:
        """Add queries to a cell, or to `elsewhere` if there are `MAX_CELLS` others."""
        if cell in self.cells or len(self.cells) < MAX_CELLS:
            known = self.cells.get(cell, CellCount())
            self.cells[cell] = CellCount(known.thin + thin, known.outside + outside)
        else:
            self.elsewhere += int(thin + outside)

    def add(self, other: QueryCounts) -> None:
        """Add the counts of another map of the component."""
        self.since = min((s for s in (self.since, other.since) if s is not None), default=None)
        self.elsewhere += other.elsewhere
        for cell, counts in other.cells.items():
            self.count(cell, *counts)
        latest = sorted([*self.latest, *other.latest], key=lambda query: query["when"])
        self.latest = deque(latest, maxlen=MAX_LATEST)


class QueryStatistics:
    """Thin and outside queries of each component, by all processes of a data directory."""

    def __init__(self, ledger: Ledger) -> None:
        self._ledger = ledger
        self._lock = threading.Lock()
        # Held from the taking of counts to their commit: they are in neither place in between.
        self._saving = threading.Lock()
        self._unsaved: dict[str, QueryCounts] = {}
        self._refused = False
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._keep_saving, name="demand", daemon=True)

    def start(self) -> None:
        """Start to save the counts every second, for the other processes."""
        self._thread.start()

    def stop(self) -> None:
        """Save the last counts."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()
        self.save()

    def note(
        self, name: str, span: LoadRange, wrench: tuple[float, ...], coverage: str, count: int = 1
    ) -> None:
        """Count a wrench (n,), N and N·m, that was not covered."""
        # Plain numbers take a tenth of the time of arrays of six.
        cell = tuple(
            max(-_BEYOND, min(_BEYOND, round(load / (CELL * scale))))
            for load, scale in zip(wrench, span.scale.tolist(), strict=True)
        )
        now = time.time()
        with self._lock:
            if name not in self._unsaved and len(self._unsaved) >= MAX_COMPONENTS:
                return
            counts = self._unsaved.setdefault(name, QueryCounts(since=now))
            counts.latest.append({"wrench": list(wrench), "coverage": coverage, "when": now})
            if coverage == "outside":
                counts.count(cell, 0, count)
            else:
                counts.count(cell, count, 0)

    def note_batch(
        self, name: str, span: LoadRange, wrenches: np.ndarray, coverage: np.ndarray
    ) -> None:
        """Count the wrenches of a batch, (k, n), N and N·m, that were not covered."""
        uncovered = np.flatnonzero(coverage)
        step = max(1, len(uncovered) // MAX_OF_A_BATCH)
        positions = uncovered[::step]
        scaled = np.clip(np.rint(wrenches[positions] / (CELL * span.scale)), -_BEYOND, _BEYOND)
        key = np.column_stack((scaled, coverage[positions]))
        _, first, counts = np.unique(key, axis=0, return_index=True, return_counts=True)
        for place, count in zip(positions[first].tolist(), counts.tolist(), strict=True):
            wrench = tuple(wrenches[place].tolist())
            self.note(name, span, wrench, COVERAGE[int(coverage[place])], count * step)

    def map_of(self, name: str, span: LoadRange) -> dict[str, Any]:
        """Return a component's map in the form of the reply, the most frequent cells first."""
        self.save()
        counts = QueryCounts()
        try:
            with self._ledger.reading() as db:
                counts = _saved(db, name)
        except LedgerError as error:
            self._warn(error)
        with self._lock:
            if name in self._unsaved:  # the ledger cannot be written at present
                counts.add(self._unsaved[name])
        size = CELL * span.scale
        cells = sorted(counts.cells.items(), key=lambda cell: -sum(cell[1]))
        return {
            "asked": int(counts.elsewhere + sum(thin + outside for _, (thin, outside) in cells)),
            "elsewhere": counts.elsewhere,
            "since": counts.since,
            "cell_size": size.tolist(),
            "cells": [
                {
                    "wrench": (np.array(cell) * size).tolist(),
                    "count": int(thin + outside),
                    "thin": int(thin),
                    "outside": int(outside),
                    "coverage": "outside" if outside > thin else "thin",
                }
                for cell, (thin, outside) in cells
            ],
            "latest": list(counts.latest)[::-1],
        }

    def forget(self, name: str) -> None:
        """Delete a component's map.

        Raises LedgerUnavailableError if the ledger cannot be written.
        """
        with self._saving:
            with self._ledger.writing(durable=False) as db:
                db.execute("DELETE FROM demand WHERE component = ?", (name,))
                note(db, "demand.forget", name, name)
            with self._lock:
                self._unsaved.pop(name, None)

    def save(self) -> None:
        """Add the counts of this process to the database."""
        with self._saving:
            self._save()

    def _save(self) -> None:
        with self._lock:
            counted = self._unsaved
            self._unsaved = {}
        if not counted:
            return
        try:
            with self._ledger.writing(durable=False) as db:
                known = {name for (name,) in db.execute("SELECT component FROM demand")}
                for name, counts in counted.items():
                    if name in known or len(known) < MAX_COMPONENTS:
                        known.add(name)
                        total = _saved(db, name)
                        total.add(counts)
                        saved = {
                            "since": total.since,
                            "elsewhere": total.elsewhere,
                            "cells": [[*cell, *both] for cell, both in total.cells.items()],
                            "latest": list(total.latest),
                        }
                        values = name, json.dumps(saved)
                        db.execute("INSERT OR REPLACE INTO demand VALUES (?, ?)", values)
            self._refused = False
        except LedgerError as error:
            self._warn(error)
            with self._lock:
                for name, counts in self._unsaved.items():
                    counted.setdefault(name, QueryCounts()).add(counts)
                self._unsaved = counted

    def _warn(self, error: Exception) -> None:
        """Log that the ledger cannot be used, once until it can be used again."""
        (log.debug if self._refused else log.warning)("the demand map is not saved: %s", error)
        self._refused = True

    def _keep_saving(self) -> None:
        while not self._stopping.wait(SAVE_S):
            self.save()


def _saved(db: Connection, name: str) -> QueryCounts:
    """Return the saved map of a component; an empty one if it is damaged."""
    row = db.execute("SELECT counts FROM demand WHERE component = ?", (name,)).fetchone()
    if row is None:
        return QueryCounts()
    try:
        read = json.loads(row[0])
        cells = {
            tuple(map(int, cell)): CellCount(thin, outside)
            for *cell, thin, outside in read["cells"]
        }
        latest = deque(read.get("latest", ()), maxlen=MAX_LATEST)
        return QueryCounts(float(read["since"]), cells, int(read["elsewhere"]), latest)
    except (ValueError, KeyError, TypeError) as error:
        log.warning("the demand map of %s begins anew: %s", name, error)
        return QueryCounts()
