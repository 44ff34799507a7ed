"""Demand maps: queries that a table did not cover, counted by cells of its load range.

The main call counts its queries here, some thousand a second, so each process has its counts in
memory, bounded in size. Every second, and when a map is read, it adds them to the ledger's
database.
"""

from __future__ import annotations

import json
import logging
import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, Literal, NamedTuple, Self

import numpy as np
from typing_extensions import TypedDict

from wrenchbook.service.contract import COVERAGE
from wrenchbook.service.ledger import Ledger, LedgerError
from wrenchbook.service.ledger.audit import note
from wrenchbook.service.ledger.connection import Connection
from wrenchbook.service.messages import Message, Six
from wrenchbook.surrogate.table.rows import LoadRange

log = logging.getLogger(__name__)

# A map with all its cells is about 100 kB of JSON, which is written each second.
MAX_COMPONENTS: Final = 500
MAX_CELLS: Final = 2000  # cells of a component; queries of further cells count as `elsewhere`
MAX_LATEST: Final = 200
# Wrenches counted of a batch, 0.1 s; in a larger one every k-th counts k times.
MAX_OF_A_BATCH: Final = 10_000
CELL: Final = 0.2  # part of half a load's range: five cells to each side of zero
OUTERMOST: Final = 10  # cells from zero; that cell has all loads beyond; also in page/js/demand.js
SAVE_S: Final = 1.0  # s between two additions of a process' counts to the database

Numbers = tuple[float, ...]
Cell = tuple[int, ...]  # the rounded number of cells from zero, by load


class DemandCell(Message):
    """Queries in one cell of a demand map."""

    wrench: Six
    count: int
    thin: int
    outside: int
    coverage: Literal["thin", "outside"]


class UncoveredQuery(TypedDict):
    """A query that was not covered."""

    wrench: Sequence[float]
    coverage: str
    when: float


class Demand(Message):
    """Demand map: wrenches of queries that were not covered, by cells of the load range."""

    component: str
    asked: int
    elsewhere: int
    since: float | None
    cell_size: Six
    cells: Sequence[DemandCell]
    latest: Sequence[UncoveredQuery]


class CellCount(NamedTuple):
    """Numbers of the queries in a cell by their coverage."""

    thin: int = 0
    outside: int = 0


def cell_of(wrench: Sequence[float], scale: Numbers) -> Cell:
    """Return the cell of a wrench, shape (n,), N and N·m, in a range of `LoadRange.scale`."""
    # Plain numbers take a tenth of the time of arrays of six.
    return tuple(
        round(max(-OUTERMOST, min(OUTERMOST, load / (CELL * size))))
        for load, size in zip(wrench, scale, strict=True)
    )


def centre_of(cell: Cell, scale: Numbers) -> list[float]:
    """Return the wrench at the centre of a cell, shape (n,), N and N·m."""
    return [number * CELL * size for number, size in zip(cell, scale, strict=True)]


@dataclass
class DemandMap:
    """The counts of one component."""

    scale: Numbers  # (n,), N and N·m: `LoadRange.scale` of the range that the cells divide
    since: float | None = None  # time of the first query, s since the epoch
    cells: dict[Cell, CellCount] = field(default_factory=dict)
    elsewhere: int = 0  # queries beyond `MAX_CELLS` cells, or beyond an earlier range's cells
    latest: deque[UncoveredQuery] = field(default_factory=lambda: deque(maxlen=MAX_LATEST))

    def count(self, cell: Cell, thin: int, outside: int) -> None:
        """Add queries to a cell, or to `elsewhere` if there are `MAX_CELLS` others."""
        if cell in self.cells or len(self.cells) < MAX_CELLS:
            before = self.cells.get(cell, CellCount())
            self.cells[cell] = CellCount(before.thin + thin, before.outside + outside)
        else:
            self.elsewhere += thin + outside

    def add(self, newer: DemandMap) -> None:
        """Add the counts of a newer map of the component, whose range is then this map's too."""
        self.rescale(newer.scale)
        self.since = min((s for s in (self.since, newer.since) if s is not None), default=None)
        self.elsewhere += newer.elsewhere
        for cell, counts in newer.cells.items():
            self.count(cell, *counts)
        latest = sorted([*self.latest, *newer.latest], key=lambda query: query["when"])
        self.latest = deque(latest, maxlen=MAX_LATEST)

    def rescale(self, scale: Numbers) -> None:
        """Count in the cells of another load range; begin anew if that has other inputs.

        Queries of a cell count in the cell of its centre. Those of an outermost cell, whose loads
        are only known to be beyond it, count as `elsewhere`.
        """
        if scale == self.scale:
            return
        cells, before = self.cells, self.scale
        self.scale, self.cells = scale, {}
        if len(scale) != len(before):
            self.since, self.elsewhere = None, 0
            self.latest.clear()
            return
        for cell, counts in cells.items():
            if OUTERMOST in map(abs, cell):
                self.elsewhere += sum(counts)
            else:
                self.count(cell_of(centre_of(cell, before), scale), *counts)

    def to_json(self) -> str:
        """Return the stored form, in which a cell is a list of its numbers and its two counts."""
        cells = [[*cell, *counts] for cell, counts in self.cells.items()]
        return json.dumps({**vars(self), "cells": cells, "latest": list(self.latest)})

    @classmethod
    def from_json(cls, text: str, scale: Numbers) -> Self:
        """Return a stored map; a map of an earlier version has no scale, and gets `scale`.

        Raises KeyError, TypeError, AttributeError, ValueError or OverflowError if it is
        damaged.
        """
        stored = json.loads(text)
        scale = tuple(map(float, stored.get("scale", scale)))
        cells = {
            tuple(map(int, cell)): CellCount(int(thin), int(outside))
            for *cell, thin, outside in stored["cells"]
        }
        latest = deque[UncoveredQuery](maxlen=MAX_LATEST)
        for query in stored.get("latest", ()):
            wrench, when = [*map(float, query["wrench"])], float(query["when"])
            latest.append({"wrench": wrench, "coverage": query["coverage"], "when": when})
        if any(len(loads) != len(scale) for loads in (*cells, *(q["wrench"] for q in latest))):
            raise ValueError(f"it has wrenches that are not of {len(scale)} inputs")
        return cls(scale, float(stored["since"]), cells, int(stored["elsewhere"]), latest)


