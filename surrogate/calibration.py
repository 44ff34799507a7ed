"""The width of error bars, from the errors at points that were left out.

Axes, kriging, compliance and deformed surfaces predict an error in different ways; the quantile
that holds a level of errors over predictions, and its uncertainty with few points, are here.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

Floats = NDArray[np.float64]

LEVEL = 0.95  # what bars are meant to hold; at least 0.9 is then held on rows not in the table
# Probability that an error is no larger than few points show. Of 30 random solves, nine responses,
# seeds 100 and 101 (`make bench NAME=bars`), the kriging's worst output has 81, 84, 86 and
# 88 % inside with confidences of 0.5, 0.8, 0.95 and 0.99; median bars are 4.6, 4.8, 5.1 and 5.5 x
# the errors.
CONFIDENCE = 0.95


def quantile(ratios: Floats, weights: Floats | None = None) -> float:
    """Return the weighted conformal quantile of ratios (k,) at `LEVEL`.

    Split conformal prediction (Vovk, Gammerman and Shafer 2005; Lei et al. 2018): at equal weights
    the ratio number ceil(level (k + 1)) of k; the largest where k is too small for that.
    """
    order = np.argsort(ratios)
    total = np.cumsum(np.ones(len(ratios)) if weights is None else weights[order])
    index = int(np.searchsorted(total, LEVEL * (total[-1] + 1)))
    return float(ratios[order][min(index, len(ratios) - 1)])


def widening(freedom: Floats | float, outputs: int = 1) -> Floats:
    """Return the factor by which errors may exceed those of so many degrees of freedom.

    The factor of normal tolerance intervals, sqrt(f / chi2_a(f)): with it an interval holds its
    content at confidence 1 - a, the centre being known (Krishnamoorthy and Mathew 2009,
    "Statistical Tolerance Regions"). With several outputs the confidence is for all of them
    (Bonferroni).
    """
    half = np.asarray(freedom) / 2
    return np.sqrt(half / gammaincinv(half, (1 - CONFIDENCE) / outputs))


def common_quantile(ratios: Floats, sizes: Floats, weights: Floats | None = None) -> float:
    """Return the `quantile` of ratios (k, q) over their outputs' sizes (q,), all outputs together.

    Alone, the largest of ten ratios of an output is small by chance in every fourth table (on five
    made-up responses 20 % of the tables of 30 rows held less than 0.9, with all together 8 %). An
    output of size zero does not count, unless all are.
    """
    varying = sizes > 0 if (sizes > 0).any() else np.ones_like(sizes, dtype=bool)
    scaled = ratios[:, varying] / np.where(sizes[varying] > 0, sizes[varying], 1.0)
    return quantile(scaled.ravel(), None if weights is None else weights.repeat(scaled.shape[1]))


def conformal_factor(ratios: Floats) -> Floats:
    """Return per output the factor on predicted errors that holds a level of errors, shape (q,).

    `ratios` (h, q) are errors over predicted errors at h points. Each output is by itself, and each
    point is one degree of freedom. Zero without points.
    """
    if not len(ratios):
        return np.zeros(ratios.shape[1])
    return np.array([quantile(column) for column in ratios.T]) * widening(len(ratios))
