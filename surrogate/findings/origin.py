"""The compliance at zero load of measured rows, with its uncertainty, for any curvature.

The readings y of an output, (n,), are a Gaussian process of the loads with a linear mean, noise,
and further terms of the mean that could be taken for a slope at zero load: a drift with time, a
loop by the direction of the motion, and a jump (of a clearance) where a load changes its sign. With
the kernel K = U L U', the noise v, D = 1 / (L + v), B = U' times the terms of the mean at the
readings, k = U' times the covariance of the readings and the slopes at zero load, whose prior
covariance is P, and E the terms of the mean that are slopes or jumps (Morris, Mitchell and
Ylvisaker 1993),

    b = (B' D B)^-1 B' D U' y,   slopes = E b + k' D (U' y - B b),
    covariance s^2 (P - k' D k + R' (B' D B)^-1 R) + Q,   R = E' - B' D k.

In directions that the readings do not determine, as where a load has few levels, b is 0, and Q has
a deviation by the range of the readings, whatever their noise s. The result is the average over
kernels and noises, weighted by their restricted likelihood (Patterson and Thompson 1971). So
curvature between the rows widens the uncertainty of a slope.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..kriging.correlation import (
    Hyperparameters,
    covariance,
    covariances_of_values,
    weighted_products,
)
from ..kriging.effects import INVERSE_SQUARES
from ..kriging.equations import evenly
from ..table.rows import ZERO_LOAD, Floats, LoadRange, Rows
from ..table.space import DEFAULT
from .response import RobustFit

# Rows used: they determine slopes to a tenth of the noise of a reading, in half a second.
MAX_ROWS = 300
# Variance of the term of all loads over that of a load group: a weak and a strong coupling.
JOINT_WEIGHTS = np.exp([-3.0, 1.0])
RATIOS = np.exp(np.arange(-14.0, 8.0))  # noise over process variance: from 1e-6 to 1e3
USUAL_STEP = 90  # percentile of an output's changes from row to row that counts as its usual step
MIN_STEP = 0.05  # part of the usual step: smaller steps have no sure direction
# Deviation of a direction of the terms that the readings do not determine, in ranges of them: the
# largest load may move the output by twice the range seen.
PRIOR = 2.0
# Part of the largest singular value of the terms: smaller ones are the scatter of repeated levels.
DETERMINED = 1e-3
EXACT = 1e-9  # part of an output's range: smaller deviations are rounding
# Degrees of freedom that must remain for a noise: the variance of Student's t is finite above 2.
MIN_FREEDOM = 3
N_SLOPES = 12  # coefficients of an output: slopes of six loads, then their jumps


class Slopes(NamedTuple):
    """Slopes and jumps of rows at zero load."""

    matrix: Floats  # (6, 6), SI: compliance; row output, column load; 0 where unknown
    # (6, 6, 6), SI: covariance of each output's row of `matrix`. For a load that the rows do not
    # vary it has the prior's width, so that no check takes the 0 in `matrix` for a known slope; 0
    # for an output that was not measured.
    covariance: Floats
    jump: Floats  # (6,), m and rad: jump of each output where its own load changes its sign
    # (6,), m and rad: standard deviation of `jump`; the prior's where a load keeps its sign, and 0
    # for an output that was not measured
    jump_deviation: Floats


def slopes_at_zero(rows: Rows, load_range: LoadRange, response: RobustFit) -> Slopes:
    """Return the compliance at zero load of rows in the order of their measurement.

    `response`: the robust response at these rows, which shows the direction of the motion.
    """
    used = evenly(len(rows), MAX_ROWS)
    loads = rows.wrench[used] / load_range.scale
    time = np.linspace(-0.5, 0.5, len(rows))[used]
    mean = np.zeros((6, N_SLOPES))
    covariances = np.zeros((6, N_SLOPES, N_SLOPES))
    measured = np.isfinite(rows.displacement[used])
    # Outputs that the same rows have share the decomposition of the kernel.
    for pattern in np.unique(measured, axis=1).T:
        if not pattern.any():
            continue
        outputs = np.flatnonzero((measured == pattern[:, None]).all(axis=0))
        x = loads[pattern]
        y = rows.displacement[np.ix_(used[pattern], outputs)]
        signs = np.sign(np.where(np.abs(x) > ZERO_LOAD, x, 0.0))
        columns = []
        for output in outputs:
            direction = _directions(response.expected[:, output])[used[pattern]]
            own = x[:, output]  # its powers: a response of 3rd or 5th degree is no jump
            others = np.ones(len(x)), time[pattern], direction, own**3, own**5
            columns.append(np.column_stack((x, signs, *others)))
        spans = np.maximum(np.ptp(y, axis=0), np.finfo(float).tiny)
        centred = np.where(np.ptp(y, axis=0) > 0, y - y.mean(axis=0), 0.0)  # the mean is rounded
        means, spreads = _posterior(x, centred / spans, columns)
        mean[outputs] = means * spans[:, None]
        covariances[outputs] = spreads * spans[:, None, None] ** 2
    is_varied = np.ptp(loads, axis=0) > ZERO_LOAD
    mean[:, :6][:, ~is_varied] = 0.0
    scale = load_range.scale
    own_load = np.arange(6)
    own_jump = 6 + own_load
    # A jump is twice the coefficient of the load's sign, from -1 to 1.
    return Slopes(
        matrix=mean[:, :6] / scale,
        covariance=covariances[:, :6, :6] / np.outer(scale, scale),
        jump=2 * mean[own_load, own_jump],
        jump_deviation=2 * np.sqrt(covariances[own_load, own_jump, own_jump]),
    )


def _directions(expected: Floats) -> Floats:
    """Return the sign of an output's change since the row before, (n,); 0 for a small change."""
    if not len(expected):
        return expected
    steps = np.diff(expected, prepend=expected[0])
    usual = np.percentile(np.abs(steps), USUAL_STEP)
    return np.where(np.abs(steps) > MIN_STEP * usual, np.sign(steps), 0.0)


