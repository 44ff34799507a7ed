"""Names of methods and coverage, and the error that a covered answer may have."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .table.rows import Floats, Rows, Tolerance
from .table.space import DEFAULT, Space

COVERED, THIN, OUTSIDE = 0, 1, 2
NAMES = ("covered", "thin", "outside")
# In the order of their numbers in surrogate/kernel/wrenchbook.h.
METHODS = ("griddata", "additive", "kriging", "linear")
BY_AXES = METHODS[:2]  # exist for one wrench at one interface alone
ANSWERED = (*METHODS, "row", "estimate")  # what a reply may name

WITHOUT_TOLERANCE = 0.01  # of an output's variation, where neither request nor component has one
# Of the largest variation of its kind (translations, rotations): an output that varies by less is
# rounding, and a hundredth of that would leave nothing covered.
MIN_VARIATION = 1e-6


class UnknownMethodError(ValueError):
    """A method that the table does not have; the text says which there are."""

    def __init__(self, method: str, why: str = "") -> None:
        super().__init__(why or f"unknown method {method!r}: one of {', '.join(METHODS)}")


def allowed_by(tolerance: Tolerance, space: Space = DEFAULT) -> tuple[float, ...]:
    """Return the largest error bar of each output, shape (m,), m and rad."""
    limits = {"m": tolerance.translation, "rad": tolerance.rotation}
    return tuple(limits[output.unit] for output in space.outputs)


def bars_within(outputs: Floats, bars: Floats, allowed: ArrayLike) -> NDArray[np.bool_]:
    """Return whether total error bars (n, m) are within the allowed ones (m,), m and rad: (n,).

    The kernel's law: an output without a value, NaN, does not count; false where that is not known,
    as a value has no error bar, or no output has one.
    """
    absent = np.isnan(outputs) & np.isnan(bars)
    return np.all(absent | (bars <= np.asarray(allowed)), axis=1) & ~absent.all(axis=1)


def within_tolerance_many(outputs: Floats, bars: Floats, tolerance: Tolerance) -> list[bool | None]:
    """Return `bars_within` a tolerance as JSON has it: None where it is not known."""
    allowed = np.resize(allowed_by(tolerance), bars.shape[1])
    within = bars_within(outputs, bars, allowed)
    known = within | (bars > allowed).any(axis=1)
    return [bool(inside) if sure else None for inside, sure in zip(within, known, strict=True)]


def limits_of(rows: Rows, tolerance: Tolerance | None, outputs: Sequence[int]) -> Floats:
    """Return the largest interpolation error of each output, (m,), m and rad, of covered answers.

    By a tolerance, or without by the variation of the output over the rows that the answers are
    made of. Of `outputs` alone: any error of the others is allowed.
    """
    space = rows.space
    if tolerance is not None:
        limits = np.array(allowed_by(tolerance, space))
    else:
        moved = rows.displacement if len(rows) else np.zeros((1, len(space.outputs)))
        variation = np.ptp(moved, axis=0)
        varies = np.maximum(variation, MIN_VARIATION * space.largest_of_kind(variation))
        # A kind of output that nothing moves has no variation to take a part of.
        limits = np.where(varies > 0, WITHOUT_TOLERANCE * varies, np.inf)
    return np.where(np.isin(np.arange(len(limits)), outputs), limits, np.inf)
