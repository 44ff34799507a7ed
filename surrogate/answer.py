"""Names of methods and coverage, and what tolerances allow."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .table.rows import OUTPUT_UNITS, OUTPUTS, Floats, Tolerance

COVERED, THIN, OUTSIDE = 0, 1, 2
NAMES = ("covered", "thin", "outside")
METHODS = ("griddata", "additive", "kriging", "linear", "nearest", "tangent")


class UnknownMethodError(ValueError):
    """A method that the table does not have; the text says which there are."""

    def __init__(self, method: str, why: str = "") -> None:
        super().__init__(why or f"unknown method {method!r}: one of {', '.join(METHODS)}")


def over_tolerance(error: Sequence[float], allowed: Sequence[float]) -> str:
    """Return why error bars (6,), m and rad, are over what is allowed (6,), or an empty text."""
    worst, name = 1.0, ""
    for output in range(6):
        if error[output] > worst * allowed[output]:
            worst = error[output] / allowed[output]
            unit = OUTPUT_UNITS[output]
            name = (
                f"the error bar of {OUTPUTS[output]}, {error[output]:.2g} {unit}, "
                f"is over the tolerance, {allowed[output]:.2g} {unit}"
            )
    return name


def allowed_by(tolerance: Tolerance) -> tuple[float, ...]:
    """Return the largest error bar of each output, shape (6,), m and rad."""
    return (tolerance.translation,) * 3 + (tolerance.rotation,) * 3


def six(tolerance: Tolerance | None) -> tuple[float, ...] | None:
    """Return the largest error of each output by a tolerance, (6,), m and rad; None without."""
    return None if tolerance is None else allowed_by(tolerance)


def within_tolerance(
    bars: Sequence[float | None] | None, tolerance: Tolerance | None
) -> bool | None:
    """Return whether the whole bars of an answer, six, m and rad, are within a tolerance.

    Coverage asks that of the table's share alone, which more rows lower; this is of the bar that is
    told, the solver's share included. An output without a bar (None) has nobody measured; None
    where no output has one, or there is no tolerance.
    """
    if bars is None or tolerance is None:
        return None
    if None in bars:
        pairs = zip(bars, allowed_by(tolerance), strict=True)
        known = [bar <= most for bar, most in pairs if bar is not None]
        return all(known) if known else None
    a, b, c, d, e, f = bars
    most, turn = tolerance.translation, tolerance.rotation
    return a <= most and b <= most and c <= most and d <= turn and e <= turn and f <= turn  # pyright: ignore[reportOptionalOperand, reportReturnType]


def within_tolerance_many(bars: Floats, tolerance: Tolerance | None) -> list[bool | None] | None:
    """Return `within_tolerance` of bars (n, 6), m and rad, NaN where there is none."""
    if tolerance is None:
        return None
    unknown = np.isnan(bars)
    within_all = np.all(unknown | (bars <= np.array(allowed_by(tolerance))), axis=1)
    none_known = np.all(unknown, axis=1)
    pairs = zip(none_known.tolist(), within_all.tolist(), strict=True)
    return [None if blank else held for blank, held in pairs]