def _posterior(x: Floats, y: Floats, columns: list[Floats]) -> tuple[Floats, Floats]:
    """Return the mean of slopes and jumps, (k, 12), and their covariance, (k, 12, 12).

    `x` (n, 6): loads, half ranges.
    `y` (n, k): readings of k outputs, over their ranges.
    `columns`: the terms of each output's mean at the readings, (n, c); the first 12 of them are
    the loads and their signs.
    """
    n = len(x)
    values = np.ones((n, 1), dtype=bool)
    slopes = np.ones((1, 7), dtype=bool)
    slopes[:, 0] = False
    zero_load = np.zeros((1, 6))
    means_of_terms = [_Mean.of(terms, y[:, output]) for output, terms in enumerate(columns)]
    # One entry for each kernel, noise and output.
    shape = len(INVERSE_SQUARES) * len(JOINT_WEIGHTS), len(RATIOS), y.shape[1]
    negative_log_likelihoods = np.empty(shape)
    means = np.empty((*shape, N_SLOPES))
    covariances = np.empty((*shape, N_SLOPES, N_SLOPES))
    of_lengths = covariances_of_values(x, DEFAULT.kriging_groups, INVERSE_SQUARES)
    kernels = (
        (axes + weight * joint, Hyperparameters(np.full(6, inverse_square), np.array([weight])))
        for inverse_square, (axes, joint) in zip(INVERSE_SQUARES, of_lengths, strict=True)
        for weight in JOINT_WEIGHTS
    )
    for number, (matrix, kernel) in enumerate(kernels):
        roots, vectors = np.linalg.eigh(matrix)  # L and U
        inverse = 1 / (np.maximum(roots, 0.0) + RATIOS[:, None])  # D of each noise
        across, prior = np.zeros((n, N_SLOPES)), np.zeros((N_SLOPES, N_SLOPES))
        across[:, :6] = vectors.T @ covariance(x, values, zero_load, slopes, kernel)
        prior[:6, :6] = covariance(zero_load, slopes, zero_load, slopes, kernel)
        for output, of_terms in enumerate(means_of_terms):
            data = vectors.T @ np.column_stack((of_terms.basis, of_terms.residual))
            factors = np.column_stack((data[:, :-1], across, data[:, -1]))
            likelihood, mean, spread = _posterior_by_noise(factors, inverse, prior, of_terms)
            negative_log_likelihoods[number, :, output] = likelihood
            means[number, :, output], covariances[number, :, output] = mean, spread

    # The average over kernels and noises; letters: kernel, ratio, output, entry, entry.
    weights = np.exp(negative_log_likelihoods.min(axis=(0, 1)) - negative_log_likelihoods)
    weights /= weights.sum(axis=(0, 1))
    mean = np.einsum("kro,kroe->oe", weights, means)
    deviation = means - mean
    spread = np.einsum("kro,kroe,krof->oef", weights, deviation, deviation)
    spread += np.einsum("kro,kroef->oef", weights, covariances)
    spread += np.stack([of_terms.undetermined for of_terms in means_of_terms])
    variances = np.einsum("oee->oe", spread)
    np.maximum(variances, 0.0, out=variances)  # rounding of exact readings
    return mean, spread


