"""The demand map: what was asked of a table and not covered, by cells of its load range.

Asked a thousand times a second, so it counts in a dictionary of bounded size and writes nothing
down on the way. What one process has counted it adds, every second or when it is asked, to a file
that all processes of a data directory share: each tells the sum, and none overwrites another's.
"""

from __future__ import annotations

import json
import logging
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np

from wrenchbook.service.contract import COVERAGE
from wrenchbook.service.demand.counts import QueryCounts, add, kept, read
from wrenchbook.service.files.durable import write_whole_bytes
from wrenchbook.service.files.lock import take
from wrenchbook.surrogate.table.rows import LoadRange

log = logging.getLogger(__name__)

MOST_COMPONENTS: Final = 500
MOST_OF_A_BATCH: Final = 10_000  # wrenches looked at; more are counted by their share
CELL: Final = 0.2  # of half a load's range: five cells to each side of zero
_BEYOND: Final = 10  # cells; what lies farther off is in the outermost one
ADD_S: Final = 1.0  # between two additions of a process' own counts to the file


class QueryStatistics:
    """What was asked of each component and was thin or outside.

    Parameters
    ----------
    path : path
        The file that holds it, beside which lies its lock.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._lock_path = path, path.with_name(f".{path.stem}.lock")
        self._lock = threading.Lock()
        self._held: dict[str, QueryCounts] = {}  # as the file had it last
        self._own: dict[str, QueryCounts] = {}  # what has been counted here since then
        self._refused = False
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._keep_adding, name="demand", daemon=True)
        self._held = self._read()

    def start(self) -> None:
        """Add to the file every second what was counted, so that other processes tell it too."""
        self._thread.start()

    def stop(self) -> None:
        """Add to the file what was counted last."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()
        self.save()

    def note(
        self, name: str, span: LoadRange, wrench: tuple[float, ...], coverage: str, count: int = 1
    ) -> None:
        """Count a wrench (n,), N and N·m, that was not covered."""
        scale = span.scale.tolist()  # plain numbers: a tenth of what arrays of six take
        cell = tuple(
            max(-_BEYOND, min(_BEYOND, round(load / (CELL * of))))
            for load, of in zip(wrench, scale, strict=True)
        )
        with self._lock:
            if not (name in self._own or name in self._held) and self._is_full():
                return
            counts = self._own.setdefault(name, QueryCounts(since=time.time()))
            counts.latest.append(
                {"wrench": list(wrench), "coverage": coverage, "when": time.time()}
            )
            counts.count(cell, count * (coverage != "outside"), count * (coverage == "outside"))

    def note_batch(
        self, name: str, span: LoadRange, wrenches: np.ndarray, coverage: np.ndarray
    ) -> None:
        """Count the wrenches of a batch, (k, n), N and N·m, that were not covered."""
        left = np.flatnonzero(coverage)
        step = max(1, len(left) // MOST_OF_A_BATCH)
        scaled = np.clip(np.rint(wrenches[left[::step]] / (CELL * span.scale)), -_BEYOND, _BEYOND)
        key = np.column_stack((scaled, coverage[left[::step]]))
        _, first, counts = np.unique(key, axis=0, return_index=True, return_counts=True)
        for at, count in zip(left[::step][first].tolist(), counts.tolist(), strict=True):
            wrench = tuple(wrenches[at].tolist())
            self.note(name, span, wrench, COVERAGE[int(coverage[at])], count * step)

    def map_of(self, name: str, span: LoadRange) -> dict[str, Any]:
        """Return a component's map as a reply has it, the most asked first."""
        self.save()
        with self._lock:
            whole = {one: self._held[one] for one in (name,) if one in self._held}
            whole = add(whole, {one: self._own[one] for one in (name,) if one in self._own})
        counts = whole.get(name, QueryCounts(since=None))
        size = CELL * span.scale
        cells = sorted(counts.cells.items(), key=lambda cell: -sum(cell[1]))
        return {
            "asked": int(counts.elsewhere + sum(sum(found) for _, found in cells)),
            "elsewhere": counts.elsewhere,
            "since": counts.since,
            "cell_size": size.tolist(),
            "cells": [
                {
                    "wrench": (np.array(cell) * size).tolist(),
                    "count": int(sum(found)),
                    "thin": int(found[0]),
                    "outside": int(found[1]),
                    "coverage": "outside" if found[1] > found[0] else "thin",
                }
                for cell, found in cells
            ],
            "latest": list(counts.latest)[::-1],
        }

    def forget(self, name: str) -> None:
        """Begin a component's map anew."""
        self.save()
        with self._alone() as alone, self._lock:
            self._own.pop(name, None)
            if alone and self._held.pop(name, None) is not None:
                self._write(self._held)

    def save(self) -> None:
        """Add what was counted here to the file; with what others have counted it is held here."""
        with self._alone() as alone:
            if not alone:
                return  # another process is at it; the next time will do
            locked = self._read()
            with self._lock:
                own, self._own = self._own, {}
                self._held = add(locked, own)
            if own and not self._write(self._held):
                with self._lock:
                    self._own, self._held = add(own, self._own), locked

    def _is_full(self) -> bool:
        return len(self._own.keys() | self._held.keys()) >= MOST_COMPONENTS

    def _warn(self, error: OSError) -> None:
        """Tell of a disk that takes nothing, once until it does again."""
        (log.debug if self._refused else log.warning)("the demand map is not saved: %s", error)
        self._refused = True

    def _keep_adding(self) -> None:
        while not self._stopping.wait(ADD_S):
            if self._own:
                self.save()

    @contextmanager
    def _alone(self) -> Iterator[bool]:
        """Give whether this process alone may change the file now."""
        try:
            descriptor = take(self._lock_path)
        except OSError as error:
            self._warn(error)
            descriptor = None
        try:
            yield descriptor is not None
        finally:
            if descriptor is not None:
                os.close(descriptor)

    def _write(self, counts: dict[str, QueryCounts]) -> bool:
        try:
            write_whole_bytes(self._path, json.dumps(kept(counts)).encode(), durable=False)
        except OSError as error:
            self._warn(error)
            return False
        self._refused = False
        return True

    def _read(self) -> dict[str, QueryCounts]:
        try:
            return read(json.loads(self._path.read_bytes()))
        except FileNotFoundError:
            return {}
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            log.warning("the demand map begins anew: %s", error)
            return {}
