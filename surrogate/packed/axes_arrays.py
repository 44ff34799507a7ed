"""The three axes of straight direction influence as the arrays of a packed table.

Points and simplices are numbered along a space-filling curve, so that what lies close together in
the load range lies close together in the file. A simplex takes 128 bytes, two cache lines. The
kernel finds the simplex of a point so: it starts from the simplex that a regular grid names for the
point's cell and steps through the face opposite the most negative barycentric coordinate (the
visibility walk of Devillers, Pion and Teillaud 2002, which always ends in a Delaunay
triangulation).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import chain
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from ..axes.axes import Axes
from ..axes.axis_table import AxisTable
from ..axes.triangulation import Triangulation, curve_order
from ..table.rows import Floats

SIMPLEX, VERTEX = 16, 9  # doubles of a simplex and of a point: wb_simplex, wb_vertex

Array = NDArray[np.generic]
Indices = NDArray[np.intp]

# Numbers of a simplex' map: the slopes of all barycentric coordinates but the last (3 x 3), and the
# position of the last vertex, where these coordinates are zero.
MAP = 12
# Integers of an axis: dimensions (-1 without a table), first cell of its grid, cells a side.
DIMENSION, FIRST_CELL, CELLS, INTS = 0, 1, 2, 5
# Numbers of an axis: load scale (3), origin (3), basis (3 x 3), largest distance of a point from
# its plane or line, corner of the grid (3), cells per length (3).
SCALE, ORIGIN, BASIS, SLACK, CORNER, DENSITY, FLOATS = 0, 3, 6, 15, 16, 19, 22

# Grid of the walks' starts: with four cells a simplex most walks take one step; a larger grid takes
# longer to make (a microsecond a cell) than it saves.
CELLS_PER_SIMPLEX, MAX_CELLS, MIN_CELLS_PER_SIMPLEX = 4.0, 300_000, 0.5

PER_NUMBER = 1.0  # buckets per number: a search then takes one or two steps


class AxesArrays(NamedTuple):
    """The arrays of the block ``axes`` but for its cuts, by their names: see `arrays`."""

    simplex: Floats
    degenerate: NDArray[np.uint8]
    vertex: Floats
    slopes: Floats
    facets: NDArray[np.int32]
    point_first: NDArray[np.int32]
    simplex_first: NDArray[np.int32]
    facet_first: NDArray[np.int32]
    floats: Floats
    ints: NDArray[np.int32]
    grid: NDArray[np.int32]
    span: Floats
    zero_load: Floats
    member_first: NDArray[np.int32]
    members: NDArray[np.int64]


def axes_arrays(axes: Axes, members: Sequence[tuple[int, ...]]) -> dict[str, Array]:
    """Return the arrays of the axes, of the default space, by their names.

    `members`: the numbers (`seq`) of the rows merged into each row of the axes.
    """
    shapes = {"simplex": [SIMPLEX], "degenerate": [], "vertex": [VERTEX], "slopes": [6, 3]}
    shapes["facets"] = [4]
    parts: dict[str, list[NDArray]] = {name: [np.empty((0, *n))] for name, n in shapes.items()}
    span = np.zeros((3, 3, 2))
    first = np.zeros((4, 3), dtype=np.int32)  # first point, simplex and facet of each axis; ends
    for axis, table in enumerate(axes.tables):
        first[axis + 1] = first[axis]
        if table is None:
            continue
        shape, (points, simplices) = table.triangulation, _order(table)
        facets = _facets(table)
        facets[:, :3] += first[axis, 0]
        facets[:, 3] += first[axis, 1]
        loads = table.rows.points * table.scale
        span[axis] = np.stack((loads.min(axis=0), loads.max(axis=0)), axis=1)
        parts["simplex"].append(_simplices(table, *first[axis, :2].tolist()))
        parts["degenerate"].append(shape.degenerate[simplices])
        vertices = np.concatenate((shape.points[points], table.values[points]), axis=1)
        parts["vertex"].append(vertices)
        parts["slopes"].append(table.slopes[points])
        parts["facets"].append(facets)
        first[axis + 1] += len(points), len(simplices), len(facets)
    joined = {name: np.concatenate(part) for name, part in parts.items()}
    floats, ints, grid = _grids(axes.tables, first[:, 1].tolist())
    member_first, numbers = _row_numbers(axes.tables, members)
    arrays = AxesArrays(
        simplex=joined["simplex"],
        degenerate=joined["degenerate"].astype(np.uint8),
        vertex=joined["vertex"],
        slopes=joined["slopes"],
        facets=joined["facets"].astype(np.int32),
        point_first=first[:, 0].copy(),
        simplex_first=first[:, 1].copy(),
        facet_first=first[:, 2].copy(),
        floats=floats,
        ints=ints,
        grid=grid,
        span=span,
        zero_load=axes.at_zero,
        member_first=member_first,
        members=numbers,
    )
    named: dict[str, Array] = arrays._asdict()
    for moment, cuts in enumerate(axes.cuts):
        for cut in cuts:
            name = f"cut{moment}{cut.column - 1}"
            count = len(cut.state)
            stations = cut.stations if count else np.empty(0)
            named[f"{name}/state"], named[f"{name}/stations"] = cut.state.astype(np.int32), stations
            named[f"{name}/outputs"] = cut.outputs.reshape(count, 2, 6)
            named[f"{name}/bucket"], named[f"{name}/start"] = buckets_of(stations)
    return named


def _grids(
    tables: Sequence[AxisTable | None], first_simplex: list[int]
) -> tuple[Floats, NDArray[np.int32], NDArray[np.int32]]:
    """Return `floats`, `ints` and `grid` of `AxesArrays`."""
    floats = np.zeros((3, FLOATS))
    ints = np.zeros((3, INTS), dtype=np.int32)
    ints[:, DIMENSION] = -1
    grids = [np.empty(0, dtype=np.int32)]
    cells = 0
    for axis, table in enumerate(tables):
        if table is None:
            continue
        numbered = numbered_of(table.triangulation)
        floats[axis], ints[axis] = numbered.floats, numbered.ints
        floats[axis, SCALE : SCALE + 3], ints[axis, FIRST_CELL] = table.scale, cells
        grids.append((numbered.grid + first_simplex[axis]).astype(np.int32))
        cells += len(grids[-1])
    return floats, ints, np.concatenate(grids)


def _row_numbers(
    tables: Sequence[AxisTable | None], members: Sequence[tuple[int, ...]]
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Return `member_first` and `members` of `AxesArrays`."""
    sizes, numbers = [np.zeros(1, dtype=np.intp)], [np.empty(0, dtype=np.int64)]
    for table in tables:
        if table is None:
            continue
        order = _order(table)[0]
        point, entry = _members_of(table.rows.members, order)
        behind, row = _members_of(members, entry)
        numbers.append(row[np.lexsort((row, point[behind]))])
        sizes.append(np.bincount(point[behind], minlength=len(order)))
    return np.cumsum(np.concatenate(sizes)).astype(np.int32), np.concatenate(numbers)


