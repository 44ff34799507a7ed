"""What was asked of a component and not covered, by cells; sums of it, and how it is written."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Final

MOST_CELLS: Final = 2000  # of a component; what finds none is counted as `elsewhere`
MOST_LATEST: Final = 200

Cell = tuple[int, ...]


@dataclass
class QueryCounts:
    """The map of one component.

    Attributes
    ----------
    since : float or None
        When the first was counted, s since the epoch.
    cells : dict
        By cell how many were thin and how many outside.
    elsewhere : int
        Those that found no cell any more.
    latest : deque of dict
        The wrenches asked last.
    """

    since: float | None
    cells: dict[Cell, list[float]] = field(default_factory=dict)
    elsewhere: int = 0
    latest: deque[dict[str, Any]] = field(default_factory=lambda: deque(maxlen=MOST_LATEST))

    def count(self, cell: Cell, thin: float, outside: float) -> None:
        """Add to a cell, as long as there is room for cells."""
        found = self.cells.get(cell)
        if found is None and len(self.cells) >= MOST_CELLS:
            self.elsewhere += int(thin + outside)
        elif found is None:
            self.cells[cell] = [thin, outside]
        else:
            self.cells[cell] = [found[0] + thin, found[1] + outside]


def add(first: dict[str, QueryCounts], second: dict[str, QueryCounts]) -> dict[str, QueryCounts]:
    """Return the sum of two maps by component; neither is changed."""
    return {name: _sum(first.get(name), second.get(name)) for name in {**first, **second}}


def kept(maps: dict[str, QueryCounts]) -> dict[str, Any]:
    """Return maps as JSON keeps them."""
    return {
        name: {
            "since": one.since,
            "elsewhere": one.elsewhere,
            "cells": [[*cell, *found] for cell, found in one.cells.items()],
            "latest": list(one.latest),
        }
        for name, one in maps.items()
    }


def read(body: dict[str, Any]) -> dict[str, QueryCounts]:
    """Return the maps that `kept` has made.

    Raises
    ------
    ValueError, KeyError, TypeError, AttributeError
        If it is none of its.
    """
    return {name: _read(one) for name, one in body.items()}


def _read(one: dict[str, Any]) -> QueryCounts:
    cells = {tuple(map(int, cell)): [thin, outside] for *cell, thin, outside in one["cells"]}
    counts = QueryCounts(float(one["since"]), cells, int(one["elsewhere"]))
    counts.latest.extend(one.get("latest", ()))
    return counts


def _sum(first: QueryCounts | None, second: QueryCounts | None) -> QueryCounts:
    first, second = first or QueryCounts(None), second or QueryCounts(None)
    made = QueryCounts(
        min((one.since for one in (first, second) if one.since), default=None),
        dict(first.cells),
        first.elsewhere + second.elsewhere,
    )
    for cell, (thin, outside) in second.cells.items():
        made.count(cell, thin, outside)
    made.latest.extend(_by_time([*first.latest, *second.latest]))
    return made


def _by_time(latest: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    return sorted(latest, key=lambda one: one["when"])
