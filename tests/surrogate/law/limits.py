"""Estimates beyond the limits of a table are not given."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tests.surrogate.law.answer import Answer, Batch
from wrenchbook.surrogate.answer import COVERED
from wrenchbook.surrogate.table.rows import (
    LONGEST,
    ROTATION_LIMIT,
    TRANSLATION_LIMIT,
    Floats,
    rotation_angles,
)

BEYOND_LIMITS = (
    f"the estimate leaves what tables may hold, {math.degrees(ROTATION_LIMIT):g} degrees and "
    f"{TRANSLATION_LIMIT:g} m, and is not given"
)


def beyond_limits(displacements: Floats) -> np.ndarray:
    """Return which displacements, (n, 6), m and rad, no table may hold; NaN exceeds nothing."""
    moved = np.abs(displacements[:, :3]) > TRANSLATION_LIMIT
    return np.asarray(moved.any(axis=1) | (rotation_angles(displacements) > LONGEST))


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


def _is_beyond(displacement: Sequence[float | None] | None) -> bool:
    """Return `beyond_limits` of one displacement (6,), m and rad; None exceeds nothing."""
    if displacement is None:
        return False
    known = [0.0 if amount is None or amount != amount else amount for amount in displacement]
    x, y, z = known[3:]
    angle = math.sqrt(x * x + y * y + z * z)
    return max(map(abs, known[:3])) > TRANSLATION_LIMIT or angle > LONGEST