def _order(table: AxisTable) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the old number of each point and of each simplex."""
    numbered = numbered_of(table.triangulation)
    return numbered.point_order, numbered.simplex_order


def _simplices(table: AxisTable, point: int, simplex: int) -> Floats:
    """Return the numbers (m, SIMPLEX) of a table's simplices.

    `point`, `simplex`: the index of the table's first point and simplex among those of all axes.
    """
    numbered = numbered_of(table.triangulation)
    out = np.zeros((len(numbered.simplex), SIMPLEX))
    ints = numbered.simplex.copy()
    corners = table.triangulation.dimension + 1
    ints[:, :corners] += point
    ints[:, corners:4] = 0
    ints[:, 4:] += np.where(ints[:, 4:] >= 0, simplex, 0)
    out[:, :4] = np.ascontiguousarray(ints).view(np.float64)
    out[:, 4:] = numbered.maps
    return out


def _facets(table: AxisTable) -> NDArray[np.intp]:
    """Return the hull's facets (f, 4): vertices and the simplex behind, in their new numbers."""
    shape, (points, simplices) = table.triangulation, _order(table)
    if not shape.dimension:
        return np.zeros((0, 4), dtype=np.intp)
    facets = np.zeros((len(shape.hull), 4), dtype=np.intp)
    facets[:, : shape.dimension] = np.argsort(points)[shape.hull]
    facets[:, 3] = np.argsort(simplices)[shape.behind_hull]
    return facets


def _members_of(
    groups: Sequence[tuple[int, ...]], which: NDArray[np.integer]
) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
    """Return the members of some groups (k,): the index in `which` of each, and the member."""
    sizes = np.fromiter(map(len, groups), np.int64, len(groups))
    members = np.fromiter(chain.from_iterable(groups), np.int64, int(sizes.sum()))
    ends = np.cumsum(sizes)
    counts = sizes[which]
    owner = np.repeat(np.arange(len(which)), counts)
    return owner, members[(ends[which] - np.cumsum(counts))[owner] + np.arange(len(owner))]


class Numbered(NamedTuple):
    """Vertices and simplices numbered along a space-filling curve."""

    maps: Floats  # (m, MAP)
    # (m, 8): four vertices, and the four neighbours across from them, -1 on the hull
    simplex: NDArray[np.int32]
    grid: Indices  # (cells,): for each cell a simplex close by
    # floats, ints: (FLOATS,) and (INTS,): see the columns above; the load scale stays 1
    floats: Floats
    ints: NDArray[np.int32]
    # simplex_order, point_order: (m,) and (n,): the old number of each simplex and point
    simplex_order: Indices
    point_order: Indices


