"""Limits of every displacement: what no row of a table may exceed, and no estimate is given beyond.

An estimate off the rows goes on linearly, so it may be any number; beyond these limits the
small-deformation contract has ended and no such row could ever be in the table.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .table.rows import Floats

ROTATION_LIMIT = math.radians(20.0)
"""Longest rotation vector a table may hold, rad: beyond it the small-deformation contract ends."""

TRANSLATION_LIMIT = 10.0
"""Largest translation a table may hold, m.

A cantilever's tip moves by 2/3 of its length times its rotation (u = P L^3 / 3EI, r = P L^2 /
2EI), so within 20 degrees a part has to be 43 m long to move by 10 m: no part of a machine is
refused. A millimetre taken for a metre is noticed from 10 mm on, a micrometre from 10 um on.
"""

LONGEST = ROTATION_LIMIT * (1.0 + 1e-12)
"""rad: the last bits of a conversion from degrees must not refuse exactly 20 degrees."""


def rotation_angles(displacements: Floats) -> Floats:
    """Return the rotation angles of displacements (n, 6), m and rad: (n,), rad; NaN counts as 0."""
    with np.errstate(over="ignore"):
        return np.sqrt(np.nansum(displacements[:, 3:] ** 2, axis=1))


def is_too_far(angles: Floats) -> NDArray[np.bool_]:
    """Return which rotations, shape (n,), rad, are beyond the limit."""
    return np.asarray(angles > LONGEST)
