"""Farthest-point thinning of a stream of wrenches, in bounded memory and little time.

The wrenches kept are a net: no two are as near as its reach, and each one met is near one kept.
When there are too many the reach grows and some go (the doubling algorithm: Charikar, Chekuri,
Feder and Motwani 1997), so a wrench is looked at once, and never again once another stands for it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from wrenchbook.service.ledger.recordings import MERGE

Floats = NDArray[np.float64]
Places = NDArray[np.intp]

MOST = 10_000  # wrenches of a recording within the load range
MOST_OUTSIDE = 1_000  # beyond it: blows, of which a sketch is enough, take no place from the others
# Thinning goes down to this share, so that it happens once in 2,000 new wrenches, not with each.
TARGET = 0.8
CHUNK = 2_048  # wrenches looked at in one go: each is a tree of its own and one more of the net
LARGEST = 1e300  # scaled loads beyond this count as this: all differences stay finite numbers
_EDGE = 1 + 1e-12  # KDTree's bound is exclusive; a wrench at just the reach counts as near


@dataclass(frozen=True)
class Net:
    """Points no two of which are within reach of each other.

    Attributes
    ----------
    points : ndarray, shape (m, 6), dimensionless
        See `scaled_loads`.
    keys : list of bytes
        The packed wrench of each.
    reach, within : float
        As in `service.ledger.recordings.Tally`.
    most : int
        How many there may be.
    """

    points: Floats = field(default_factory=lambda: np.empty((0, 6)))
    keys: list[bytes] = field(default_factory=list)
    reach: float = MERGE
    within: float = 0.0
    most: int = MOST


@dataclass(frozen=True)
class Taken:
    """What a block has done to a net: the net after it, and what is new, gone, and stood for."""

    net: Net
    added: list[bytes]
    dropped: list[bytes]
    merged: int
    thinned: int


def scaled_loads(wrenches: Floats, scale: Floats) -> Floats:
    """Return wrenches (n, 6), N and N·m, as points (n, 6), dimensionless: by their scale (6,).

    Beyond the scale a load s counts as 1 + ln s, so that it is near what differs from it by a
    share of itself: a few blows a million times too hard would else be all that thinning sees.
    """
    with np.errstate(over="ignore"):
        points = np.clip(wrenches / scale, -LARGEST, LARGEST)
    size = np.abs(points)
    far = size > 1.0
    points[far] = np.sign(points[far]) * (1.0 + np.log(size[far]))
    return points


def take(net: Net, points: Floats, keys: list[bytes]) -> Taken:
    """Take points, shape (n, 6), dimensionless, into a net in their order."""
    before, merged, thinned = net, 0, 0
    for start in range(0, len(points), CHUNK):
        part = slice(start, start + CHUNK)
        net, same, near = _take_part(net, points[part], keys[part])
        merged, thinned = merged + same, thinned + near
        if len(net.keys) > net.most:
            fewer = _coarser(net)
            thinned += len(net.keys) - len(fewer.keys)
            net = fewer
    kept, had = set(net.keys), set(before.keys)
    added = [key for key in net.keys if key not in had]
    return Taken(net, added, [key for key in before.keys if key not in kept], merged, thinned)


def spaced(points: Floats, reach: float) -> NDArray[np.bool_]:
    """Return which points, shape (n, 6), dimensionless, are kept, first come first, shape (n,).

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

    Both are scaled loads, shapes (n, 6) and (k, 6), dimensionless (Gonzalez 1985: no choice of as
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


def _take_part(net: Net, points: Floats, keys: list[bytes]) -> tuple[Net, int, int]:
    """Return the net with some points, how many are merged, how many another stands for."""
    apart = np.full(len(points), np.inf)
    if net.keys:
        bound = net.reach * _EDGE
        apart = _tree(net.points).query(points, p=np.inf, distance_upper_bound=bound)[0]
    fresh = np.flatnonzero(np.isinf(apart))
    same = int((apart <= MERGE * _EDGE).sum())
    different = fresh[spaced(points[fresh], MERGE)]
    chosen = different
    if net.reach > MERGE:
        chosen = different[spaced(points[different], net.reach)]
    merged = same + len(fresh) - len(different)
    thinned = len(points) - merged - len(chosen)
    within = max(net.within, net.reach if thinned else MERGE if merged else 0.0)
    after = np.concatenate([net.points, points[chosen]])
    return (
        replace(
            net, points=after, keys=net.keys + [keys[one] for one in chosen.tolist()], within=within
        ),
        merged,
        thinned,
    )


def _coarser(net: Net) -> Net:
    """Return a net of a larger reach with at most `TARGET` of the most points."""
    points, keys, reach, within = net.points, net.keys, net.reach, net.within
    while len(keys) > TARGET * net.most:
        nearest = _tree(points).query(points, k=2, p=np.inf)[0][:, 1]
        # What three of ten points have another within: most of these go, few others.
        reach = max(1.1 * reach, float(np.quantile(nearest, 0.3)))
        keep = spaced(points, reach)
        if not keep.all():
            points, within = points[keep], within + reach
            keys = [key for key, kept in zip(keys, keep.tolist(), strict=True) if kept]
    return Net(points, keys, reach, within, net.most)


def _tree(points: Floats) -> KDTree:
    """Return a tree that is quick to make: it is asked for a few thousand points, once."""
    return KDTree(points, balanced_tree=False, compact_nodes=False)