class DemandMaps:
    """The demand maps of all components, by all processes of a data directory."""

    def __init__(self, ledger: Ledger) -> None:
        self._ledger = ledger
        self._lock = threading.Lock()
        # Held from the taking of counts to their commit: they are in neither place in between.
        self._saving = threading.Lock()
        self._unsaved: dict[str, DemandMap] = {}
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
        self, name: str, span: LoadRange, wrench: Numbers, coverage: str, count: int = 1
    ) -> None:
        """Count a wrench (n,), N and N·m, that was not covered."""
        scale = tuple(span.scale.tolist())
        cell = cell_of(wrench, scale)
        now = time.time()
        with self._lock:
            if name not in self._unsaved and len(self._unsaved) >= MAX_COMPONENTS:
                return
            if name not in self._unsaved:
                self._unsaved[name] = DemandMap(scale)
            counts = self._unsaved[name]
            counts.rescale(scale)
            counts.since = counts.since or now
            counts.latest.append({"wrench": list(wrench), "coverage": coverage, "when": now})
            counts.count(cell, *((0, count) if coverage == "outside" else (count, 0)))

    def note_batch(
        self, name: str, span: LoadRange, wrenches: np.ndarray, coverage: np.ndarray
    ) -> None:
        """Count the wrenches of a batch, (k, n), N and N·m, that were not covered.

        `coverage`, (k,), has the positions in `COVERAGE`. Of each cell the first wrench is among
        the latest.
        """
        uncovered = np.flatnonzero(coverage)
        step = max(1, len(uncovered) // MAX_OF_A_BATCH)
        chosen = uncovered[::step]
        scale = tuple(span.scale.tolist())
        groups: dict[tuple[Cell, int], list[Numbers]] = {}
        for wrench, code in zip(wrenches[chosen].tolist(), coverage[chosen].tolist(), strict=True):
            groups.setdefault((cell_of(wrench, scale), code), []).append(wrench)
        for (_, code), members in groups.items():
            self.note(name, span, members[0], COVERAGE[code], step * len(members))

    def map_of(self, name: str, span: LoadRange) -> Demand:
        """Return a component's map, the most frequent cells first.

        Raises LedgerError if the ledger cannot be read.
        """
        self.save()
        scale = tuple(span.scale.tolist())
        with self._ledger.reading() as db:
            counts = _saved(db, name, scale)
        with self._lock:
            if name in self._unsaved:  # the ledger cannot be written at present
                counts.add(self._unsaved[name])
        counts.rescale(scale)
        cells = sorted(counts.cells.items(), key=lambda cell: -sum(cell[1]))
        return Demand(
            component=name,
            asked=counts.elsewhere + sum(thin + outside for _, (thin, outside) in cells),
            elsewhere=counts.elsewhere,
            since=counts.since,
            cell_size=CELL * span.scale,
            cells=[
                DemandCell(
                    wrench=np.array(centre_of(cell, scale)),
                    count=thin + outside,
                    thin=thin,
                    outside=outside,
                    coverage="outside" if outside > thin else "thin",
                )
                for cell, (thin, outside) in cells
            ],
            latest=list(counts.latest)[::-1],
        )

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
        """Add the counts of this process to the database; keep them if it cannot be written."""
        with self._saving:
            with self._lock:
                taken = self._unsaved
                self._unsaved = {}
            if not taken:
                return
            try:
                self._write(taken)
                self._refused = False
            except LedgerError as error:
                # Logged once until the ledger can be used again.
                level = logging.DEBUG if self._refused else logging.WARNING
                log.log(level, "the demand maps are not saved: %s", error)
                self._refused = True
                with self._lock:
                    for name, counts in self._unsaved.items():
                        taken.setdefault(name, DemandMap(counts.scale)).add(counts)
                    self._unsaved = taken

    def _write(self, taken: dict[str, DemandMap]) -> None:
        with self._ledger.writing(durable=False) as db:
            stored = {name for (name,) in db.execute("SELECT component FROM demand")}
            for name, counts in taken.items():
                if name in stored or len(stored) < MAX_COMPONENTS:
                    stored.add(name)
                    total = _saved(db, name, counts.scale)
                    total.add(counts)
                    values = name, total.to_json()
                    db.execute("INSERT OR REPLACE INTO demand VALUES (?, ?)", values)

    def _keep_saving(self) -> None:
        while not self._stopping.wait(SAVE_S):
            self.save()


def _saved(db: Connection, name: str, scale: Numbers) -> DemandMap:
    """Return the saved map of a component; an empty one if there is none, or it is damaged."""
    row = db.execute("SELECT counts FROM demand WHERE component = ?", (name,)).fetchone()
    if row is None:
        return DemandMap(scale)
    try:
        return DemandMap.from_json(row[0], scale)
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        log.warning("the demand map of %s begins anew: %s", name, error)
        return DemandMap(scale)
