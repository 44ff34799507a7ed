"""A robust reference response of measured rows: what their readings scatter around.

A polynomial of third degree in each load, with products of two loads where the rows are enough for
them, fitted by iteratively reweighted least squares with Tukey's biweight (Beaton and Tukey 1974),
which single wrong rows do not bend.
"""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple

import numpy as np

from ..table.rows import CLEAN, Floats, LoadRange, Rows

ROUNDS = 30  # of reweighting: the weights are settled after 10 to 20
BIWEIGHT = 4.685  # deviations: 95 % efficient for normal errors (Holland and Welsch 1977)
NORMAL = 1.4826  # deviation over median absolute deviation, of normal errors
ROWS_A_TERM = 5  # rows that a term of the polynomial needs at least
EXACT = 1e-4  # of an output's range: residuals below it are no error worth a remark
RANK = 1e-9  # of the largest: directions that the rows do not tell apart, and their ridge


class RobustFit(NamedTuple):
    """The fitted response at the rows.

    Attributes
    ----------
    expected : ndarray, shape (n, 6), m and rad
    residual : ndarray, shape (n, 6), m and rad
        Measured less expected; NaN where an output was not measured.
    deviation : ndarray, shape (6,), m and rad
        Robust standard deviation of the residuals.
    range : ndarray, shape (6,), m and rad
        Between the 2nd and 98th percentile of each expected output.
    terms : ndarray, shape (n, t)
        The polynomial's terms at the rows, dimensionless.
    """

    expected: Floats
    residual: Floats
    deviation: Floats
    range: Floats
    terms: Floats


def terms_of(scaled: Floats) -> Floats:
    """Return the polynomial's terms (n, t) at scaled loads (n, 6), as many as the rows allow."""
    used = np.flatnonzero(np.abs(scaled).max(axis=0, initial=0.0) > CLEAN)
    loads, count = scaled[:, used], len(scaled)
    found = [np.ones((count, 1)), loads]
    for more in (
        loads**2,
        loads**3,
        np.stack([loads[:, i] * loads[:, j] for i, j in combinations(range(len(used)), 2)], axis=1)
        if len(used) > 1
        else np.empty((count, 0)),
    ):
        if ROWS_A_TERM * (sum(part.shape[1] for part in found) + more.shape[1]) <= count:
            found.append(more)
    return np.concatenate(found, axis=1)


def response_of(rows: Rows, load_range: LoadRange) -> RobustFit:
    """Return the robust response of rows with at least two wrenches."""
    terms = terms_of(rows.wrench / load_range.scale)
    basis, sizes, _ = np.linalg.svd(terms, full_matrices=False)
    basis = basis[:, sizes > RANK * sizes[0]] * np.sqrt(len(terms))
    moved = rows.displacement
    expected = np.stack([_fitted(basis, moved[:, output]) for output in range(6)], axis=1)
    residual = moved - expected
    known = [column[np.isfinite(column)] for column in expected.T]
    ends = np.array([np.percentile(one, [2, 98]) if len(one) else (0.0, 0.0) for one in known]).T
    size = np.maximum(ends[1] - ends[0], np.finfo(float).tiny)
    deviation = np.maximum(
        np.array([_deviation(column[np.isfinite(column)]) for column in residual.T]), EXACT * size
    )
    return RobustFit(expected, residual, deviation, size, terms)


def _fitted(basis: Floats, moved: Floats) -> Floats:
    """Return the robust fit at all rows, (n,); NaN where no row has the output."""
    known = np.isfinite(moved)
    if known.sum() < 2:
        return np.full(len(moved), np.nan)
    x, y = basis[known], moved[known]
    floor = EXACT * max(float(np.ptp(y)), np.finfo(float).tiny)
    found = _solved(x, y, np.ones(len(y)))
    # Least absolute deviations first: from plain least squares, wrong rows keep their weight.
    for round_ in range(ROUNDS):
        missed = np.abs(y - x @ found)
        scale = max(NORMAL * float(np.median(missed)), floor)
        if round_ < ROUNDS // 2:
            weights = scale / np.maximum(missed, scale / 10)
        else:
            weights = np.clip(1.0 - (missed / (BIWEIGHT * scale)) ** 2, 0.0, None) ** 2
        found = _solved(x, y, weights)
    return basis @ found


def _solved(x: Floats, y: Floats, weights: Floats) -> Floats:
    """Return weighted least squares (t,) on a basis (n, t) of columns of length sqrt(n)."""
    weighted = x * weights[:, None]
    normal = x.T @ weighted + RANK * max(float(weights.sum()), 1.0) * np.eye(x.shape[1])
    return np.asarray(np.linalg.solve(normal, weighted.T @ y), dtype=float)


def _deviation(values: Floats) -> float:
    return NORMAL * float(np.median(np.abs(values - np.median(values)))) if len(values) else 0.0
