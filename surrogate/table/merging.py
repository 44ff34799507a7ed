"""Rows at the same wrench: their groups, their mean, and their contradictions.

The slopes and curvatures between two rows at almost one wrench are noise: such rows are merged, and
their difference is the uncertainty. A row beyond the load range answers at its own wrench only: one
row at 25 times the range makes simplices that take most of it, and changes every fit.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from scipy.special import ndtri

from ..calibration import LEVEL
from .rows import NEAR, SOLVED, ZERO_LOAD, Floats, LoadRange, Rows

DIRECTIONS = 3  # with three, nine tenths of 30,000 rows have no neighbour along one of them
# Factor on a distance along a direction: the rounding of loads, 2e-16, over a distance of 1e-6.
ROUNDING_FACTOR = 1 + 1e-6
# Decimals of scaled loads: rows that agree to these decimals are one, without a distance.
EQUAL_DECIMALS = 12
MAX_PAIRS = 10_000_000  # pairs of near rows, each counted twice: 80 MB
WINDOW = NEAR * ROUNDING_FACTOR  # distance of keys of wrenches that may be near each other
# The components of the direction of the keys of `RowIndex` are roots of primes, so that the steps
# of no two loads cancel.
_PRIMES = [k for k in range(2, 90) if all(k % divisor for divisor in range(2, k))]

MIN_CONFLICT = 1e-6  # part of an output's range: rounding in a file stays below it
MAX_LISTED = 50  # conflicts listed in a summary, which counts all of them


class Observations(NamedTuple):
    """Measured values of unknown uncertainty behind each row and output, shape (n, 6).

    Their scatter and the likelihood of a kriging show their noise.
    """

    number: Floats  # 0 where an uncertainty is stated, or a value is solved
    scatter: Floats  # m^2 and rad^2: sum of their squared differences from their mean

    def take(self, indices: NDArray[np.intp]) -> Observations:
        """Return the observations of the rows with these indices, shape (k,)."""
        return Observations(self.number[indices], self.scatter[indices])


class Merged(NamedTuple):
    """Rows of distinct wrenches."""

    # Displacement, tangent and curvature are the mean of the merged rows. The uncertainty is their
    # largest, or half the spread of their displacements if that is larger. Number and wrench are
    # those of one of them.
    rows: Rows
    members: tuple[tuple[int, ...], ...]  # the numbers (`seq`) of the rows merged into each row
    within: NDArray[np.bool_]  # (n,): which rows lie within the load range
    # (rows before merging,): index, in `rows`, of the row into which each was merged.
    owner: NDArray[np.intp]
    observations: Observations  # the observations merged into each row

    def usable(self) -> tuple[Rows, tuple[tuple[int, ...], ...], Observations]:
        """Return the rows within the load range, their members and observations."""
        if self.within.all():
            return self.rows, self.members, self.observations
        inside = np.flatnonzero(self.within)
        members = tuple(self.members[index] for index in inside)
        return self.rows.take(inside), members, self.observations.take(inside)


def merge(rows: Rows, load_range: LoadRange) -> Merged:
    """Merge rows, in ascending order of `seq`, whose wrenches lie within 1e-6 of the range.

    A row beyond the range never merges with one within it.
    """
    within, owner = _groups(rows, load_range)
    sizes = np.bincount(owner)
    repeated_groups = np.flatnonzero(sizes > 1)
    present = np.isfinite(rows.displacement)
    is_exact = rows.is_solved | rows.has_tangent
    is_known = present & ((rows.uncertainty > 0) | is_exact[:, None])
    number = np.where(present & ~is_known, 1.0, 0.0)
    observations = Observations(number, np.zeros_like(number))
    if not len(repeated_groups):
        return Merged(rows, tuple(zip(rows.seq.tolist(), strict=True)), within, owner, observations)

    # The wrench is that of the row with the fewest loads, so that a single-axis row stays
    # single-axis, and zero load stays zero load. Of equal rows the outermost counts, so that the
    # hull does not shrink.
    scaled = rows.wrench / load_range.scale
    loads = (np.abs(scaled) > ZERO_LOAD).sum(axis=1)
    order = np.lexsort((rows.seq, -(scaled**2).sum(axis=1), loads, owner))
    first = order[np.cumsum(sizes) - sizes]

    order, starts = _repeated(owner)
    columns = _merged_columns(rows, order, starts)
    merged = {name: np.array(getattr(rows, name)[first]) for name in columns}
    for name, values in columns.items():
        merged[name][repeated_groups] = values
    members = list(zip(rows.seq[first].tolist(), strict=True))
    numbers = np.split(rows.seq[order], starts[1:])
    for index, group in zip(repeated_groups.tolist(), numbers, strict=True):
        members[index] = tuple(group.tolist())

    mean = columns["displacement"].repeat(sizes[repeated_groups], axis=0)
    squares = np.where(present[order], rows.displacement[order] - mean, 0.0) ** 2
    unknown = ~np.logical_or.reduceat(is_known[order], starts)
    observations = observations.take(first)
    number = np.add.reduceat(present[order], starts, dtype=float)
    observations.number[repeated_groups] = np.where(unknown, number, 0)
    scatter = np.add.reduceat(squares, starts)
    observations.scatter[repeated_groups] = np.where(unknown, scatter, 0.0)
    merged_rows = replace(rows.take(first), **merged)
    return Merged(merged_rows, tuple(members), within[first], owner, observations)


def _merged_columns(
    rows: Rows, order: NDArray[np.intp], starts: NDArray[np.intp]
) -> dict[str, NDArray[Any]]:
    """Return the columns of each group that differ from those of its first row; see `_repeated`."""
    repeated_rows = rows.take(order)
    displacement = repeated_rows.displacement
    present = np.isfinite(displacement)
    high = np.maximum.reduceat(np.where(present, displacement, -np.inf), starts)
    low = np.minimum.reduceat(np.where(present, displacement, np.inf), starts)
    largest = np.maximum.reduceat(np.nan_to_num(repeated_rows.uncertainty), starts)
    # A merged row is solved only if all its rows are; else it has the first source of another kind.
    count = len(repeated_rows)
    measured = np.where(repeated_rows.is_solved, count, np.arange(count))
    sources = np.append(repeated_rows.source, SOLVED)
    return {
        "displacement": _means(displacement, starts, ()),
        "uncertainty": np.maximum(np.where(high > low, high - low, 0.0) / 2, largest),
        "compliance": _means(repeated_rows.compliance, starts, (1, 2)),
        "curvature": _means(repeated_rows.curvature, starts, (1,)),
        "source": sources[np.minimum.reduceat(measured, starts)],
    }


class RowIndex:
    """The nearest row of each wrench, if that is within 1e-6 of the range in each load.

    Of several rows of one wrench the first counts. The key of a wrench is its position along a
    direction whose components have the sum 1: wrenches within `NEAR` in each load have keys within
    `NEAR`, and few others do.

    `wrenches` (n, 6), N and N·m.
    `scale` (6,), N and N·m: scale of the load range.
    `keys` (m,): position of each distinct wrench along the direction, ascending, dimensionless.
    `order` (m,): the row of each key.
    `rates` (6,), 1/N and 1/(N·m): slope of the key by each load.
    """

    def __init__(self, wrenches: Floats, scale: Floats) -> None:
        self._wrenches = wrenches
        self._scale = scale
        roots = np.sqrt(np.array(_PRIMES[: len(scale)], dtype=float))
        self.rates = (roots / roots.sum()) / scale
        keys = wrenches @ self.rates
        order = np.argsort(keys, kind="stable")
        ordered = wrenches[order]
        first = np.ones(len(order), dtype=bool)
        first[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
        self.order: NDArray[np.intp] = order[first]
        self.keys: Floats = keys[self.order]

    def indices(self, wrenches: Floats) -> NDArray[np.intp]:
        """Return the row of each wrench (k, 6), N and N·m, shape (k,); -1 without a near row."""
        indices = np.full(len(wrenches), -1, dtype=np.intp)
        with np.errstate(over="ignore", invalid="ignore"):  # of a load of 1e300
            keys = wrenches @ self.rates
            first = np.searchsorted(self.keys, keys - WINDOW)
            last = np.searchsorted(self.keys, keys + WINDOW, side="right")
        for index in np.flatnonzero(first < last).tolist():
            rows = np.sort(self.order[first[index] : last[index]])
            distances = (np.abs(self._wrenches[rows] - wrenches[index]) / self._scale).max(axis=1)
            nearest = np.argmin(distances)  # of equally near rows the first
            if distances[nearest] <= NEAR:
                indices[index] = rows[nearest]
        return indices


def repeated(rows: Rows, load_range: LoadRange) -> list[NDArray[np.intp]]:
    """Return the rows of each wrench that several rows have: indices, shape (k,), ascending."""
    order, starts = _repeated(_groups(rows, load_range)[1])
    return np.split(order, starts[1:]) if len(starts) else []


def row_conflicts(
    rows: Rows, load_range: LoadRange, noise: Floats | float = np.nan
) -> dict[str, Any]:
    """Return repeated wrenches for a coverage summary: their count, and the contradictory ones.

    Rows of a wrench disagree if an output's spread is over twice the largest stored uncertainty
    plus a millionth of the output's range: two such rows cannot both be right. Readings without a
    stated uncertainty disagree only if the spread is also larger than noise causes anywhere in the
    table, at the level of error bars.

    `noise` (m,), m and rad: 95 % half width of one reading's noise; NaN where unknown.
    """
    groups = repeated(rows, load_range)
    pairs = sum(len(group) * (len(group) - 1) for group in groups) / 2
    # Bonferroni's bound of the difference of two readings, over all pairs.
    by_chance = ndtri(1 - (1 - LEVEL) / (2 * max(pairs, 1.0))) / ndtri((1 + LEVEL) / 2)
    by_noise = np.nan_to_num(np.sqrt(2) * by_chance * noise)
    is_exact = (rows.is_solved | rows.has_tangent)[:, None]
    is_reading = ~is_exact & ~(rows.uncertainty > 0)
    rounding = MIN_CONFLICT * np.abs(np.nan_to_num(rows.displacement)).max(axis=0, initial=0.0)
    names = rows.space.output_names
    conflicts = []
    for indices in groups:
        displacements = rows.displacement[indices]
        # NaN where no row measured the output.
        spread = np.fmax.reduce(displacements) - np.fmin.reduce(displacements)
        stated = 2 * np.nan_to_num(rows.uncertainty[indices]).max(axis=0)
        of_readings = np.where(is_reading[indices].any(axis=0), by_noise, 0.0)
        allowed = np.maximum(stated, of_readings) + rounding
        over = np.flatnonzero(spread > allowed)
        if len(over):
            wrench = rows.wrench[indices[0]].tolist()
            conflicts.append(
                {
                    "rows": rows.seq[indices].tolist(),
                    "wrench": dict(zip(rows.space.input_names, wrench, strict=True)),
                    "spread": {names[output]: float(spread[output]) for output in over},
                }
            )
    return {
        "conflicts": conflicts[:MAX_LISTED],
        "conflicting_wrenches": len(conflicts),
        "repeated_wrenches": len(groups),
    }


def _groups(rows: Rows, load_range: LoadRange) -> tuple[NDArray[np.bool_], NDArray[np.intp]]:
    """Return which rows lie within the range, and each row's group of rows at one wrench."""
    within = load_range.holds(rows.wrench)
    scaled = rows.wrench / load_range.scale
    return within, close_groups(np.column_stack((scaled, np.where(within, 0.0, 1.0))))


