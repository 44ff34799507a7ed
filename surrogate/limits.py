"""Limits of every displacement: what no row of a table may exceed, and no estimate is given beyond.

An estimate off the rows goes on linearly, so it may be any number; beyond these limits the
small-deformation contract has ended and no such row could ever be in the table.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .answer import COVERED, Answer, Batch
from .table.rows import Floats, Tolerance

ROTATION_LIMIT = math.radians(20.0)
"""Longest rotation vector a table may hold, rad: beyond it the small-deformation contract ends."""

TRANSLATION_LIMIT = 10.0
"""Largest translation a table may hold, m.

A cantilever's tip moves by 2/3 of its length times its tip's turn (u = P L^3 / 3EI, r = P L^2 /
2EI), so within 20 degrees a part has to be 43 m long to move by 10 m: no part of a machine is
refused. A millimetre taken for a metre is noticed from 10 mm on, a micrometre from 10 um on.
"""

BEYOND_LIMITS = (
    f"the estimate leaves what tables may hold, {math.degrees(ROTATION_LIMIT):g} degrees and "
    f"{TRANSLATION_LIMIT:g} m, and is not given"
)

LONGEST = ROTATION_LIMIT * (1.0 + 1e-12)
"""rad: the last bits of a conversion from degrees must not refuse exactly 20 degrees."""


def rotation_angles(displacements: Floats) -> Floats:
    """Return the rotation angles of displacements (n, 6), m and rad: (n,), rad; NaN counts as 0."""
    with np.errstate(over="ignore"):
        return np.sqrt(np.nansum(displacements[:, 3:] ** 2, axis=1))


def is_too_far(angles: Floats) -> NDArray[np.bool_]:
    """Return which rotations, shape (n,), rad, are beyond the limit."""
    return np.asarray(angles > LONGEST)


def beyond_limits(displacements: Floats) -> NDArray[np.bool_]:
    """Return which displacements, (n, 6), m and rad, no table may hold; NaN exceeds nothing."""
    moved = np.abs(displacements[:, :3]) > TRANSLATION_LIMIT
    return np.asarray(moved.any(axis=1) | is_too_far(rotation_angles(displacements)))


def within_limits(answer: Answer) -> Answer:
    """Return an answer, its displacement and bars None if it is an estimate beyond the limits."""
    if answer.coverage == "covered" or not _is_beyond(answer.displacement):
        return answer
    reason = "; ".join(filter(None, (answer.reason, BEYOND_LIMITS)))
    return answer._replace(displacement=None, error=None, reason=reason)


def within_limits_many(found: Batch) -> Batch:
    """Set a batch's displacements and bars to NaN where they are estimates beyond the limits."""
    gone = (found.coverage != COVERED) & beyond_limits(found.displacement)
    found.displacement[gone] = found.error[gone] = np.nan
    return found


class LimitedAnswers:
    """The calls of a table from its estimates, of which those beyond the limits are not given."""

    def estimate(
        self,
        wrench: Sequence[float],
        tolerance: Tolerance | None = None,
        method: str | None = None,
    ) -> Answer:
        """Return `answer` to a wrench (6,), N and N·m, with estimates beyond the limits too."""
        raise NotImplementedError

    def estimates(
        self,
        wrenches: ArrayLike,
        tolerance: Tolerance | None = None,
        method: str | None = None,
    ) -> Batch:
        """Return `batch` of wrenches (n, 6), N and N·m, with estimates beyond the limits too."""
        raise NotImplementedError

    def answer(
        self,
        wrench: Sequence[float],
        tolerance: Tolerance | None = None,
        method: str | None = None,
    ) -> Answer:
        """Answer one wrench of six finite floats, N and N·m.

        Raises
        ------
        UnknownMethodError
            If the method is none of `METHODS`.
        """
        return within_limits(self.estimate(wrench, tolerance, method))

    def batch(
        self,
        wrenches: ArrayLike,
        tolerance: Tolerance | None = None,
        method: str | None = None,
    ) -> Batch:
        """Answer many wrenches, shape (n, 6), N and N·m, with the same numbers as `answer`.

        Raises
        ------
        UnknownMethodError
            If the method is none of `METHODS`.
        """
        return within_limits_many(self.estimates(wrenches, tolerance, method))


def _is_beyond(displacement: Sequence[float | None] | None) -> bool:
    """Return `beyond_limits` of one displacement (6,), m and rad; None exceeds nothing."""
    if displacement is None:
        return False
    known = [0.0 if amount is None or amount != amount else amount for amount in displacement]
    x, y, z = known[3:]
    angle = math.sqrt(x * x + y * y + z * z)
    return max(map(abs, known[:3])) > TRANSLATION_LIMIT or angle > LONGEST
