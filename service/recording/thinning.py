"""Farthest-point thinning of a stream of wrenches, in bounded memory and little time.

It keeps a subset of the wrenches: no two are within `reach` of each other, and every wrench lies
within `within` of a kept one. When the subset is full, `reach` grows and some are dropped (the
doubling algorithm: Charikar, Chekuri, Feder and Motwani 1997), so each wrench is examined once.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from wrenchbook.service.ledger.recordings import MERGE
from wrenchbook.surrogate.table.space import DEFAULT

Floats = NDArray[np.float64]
Places = NDArray[np.intp]

MOST = 10_000  # wrenches of a recording within the load range
MOST_OUTSIDE = 1_000  # beyond the range: impacts, counted apart from the others
# Thinning goes down to this share, so that it happens once in 2,000 new wrenches, not with each.
TARGET = 0.8
CHUNK = 2_048  # wrenches at once: each chunk takes a tree of its own and one of the subset
LARGEST = 1e300  # scaled loads beyond this count as this: all differences stay finite numbers
_EDGE = 1 + 1e-12  # KDTree's bound is exclusive; a wrench at just the reach counts as near


@dataclass(frozen=True)
class Subset:
    """Points of which no two are within reach of each other.

    Attributes
    ----------
    points : ndarray, shape (m, n), dimensionless
        See `scaled_loads`.
    keys : list of bytes
        The packed wrench of each.
    reach, within : float
        As in `service.ledger.recordings.Tally`.
    most : int
        How many there may be.
    """

    points: Floats = field(default_factory=lambda: np.empty((0, len(DEFAULT.inputs))))
    keys: list[bytes] = field(default_factory=list)
    reach: float = MERGE
    within: float = 0.0
    most: int = MOST


@dataclass(frozen=True)
class Taken:
    """The subset after a block, keys added and dropped, counts of merged and thinned."""

    subset: Subset
    added: list[bytes]
    dropped: list[bytes]
    merged: int
    thinned: int


def scaled_loads(wrenches: Floats, scale: Floats) -> Floats:
    """Return wrenches (n, m), N and N·m, as points (n, m), dimensionless: by their scale (m,).

    Beyond the scale a load s counts as 1 + ln s, so that it is near what differs from it by a
    share of itself: a few blows a million times too hard would else be all that thinning sees.
    """
    with np.errstate(over="ignore"):
        points = np.clip(wrenches / scale, -LARGEST, LARGEST)
    size = np.abs(points)
    far = size > 1.0
    points[far] = np.sign(points[far]) * (1.0 + np.log(size[far]))
    return points


def take(subset: Subset, points: Floats, keys: list[bytes]) -> Taken:
    """Add points, shape (n, m), dimensionless, to a subset in their order."""
    before, merged, thinned = subset, 0, 0
    for start in range(0, len(points), CHUNK):
        part = slice(start, start + CHUNK)
        subset, same, near = _take_part(subset, points[part], keys[part])
        merged, thinned = merged + same, thinned + near
        if len(subset.keys) > subset.most:
            fewer = _coarser(subset)
            thinned += len(subset.keys) - len(fewer.keys)
            subset = fewer
    kept, had = set(subset.keys), set(before.keys)
    added = [key for key in subset.keys if key not in had]
    return Taken(subset, added, [key for key in before.keys if key not in kept], merged, thinned)


def spaced(points: Floats, reach: float) -> NDArray[np.bool_]:
    """Return which points, shape (n, m), dimensionless, are kept, first come first, shape (n,).

    No two of these are within reach of each other, and all others are of one of them.
    """
    keep = np.ones(len(points), dtype=bool)
    if len(points) < 2:
        return keep
    tree, bound = _tree(points), reach * _EDGE
    nearest = tree.query(points, k=2, p=np.inf, distance_upper_bound=bound)[0][:, 1]
    for place in np.flatnonzero(nearest < np.inf).tolist():
        if keep[place]:
            near = np.array(tree.query_ball_point(points[place], bound, p=np.inf))
            keep[near[near > place]] = False
    return keep


def farthest_first(points: Floats, known: Floats, most: int) -> list[int]:
    """Return places of at most `most` points, each the farthest from the known and those before.

    Both are scaled loads, shapes (n, m) and (k, m), dimensionless (Gonzalez 1985: no choice of as
    many covers the rest twice as well).
    """
    if not len(points):
        return []
    apart = np.full(len(points), np.inf)
    if len(known):
        apart = np.asarray(_tree(known).query(points, p=np.inf)[0])
    chosen: list[int] = []
    for _ in range(min(most, len(points))):
        place = int(np.argmax(apart))
        chosen.append(place)
        apart = np.minimum(apart, np.abs(points - points[place]).max(axis=1))
        apart[place] = -1.0
    return chosen


def _take_part(subset: Subset, points: Floats, keys: list[bytes]) -> tuple[Subset, int, int]:
    """Return the subset with some points, how many are merged and how many are thinned."""
    apart = np.full(len(points), np.inf)
    if subset.keys:
        bound = subset.reach * _EDGE
        apart = _tree(subset.points).query(points, p=np.inf, distance_upper_bound=bound)[0]
    fresh = np.flatnonzero(np.isinf(apart))
    same = int((apart <= MERGE * _EDGE).sum())
    different = fresh[spaced(points[fresh], MERGE)]
    chosen = different
    if subset.reach > MERGE:
        chosen = different[spaced(points[different], subset.reach)]
    merged = same + len(fresh) - len(different)
    thinned = len(points) - merged - len(chosen)
    within = max(subset.within, subset.reach if thinned else MERGE if merged else 0.0)
    after = np.concatenate([subset.points, points[chosen]])
    return (
        replace(
            subset,
            points=after,
            keys=subset.keys + [keys[one] for one in chosen.tolist()],
            within=within,
        ),
        merged,
        thinned,
    )


def _coarser(subset: Subset) -> Subset:
    """Return a subset of a larger reach with at most `TARGET` of the most points."""
    points, keys, reach, within = subset.points, subset.keys, subset.reach, subset.within
    while len(keys) > TARGET * subset.most:
        nearest = _tree(points).query(points, k=2, p=np.inf)[0][:, 1]
        # Three of ten points have a neighbour within this reach: most of these are dropped.
        reach = max(1.1 * reach, float(np.quantile(nearest, 0.3)))
        keep = spaced(points, reach)
        if not keep.all():
            points, within = points[keep], within + reach
            keys = [key for key, kept in zip(keys, keep.tolist(), strict=True) if kept]
    return Subset(points, keys, reach, within, subset.most)


def _tree(points: Floats) -> KDTree:
    """Return a tree that is quick to build: each is queried once, for a few thousand points."""
    return KDTree(points, balanced_tree=False, compact_nodes=False)
