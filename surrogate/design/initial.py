"""The first wrenches of a table: what a kriging needs before it can tell its own error.

A solve brings its tangent compliance, so each wrench tells seven numbers of every output, and one
that loads all axes tells of all of them and of what they do together. So the first wrenches are no
load at all, then corners of the load box in a fraction that keeps the loads' effects apart, then an
additive recurrence (Roberts 2018, the R sequence), which spreads any number of points evenly.
"""

from __future__ import annotations

import numpy as np

from ..table.rows import CLEAN, LOADS, Floats, LoadRange
from ..table.spread import spread_wrenches

# Signs of eight corners: the third of the 2^(6-3) fractions, in which no load's effect is another's
# (Box and Hunter 1961): the last three are the products of two of the first three.
_SIGNS = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij")).reshape(3, 8).T
CORNERS = np.concatenate((_SIGNS, _SIGNS[:, [0, 0, 1]] * _SIGNS[:, [1, 2, 2]]), axis=1)
# How far out they are: with 15 solves of `plate_thin` the worst output's error is 0.13 to 0.16 % of
# its range at 0.8, 0.22 to 0.25 % at 1, and 0.18 to 0.30 % without corners; at 54 all are alike.
OUT = 0.8
# Wrenches of the first design: two for each load and three more, 15 of six loads.
A_LOAD, FURTHER = 2, 3
_FAR = 2.0**62  # steps from no load, of what an int64 holds: no wrench to be asked is out there


class Known:
    """The wrenches that need not be asked again: rows and pending ones."""

    def __init__(self, load_range: LoadRange, rows: Floats, pending: Floats) -> None:
        self.scale, self.pending = load_range.scale, pending
        self.keys = {self._key(wrench) for wrench in np.concatenate((rows, pending))}

    def _key(self, wrench: Floats) -> tuple[int, ...]:
        with np.errstate(over="ignore"):
            steps = np.round(wrench / self.scale / CLEAN)
        return tuple(np.clip(steps, -_FAR, _FAR).astype(np.int64).tolist())

    def new(self, wrenches: Floats) -> Floats:
        """Return those of some wrenches not known yet, each once, and know them from now on.

        Shape (k, 6), N and N·m, as those given.
        """
        fresh = []
        for wrench in wrenches:
            key = self._key(wrench)
            if key not in self.keys:
                self.keys.add(key)
                fresh.append(wrench)
        return np.array(fresh).reshape(-1, 6)


def first_count(span: LoadRange) -> int:
    """Return how many wrenches the first design of a span has; one where no load varies."""
    vary = int((span.high > span.low).sum())
    return A_LOAD * vary + FURTHER if vary else 1


def first_design(span: LoadRange, known: Known, count: int) -> Floats:
    """Return new wrenches of the first design within a span, shape (count, 6), N and N·m.

    A load that the span holds at one value keeps it. Fewer come from a span so narrow that there
    are not as many wrenches in it as can be told apart.
    """
    middle, half = (span.low + span.high) / 2, (span.high - span.low) / 2
    at_rest = np.clip(np.zeros(len(LOADS)), span.low, span.high)
    corners = middle + OUT * CORNERS * half
    chosen = list(known.new(np.concatenate((at_rest[None], corners))))
    # A place of the sequence is refused only if it is known already. So many refusals mean that
    # the whole span is.
    last = count + len(known.keys) if half.any() else 0
    for place in range(1, last + 1):
        if len(chosen) >= count:
            break
        chosen.extend(known.new(spread_wrenches(span, 1, place)))
    return np.array(chosen[:count]).reshape(-1, len(LOADS))