def close_groups(points: Floats) -> NDArray[np.intp]:
    """Return the group of each scaled point, shape (n, d) -> (n,): 0, 1, ... by first appearance.

    Points within 1e-6 of each other in every coordinate, by themselves or by others between them,
    are one group. Points are dimensionless.
    """
    if not len(points):
        return np.empty(0, dtype=np.intp)
    keys = np.round(points, EQUAL_DECIMALS) + 0.0  # -0.0 becomes 0.0
    # The distinct points in lexical order, and the index of each point in them. `numpy.unique`
    # along an axis does the same, but compares bytes and blocks all other threads.
    order = np.lexsort(keys.T[::-1])
    ordered = keys[order]
    new = np.ones(len(keys), dtype=bool)
    new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    group = np.empty(len(keys), dtype=np.intp)
    group[order] = np.cumsum(new) - 1
    distinct = ordered[new]

    near, n_pairs = _maybe_near(distinct)
    # Readings of a held load are dense. Readings of one cell are one group, represented by its
    # first reading; cells grow until the remaining pairs fit into memory.
    first = np.arange(len(near))  # reading of each cell
    cell = np.arange(len(near))
    edge = NEAR
    tree = KDTree(distinct[near])
    while n_pairs > MAX_PAIRS and tree.count_neighbors(tree, NEAR, p=np.inf) > MAX_PAIRS:
        cells = np.floor(distinct[near] / edge)
        _, first, cell = np.unique(cells, axis=0, return_index=True, return_inverse=True)
        tree = KDTree(distinct[near[first]])
        edge = 2 * edge
    pairs = near[first[tree.query_pairs(NEAR, p=np.inf, output_type="ndarray")]]
    pairs = np.concatenate((pairs, np.stack((near, near[first[cell.reshape(-1)]]), axis=1)))

    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(distinct),) * 2)
    label = np.asarray(connected_components(links, directed=False)[1])[group]
    _, first, number = np.unique(label, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.intp)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[number.reshape(-1)]


