"""Answers of the numpy law: one, or many."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wrenchbook.surrogate.answer import OUTSIDE
from wrenchbook.surrogate.table.rows import Floats
from wrenchbook.surrogate.table.space import OUTPUT_UNITS, OUTPUTS


class Answer(NamedTuple):
    """The displacement a table gives for one wrench.

    Attributes
    ----------
    displacement : tuple of 6 floats or None, m and rad
        None where there is no row to estimate from.
    error : tuple of 6 floats or None, m and rad
        95 % error bars; None where nothing tells them.
    coverage : str
        "covered", "thin" or "outside".
    reason : str
        Why not covered; empty if covered.
    method : str
        One of `METHODS`, "row" (one row has just this wrench) or "estimate".
    missing : tuple of str
        The outputs, by their names in `OUTPUTS`, that no row tells: None in the other two, and
        no part of what `coverage` says.
    """

    displacement: tuple[float, ...] | None
    error: tuple[float, ...] | None
    coverage: str
    reason: str
    method: str
    missing: tuple[str, ...] = ()


class Batch(NamedTuple):
    """The same for many wrenches.

    Attributes
    ----------
    displacement, error : ndarray, shape (n, 6), m and rad
        NaN where `Answer` has None.
    coverage : ndarray of uint8, shape (n,)
        0 covered, 1 thin, 2 outside.
    """

    displacement: Floats
    error: Floats
    coverage: NDArray[np.uint8]


def over_tolerance(error: Sequence[float], allowed: Sequence[float]) -> str:
    """Return why error bars (6,), m and rad, are over what is allowed (6,), or an empty text."""
    worst, name = 1.0, ""
    for output in range(6):
        if error[output] > worst * allowed[output]:
            worst = error[output] / allowed[output]
            unit = OUTPUT_UNITS[output]
            name = (
                f"the interpolation error of {OUTPUTS[output]}, {error[output]:.2g} {unit}, "
                f"is over the tolerance, {allowed[output]:.2g} {unit}"
            )
    return name


def within(error: Sequence[float], allowed: Sequence[float]) -> bool:
    """Return whether six bars, m and rad, are within what is allowed; NaN is not."""
    a, b, c, d, e, f = error
    u, v, w, x, y, z = allowed
    return a <= u and b <= v and c <= w and d <= x and e <= y and f <= z


def no_answers(count: int) -> Batch:
    """Return so many answers of a table without rows."""
    blank = np.full((count, 6), np.nan)
    return Batch(blank, blank.copy(), np.full(count, OUTSIDE, dtype=np.uint8))
