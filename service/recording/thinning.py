"""Farthest-point thinning of a stream of wrenches, in bounded memory and little time.

It keeps a subset of the wrenches: no two are within `radius` of each other, and every wrench lies
within `within` of a kept one. When the subset is full, `radius` grows and some are dropped (the
doubling algorithm: Charikar, Chekuri, Feder and Motwani 1997), so each wrench is examined once.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from wrenchbook.surrogate.table.rows import NEAR, Floats
from wrenchbook.surrogate.table.space import DEFAULT

MAX_INSIDE = 10_000  # wrenches of a recording within the load range
MAX_OUTSIDE = 1_000  # wrenches beyond the range: impacts, counted separately
# Part of the limit that remains after thinning, which then happens once in 2,000 new wrenches, not
# with each.
TARGET = 0.8
# Quantile of the distances to the nearest neighbour that becomes the next radius: three of ten
# points then have a neighbour within it, and most of the three are dropped.
DROPPED = 0.3
# Least growth of the radius in a step: thinning ends even if many points are equally far apart.
MIN_GROWTH = 1.1
CHUNK = 2_048  # wrenches at once: each chunk takes its own tree and one of the subset
LARGEST = 1e300  # scaled loads beyond this count as equal to it, so that all differences are finite
_EDGE = 1 + 1e-12  # KDTree's bound is exclusive, but a wrench exactly at the radius counts as near


@dataclass(frozen=True)
class Subset:
    """Points (m, n), dimensionless (see `scaled_loads`), no two within `radius` of each other.

    `keys` has the packed wrench of each; every offered wrench is `within` this distance of one;
    there may be `limit` of them.
    """

    points: Floats = field(default_factory=lambda: np.empty((0, len(DEFAULT.inputs))))
    keys: list[bytes] = field(default_factory=list)
    radius: float = NEAR
    within: float = 0.0
    limit: int = MAX_INSIDE


@dataclass(frozen=True)
class Step:
    """The subset after a block: keys added and dropped, numbers of merged and thinned wrenches."""

    subset: Subset
    added: list[bytes]
    dropped: list[bytes]
    merged: int
    thinned: int


def scaled_loads(wrenches: Floats, scale: Floats) -> Floats:
    """Return wrenches (n, m), N and N·m, over their scale (m,) as points (n, m), dimensionless.

    Beyond the scale a load of s scales counts as 1 + ln s, so that distances are relative there:
    otherwise a few impacts a million times too hard would determine the radius.
    """
    with np.errstate(over="ignore"):
        points = np.clip(wrenches / scale, -LARGEST, LARGEST)
    size = np.abs(points)
    far = size > 1.0
    points[far] = np.sign(points[far]) * (1.0 + np.log(size[far]))
    return points


def take(subset: Subset, points: Floats, keys: list[bytes]) -> Step:
    """Return the subset with points, shape (n, m), dimensionless, added in their order."""
    before = subset
    all_merged = 0
    all_thinned = 0
    for start in range(0, len(points), CHUNK):
        chunk = points[start : start + CHUNK]
        distance = np.full(len(chunk), np.inf)
        if subset.keys:
            bound = subset.radius * _EDGE
            distance = _tree(subset.points).query(chunk, p=np.inf, distance_upper_bound=bound)[0]

        fresh = np.flatnonzero(np.isinf(distance))
        chosen = different = fresh[spaced(chunk[fresh], NEAR)]
        if subset.radius > NEAR:
            chosen = different[spaced(chunk[different], subset.radius)]
        merged = int((distance <= NEAR * _EDGE).sum()) + len(fresh) - len(different)
        thinned = len(chunk) - merged - len(chosen)

        subset = Subset(
            np.concatenate([subset.points, chunk[chosen]]),
            subset.keys + [keys[start + index] for index in chosen.tolist()],
            subset.radius,
            max(subset.within, subset.radius if thinned else NEAR if merged else 0.0),
            subset.limit,
        )
        if len(subset.keys) > subset.limit:
            count = len(subset.keys)
            subset = _coarser(subset)
            thinned += count - len(subset.keys)
        all_merged, all_thinned = all_merged + merged, all_thinned + thinned

    now, had = set(subset.keys), set(before.keys)
    added = [key for key in subset.keys if key not in had]
    dropped = [key for key in before.keys if key not in now]
    return Step(subset, added, dropped, all_merged, all_thinned)


def spaced(points: Floats, radius: float) -> NDArray[np.bool_]:
    """Return which points (n, m), dimensionless, are kept, earlier ones first: a mask (n,).

    No two kept points are within `radius` of each other, and every other point is within it of one.
    """
    keep = np.ones(len(points), dtype=bool)
    if len(points) < 2:
        return keep
    tree = _tree(points)
    bound = radius * _EDGE
    nearest = tree.query(points, k=2, p=np.inf, distance_upper_bound=bound)[0][:, 1]
    for index in np.flatnonzero(nearest < np.inf).tolist():
        if keep[index]:
            near = np.array(tree.query_ball_point(points[index], bound, p=np.inf))
            keep[near[near > index]] = False
    return keep


def farthest_first(points: Floats, known: Floats, count: int) -> list[int]:
    """Return the indices of at most `count` points, each farthest from the known and earlier ones.

    `points` (n, m) and `known` (k, m) are scaled loads, dimensionless. Gonzalez 1985: no choice of
    as many points has less than half the distance to the others.
    """
    if not len(points):
        return []
    distance = np.full(len(points), np.inf)
    if len(known):
        distance = np.asarray(_tree(known).query(points, p=np.inf)[0])
    chosen: list[int] = []
    for _ in range(min(count, len(points))):
        index = int(np.argmax(distance))
        chosen.append(index)
        distance = np.minimum(distance, np.abs(points - points[index]).max(axis=1))
        distance[index] = -1.0
    return chosen


def _coarser(subset: Subset) -> Subset:
    """Return a subset of a larger radius with at most `TARGET` of the limit's points."""
    points, keys, radius, within = subset.points, subset.keys, subset.radius, subset.within
    while len(keys) > TARGET * subset.limit:
        nearest = _tree(points).query(points, k=2, p=np.inf)[0][:, 1]
        radius = max(MIN_GROWTH * radius, float(np.quantile(nearest, DROPPED)))
        keep = spaced(points, radius)
        if not keep.all():
            points = points[keep]
            within = within + radius
            keys = [key for key, is_far in zip(keys, keep.tolist(), strict=True) if is_far]
    return Subset(points, keys, radius, within, subset.limit)


def _tree(points: Floats) -> KDTree:
    """Return a tree that is built quickly: it is queried once, for a few thousand points."""
    return KDTree(points, balanced_tree=False, compact_nodes=False)
