"""The three axes of straight direction influence, and the rows that each of them uses.

Axis i of a cyclic order (i, j, k) has the inputs (F_i, M_j, M_k) and the outputs (u_i, rx, ry, rz).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .compliance import ComplianceFit
from .merging import close_groups, merge
from .rows import ZERO_LOAD, Floats, LoadRange, Rows
from .space import axis_inputs

OffAxis = Literal["correct", "ignore", "exclude"]

# Number of values of a load that show its curvature. An odd response, as most are, is straight
# through three, such as -1, 0 and 1: left-out rows have no error there, and the error between them
# is a quarter of the range.
LEVELS = 4
# Part of the range: smaller differences are a load cell's scatter, not separate values. Loads of a
# composite design that scattered by 1e-6 to 1e-3 of the range counted everything as covered, with
# 97 % of it outside the bars.
MIN_STEP = 0.05


def has_levels(points: Floats) -> bool:
    """Return whether each load that varies over scaled points (n, k) has `LEVELS` values."""
    return all(_levels(column) >= LEVELS for column in points.T if np.ptp(column) > MIN_STEP)


def _levels(values: Floats) -> int:
    """Return the number of groups of values that are `MIN_STEP` of their span apart."""
    count = 0
    last = -np.inf
    step = MIN_STEP * min(float(np.ptp(values)) / 2, 1.0)
    for value in np.sort(values).tolist():
        if value > last + step:
            count += 1
            last = value
    return count


class LoadAxis(NamedTuple):
    """One axis: its name, its load columns (F_i, M_j, M_k) and its output columns."""

    name: str
    inputs: tuple[int, int, int]
    outputs: tuple[int, int, int, int]

    @property
    def others(self) -> list[int]:
        """The columns of the three loads that are not this axis' inputs."""
        return [load for load in range(6) if load not in self.inputs]


AXES = tuple(LoadAxis("xyz"[i], axis_inputs(i), (i, 3, 4, 5)) for i in range(3))


@dataclass(frozen=True)
class AxisRows:
    """The distinct points of one axis, in scaled inputs."""

    axis: LoadAxis
    points: Floats  # (n, 3), dimensionless: inputs over the load range's half widths
    # (n, 6), m and rad: all six outputs, without the off-axis part where the row is multi-axis; the
    # mean of merged rows
    displacement: Floats
    # the indices, in the table's rows, of the rows merged into each point
    members: tuple[tuple[int, ...], ...]
    single_axis: NDArray[np.bool_]  # (n,)
    # (n, 6, 3), m and rad: derivative of the displacement by the scaled inputs; NaN where unknown
    # or multi-axis
    tangent: Floats

    def equals(self, other: AxisRows) -> bool:
        """Return whether all numbers equal another's to the bit; the rows' indices may differ."""
        columns = ("points", "displacement", "single_axis", "tangent")
        return self.axis == other.axis and all(
            getattr(self, name).tobytes() == getattr(other, name).tobytes() for name in columns
        )

    def take(self, mask: NDArray[np.bool_]) -> AxisRows:
        """Return the points that a mask, (n,), picks."""
        return AxisRows(
            self.axis,
            self.points[mask],
            self.displacement[mask],
            tuple(self.members[point] for point in np.flatnonzero(mask)),
            self.single_axis[mask],
            self.tangent[mask],
        )


# Mask of the loads (6) that are not an axis' inputs (3): a product with it shows whether any of
# them acts.
_FOREIGN = np.array([[load in axis.others for axis in AXES] for load in range(6)])


def single_axis_rows(
    rows: Rows, load_range: LoadRange, min_load: float = ZERO_LOAD
) -> NDArray[np.bool_]:
    """Return which rows load which axis alone, by its inputs, shape (n, 3).

    `min_load`: part of the range below which a load counts as zero.
    """
    loaded = np.abs(rows.wrench) > min_load * load_range.scale
    return ~(loaded @ _FOREIGN)


def count_multi_axis(rows: Rows, load_range: LoadRange) -> int:
    """Return the number of rows that load more than one axis by more than a load cell's scatter."""
    return int((~single_axis_rows(rows, load_range, MIN_STEP).any(axis=1)).sum())


def axis_rows(
    rows: Rows, load_range: LoadRange, axis: LoadAxis, fit: ComplianceFit, off_axis: OffAxis
) -> AxisRows:
    """Choose the rows of one axis, subtract their off-axis part, and merge equal points.

    A large number of rows is represented by an even choice of the rows of this axis alone, and one
    of the others. A row that loads this axis alone is used as it is; a row of another axis alone
    never is. A row of several axes follows `off_axis`: "correct" subtracts the fitted compliance
    times its off-axis loads (and leaves the row out if the fit does not know those loads), "ignore"
    uses the row as it is, "exclude" leaves it out.
    """
    inputs, off_loads = list(axis.inputs), list(axis.others)
    of_axis, indices = _usable_rows(rows, load_range, axis, fit, off_axis)
    displacement = rows.displacement[indices]
    if off_axis == "correct":
        loads = np.where(np.isin(np.arange(6), off_loads), rows.wrench[indices], 0.0)
        displacement = np.where(
            of_axis[indices][:, None], displacement, displacement - loads @ fit.matrix.T
        )
    # Multi-axis rows may share a point; `seq` is a row's index here, so `members` are indices.
    merged = merge(
        replace(
            rows.take(indices),
            seq=indices,
            wrench=np.where(np.isin(np.arange(6), inputs), rows.wrench[indices], 0.0),
            displacement=displacement,
            curvature=np.empty((len(indices), 0)),
        ),
        load_range,
    )
    # Sorted, so that the rows' order does not change the result.
    points = merged.rows.wrench[:, inputs] / load_range.scale[inputs] + 0.0
    order = np.lexsort(points.T[::-1])
    ordered = merged.rows.take(order)
    tangent = ordered.compliance[:, :, inputs] * load_range.scale[inputs]
    # The tangent of a multi-axis row is not by the axis' loads alone.
    tangent[~of_axis[ordered.seq]] = np.nan
    return AxisRows(
        axis=axis,
        points=points[order],
        displacement=ordered.displacement,
        members=tuple(merged.members[point] for point in order),
        single_axis=of_axis[ordered.seq],
        tangent=tangent,
    )


