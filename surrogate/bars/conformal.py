"""How much bars must grow to hold a level of the errors that were seen.

Split conformal prediction (Vovk et al. 2005, Lei et al. 2018).
"""

from __future__ import annotations

import math

import numpy as np

from surrogate.table.rows import Floats

LEVEL = 0.95  # of the errors that a bar should hold
CAUTION = 6.0  # a quantile of h errors is enlarged by this over h


def conformal_factor(
    errors: Floats, bars: Floats, level: float = LEVEL, caution: float = CAUTION
) -> Floats:
    """Return, per column, the factor on bars (h, q) that covers a level of the errors (h, q).

    The quantile of their ratios is taken at ceil(level (h + 1)) of h, the largest if h is too
    small for that, and enlarged the more, the fewer there are. It is infinite if too many bars are
    zero where errors are not.
    """
    ratios = np.full(errors.shape, np.inf)
    np.divide(errors, bars, out=ratios, where=bars > 0)
    ratios[errors == 0] = 0.0
    count = len(ratios)
    if not count:
        return np.zeros(errors.shape[1])
    rank = min(math.ceil(level * (count + 1)), count) - 1
    return np.partition(ratios, rank, axis=0)[rank] * (1 + caution / count)
