"""The compliance at no load of measured rows, with its uncertainty, whatever the response's bend.

Readings of an output are a Gaussian process of the loads with a linear mean, noise, and what may
be confused with a slope there: a drift with time, a loop by the direction of the motion, and a jump
of clearance where a load changes its sign. Given a kernel with K = U L U' and noise v, with D = 1 /
(L + v), B = U' times the mean's columns, k = U' times the covariance of readings and slopes at no
load, whose prior covariance is P (Morris, Mitchell and Ylvisaker 1993),

    b = (B' D B)^-1 B' D U' y,   slopes = E b + k' D (U' y - B b),
    covariance s^2 (P - k' D k + R' (B' D B)^-1 R),   R = E' - B' D k,

averaged over kernels and noise by their restricted likelihood (Patterson and Thompson 1971), so
that what a response may do between the rows is not taken for its slope.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..kriging.correlation import Hyperparameters, covariance
from ..kriging.equations import evenly
from ..table.rows import ZERO_LOAD, Floats, LoadRange, Rows
from .response import RobustFit

SAMPLE = 300  # rows: slopes are known to a tenth of the noise of a reading, in half a second
# Kernels: lengths in half ranges are exp(-theta / 2), weights those of the term of all loads.
KERNELS = tuple((theta, weight) for theta in (1.4, 0.0, -1.4, -2.8) for weight in (-3.0, 1.0))
RATIOS = np.exp(np.arange(-14.0, 8.0))  # noise over process variance
STEP = 0.05  # of the largest usual step of an output: smaller steps have no direction
PRIOR = 1e3  # deviations of the readings: of coefficients of the mean; wide, and finite


class Slopes(NamedTuple):
    """Slopes and jumps of rows at no load."""

    matrix: Floats  # (6, 6), SI: compliance; row output, column load. 0 where it is not known.
    # (6, 6, 6), SI: of each output's row of `matrix`; 0 where that is 0, or exact
    covariance: Floats
    # jump, deviation: (6,), m and rad: how far each output jumps where its own load changes its
    # sign, and the deviation of that
    jump: Floats
    deviation: Floats


def slopes_at_zero(rows: Rows, load_range: LoadRange, response: RobustFit) -> Slopes:
    """Return the compliance at no load of rows in the order of their measurement."""
    chosen = evenly(len(rows), SAMPLE)
    wrench = rows.wrench[chosen] / load_range.scale
    time = np.linspace(-0.5, 0.5, len(rows))[chosen]
    estimate, spread = np.zeros((6, 12)), np.zeros((6, 12, 12))
    known = np.isfinite(rows.displacement[chosen])
    for pattern in np.unique(known, axis=1).T:
        outputs = np.flatnonzero((known == pattern[:, None]).all(axis=0))
        if not pattern.any():
            continue
        x, y = wrench[pattern], rows.displacement[np.ix_(chosen[pattern], outputs)]
        signs = np.sign(np.where(np.abs(x) > ZERO_LOAD, x, 0.0))
        columns = []
        for output in outputs:
            loop = _directions(response.expected[:, output])[chosen[pattern]]
            load = x[:, output]  # a cubic response and one of 5th degree are no jump
            beside = np.ones(len(x)), time[pattern], loop, load**3, load**5
            columns.append(np.column_stack((x, signs, *beside)))
        size = np.maximum(y.std(axis=0), np.finfo(float).tiny)
        mean, covariances = _averaged(x, (y - y.mean(axis=0)) / size, columns)
        estimate[outputs] = mean * size[:, None]
        spread[outputs] = covariances * size[:, None, None] ** 2
    scale, diagonal = load_range.scale, np.arange(6)
    estimate[:, :6][:, ~(np.ptp(wrench, axis=0) > ZERO_LOAD)] = 0.0
    deviation = 2 * np.sqrt(spread[diagonal, 6 + diagonal, 6 + diagonal])
    matrix, covariances = estimate[:, :6] / scale, spread[:, :6, :6] / np.outer(scale, scale)
    return Slopes(matrix, covariances, 2 * estimate[diagonal, 6 + diagonal], deviation)


def _directions(expected: Floats) -> Floats:
    """Return the sign of an output's change from the row before, (n,); 0 where it rests."""
    if not len(expected):
        return expected
    steps = np.diff(expected, prepend=expected[0])
    usual = np.percentile(np.abs(steps), 90)
    return np.where(np.abs(steps) > STEP * usual, np.sign(steps), 0.0)


