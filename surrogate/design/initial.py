"""The first wrenches of a table: what a kriging needs before it can tell its own error.

A solve brings its tangent compliance, so each wrench tells seven numbers of every output, and one
that loads all axes tells of all of them and of what they do together. So the first wrenches are no
load at all and then full ones, along an additive recurrence (Roberts 2018, the R sequence), which
spreads any number of points evenly.
"""

from __future__ import annotations

import numpy as np

from ..table.axes import CLEAN, Axis
from ..table.rows import Floats, LoadRange

FIRST = 15  # two for each load and three more: with those `plate_thin` is at 0.7 % of its range


class Known:
    """The wrenches that need not be asked again: rows and pending ones."""

    def __init__(self, load_range: LoadRange, rows: Floats, pending: Floats) -> None:
        self.scale, self.pending = load_range.scale, pending
        self.keys = {self._key(wrench) for wrench in np.concatenate((rows, pending))}

    def _key(self, wrench: Floats) -> tuple[int, ...]:
        return tuple(np.round(wrench / self.scale / CLEAN).astype(np.int64).tolist())

    def new(self, wrenches: Floats) -> Floats:
        """Return those of wrenches (k, 6) not known yet, each once, and know them from now on."""
        fresh = []
        for wrench in wrenches:
            key = self._key(wrench)
            if key not in self.keys:
                self.keys.add(key)
                fresh.append(wrench)
        return np.array(fresh).reshape(-1, 6)


def first_design(span: LoadRange, known: Known, count: int) -> Floats:
    """Return new wrenches of the first design within a span, shape (count, 6), N and N·m.

    A load that the span holds at one value keeps it.
    """
    at_rest = np.clip(np.zeros(6), span.low, span.high)
    chosen = list(known.new(at_rest[None]))
    place = 0
    while len(chosen) < count and (span.high > span.low).any():
        place += 1
        chosen.extend(known.new(spread_wrenches(span, 1, place)))
    return np.array(chosen[:count]).reshape(-1, 6)


def spread_wrenches(span: LoadRange, count: int, start: int = 1) -> Floats:
    """Return `count` evenly spread wrenches of a span, shape (count, 6), N and N·m."""
    vary = np.flatnonzero(span.high > span.low)
    root = 2.0  # the root of x^(d + 1) = x + 1, by which the recurrence steps
    for _ in range(60):
        root = (1 + root) ** (1 / (len(vary) + 1))
    step = root ** -np.arange(1.0, len(vary) + 1)
    fraction = (0.5 + np.arange(start, start + count)[:, None] * step) % 1.0
    wrenches = np.tile(span.low, (count, 1))
    wrenches[:, vary] += fraction * (span.high - span.low)[vary]
    return wrenches


def axis_box(load_range: LoadRange, axis: Axis) -> tuple[Floats, Floats]:
    """Return the low and high ends, (3,) each, of an axis' loads, stretched to hold zero."""
    inputs = list(axis.inputs)
    return np.minimum(load_range.low[inputs], 0.0), np.maximum(load_range.high[inputs], 0.0)
