"""Which rows of a kriging are the nearest one of some wrench of a scene.

An error bar comes from the neighbourhood of the nearest row, and these are most of a kriging's
memory. Over a scene's box the difference of two rows' squared distances is linear in the loads, so
whether a row is nearest anywhere is a question of linear programming, with as many unknowns as the
scene has dimensions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from ..table.rows import Floats

SAMPLE = 2048  # places of the box asked first: what is nearest at one needs no linear programme
PROGRAMMES = 200  # linear programmes solved: a second; beyond that every possible row is kept
AT_ONCE = 1_000_000  # differences of loads at once: 8 MB
ROOM = 1e-9  # squared half ranges: rows that tie by rounding both count as nearest


def nearest_anywhere(points: Floats, rates: Floats, low: Floats, high: Floats) -> NDArray[np.bool_]:
    """Return which points are nearest to some place of a box, shape (n,).

    Parameters
    ----------
    points : ndarray, shape (n, 6), dimensionless
    rates : ndarray, shape (6,), dimensionless
        Inverse squared lengths: what squared differences are weighted by.
    low, high : ndarray, shape (6,), dimensionless
    """
    squares, box = (points**2) @ rates, (low, high)
    possible = np.zeros(len(points), dtype=bool)
    for rows in np.array_split(np.arange(len(points)), 1 + points.size * len(points) // AT_ONCE):
        tilt, lift = _differences(points, rates, squares, rows)
        least = lift + np.minimum(tilt * low, tilt * high).sum(axis=2)
        possible[rows] = ~(least > ROOM).any(axis=1)  # no other one is nearer everywhere
    open_ = np.flatnonzero(possible & ~_sampled(points, rates, low, high))
    if len(open_) <= PROGRAMMES:
        for row in open_:
            tilt, lift = _differences(points, rates, squares, np.array([row]))
            possible[row] = _feasible(tilt[0], ROOM - lift[0], *box)
    return possible


def _differences(
    points: Floats, rates: Floats, squares: Floats, rows: NDArray[np.intp]
) -> tuple[Floats, Floats]:
    """Return tilt (k, n, 6) and lift (k, n): the squared distance of k rows less that of each.

    At a place x it is tilt x + lift.
    """
    tilt = -2 * rates * (points[rows, None] - points[None])
    return tilt, squares[rows, None] - squares[None]


def _sampled(points: Floats, rates: Floats, low: Floats, high: Floats) -> NDArray[np.bool_]:
    """Return which points are nearest to one of some places of the box, shape (n,)."""
    at = np.random.default_rng(0).uniform(size=(SAMPLE, 6)) * (high - low) + low
    roots = np.sqrt(rates)
    found = np.zeros(len(points), dtype=bool)
    squares = (points**2) @ rates
    found[np.argmin(squares - 2 * (at * roots) @ (points * roots).T, axis=1)] = True
    return found


def _feasible(tilt: Floats, upper: Floats, low: Floats, high: Floats) -> bool:
    """Return whether some place of a box has `tilt` (n, 6) times it at most `upper` (n,)."""
    vary = np.flatnonzero(high > low)
    fixed = np.flatnonzero(high <= low)
    upper = upper - tilt[:, fixed] @ low[fixed]
    if not len(vary):
        return bool((upper >= 0).all())
    bounds = np.column_stack((low[vary], high[vary]))
    found = linprog(np.zeros(len(vary)), A_ub=tilt[:, vary], b_ub=upper, bounds=bounds)
    return found.status != 2  # 2: infeasible; whatever else it says, the row is kept