_KNOWN: WeakKeyDictionary[Triangulation, Numbered] = WeakKeyDictionary()
"""Numberings of triangulations in use: versions of a table share those of unchanged axes."""


def numbered_of(shape: Triangulation) -> Numbered:
    """Return a triangulation numbered for walks."""
    if (numbered := _KNOWN.get(shape)) is not None:
        return numbered
    dimension, local = shape.dimension, shape.local_coordinates(shape.points)
    weights = shape.weights if dimension == 3 else shape.weights @ shape.basis.T
    points = curve_order(local)
    simplices = curve_order(local[shape.simplices].mean(axis=1))
    new_point = np.empty(len(points), np.intp)
    new_point[points] = np.arange(len(points))
    new_simplex = np.empty(len(simplices) + 1, np.intp)
    new_simplex[simplices], new_simplex[-1] = np.arange(len(simplices)), -1

    simplex = np.zeros((len(simplices), 8), dtype=np.int32)
    simplex[:, : dimension + 1] = new_point[shape.simplices[simplices]]
    simplex[:, 4:] = -1
    simplex[:, 4 : 5 + dimension] = new_simplex[shape.neighbours[simplices]]
    positions = np.zeros((len(local), 3))
    positions[:, :dimension] = local[points]
    maps = np.zeros((len(simplices), MAP))
    for corner in range(dimension):
        maps[:, 3 * corner : 3 * corner + dimension] = weights[simplices, corner]
    maps[:, 9:] = positions[simplex[:, dimension]]

    floats = np.zeros(FLOATS)
    ints = np.zeros(INTS, dtype=np.int32)
    floats[:3], ints[CELLS : CELLS + 3], ints[DIMENSION] = 1.0, 1, dimension
    floats[ORIGIN : ORIGIN + 3], floats[SLACK] = shape.origin, shape.slack
    floats[BASIS : BASIS + 3 * dimension] = shape.basis.ravel()
    grid = new_simplex[_grid(shape, local, floats, ints)]
    _KNOWN[shape] = Numbered(maps, simplex, grid, floats, ints, simplices, points)
    return _KNOWN[shape]


def _grid(shape: Triangulation, local: Floats, floats: Floats, ints: NDArray[np.int32]) -> Indices:
    """Return the simplex that holds the middle of each cell of a grid over the points.

    A cell outside the hull takes the simplex whose middle is nearest. The grid's frame is written
    to `floats` and `ints`.
    """
    dimension = shape.dimension
    if not dimension:
        return np.zeros(1, dtype=np.intp)
    low, high = local.min(axis=0), local.max(axis=0)
    count = len(shape.simplices)
    cells = max(min(CELLS_PER_SIMPLEX * count, MAX_CELLS), MIN_CELLS_PER_SIMPLEX * count)
    side = max(math.ceil(cells ** (1 / dimension)), 1)
    width = np.maximum(high - low, np.finfo(float).tiny) / side
    floats[CORNER : CORNER + dimension], floats[DENSITY : DENSITY + dimension] = low, 1 / width
    ints[CELLS : CELLS + dimension] = side
    units = np.stack(np.meshgrid(*[np.arange(side) + 0.5] * dimension, indexing="ij"), axis=-1)
    middles = low + units.reshape(-1, dimension) * width
    points = middles if dimension == 3 else shape.origin + middles @ shape.basis
    containing = shape.locate(points)
    sound = np.flatnonzero(~shape.degenerate)
    lost = np.flatnonzero((containing < 0) | shape.degenerate[containing])
    if len(sound) and len(lost):
        centres = shape.points[shape.simplices[sound]].mean(axis=1)
        containing[lost] = sound[KDTree(centres).query(points[lost])[1]]
    return np.maximum(containing, 0)


def buckets_of(numbers: Floats) -> tuple[Floats, NDArray[np.int32]]:
    """Return the frame and the bounds of buckets over ascending numbers, shape (k,).

    A number's bucket is (number - frame[0]) frame[1], as `wb_bucket` of surrogate/kernel computes
    it; the numbers of bucket b have the indices start[b] to start[b + 1]. Shapes (2,) and (b + 1,);
    the frame has the numbers' unit and its inverse.
    """
    count = max(int(len(numbers) * PER_NUMBER), 1)
    low, high = (float(numbers[0]), float(numbers[-1])) if len(numbers) else (0.0, 0.0)
    density = count / (high - low) if high > low else 0.0
    if not np.isfinite(density):
        density = 0.0
    buckets = np.clip((numbers - low) * density, 0, count - 1).astype(np.intp)
    start = np.searchsorted(buckets, np.arange(count + 1)).astype(np.int32)
    start[-1] = len(numbers)
    return np.array([low, density]), start