def _usable_rows(
    rows: Rows, load_range: LoadRange, axis: LoadAxis, fit: ComplianceFit, off_axis: OffAxis
) -> tuple[NDArray[np.bool_], NDArray[np.intp]]:
    """Return which rows load this axis alone, (n,), and the indices of the rows in use, (k,)."""
    single_axis = single_axis_rows(rows, load_range)
    of_axis = single_axis[:, AXES.index(axis)]
    multi_axis = ~single_axis.any(axis=1) & (off_axis != "exclude")
    if off_axis == "correct":
        off_loads = list(axis.others)
        loaded = np.abs(rows.wrench) > ZERO_LOAD * load_range.scale
        multi_axis &= ~(loaded[:, off_loads] & ~fit.known[off_loads]).any(axis=1)
    scaled = (rows.wrench / load_range.scale)[:, list(axis.inputs)] + 0.0
    single, multi = np.flatnonzero(of_axis), np.flatnonzero(multi_axis)
    single, multi = single[evenly_chosen(scaled[single])], multi[evenly_chosen(scaled[multi])]
    indices = np.sort(np.concatenate([single, multi]))
    if multi_axis.any():
        # At points of single-axis rows only these rows count.
        group = close_groups(scaled[indices])
        chosen = of_axis[indices] | ~np.isin(group, group[of_axis[indices]])
        indices = indices[chosen]
    return of_axis, indices


# Largest number of triangulated points of one axis. A triangulation of n points in three dimensions
# has some 6.7 n tetrahedra: with their arrays 1.5 kB a point, and 45 µs a point to build. A table
# of a million rows would take gigabytes and minutes, for neighbours closer than any response bends.
# So beyond this number a half, a quarter, ... of the points is triangulated, and the others test
# the bars. Three triangulations of this size stay below 300 MB and take some 10 s, and neighbours
# have a distance of a fortieth of the range.
MAX_POINTS = 60_000
# Number of directions whose outermost point is kept, so that the hull is kept: 400 directions are
# 10 degrees apart, and a rounded hull loses a part in 250 between them.
DIRECTIONS = 400
CHUNK = 5000  # points at once: their coordinates along all directions take 20 MB
# Odd factors of Knuth's multiplicative hashing (The Art of Computer Programming 3, 6.4), one for
# each coordinate.
_FACTORS = np.uint64(0x9E3779B97F4A7C15) * np.arange(1, 13, 2, dtype=np.uint64)
_HALF = np.uint64(32)  # half the bits, by which hashes mix their upper bits into the lower ones


def evenly_chosen(points: Floats) -> NDArray[np.bool_]:
    """Return which points (n, 3), dimensionless, represent all points, shape (n,).

    The choice is by a hash of each point alone, so that a new row changes no other row's choice
    until their number passes the next double of `MAX_POINTS`.
    """
    halvings = 0
    while len(points) > MAX_POINTS << halvings:
        halvings += 1
    if not halvings:
        return np.ones(len(points), dtype=bool)
    chosen = hashes(points) >> np.uint64(64 - halvings) == 0

    # The outermost point along each of many directions and each corner of the box.
    corners = np.array(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3)).reshape(3, -1).T
    # Directions spread evenly over the sphere, (DIRECTIONS, 3): Fibonacci's spiral.
    height = 1 - (2 * np.arange(DIRECTIONS) + 1) / DIRECTIONS
    angle = np.pi * (3 - np.sqrt(5)) * np.arange(DIRECTIONS)
    radius = np.sqrt(1 - height**2)
    directions = np.concatenate(
        (corners, np.column_stack((radius * np.cos(angle), radius * np.sin(angle), height)))
    )
    farthest = np.full(len(directions), -np.inf)
    outermost = np.zeros(len(directions), dtype=np.intp)
    for start in range(0, len(points), CHUNK):
        along = directions @ points[start : start + CHUNK].T
        best = along.argmax(axis=1)
        value = along[np.arange(len(best)), best]
        better = value > farthest
        farthest[better], outermost[better] = value[better], start + best[better]
    chosen[outermost] = True
    return chosen


def hashes(numbers: Floats) -> NDArray[np.uint64]:
    """Return a hash of each row of a matrix (k, d), d at most 6, shape (k,); -0.0 counts as 0.0.

    Numbers may have any unit; hashes are dimensionless.
    """
    bits = np.ascontiguousarray(numbers + 0.0).view(np.uint64)
    mixed = (bits ^ (bits >> _HALF)) * _FACTORS[: bits.shape[1]]
    return np.bitwise_xor.reduce(mixed ^ (mixed >> _HALF), axis=1)
