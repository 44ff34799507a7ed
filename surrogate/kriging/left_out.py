"""Rows left out in groups, without factorising anew.

With Q = inv(K) - inv(K) F inv(A) F' inv(K) and b the equations of a group of rows (their values and
slopes), the error of an answer that has not seen them, mean refitted and hyperparameters kept, is
inv(Q_bb) (Q y)_b (Dubrule 1983); its posterior covariance is inv(Q_bb).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..table.rows import Floats
from .equations import Equations
from .factor import KrigingFactor

# Added to the diagonal of a group's precision, of its mean: rows a hair apart leave it singular to
# rounding.
REGULAR = 1e-14


class LeftOutRows(NamedTuple):
    """Errors of rows that were left out with their group, in dimensionless numbers.

    Attributes
    ----------
    errors : ndarray, shape (r, q)
        Of the values of the factor's outputs, spreads; NaN of a row that cannot be left out.
    sizes : ndarray, shape (r, q)
        Root mean square of a row's value and slopes, each over the deviation it should have.
    variances : ndarray, shape (r,), process variances
        That the values' errors should have, the noise of the row itself included.
    mean_covariances : ndarray, shape (r, 7, 7)
        Of the mean's coefficients without the row's group.
    """

    errors: Floats
    sizes: Floats
    variances: Floats
    mean_covariances: Floats


def left_out(equations: Equations, factor: KrigingFactor, labels: NDArray[np.intp]) -> LeftOutRows:
    """Return the errors of a factor's rows, each left out with all rows of its label.

    Parameters
    ----------
    labels : ndarray of int, shape (r,)
        Group of each of the factor's rows.
    """
    own = equations.take(factor.rows)
    sizes = own.known.sum(axis=1)
    ends = np.cumsum(sizes)
    precision = np.asarray(np.linalg.inv(factor.mean_covariance), dtype=float)
    out = LeftOutRows(
        np.full((len(own), len(factor.outputs)), np.nan),
        np.full((len(own), len(factor.outputs)), np.nan),
        np.full(len(own), np.nan),
        np.full((len(own), 1 + own.loads, 1 + own.loads), np.nan),
    )
    for label in np.unique(labels):
        rows = np.flatnonzero(labels == label)
        if len(rows) == len(own):
            break
        places = np.concatenate([np.arange(ends[row] - sizes[row], ends[row]) for row in rows])
        # T is triangular: what stands above the group is zero.
        below = factor.T[places[0] :, places]
        block, shares = below.T @ below, below.T @ factor.TF[places[0] :]
        diagonal = np.diag_indices_from(block)
        block[diagonal] += REGULAR * block[diagonal].mean()
        covariance = np.linalg.inv(block - shares @ factor.mean_covariance @ shares.T)
        missed = covariance @ factor.weights[places]
        out.mean_covariances[rows] = np.linalg.inv(
            precision - shares.T @ np.linalg.solve(block, shares)
        )
        start = 0
        for row, size in zip(rows, sizes[rows], strict=True):
            mine = slice(start, start + size)
            out.errors[row], out.variances[row] = missed[mine][0], covariance[start, start]
            # what the row's errors are by the covariance that they should have
            squares = missed[mine] * np.linalg.solve(covariance[mine, mine], missed[mine])
            out.sizes[row] = np.sqrt(np.maximum(squares.sum(axis=0) / size / factor.variance, 0.0))
            start += size
    return out
