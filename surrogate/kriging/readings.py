"""Measured rows whose uncertainty nobody stated: how many readings are behind a value.

Their noise is not known until the likelihood, and the spread of readings at one wrench, tell it.
Solves repeat exactly and have none.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..table.rows import Floats, Rows

SOLVED = "fea"  # the source of a row that repeats exactly


class Readings(NamedTuple):
    """Of each row and output, shape (n, 6).

    Attributes
    ----------
    number : ndarray, dimensionless
        Readings of unstated uncertainty whose mean the value is; 0 where it is stated, or a solve.
    scatter : ndarray, squares of m and rad
        Sum of their squared differences from the mean.
    """

    number: Floats
    scatter: Floats

    def take(self, which: NDArray[np.intp]) -> Readings:
        """Return those of some rows, whose indices have shape (k,)."""
        return Readings(self.number[which], self.scatter[which])


def readings_of(rows: Rows, owner: NDArray[np.intp] | None = None) -> Readings:
    """Return the readings behind each row, or behind each of those that several are merged to.

    Shape (n, 6) each, in squares of m and rad or dimensionless.

    Parameters
    ----------
    owner : ndarray of int, shape (n,), optional
        Index of the merged row that each row went to.
    """
    present = np.isfinite(rows.displacement)
    solved = (rows.source == SOLVED) | np.isfinite(rows.compliance).all(axis=(1, 2))
    stated = present & ((rows.uncertainty > 0) | solved[:, None])
    if owner is None:
        return Readings(np.where(present & ~stated, 1.0, 0.0), np.zeros_like(rows.displacement))
    size = int(owner.max(initial=-1)) + 1
    count, told, total, scatter = (np.zeros((size, 6)) for _ in range(4))
    value = np.where(present, rows.displacement, 0.0)
    for output in range(6):
        count[:, output] = np.bincount(owner, present[:, output], size)
        told[:, output] = np.bincount(owner, stated[:, output], size)
        total[:, output] = np.bincount(owner, value[:, output], size)
    mean = (total / np.maximum(count, 1))[owner]
    apart = np.where(present, rows.displacement - mean, 0.0) ** 2
    for output in range(6):
        scatter[:, output] = np.bincount(owner, apart[:, output], size)
    unstated = told == 0
    return Readings(np.where(unstated, count, 0.0), np.where(unstated, scatter, 0.0))
