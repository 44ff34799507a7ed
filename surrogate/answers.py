"""What a surrogate says: one answer, or many."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrogate.coverage import over_tolerance
from surrogate.rows import Floats, Tolerance

COMPOSED = ("tangent", "rbf", "corrected", "auto")  # read where griddata is covered
METHODS = ("griddata", *COMPOSED, "linear", "nearest")


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
    """

    displacement: tuple[float, ...] | None
    error: tuple[float, ...] | None
    coverage: str
    reason: str
    method: str


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


def judged(
    displacement: tuple[float, ...],
    error: tuple[float, ...],
    tolerance: Tolerance | None,
    method: str,
) -> Answer:
    """Return a covered answer, or a thin one if its error bars are over the tolerance."""
    reason = over_tolerance(error, tolerance) if tolerance is not None else ""
    return Answer(displacement, error, "thin" if reason else "covered", reason, method)
