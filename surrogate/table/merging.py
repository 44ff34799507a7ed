"""The rows that answers are made of: those within the load range, repeated ones merged.

A row beyond the load range answers its own wrench and nothing else: one row at 25 times the range
makes simplices that take most of it, and bends every fit. Two rows that are almost one tell, by the
little they differ, slopes and curvatures that are nothing but noise: they are one row, and what
they differ by is its uncertainty.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from .rows import CLEAN, Floats, LoadRange, Rows

NEAR = 1e-6  # of the range: rows closer than this, in each load, are one
DIRECTIONS = 3  # each leaves about a tenth of 30,000 rows
ROUNDING = 1e-6  # of the distance along a direction, whose ends are of size 1 (2e-16 over 1e-6)
EQUAL = 12  # decimals of scaled loads to which rows are one before any distance is measured


class Merged(NamedTuple):
    """Rows of distinct wrenches.

    Attributes
    ----------
    rows : Rows
        Displacement, tangent and curvature are the mean of the merged rows, the uncertainty is
        their largest or half the spread of their displacements; the number, the wrench and the
        source are those of one of them.
    members : tuple of tuple of int
        The numbers (`seq`) of the rows behind each.
    within : ndarray of bool, shape (n,)
        Which lie within the load range.
    owner : ndarray of int, shape (given rows,)
        The index, in these rows, of each row that was given.
    """

    rows: Rows
    members: tuple[tuple[int, ...], ...]
    within: NDArray[np.bool_]
    owner: NDArray[np.intp]

    def usable(self) -> tuple[Rows, tuple[tuple[int, ...], ...]]:
        """Return the rows within the load range, and their members."""
        if self.within.all():
            return self.rows, self.members
        members = tuple(self.members[place] for place in np.flatnonzero(self.within))
        return self.rows.take(self.within), members


def merge(rows: Rows, load_range: LoadRange) -> Merged:
    """Merge rows, in ascending order of `seq`, whose wrenches lie within 1e-6 of the range.

    A row beyond the range never merges with one within it.
    """
    scaled = rows.wrench / load_range.scale
    within = load_range.holds(rows.wrench)
    owner = close_groups(np.column_stack((scaled, np.where(within, 0.0, 1.0))))
    count = int(owner.max(initial=-1)) + 1
    if count == len(rows):
        return Merged(rows, tuple(zip(rows.seq.tolist(), strict=True)), within, owner)
    # The wrench is that of the row with the fewest loads, so that a clean row stays clean and the
    # row at no load at no load; then of the outermost, so that the hull does not shrink.
    loaded = (np.abs(scaled) > CLEAN).sum(axis=1)
    order = np.lexsort((rows.seq, -(scaled**2).sum(axis=1), loaded, owner))
    first = order[np.searchsorted(owner[order], np.arange(count))]
    by_seq = np.argsort(owner, kind="stable")
    sizes = np.bincount(owner, minlength=count)
    starts = np.cumsum(sizes) - sizes
    members = list(zip(rows.seq[by_seq[starts]].tolist(), strict=True))
    found = rows.take(first)
    several = np.flatnonzero(sizes > 1)
    curvature = rows.curvature[first]  # of the first ones alone it may be unknown
    if len(several):  # what the means are written to
        own = {name: np.array(getattr(found, name)) for name in ("uncertainty", "compliance")}
        found = replace(found, **own)
    for place in several.tolist():
        group = by_seq[starts[place] : starts[place] + sizes[place]]
        members[place] = tuple(rows.seq[group].tolist())
        # Put the mean of merged rows in the place of one of them.
        merged = rows.take(group)
        found.displacement[place] = merged.displacement.mean(axis=0)
        stored = np.nan_to_num(merged.uncertainty).max(axis=0)
        found.uncertainty[place] = np.maximum(np.ptp(merged.displacement, axis=0) / 2, stored)
        found.compliance[place] = _mean_known(merged.compliance)
        measured = merged.source != "fea"  # solves repeat exactly; a merged row does only if all do
        found.source[place] = merged.source[measured][0] if measured.any() else "fea"
        curvature[place] = _mean_known(rows.curvature[group])
    found = replace(found, curvature=curvature)
    return Merged(found, tuple(members), within[first], owner)


def close_groups(points: Floats) -> NDArray[np.intp]:
    """Return the group of each scaled point, shape (n, d) -> (n,): 0, 1, ... by first appearance.

    Points within 1e-6 of each other in every coordinate, by themselves or by others between them,
    are one group. Points are dimensionless.
    """
    if not len(points):
        return np.empty(0, dtype=np.intp)
    # + 0.0 turns -0.0 into 0.0, which a byte-wise comparison would keep apart
    keys = np.round(points, EQUAL) + 0.0
    # The distinct points in lexical order, and the place of each given one in them. As
    # `numpy.unique` along an axis does, which compares bytes and keeps all other threads waiting.
    order = np.lexsort(keys.T[::-1])
    ordered = keys[order]
    new = np.ones(len(keys), dtype=bool)
    new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    group = np.empty(len(keys), dtype=np.intp)
    group[order] = np.cumsum(new) - 1
    distinct = ordered[new]
    # The points that another one may be near to, by what they are along a few directions. Points
    # that are near each other are so along any direction; of points apart few are.
    left = np.arange(len(distinct))
    directions = np.random.default_rng(0).uniform(0.5, 1.0, (DIRECTIONS, distinct.shape[1]))
    for direction in directions:
        along = distinct[left] @ direction
        order = np.argsort(along)
        close = np.diff(along[order]) <= NEAR * direction.sum() * (1 + ROUNDING)
        kept = np.zeros(len(left), dtype=bool)
        kept[order[1:][close]] = True
        kept[order[:-1][close]] = True
        left = left[kept]
    near = left
    pairs = near[KDTree(distinct[near]).query_pairs(NEAR, p=np.inf, output_type="ndarray")]
    size = len(distinct)
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(size, size))
    label = np.asarray(connected_components(links, directed=False)[1])[group]
    _, first, number = np.unique(label, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.intp)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[number.reshape(-1)]


def _mean_known(values: Floats) -> Floats:
    """Return the mean of the entries, (n, ...) -> (...), that are known; NaN if none is."""
    known = values[np.isfinite(values).all(axis=tuple(range(1, values.ndim)))]
    return known.mean(axis=0) if len(known) else np.full(values.shape[1:], np.nan)
