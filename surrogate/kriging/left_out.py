"""Rows left out whole, without factorising anew, and the factor that bars take from them.

With Q = inv(K) - inv(K) F inv(A) F' inv(K) and b the equations of one row (its value and slopes),
the error of an answer that has not seen them, mean refitted and hyperparameters kept, is
inv(Q_bb) (Q y)_b (Dubrule 1983); its posterior covariance is inv(Q_bb).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..table.rows import Floats
from .equations import Equations
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
    squared_deviations : ndarray, shape (k,)
        Their posterior variance over the process variance, noise of the row included.
    mean_covariances : ndarray, shape (k, 7, 7)
        Of the mean's coefficients without the row.
    """

    rows: NDArray[np.intp]
    errors: Floats
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
    squared, means = np.empty(count), np.empty((count, len(precision), len(precision)))
    for place, row in enumerate(chosen):
        # T is triangular: what stands above the block is zero.
        below = factor.T[starts[row] :, starts[row] : ends[row]]
        block = below.T @ below
        shares = below.T @ factor.TF[starts[row] :]
        whole = np.linalg.inv(block - shares @ factor.mean_covariance @ shares.T)
        errors[place] = whole[0] @ factor.weights[starts[row] : ends[row]]
        squared[place] = whole[0, 0]
        means[place] = np.linalg.inv(precision - shares.T @ np.linalg.solve(block, shares))
    return LeftOut(factor.rows[chosen], errors, squared, means)


def conformal_factors(
    errors: Floats, deviations: Floats, settings: KrigingSettings = DEFAULTS
) -> Floats:
    """Return what deviations are multiplied by for a bar of `level`, one an output, shape (6,).

    The ratios |error| / deviation of k left-out rows have a size, one an output, and a tail, whose
    shape the outputs share: the tail's quantile is taken of all ratios over their output's size, at
    the rank that holds for one more row (split conformal prediction: Lei et al. 2018), and widened
    for few rows. One quantile an output would rest on two or three rows of 40.

    Parameters
    ----------
    errors, deviations : ndarray, shape (k, 6), dimensionless
        In spreads; NaN where a row does not bring the output.
    """
    with np.errstate(invalid="ignore"):  # an output that nothing moves errs by nothing
        ratios = np.abs(errors) / deviations
    told = np.isfinite(ratios)
    counts = told.sum(axis=0)
    squares = np.where(told, ratios, 0.0) ** 2
    # An output that few rows tell takes the size that all of them share.
    common = np.sqrt(squares.sum() / max(counts.sum(), 1))
    own = np.sqrt(squares.sum(axis=0) / np.maximum(counts, 1))
    size = np.where((counts >= settings.rows_an_output) & (own > 0), own, common)
    tail = _quantile((ratios / np.where(size > 0, size, 1.0))[told], settings.level)
    return tail * size * (1 + settings.widening / np.maximum(counts, 1))


def _quantile(ratios: Floats, level: float) -> float:
    """Return the smallest ratio that so many of one more are below."""
    if not len(ratios):
        return np.inf
    rank = int(np.ceil(level * (len(ratios) + 1)))
    return float(np.sort(ratios)[min(rank, len(ratios)) - 1])