def _averaged(x: Floats, y: Floats, columns: list[Floats]) -> tuple[Floats, Floats]:
    """Return the mean of slopes and jumps, (k, 12), and their covariance, (k, 12, 12).

    Of readings (n, k) at scaled loads (n, 6), with the columns (n, c) of each output's mean.
    """
    n, count = len(x), columns[0].shape[1]
    value, slopes = np.ones((n, 1), dtype=bool), np.ones((1, 7), dtype=bool)
    slopes[:, 0] = False
    origin, picked = np.zeros((1, 6)), np.eye(count)[:12]  # E: the columns begin with these 12
    shape = len(KERNELS), len(RATIOS), y.shape[1]
    likelihood, means = np.empty(shape), np.empty((*shape, 12))
    squares = np.empty((*shape, 12, 12))
    for at, (theta, weight) in enumerate(KERNELS):
        kernel = Hyperparameters.of_logarithms(np.array([theta] * 6 + [weight]))
        roots, vectors = np.linalg.eigh(covariance(x, value, x, value, kernel))
        inverse = 1 / (np.maximum(roots, 0.0) + RATIOS[:, None])
        across, prior = np.zeros((n, 12)), np.zeros((12, 12))
        across[:, :6] = vectors.T @ covariance(x, value, origin, slopes, kernel)
        prior[:6, :6] = covariance(origin, slopes, origin, slopes, kernel)
        for output, of_mean in enumerate(columns):
            # Products (B, k, U' y)' D (B, k, U' y) for every noise at once; `b`, `k` and -1 are
            # the places of the three.
            factors = np.column_stack((vectors.T @ of_mean, across, vectors.T @ y[:, output]))
            products = (factors[:, :, None] * factors[:, None]).reshape(n, -1)
            weighted = (inverse @ products).reshape(len(RATIOS), *[factors.shape[1]] * 2)
            b, k = slice(0, count), slice(count, count + 12)
            normal = weighted[:, b, b] + np.eye(count) / PRIOR**2
            covariances = np.linalg.inv(normal)
            estimate = np.einsum("rab,rb->ra", covariances, weighted[:, b, -1])
            residual = weighted[:, -1, -1] - (estimate * weighted[:, b, -1]).sum(axis=1)
            variance = np.maximum(residual, np.finfo(float).tiny) / max(n - count, 1)
            logarithms = np.linalg.slogdet(normal)[1] - np.log(inverse).sum(axis=1)
            likelihood[at, :, output] = 0.5 * ((n - count) * np.log(variance) + logarithms)
            by_mean = picked - weighted[:, k, b]  # R'
            mean = weighted[:, k, -1] + np.einsum("rkb,rb->rk", by_mean, estimate)
            spread = prior - weighted[:, k, k]
            spread = spread + by_mean @ covariances @ by_mean.transpose(0, 2, 1)
            means[at, :, output] = mean
            squares[at, :, output] = variance[:, None, None] * spread
            squares[at, :, output] += mean[:, :, None] * mean[:, None]
    weights = np.exp(likelihood.min(axis=(0, 1)) - likelihood)
    weights /= weights.sum(axis=(0, 1))
    mean = np.einsum("kro,kroe->oe", weights, means)
    square = np.einsum("kro,kroef->oef", weights, squares)
    return mean, square - mean[:, :, None] * mean[:, None]
