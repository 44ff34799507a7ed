"""What the sums of a kriging lose to rounding: the digits that no two computers share.

A kriging of a smooth response has long length scales, a covariance that is nearly singular, and
weights up to 1e8 times what they sum to; each covariance is rounded in the last place, and so is
each product. Nothing physical is lost: sigma is nowhere below the root of the nugget, which leaves
the rounding below a thousandth of the bar. But a bar must not be less than it, whatever the
conformal factor.
"""

from __future__ import annotations

import numpy as np

from ..table.rows import Floats
from .equations import Equations

# What one covariance times one weight may lose, relative: its squared distance, root, exponential
# and polynomial some units in the last place each. The errors have either sign: sums of compiled
# code and of arrays were apart by up to 2.1 eps times the sum of magnitudes.
LOST = 4 * float(np.finfo(float).eps)


def rounding_of(equations: Equations, table: Floats, weights: Floats) -> Floats:
    """Return what answers may lose to rounding, shape (6,), spreads.

    Parameters
    ----------
    table : ndarray, shape (e, e), dimensionless
        The covariance of all e equations.
    weights : ndarray, shape (n, 7, 6), spreads
    """
    values = np.zeros_like(equations.known)
    values[:, 0] = True
    across = table[values[equations.known]]
    return LOST * (np.abs(across) @ np.abs(weights[equations.known])).max(axis=0)