class _Mean(NamedTuple):
    """The terms of an output's mean in an orthonormal basis, which keeps rounding small."""

    basis: Floats  # (n, t): of the terms that the readings determine
    along: Floats  # (t,): the readings in this basis
    residual: Floats  # (n,): the readings less their part along the basis
    slopes: Floats  # (12, t): slopes and jumps by these coefficients
    undetermined: Floats  # (12, 12): covariance of slopes and jumps that no reading shows

    @classmethod
    def of(cls, terms: Floats, y: Floats) -> _Mean:
        """Return the basis of terms (n, c) for readings (n,) over their range."""
        largest = np.abs(terms).max(axis=0)
        largest = np.where(largest > ZERO_LOAD, largest, 1.0)
        # All right vectors, also where the terms are more than the readings.
        is_wide = terms.shape[0] < terms.shape[1]
        left, sizes, right = np.linalg.svd(terms / largest, full_matrices=is_wide)
        known = np.count_nonzero(sizes > DETERMINED * sizes[0])
        basis, coefficients = left[:, :known], right[:known].T / sizes[:known]
        along = basis.T @ y
        scale = largest[:N_SLOPES]
        slopes = coefficients[:N_SLOPES] / scale[:, None]
        unknown = PRIOR * right[known:, :N_SLOPES] / scale
        return cls(basis, along, y - basis @ along, slopes, unknown.T @ unknown)


def _posterior_by_noise(
    factors: Floats, inverse: Floats, prior: Floats, of_terms: _Mean
) -> tuple[Floats, Floats, Floats]:
    """Return the results of one output by one kernel for each of r noises.

    These are the negative log likelihood, (r,), and mean, (r, 12), and covariance, (r, 12, 12), of
    slopes and jumps.

    `factors` (n, t + 13): B, k and U' y side by side, of the basis and the residual of the terms.
    `inverse` (r, n): D of each noise; `prior` (12, 12): P.
    """
    n = len(factors)
    count = factors.shape[1] - N_SLOPES - 1
    # (B, k, U' y)' D (B, k, U' y), with the three at `b`, `k` and -1.
    weighted = weighted_products(factors, inverse)
    b = slice(0, count)
    k = slice(count, count + N_SLOPES)

    normal = weighted[:, b, b]
    covariances = np.linalg.inv(normal)
    estimate = np.einsum("rab,rb->ra", covariances, weighted[:, b, -1])
    residual = weighted[:, -1, -1] - (estimate * weighted[:, b, -1]).sum(axis=1)
    free = n - count
    variance = np.maximum(residual / max(free, 1), EXACT**2)
    determinants = np.linalg.slogdet(normal)[1] - np.log(inverse).sum(axis=1)
    likelihood = 0.5 * (free * np.log(variance) + determinants)

    by_mean = of_terms.slopes - weighted[:, k, b]  # R'
    mean = of_terms.slopes @ of_terms.along + weighted[:, k, -1]
    mean += np.einsum("rkb,rb->rk", by_mean, estimate)
    spread = prior - weighted[:, k, k] + by_mean @ covariances @ by_mean.transpose(0, 2, 1)
    # The variance of Student's t; the range of the readings where no noise can be estimated.
    scale = variance * free / (free - 2) if free >= MIN_FREEDOM else np.ones(len(inverse))
    return likelihood, mean, scale[:, None, None] * spread
