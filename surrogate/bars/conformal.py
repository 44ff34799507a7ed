"""The conformal factor: by how much to multiply deviations so that they hold a level of errors."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LEVEL = 0.95  # what bars are meant to hold; at least 0.9 is then held on rows not in the table
# A quantile of h errors is uncertain by about 1 / h of itself; six times that keeps bars from 15
# errors above 0.9 in nine of ten tables (`make bench NAME=calibration`).
CAUTION = 6.0


def conformal_factor(errors: Floats, deviations: Floats, level: float = LEVEL) -> Floats:
    """Return, per output, the factor on deviations (h, q) that holds a level of errors (h, q).

    Split conformal prediction (Vovk, Gammerman and Shafer 2005; Lei et al. 2018): the quantile of
    their ratios at ceil(level (h + 1)) of h, the largest if h is too small for that, enlarged the
    more, the fewer there are. It is infinite if too many deviations are zero where errors are not,
    and zero without errors. Shape (q,), dimensionless where both are in one unit, such as m and
    rad.
    """
    ratios = np.full(errors.shape, np.inf)
    np.divide(errors, deviations, out=ratios, where=deviations > 0)
    ratios[errors == 0] = 0.0
    count = len(ratios)
    if not count:
        return np.zeros(errors.shape[1])
    rank = min(math.ceil(level * (count + 1)), count) - 1
    return np.partition(ratios, rank, axis=0)[rank] * (1 + CAUTION / count)
