"""Names of methods and coverage, and the largest error bar of a covered answer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .table.rows import Floats, Rows, Tolerance
from .table.space import DEFAULT, Space

COVERED, THIN, OUTSIDE = 0, 1, 2
NAMES = ("covered", "thin", "outside")
# The position of a name is its number in surrogate/kernel/wrenchbook.h.
METHODS = ("griddata", "additive", "kriging", "linear")
BY_AXES = METHODS[:2]  # methods defined only for components of one interface without further inputs
ANSWERED = (*METHODS, "row", "estimate")  # every method that a reply may name

# Part of an output's variation; used where neither request nor component states a tolerance.
WITHOUT_TOLERANCE = 0.01
# Part of the largest variation of a kind of output (translations, rotations). An output that varies
# by less varies by rounding, and WITHOUT_TOLERANCE times its variation would leave no answer
# covered.
MIN_VARIATION = 1e-6


class UnknownMethodError(ValueError):
    """A method that the table does not have; the message lists the methods that it has."""

    def __init__(self, method: str, why: str = "") -> None:
        super().__init__(why or f"unknown method {method!r}: one of {', '.join(METHODS)}")


def allowed_by(tolerance: Tolerance, space: Space = DEFAULT) -> tuple[float, ...]:
    """Return the largest error bar of each output, shape (m,), m and rad."""
    limits = {"m": tolerance.translation, "rad": tolerance.rotation}
    return tuple(limits[output.unit] for output in space.outputs)


def bars_within(outputs: Floats, bars: Floats, allowed: ArrayLike) -> NDArray[np.bool_]:
    """Return which total error bars (n, m), m and rad, are within the allowed ones (m,): (n,).

    This is the kernel's rule: an output whose value is NaN does not count. The result is False
    where a value has no error bar, or where no output has one.
    """
    absent = np.isnan(outputs) & np.isnan(bars)
    return np.all(absent | (bars <= np.asarray(allowed)), axis=1) & ~absent.all(axis=1)


def within_tolerance_many(outputs: Floats, bars: Floats, tolerance: Tolerance) -> list[bool | None]:
    """Return the result of `bars_within` per answer for JSON: None where it cannot be decided."""
    allowed = np.resize(allowed_by(tolerance), bars.shape[1])
    within = bars_within(outputs, bars, allowed)
    known = within | (bars > allowed).any(axis=1)
    return [bool(inside) if sure else None for inside, sure in zip(within, known, strict=True)]


def limits_of(rows: Rows, tolerance: Tolerance | None, outputs: Sequence[int]) -> Floats:
    """Return the largest interpolation error of each output, (m,), m and rad, of covered answers.

    The limit is the tolerance, or without one a part of the output's variation over `rows`. Outputs
    other than `outputs` have no limit (infinite).
    """
    space = rows.space
    if tolerance is not None:
        limits = np.array(allowed_by(tolerance, space))
    else:
        moved = rows.displacement if len(rows) else np.zeros((1, len(space.outputs)))
        variation = np.ptp(moved, axis=0)
        # A kind of output that does not vary, as in a single row, has its largest displacement.
        still = space.largest_of_kind(variation) == 0
        largest = space.largest_of_kind(np.abs(moved).max(axis=0))
        variation = np.where(still, largest, variation)
        varies = np.maximum(variation, MIN_VARIATION * space.largest_of_kind(variation))
        # An output whose kind does not move at all has no variation to take a part of.
        limits = np.where(varies > 0, WITHOUT_TOLERANCE * varies, np.inf)
    return np.where(np.isin(np.arange(len(limits)), outputs), limits, np.inf)
