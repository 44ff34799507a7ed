"""A triangulation laid out for walks: numbered along a curve, with a grid to start from.

The kernel finds the simplex of a point so: it starts from the simplex that a regular grid names for
the point's cell and steps through the face opposite the most negative barycentric coordinate (the
visibility walk of Devillers, Pion and Teillaud 2002, which always ends in a Delaunay
triangulation). With vertices and simplices numbered along a space-filling curve, one query of a
batch reads what the one before it has brought into the cache.
"""

from __future__ import annotations

import math
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from ..axes.triangulation import Triangulation, curve_order
from ..table.rows import Floats

Indices = NDArray[np.intp]

# Numbers of a simplex' map: the slopes of all barycentric coordinates but the last (3 x 3), and the
# place of the last vertex, where those are zero.
MAP = 12
# Whole numbers of an axis: dimensions (-1 without a table), first cell of its grid, cells a side.
DIMENSION, FIRST_CELL, CELLS, INTS = 0, 1, 2, 5
# Numbers of an axis: load scale (3), origin (3), basis (3 x 3), how far off its plane or line a
# point may lie, corner of the grid (3), cells per length (3).
SCALE, ORIGIN, BASIS, SLACK, CORNER, DENSITY, FLOATS = 0, 3, 6, 15, 16, 19, 22

# Of the grid that starts walks: with four cells a simplex most walks take one step; a large grid
# takes longer to make (a microsecond a cell) than it saves.
CELLS_PER_SIMPLEX, MOST_CELLS, LEAST_PER_SIMPLEX = 4.0, 300_000, 0.5

PER_NUMBER = 1.0  # buckets: a search then takes one or two steps


class Numbered(NamedTuple):
    """Vertices and simplices numbered along a space-filling curve.

    Attributes
    ----------
    maps : ndarray, shape (m, MAP)
    simplex : ndarray of int32, shape (m, 8)
        Four vertices, and the four neighbours across from them, -1 on the hull.
    grid : ndarray of int, shape (cells,)
        For each cell a simplex close by.
    floats, ints : ndarray, shape (FLOATS,) and (INTS,)
        See the columns above; the load scale is left at one.
    simplex_order, point_order : ndarray of int, shape (m,) and (n,)
        The old number of each simplex and point.
    """

    maps: Floats
    simplex: NDArray[np.int32]
    grid: Indices
    floats: Floats
    ints: NDArray[np.int32]
    simplex_order: Indices
    point_order: Indices


_KNOWN: WeakKeyDictionary[Triangulation, Numbered] = WeakKeyDictionary()
"""Of triangulations that are in use: versions of a table share those of unchanged axes."""


def numbered_of(shape: Triangulation) -> Numbered:
    """Return a triangulation laid out for walks."""
    found = _KNOWN.get(shape)
    if found is None:
        flat, dimension = shape.flattened(shape.points), shape.dimension
        weights = shape.weights if dimension == 3 else shape.weights @ shape.basis.T
        points, way = curve_order(flat), curve_order(flat[shape.simplices].mean(axis=1))
        new_point, new_simplex = np.empty(len(points), np.intp), np.empty(len(way) + 1, np.intp)
        new_point[points] = np.arange(len(points))
        new_simplex[way], new_simplex[-1] = np.arange(len(way)), -1
        simplex = np.zeros((len(way), 8), dtype=np.int32)
        simplex[:, : dimension + 1] = new_point[shape.simplices[way]]
        simplex[:, 4:] = -1
        simplex[:, 4 : 5 + dimension] = new_simplex[shape.neighbours[way]]
        place = np.zeros((len(flat), 3))
        place[:, :dimension] = flat[points]
        maps = np.zeros((len(way), MAP))
        for corner in range(dimension):
            maps[:, 3 * corner : 3 * corner + dimension] = weights[way, corner]
        maps[:, 9:] = place[simplex[:, dimension]]
        floats, ints = np.zeros(FLOATS), np.zeros(INTS, dtype=np.int32)
        floats[:3], ints[CELLS : CELLS + 3], ints[DIMENSION] = 1.0, 1, dimension
        floats[ORIGIN : ORIGIN + 3], floats[SLACK] = shape.origin, shape.slack
        floats[BASIS : BASIS + 3 * dimension] = shape.basis.ravel()
        grid = new_simplex[_grid(shape, flat, floats, ints)]
        found = _KNOWN[shape] = Numbered(maps, simplex, grid, floats, ints, way, points)
    return found


def _grid(shape: Triangulation, flat: Floats, floats: Floats, ints: NDArray[np.int32]) -> Indices:
    """Return the simplex that holds the middle of each cell of a grid over the points.

    A cell outside the hull takes the simplex whose middle is nearest. The grid's frame is written
    to `floats` and `ints`.
    """
    dimension = shape.dimension
    if not dimension:
        return np.zeros(1, dtype=np.intp)
    low, high = flat.min(axis=0), flat.max(axis=0)
    count = len(shape.simplices)
    cells = max(min(CELLS_PER_SIMPLEX * count, MOST_CELLS), LEAST_PER_SIMPLEX * count)
    side = max(math.ceil(cells ** (1 / dimension)), 1)
    width = np.maximum(high - low, np.finfo(float).tiny) / side
    floats[CORNER : CORNER + dimension], floats[DENSITY : DENSITY + dimension] = low, 1 / width
    ints[CELLS : CELLS + dimension] = side
    places = np.stack(np.meshgrid(*[np.arange(side) + 0.5] * dimension, indexing="ij"), axis=-1)
    middles = low + places.reshape(-1, dimension) * width
    points = middles if dimension == 3 else shape.origin + middles @ shape.basis
    found = shape.locate(points)
    sound = np.flatnonzero(~shape.degenerate)
    lost = np.flatnonzero((found < 0) | shape.degenerate[found])
    if len(sound) and len(lost):
        centres = shape.points[shape.simplices[sound]].mean(axis=1)
        found[lost] = sound[KDTree(centres).query(points[lost])[1]]
    return np.maximum(found, 0)


def buckets_of(numbers: Floats) -> tuple[Floats, NDArray[np.int32]]:
    """Return the frame and the bounds of buckets over ascending numbers, shape (k,).

    A number's bucket is (number - frame[0]) frame[1], as `wb_bucket` of surrogate/kernel computes
    it; those of bucket b have the places start[b] to start[b + 1]. Shapes (2,) and (b + 1,); the
    frame has the numbers' unit and its inverse.
    """
    count = max(int(len(numbers) * PER_NUMBER), 1)
    low, high = (float(numbers[0]), float(numbers[-1])) if len(numbers) else (0.0, 0.0)
    density = count / (high - low) if high > low else 0.0
    if not np.isfinite(density):
        density = 0.0
    places = np.clip((numbers - low) * density, 0, count - 1).astype(np.intp)
    start = np.searchsorted(places, np.arange(count + 1)).astype(np.int32)
    start[-1] = len(numbers)
    return np.array([low, density]), start
