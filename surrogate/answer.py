"""Names of methods and coverage, and the error that a covered answer may have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .table.rows import Floats, Rows, Tolerance

COVERED, THIN, OUTSIDE = 0, 1, 2
NAMES = ("covered", "thin", "outside")
# In the order of their numbers in surrogate/kernel/wrenchbook.h.
METHODS = ("griddata", "additive", "tangent", "kriging", "linear", "nearest")
ANSWERED = (*METHODS, "row", "estimate")  # what a reply may name

WITHOUT_TOLERANCE = 0.01  # of an output's variation, where neither request nor component has one
# Of the largest variation of its kind (translations, rotations): an output that varies by less is
# rounding, and a hundredth of that would leave nothing covered.
STILL = 1e-6


class UnknownMethodError(ValueError):
    """A method that the table does not have; the text says which there are."""

    def __init__(self, method: str, why: str = "") -> None:
        super().__init__(why or f"unknown method {method!r}: one of {', '.join(METHODS)}")


def allowed_by(tolerance: Tolerance) -> tuple[float, ...]:
    """Return the largest error bar of each output, shape (6,), m and rad."""
    return (tolerance.translation,) * 3 + (tolerance.rotation,) * 3


def six(tolerance: Tolerance | None) -> tuple[float, ...] | None:
    """Return the largest error of each output by a tolerance, (6,), m and rad; None without."""
    return None if tolerance is None else allowed_by(tolerance)


def within_tolerance_many(bars: Floats, tolerance: Tolerance | None) -> list[bool | None] | None:
    """Return whether total error bars (n, 6), m and rad, are within a tolerance, as the kernel.

    An output without an error bar, NaN, counts for nothing; None where no output has one, and as a
    whole without a tolerance.
    """
    if tolerance is None:
        return None
    unknown = np.isnan(bars)
    within_all = np.all(unknown | (bars <= np.array(allowed_by(tolerance))), axis=1)
    none_known = np.all(unknown, axis=1)
    pairs = zip(none_known.tolist(), within_all.tolist(), strict=True)
    return [None if blank else within for blank, within in pairs]


@dataclass(frozen=True)
class Allowed:
    """The largest interpolation errors of covered answers.

    Attributes
    ----------
    tolerance : Tolerance or None, m and rad
        The component's own.
    variation : ndarray, shape (6,), m and rad
        Largest less smallest value of each output over the rows.
    ranges : ndarray, shape (6,), m and rad
        The same with zero counted as one of the values.
    outputs : tuple of int
        The outputs that count; any error of the others is allowed.
    """

    tolerance: Tolerance | None
    variation: Floats
    ranges: Floats
    outputs: tuple[int, ...]

    def of(self, tolerance: Tolerance | None) -> Sequence[float]:
        """Return the largest error of each output, shape (6,), m and rad, for a covered answer."""
        limit = tolerance or self.tolerance
        found = self._by_variation if limit is None else allowed_by(limit)
        if len(self.outputs) == 6:
            return found
        return [found[output] if output in self.outputs else np.inf for output in range(6)]

    @cached_property
    def _by_variation(self) -> list[float]:
        largest = np.repeat(self.variation.reshape(2, 3).max(axis=1), 3)
        varies = np.maximum(self.variation, STILL * largest)
        # A kind of output that nothing moves has no variation to take a part of.
        return np.where(varies > 0, WITHOUT_TOLERANCE * varies, np.inf).tolist()


def allowed_of(
    rows: Rows, tolerance: Tolerance | None, outputs: tuple[int, ...] = tuple(range(6))
) -> Allowed:
    """Return what is allowed of some outputs of a table whose answers are made of these rows."""
    moved = rows.displacement
    if not len(moved):
        return Allowed(tolerance, np.zeros(6), np.zeros(6), outputs)
    low, high = moved.min(axis=0), moved.max(axis=0)
    ranges = np.maximum(high, 0.0) - np.minimum(low, 0.0)
    return Allowed(tolerance, high - low, ranges, outputs)
