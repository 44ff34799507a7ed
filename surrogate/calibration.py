"""The width of error bars, from the errors at points that were left out.

Axes, kriging, compliance and deformed surfaces predict an error in different ways. This module has
the quantile of errors over predicted errors that holds a level, and its uncertainty with few
points.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

Floats = NDArray[np.float64]

# Level that bars are built to hold, so that at least 0.9 holds on rows not in the table.
LEVEL = 0.95
# Probability that an error is no larger than few points show. Of 30 random solves, nine responses,
# seeds 100 and 101 (`make bench NAME=bars`), the kriging's worst output has 81, 84, 86 and
# 88 % inside with confidences of 0.5, 0.8, 0.95 and 0.99; median bars are 4.6, 4.8, 5.1 and 5.5 x
# the errors.
CONFIDENCE = 0.95


def quantile(ratios: Floats) -> float:
    """Return the conformal quantile of ratios (k,) at `LEVEL`.

    Split conformal prediction (Vovk, Gammerman and Shafer 2005; Lei et al. 2018): the ratio
    number ceil(level (k + 1)) of k; the largest where k is too small for that.
    """
    index = math.ceil(LEVEL * (len(ratios) + 1)) - 1
    return float(np.sort(ratios)[min(index, len(ratios) - 1)])


def widening(freedom: Floats | float, outputs: int = 1) -> Floats:
    """Return the factor by which errors may exceed those seen with `freedom` degrees of freedom.

    The factor of normal tolerance intervals, sqrt(f / chi2_a(f)): with it an interval holds its
    content at confidence 1 - a, the centre being known (Krishnamoorthy and Mathew 2009,
    "Statistical Tolerance Regions"). With several outputs the confidence is for all of them
    (Bonferroni).
    """
    half = np.asarray(freedom) / 2
    return np.sqrt(half / gammaincinv(half, (1 - CONFIDENCE) / outputs))


def common_quantile(ratios: Floats, sizes: Floats) -> float:
    """Return the `quantile` of ratios (k, q) over their outputs' sizes (q,), all outputs together.

    For a single output, the largest of ten ratios is small by chance in every fourth table: on five
    synthetic responses 20 % of the tables of 30 rows held less than 0.9, with all outputs together
    8 %. An output of size zero does not count, unless all sizes are zero.
    """
    varying = sizes > 0 if (sizes > 0).any() else np.ones_like(sizes, dtype=bool)
    scaled = ratios[:, varying] / np.where(sizes[varying] > 0, sizes[varying], 1.0)
    return quantile(scaled.ravel())


def conformal_factor(ratios: Floats) -> Floats:
    """Return the factor (q,) on predicted errors that holds a level of errors, for each output.

    `ratios` (h, q) are errors over predicted errors at h points. Each output is calibrated alone,
    and each point is one degree of freedom. The factor is zero without points.
    """
    if not len(ratios):
        return np.zeros(ratios.shape[1])
    return np.array([quantile(column) for column in ratios.T]) * widening(len(ratios))
