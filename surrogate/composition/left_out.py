"""Points of an axis left out of its triangulation, as far from the others as answers are from rows.

A left-out point shows how wrong answers are whose simplices are as large as the one that it fell
into, and nothing about larger ones: of two points side by side each is answered by the other. So
with a left-out point all points within a radius of it are left out (buffered leave-one-out: Le Rest
et al. 2014, "Spatial leave-one-out cross-validation"), and one point stands for all within a cell
of that size. At a point whose neighbours are farther than r the unit error is at least r^2 / 2, so
the radius for a typical unit error S of the table is sqrt(2 PART S).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from ..error_law import LeftOutErrors
from ..interpolation.delaunay import Indices, Triangulation
from ..table.rows import Floats
from ..table.thinning import hashes

# Of the median unit error over the load range. With a half, rows in twins, clusters and along
# motions have error bars that hold 90 to 96 % or none, and evenly spread rows lose a tenth of the
# points left out; with a quarter, motions had bars that held 48 %.
PART = 0.5
FOLDS = 4  # of evenly spread points, a quarter each: errors are those of 3/4 of the rows
MOST = 2000  # points left out of a fold: their 95 % quantile is known to 1 %
# Points left out one at a time, or a few, where there are few: 60 are left out in ten folds.
FEW = 600
WORK = 8000  # points triangulated in all folds, if there is more than one: an axis of 2000 has four
# So that the same loads in other units, which differ by rounding, are left out in the same folds:
DECIMALS = 7  # of the range: points closer than 1e-6 are one
ASIDE = 0.382  # of a cell: rows of a grid lie on no border


class LeftOut(NamedTuple):
    """Errors at k points of an axis that a triangulation was made without.

    Attributes
    ----------
    places : ndarray of int, shape (k,)
        Which of the axis' points they are, or of those that were not chosen.
    errors : ndarray, shape (k, 6), m and rad
        Interpolated less given displacement.
    unit_errors : ndarray, shape (k,), dimensionless
        Of the function |x|^2 / 2 (`error_law`).
    noise_shares : ndarray, shape (k,), dimensionless
        Sum of the squares of the barycentric coordinates.
    stated : ndarray, shape (k, 6), m and rad
        The rows' own uncertainty, interpolated.
    inside : ndarray of bool, shape (k,)
        Whether the hull of the other points holds the point.
    """

    places: Indices
    errors: Floats
    unit_errors: Floats
    noise_shares: Floats
    stated: Floats
    inside: NDArray[np.bool_]

    @property
    def inside_errors(self) -> LeftOutErrors:
        """The errors inside the hull."""
        columns = np.abs(self.errors), self.stated, self.unit_errors, self.noise_shares
        return LeftOutErrors(*(column[self.inside] for column in columns))


def joined(parts: Sequence[LeftOut]) -> LeftOut:
    """Return the left-out points of several folds as one; none if there are no folds."""
    six, none = np.empty((0, 6)), np.empty(0)
    blank = LeftOut(none.astype(np.intp), six, none, none, six, none.astype(bool))
    return LeftOut(*(np.concatenate(column) for column in zip(blank, *parts, strict=True)))


def folds(triangulation: Triangulation) -> list[tuple[Indices, NDArray[np.bool_]]]:
    """Return which points are left out together, (k,), and which of all stay, (n,)."""
    points, count = triangulation.points, len(triangulation.points)
    radius = float(np.sqrt(2 * PART * typical_unit_error(triangulation)))
    if not radius > 0:
        return []
    # One point of each cell of a grid, (k,), in an order that no pattern of rows follows. By a
    # hash of each point alone: every fourth row of a grid would be one of its faces.
    order = np.argsort(hashes(points.round(DECIMALS)), kind="stable")
    cells = np.floor(points[order] / radius + ASIDE)
    place = np.lexsort(cells.T)  # stable: the first of a cell is the first of the order
    new = np.ones(len(order), dtype=bool)
    new[1:] = (cells[place][1:] != cells[place][:-1]).any(axis=1)
    chosen = order[np.sort(place[new])]
    parts = max(min(FEW // len(chosen), len(chosen)), FOLDS)
    found = []
    for left in np.array_split(chosen, parts)[: max(WORK // count, 1)]:
        if not len(left):
            continue
        apart = np.asarray(KDTree(points[left[:MOST]]).query(points)[0])
        stay = apart > radius
        if stay.any():
            found.append((left[:MOST], stay))
    return found


def typical_unit_error(triangulation: Triangulation) -> float:
    """Return the median unit error over what the points span, dimensionless.

    Of each simplex that is the mean over its volume: half the sum of its squared edges over
    (d + 1)(d + 2).
    """
    corners, dimension = triangulation.points[triangulation.simplices], triangulation.dimension
    from_middle = corners - corners.mean(axis=1, keepdims=True)
    edges = (dimension + 1) * (from_middle**2).sum(axis=(1, 2))
    unit = 0.5 * edges / ((dimension + 1) * (dimension + 2))
    order = np.argsort(unit)
    share = np.cumsum(triangulation.volumes[order])
    return float(unit[order][np.searchsorted(share, 0.5 * share[-1])])
