"""A triangulation laid out for walks: numbered along a curve, with a grid to start from.

The kernel finds the simplex of a point so: it starts from the simplex that a regular grid names for
the point's cell and steps through the face opposite the most negative barycentric coordinate (the
visibility walk of Devillers, Pion and Teillaud 2002, which always ends in a Delaunay
triangulation). With vertices and simplices numbered along a space-filling curve, one query of a
batch reads what the one before it has brought into the cache.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..table.rows import Floats
from .morton import curve_order

Indices = NDArray[np.intp]

# Numbers of a simplex' map: the slopes of all barycentric coordinates but the last (3 x 3), and the
# place of the last vertex, where those are zero.
MAP = 12
# Columns of a simplex: four vertices, the four neighbours across from them, and how sound it is.
NEIGHBOUR, STATE, SIMPLEX = 4, 8, 9
# Whole numbers of an axis: dimensions (-1 without a table), first cell of its grid, cells a side.
DIMENSION, FIRST_CELL, CELLS, AXIS_INTS = 0, 1, 2, 5
# Numbers of an axis: load scale (3), origin (3), basis (3 x 3), how far off its plane or line a
# point may lie, corner of the grid (3), cells per length (3).
SCALE, ORIGIN, BASIS, SLACK, CORNER, DENSITY, AXIS_FLOATS = 0, 3, 6, 15, 16, 19, 22
DEGENERATE = 2  # the state of a simplex without volume: walks stop there

CELLS_PER_SIMPLEX = 0.5  # of a grid that starts walks: most then take one or two steps


class Numbered(NamedTuple):
    """Vertices and simplices numbered along a space-filling curve.

    Attributes
    ----------
    maps : ndarray, shape (m, MAP)
    simplex : ndarray of int32, shape (m, SIMPLEX)
    grid : ndarray of int32, shape (cells,)
        For each cell a simplex close by.
    floats, ints : ndarray, shape (AXIS_FLOATS,) and (AXIS_INTS,)
        See the columns above; the load scale is left at one.
    simplex_order, point_order : ndarray of int, shape (m,) and (n,)
        The old number of each simplex and point.
    place : ndarray, shape (n, 3), dimensionless
        The points in the triangulation's own coordinates, in their new order.
    """

    maps: Floats
    simplex: NDArray[np.int32]
    grid: NDArray[np.int32]
    floats: Floats
    ints: NDArray[np.int64]
    simplex_order: Indices
    point_order: Indices
    place: Floats


def number(
    flat: Floats,
    simplices: Indices,
    neighbours: Indices,
    slopes: Floats,
    degenerate: NDArray[np.bool_],
    frame: tuple[Floats, Floats, float],
) -> Numbered:
    """Lay out the points (n, d) and simplices (m, d + 1) of a triangulation for walks.

    Parameters
    ----------
    slopes : ndarray, shape (m, d, d)
        Of the barycentric coordinates but the last, in the triangulation's own coordinates.
    frame
        Origin (3,), basis (d, 3) and how far off its plane or line a point may lie.
    """
    dimension = flat.shape[1]
    points, way = curve_order(flat), curve_order(flat[simplices].mean(axis=1))
    new_point, new_simplex = np.empty(len(points), np.intp), np.empty(len(way) + 1, np.intp)
    new_point[points] = np.arange(len(points))
    new_simplex[way], new_simplex[-1] = np.arange(len(way)), -1
    simplex = np.zeros((len(way), SIMPLEX), dtype=np.int32)
    simplex[:, : dimension + 1] = new_point[simplices[way]]
    simplex[:, NEIGHBOUR:STATE] = -1
    simplex[:, NEIGHBOUR : NEIGHBOUR + dimension + 1] = new_simplex[neighbours[way]]
    simplex[:, STATE] = np.where(degenerate[way], DEGENERATE, 0)
    place = np.zeros((len(flat), 3))
    place[:, :dimension] = flat[points]
    floats, ints = _frame(dimension, *frame)
    grid = _grid(place[:, :dimension], simplex, floats, ints)
    maps = np.zeros((len(way), MAP))
    for corner in range(dimension):
        maps[:, 3 * corner : 3 * corner + dimension] = slopes[way, corner]
    maps[:, 9:] = place[simplex[:, dimension]]
    return Numbered(maps, simplex, grid.astype(np.int32), floats, ints, way, points, place)


def _frame(
    dimension: int, origin: Floats, basis: Floats, slack: float
) -> tuple[Floats, NDArray[np.int64]]:
    floats, ints = np.zeros(AXIS_FLOATS), np.zeros(AXIS_INTS, dtype=np.int64)
    floats[:3] = 1.0
    ints[CELLS : CELLS + 3] = 1
    floats[ORIGIN : ORIGIN + 3] = origin
    floats[BASIS : BASIS + 3 * dimension] = basis.ravel()
    floats[SLACK] = slack
    ints[DIMENSION] = dimension
    return floats, ints


def _grid(
    flat: Floats, simplex: NDArray[np.int32], floats: Floats, ints: NDArray[np.int64]
) -> Indices:
    """Lay a grid over the points, (n, d), and return a simplex close to each of its cells.

    That is one whose middle is in the cell; a cell without any takes that of the cell before it,
    and the walk does the rest.
    """
    dimension = flat.shape[1]
    if dimension == 0:
        return np.zeros(1, dtype=np.intp)
    low, high = flat.min(axis=0), flat.max(axis=0)
    side = max(int((len(simplex) * CELLS_PER_SIMPLEX) ** (1 / dimension)), 1)
    density = side / np.maximum(high - low, np.finfo(float).tiny)
    floats[CORNER : CORNER + dimension], floats[DENSITY : DENSITY + dimension] = low, density
    ints[CELLS : CELLS + dimension] = side
    sound = np.flatnonzero(simplex[:, STATE] != DEGENERATE)
    if not len(sound):
        return np.zeros(side**dimension, dtype=np.intp)
    middle = flat[simplex[sound, : dimension + 1]].mean(axis=1)
    cell = np.clip(((middle - low) * density).astype(np.intp), 0, side - 1)
    grid = np.full(side**dimension, -1, dtype=np.intp)
    grid[np.ravel_multi_index(tuple(cell.T), (side,) * dimension)] = sound
    last = np.maximum.accumulate(np.where(grid >= 0, np.arange(len(grid)), -1))
    return grid[np.where(last >= 0, last, np.flatnonzero(grid >= 0)[0])]
