"""The first wrenches of a table: what every axis needs before its error can be told.

The centre, the faces and the corners of each axis' load range, half moments alone (every answer is
counted from them), then a Halton sequence (Halton 1960) inside it. Rows that bring their tangent
compliance tell as much as several that do not: once a table has such rows, faces and corners are
enough. Full six-component wrenches follow an additive recurrence (Roberts 2018, the R sequence).
"""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy.stats import qmc

from surrogate.table.axes import AXES, CLEAN, Axis, clean_rows
from surrogate.table.rows import Floats, LoadRange, Rows

# Wrenches of the first design, by how many of the axis' three loads vary; with tangents fewer.
FIRST = {0: 1, 1: 7, 2: 15, 3: 27}
FIRST_WITH_TANGENTS = {0: 1, 1: 3, 2: 9, 3: 15}


class Known:
    """The wrenches that need not be asked again: rows and pending ones."""

    def __init__(self, load_range: LoadRange, rows: Floats, pending: Floats) -> None:
        self.scale, self.pending = load_range.scale, pending
        self.keys = {self._key(wrench) for wrench in np.concatenate((rows, pending))}

    def _key(self, wrench: Floats) -> tuple[int, ...]:
        return tuple(np.round(wrench / self.scale / CLEAN).astype(np.int64).tolist())

    def new(self, wrenches: Floats) -> Floats:
        """Return those not known yet, each once, and know them from now on."""
        fresh = []
        for wrench in wrenches:
            key = self._key(wrench)
            if key not in self.keys:
                self.keys.add(key)
                fresh.append(wrench)
        return np.array(fresh).reshape(-1, 6)


def first_design(load_range: LoadRange, *, tangents: bool = False) -> Floats:
    """Return the first design of all axes, shape (k, 6), N and N·m, the most telling first.

    The load range is stretched to hold zero: the composition asks every axis about one moment
    alone. A wrench that two axes share, a pure moment, is in it once. A load whose range is zero
    is never asked for.
    """
    ranked: list[tuple[int, int, Floats]] = []
    for index, axis in enumerate(AXES):
        low, high = axis_box(load_range, axis)
        if (high > low).any():
            design = _axis_design(axis, low, high, tangents)
            ranked += [(rank, index, wrench) for rank, wrench in design]
    ranked.sort(key=lambda entry: entry[:2])
    known = Known(load_range, np.empty((0, 6)), np.empty((0, 6)))
    return known.new(np.array([wrench for _, _, wrench in ranked]).reshape(-1, 6))


def axis_box(load_range: LoadRange, axis: Axis) -> tuple[Floats, Floats]:
    """Return the low and high ends, (3,) each, of an axis' loads, stretched to hold zero."""
    inputs = list(axis.inputs)
    return np.minimum(load_range.low[inputs], 0.0), np.maximum(load_range.high[inputs], 0.0)


def full_wrenches(load_range: LoadRange, known: Known, count: int) -> Floats:
    """Return new wrenches of all six loads at once, shape (count, 6); none if no two axes meet."""
    corner = np.where(load_range.high != 0, load_range.high, load_range.low)
    one = Rows.of(corner, np.zeros(6))
    if count <= 0 or clean_rows(one, load_range).any():
        return np.empty((0, 6))
    root = 1.09  # the root of x^7 = x + 1, by which the recurrence steps
    for _ in range(30):
        root = (1 + root) ** (1 / 7)
    step = root ** -np.arange(1.0, 7.0)
    chosen: list[Floats] = []
    place = 0
    while len(chosen) < count:
        place += 1
        part = (0.5 + place * step) % 1.0
        wrench = load_range.low + part * (load_range.high - load_range.low)
        chosen.extend(known.new(wrench[None]))
    return np.array(chosen)


def _axis_design(axis: Axis, low: Floats, high: Floats, tangents: bool) -> list[tuple[int, Floats]]:
    """Return one axis' first design as (rank, wrench), the lowest rank first."""
    vary = np.flatnonzero(high > low)
    signs = [(0, np.zeros(3))]
    for load, side in product(vary, (-1.0, 1.0)):
        signs.append((1, np.where(np.arange(3) == load, side, 0.0)))
    if len(vary) > 1:
        for corner in product((-1.0, 1.0), repeat=len(vary)):
            signs.append((2, np.zeros(3)))
            signs[-1][1][vary] = corner
    if not tangents:
        signs += _inside(vary, FIRST[len(vary)] - len(signs))
    wanted = (FIRST_WITH_TANGENTS if tangents else FIRST)[len(vary)]
    middle, half = (low + high) / 2, (high - low) / 2
    return [(rank, _wrench(axis, middle + s * half)) for rank, s in signs[:wanted]]


def _inside(vary: np.ndarray, count: int) -> list[tuple[int, Floats]]:
    """Return half moments alone, then a Halton sequence, in units of the half widths."""
    signs = []
    for load, side in product((1, 2), (-0.5, 0.5)):
        if load in vary and len(vary) > 1:
            signs.append((3, np.where(np.arange(3) == load, side, 0.0)))
    sequence = qmc.Halton(3, scramble=False)
    sequence.fast_forward(1)  # its first point is a corner
    more = max(count - len(signs), 0)
    return signs + [(4 + place, 2 * x - 1) for place, x in enumerate(sequence.random(more))]


def _wrench(axis: Axis, loads: Floats) -> Floats:
    wrench = np.zeros(6)
    wrench[list(axis.inputs)] = loads
    return wrench
