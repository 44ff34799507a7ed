"""Rows left out whole, without factorising anew, and the factor that bars take from them.

With Q = inv(K) - inv(K) F inv(A) F' inv(K) and b the equations of one row (its value and slopes),
the error of an answer that has not seen them, mean refitted and hyperparameters kept, is
inv(Q_bb) (Q y)_b (Dubrule 1983); its posterior covariance is inv(Q_bb).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from ..table.rows import Floats
from .correlation import PLACES
from .equations import OUTPUTS, Equations
from .factor import Factor
from .settings import DEFAULTS, KrigingSettings


class LeftOut(NamedTuple):
    """What rows left out tell, in dimensionless numbers.

    Attributes
    ----------
    rows : ndarray of int, shape (k,)
        Rows of the table.
    errors : ndarray, shape (k, q)
        Of the values of the factor's outputs, spreads.
    sizes : ndarray, shape (k, q)
        Root mean square of the row's value and slopes, each over the deviation it should have.
    squared_deviations : ndarray, shape (k,)
        Their posterior variance over the process variance, noise of the row included.
    mean_covariances : ndarray, shape (k, 7, 7)
        Of the mean's coefficients without the row.
    """

    rows: NDArray[np.intp]
    errors: Floats
    sizes: Floats
    squared_deviations: Floats
    mean_covariances: Floats


def left_out(equations: Equations, factor: Factor, settings: KrigingSettings = DEFAULTS) -> LeftOut:
    """Return the left-out rows of a factor: each of its rows, or an even choice of many."""
    own = equations.take(factor.rows)
    count = min(len(own), settings.left_out_rows)
    chosen = np.linspace(0, len(own) - 1, count).round().astype(np.intp)
    ends = np.cumsum(own.known.sum(axis=1))
    starts = np.append(0, ends[:-1])
    precision = np.linalg.inv(factor.mean_covariance)
    errors = np.empty((count, len(factor.outputs)))
    sizes = np.empty_like(errors)
    squared, means = np.empty(count), np.empty((count, len(precision), len(precision)))
    for place, row in enumerate(chosen):
        # T is triangular: what stands above the block is zero.
        below = factor.T[starts[row] :, starts[row] : ends[row]]
        block = below.T @ below
        shares = below.T @ factor.TF[starts[row] :]
        whole = np.linalg.inv(block - shares @ factor.mean_covariance @ shares.T)
        weights = factor.weights[starts[row] : ends[row]]
        missed = whole @ weights
        errors[place] = missed[0]
        # inv(whole) missed = weights: what the errors are by the covariance that they should have
        told = np.einsum("eq,eq->q", missed, weights) / len(weights) / factor.variance
        sizes[place] = np.sqrt(np.maximum(told, 0.0))
        squared[place] = whole[0, 0]
        means[place] = np.linalg.inv(precision - shares.T @ np.linalg.solve(block, shares))
    return LeftOut(factor.rows[chosen], errors, sizes, squared, means)


class Factors(NamedTuple):
    """What deviations are multiplied by for bars, and how well left-out rows tell it.

    Attributes
    ----------
    factors : ndarray, shape (6,), dimensionless
    widened : ndarray, shape (6,), dimensionless
        By how much of that, since few rows tell the size of errors: large where they are few, or
        where a few of them make nearly all of it.
    held : ndarray, shape (6,), dimensionless
        Part of the left-out rows inside the bars.
    """

    factors: Floats
    widened: Floats
    held: Floats


def conformal_factors(
    errors: Floats,
    deviations: Floats,
    sizes: Floats,
    coefficients: float = 0.0,
    settings: KrigingSettings = DEFAULTS,
) -> Factors:
    """Return what deviations are multiplied by for a bar of `level`, one an output.

    The ratios |error| / deviation of k left-out rows have a size, one an output, and a tail, whose
    shape the outputs share. The size is told by slopes as well as by values: seven numbers a row.
    The tail's quantile is that of all ratios over their output's size, at the rank that holds for
    one more (split conformal prediction: Lei et al. 2018): one quantile an output would rest on two
    or three rows of 40. Sizes are widened as `_widened` says.

    Parameters
    ----------
    errors, deviations : ndarray, shape (k, 6), dimensionless
        In spreads; NaN where a row does not bring the output.
    sizes : ndarray, shape (k, 6), dimensionless
        Root mean square of a row's errors, values and slopes, over their deviations; NaN likewise.
    coefficients : float
        Of the mean, that these rows settle too.
    """
    with np.errstate(invalid="ignore"):  # an output that nothing moves errs by nothing
        ratios = np.abs(errors) / deviations
    told = np.isfinite(ratios) & np.isfinite(sizes)
    counts = np.maximum(told.sum(axis=0), 1)
    squares = np.where(told, sizes, 0.0) ** 2
    square = squares.sum(axis=0) / counts
    size = np.sqrt(np.where(square > 0, square, 1.0))
    scatter = (squares**2).sum(axis=0) / counts / size**4 - 1
    widened = _widened(counts - coefficients, scatter, settings.confidence)
    # An output of which nothing is missed (one that no row holds) says nothing of the tail.
    missed = told & (square > 0)
    tail = _quantile((ratios / size)[missed if missed.any() else told], settings.level)
    factors = tail * size * widened
    return Factors(factors, widened, (told & (ratios <= factors)).sum(axis=0) / counts)


def doubtful(found: Factors, errors: Floats, settings: KrigingSettings = DEFAULTS) -> bool:
    """Return whether rows left out, errors (k, 6), spreads, do not tell how large errors are."""
    # Below the deviation that the nugget allows errors are rounding, whose size means nothing.
    matter = (np.abs(errors) > np.sqrt(settings.nugget)).any(axis=0)
    bad = (found.widened > settings.most_widened) | (found.held < settings.least_held)
    return bool((matter & bad).any())


def _widened(rows: Floats, scatter: Floats, confidence: float) -> Floats:
    """Return by how much a size may be larger than rows tell, (6,), at a confidence in all outputs.

    The factor of normal tolerance intervals, sqrt(f / chi2_a(f)): with it an interval holds its
    content at confidence 1 - a, the centre being known (Krishnamoorthy and Mathew 2009,
    "Statistical Tolerance Regions"). a is a sixth of the doubt, for six outputs (Bonferroni). f is
    the degrees of freedom of a chi square whose variance is that of the mean square (Satterthwaite
    1946): as many as rows where each brings one normal number, up to seven times that where values
    and slopes are alike, and few where a few rows make most of the size.

    Parameters
    ----------
    rows : ndarray, shape (6,)
        Those that tell an output, less those that settle the mean.
    scatter : ndarray, shape (6,), dimensionless
        Variance of the rows' squares over their squared mean.
    """
    freedom = 2 * np.maximum(rows, 1) / np.maximum(scatter, 2 / PLACES)
    doubt = (1 - confidence) / OUTPUTS
    return np.sqrt(freedom / (2 * gammaincinv(freedom / 2, doubt)))


def _quantile(ratios: Floats, level: float) -> float:
    """Return the smallest ratio that so many of one more are below."""
    if not len(ratios):
        return np.inf
    rank = int(np.ceil(level * (len(ratios) + 1)))
    return float(np.sort(ratios)[min(rank, len(ratios)) - 1])
