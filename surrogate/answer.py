"""Names of methods and coverage, and what tolerances allow."""

from __future__ import annotations

import numpy as np

from .table.rows import Floats, Tolerance

COVERED, THIN, OUTSIDE = 0, 1, 2
NAMES = ("covered", "thin", "outside")
METHODS = ("griddata", "additive", "kriging", "linear", "nearest", "tangent")


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
    return [None if blank else held for blank, held in pairs]
