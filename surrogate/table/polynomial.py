"""Polynomials of the loads of rows."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from .rows import ZERO_LOAD, Floats

# Part of the largest singular value: smaller ones are linear dependences of terms, to rounding.
RANK = 1e-9
ROWS_A_TERM = 5  # rows of each term: with fewer the fit follows the noise of single rows


def terms_of(scaled: Floats, distinct_rows: int | None = None) -> Floats:
    """Return the terms of a polynomial in the loads, shape (n, t).

    The terms are 1 and each load; then, as long as there are `ROWS_A_TERM` rows for each term, the
    squares, the cubes and the products of two loads.

    `scaled` (n, inputs): loads over the load range, dimensionless.
    `distinct_rows`: how many rows count, if some repeat others; n if None.
    """
    used = np.flatnonzero(np.abs(scaled).max(axis=0, initial=0.0) > ZERO_LOAD)
    loads = scaled[:, used]
    count = len(scaled) if distinct_rows is None else distinct_rows
    parts = [np.ones((len(scaled), 1)), loads]
    pairs = [loads[:, i] * loads[:, j] for i, j in combinations(range(len(used)), 2)]
    products = np.stack(pairs, axis=1) if pairs else np.empty((len(scaled), 0))
    for more in (loads**2, loads**3, products):
        if ROWS_A_TERM * (sum(part.shape[1] for part in parts) + more.shape[1]) <= count:
            parts.append(more)
    return np.concatenate(parts, axis=1)
