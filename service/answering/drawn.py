"""Answers of a table for drawings: they are not counted, and queue nothing."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wrenchbook.service.tables.mapped import ServedTable
from wrenchbook.surrogate.table.axes import LoadAxis
from wrenchbook.surrogate.table.rows import LoadRange

Floats = NDArray[np.float64]

SAMPLE = 128  # wrenches: the covered share of a range to some 4 %
PRIMES = (2, 3, 5, 7, 11, 13)  # the first six: the bases of a load's places each
A_LOAD = 7  # cells of each load in the grid of an axis; odd, so that no load is a middle of one


def sample_of(load_range: LoadRange) -> Floats:
    """Return wrenches spread over the load range, the same each time, (SAMPLE, 6), N and N·m."""
    numbers = np.arange(1, SAMPLE + 1)  # without 0, which is a corner
    spread = np.column_stack([_mirrored(numbers, base) for base in PRIMES])
    return load_range.low + spread * (load_range.high - load_range.low)


def _mirrored(numbers: NDArray[np.int_], base: int) -> Floats:
    """Return numbers (n,) with their digits in a base behind the point, the last first, (n,).

    One load's places of Halton's sequence (1960), dimensionless. Importing `scipy.stats` for it
    would take a fifth of a server's start.
    """
    out, part = np.zeros(len(numbers)), 1.0
    while numbers.any():
        part /= base
        out += part * (numbers % base)
        numbers = numbers // base
    return out


def grid_of(load_range: LoadRange, axis: LoadAxis) -> Floats:
    """Return the middles of a grid's cells over the loads of an axis, (n, 6), N and N·m.

    Its other loads are zero. At the ends of the range, which rows hardly ever reach, lie no points:
    each stands for a cell of the same size.
    """
    low, high = _ends(load_range)
    middles = np.linspace(low, high, 2 * A_LOAD + 1)[1::2]
    spans = [np.unique(middles[:, load]) for load in axis.inputs]
    wrenches = np.zeros((int(np.prod([len(span) for span in spans])), 6))
    wrenches[:, list(axis.inputs)] = list(product(*spans))
    return wrenches


def sweep_of(load_range: LoadRange, load: int, at: Floats, points: int) -> Floats:
    """Return wrenches that differ in one load alone, over its range, (points, 6), N and N·m.

    The other loads are those of `at`, shape (6,), N and N·m.
    """
    low, high = _ends(load_range)
    wrenches = np.repeat(at[None], points, axis=0)
    wrenches[:, load] = np.linspace(low[load], high[load], points)
    return wrenches


def shares_of(table: ServedTable, wrenches: Floats) -> list[float]:
    """Return what parts of wrenches, (n, 6), N and N·m, are covered, thin and outside."""
    found = table.packed.batch(wrenches)
    return (np.bincount(found.coverage, minlength=3) / len(wrenches)).tolist()


def whole_bars(table: ServedTable, wrenches: Floats) -> dict[str, Any]:
    """Return median error bars over wrenches, (n, 6), N and N·m, and how many are small enough.

    ``error`` and its part ``interpolation`` are shape (6,), m and rad, infinite where not known;
    ``within_tolerance`` is the share of wrenches that are covered and whose whole error bar is
    within the tolerance, None where a covered one cannot be compared.
    """
    answers = [table.packed.answer(wrench) for wrench in wrenches.tolist()]
    within = [one.within_tolerance for one in answers if one.coverage == "covered"]
    return {
        "error": _middle([one.error for one in answers]),
        "interpolation": _middle([one.interpolation for one in answers]),
        "bars_are_whole": table.bars_are_whole,
        "within_tolerance": None if None in within else sum(map(bool, within)) / len(answers),
    }


def _middle(bars: Sequence[Sequence[float | None] | None]) -> Floats:
    """Return the median of each output's error bars; an unknown one counts as the largest."""
    return np.median(np.nan_to_num(six_each(bars), nan=np.inf), axis=0)


def six_each(bars: Sequence[Sequence[float | None] | None]) -> Floats:
    """Return error bars as an array, shape (n, 6), m and rad; NaN where they are not known."""
    return np.array([one or (None,) * 6 for one in bars], dtype=float)


def _ends(load_range: LoadRange) -> tuple[Floats, Floats]:
    """Return the range's ends, (6,) each, N and N·m, stretched to hold zero as answers count it."""
    return np.minimum(load_range.low, 0.0), np.maximum(load_range.high, 0.0)