def _maybe_near(points: Floats) -> tuple[NDArray[np.intp], int]:
    """Return the points, (n, d), that may have a near point, and the largest number of near pairs.

    Points that are near each other are near along any direction; few others are near along several
    directions.
    """
    remaining = np.arange(len(points))
    n_pairs = 0
    directions = np.random.default_rng(0).uniform(0.5, 1.0, (DIRECTIONS, points.shape[1]))
    for direction in directions:
        along = points[remaining] @ direction
        order = np.argsort(along)
        extent = NEAR * direction.sum() * ROUNDING_FACTOR
        ends = np.searchsorted(along[order], along[order] + extent, side="right")
        after = ends - np.arange(1, len(order) + 1)  # points within the extent
        n_pairs = 2 * int(after.sum())
        is_close = np.zeros(len(remaining), dtype=bool)
        is_close[order[after > 0]] = True
        is_close[order[1:][after[:-1] > 0]] = True
        remaining = remaining[is_close]
    return remaining, n_pairs


def _repeated(owner: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the rows of all groups of several rows, group by group, and each group's start."""
    sizes = np.bincount(owner)
    order = np.argsort(owner, kind="stable")
    counts = sizes[sizes > 1]
    return order[sizes[owner[order]] > 1], np.cumsum(counts) - counts


def _means(values: Floats, starts: NDArray[np.intp], axes: tuple[int, ...]) -> Floats:
    """Return each group's mean, (k, ...), of entries that are known along `axes`; else NaN."""
    known = np.asarray(np.isfinite(values).all(axis=axes, keepdims=True))
    count = np.add.reduceat(known, starts, dtype=float)
    total = np.add.reduceat(np.where(known, values, 0.0), starts)
    return np.where(count > 0, total / np.maximum(count, 1.0), np.nan)
