"""A composition as a few flat arrays, for the compiled kernels.

Points and simplices are numbered along a space-filling curve, so that what lies close together in
the load range lies close together in memory.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..interpolation.walk import (
    AXIS_FLOATS,
    AXIS_INTS,
    DIMENSION,
    FIRST_CELL,
    NEIGHBOUR,
    PLACE,
    REST,
    SCALE,
    SIMPLEX,
    SLOPE,
    STATE,
    VALUE,
    VERTEX,
)
from ..table.axes import CLEAN
from ..table.rows import Floats
from .axis_table import AxisTable
from .composition import Composition
from .pure_moment import HOLE, PureMomentCut


class Packed(NamedTuple):
    """The arrays; the columns of the first five are named in `interpolation.walk`.

    Attributes
    ----------
    vertex : ndarray, shape (n, VERTEX)
    simplex : ndarray of int32, shape (m, SIMPLEX)
    grid : ndarray of int32, shape (cells,)
        The simplex a walk starts from.
    floats, ints : ndarray, shape (3, AXIS_FLOATS) and (3, AXIS_INTS)
    stations : ndarray, shape (s + 3,)
    pieces : ndarray, shape (s + 3, 7, 6), m and rad
        As in `PureMomentCut`: outputs, bends and rests; the last of each moment is of no use.
    cut_state, cut_ints : ndarray of int32, shape (s + 3,) and (3, 2)
        How sound each stretch is; first station and number of stations of each moment.
    rest_point : ndarray, shape (2, 6), m and rad
        The answer at no load and its bar.
    small : ndarray, shape (6,), N and N·m
        Loads up to which there is none.
    """

    vertex: Floats
    simplex: NDArray[np.int32]
    grid: NDArray[np.int32]
    floats: Floats
    ints: NDArray[np.int64]
    stations: Floats
    pieces: Floats
    cut_state: NDArray[np.int32]
    cut_ints: NDArray[np.int64]
    rest_point: Floats
    small: Floats


def pack(composition: Composition) -> Packed:
    """Lay out a composition for `fast`."""
    floats, ints = np.zeros((3, AXIS_FLOATS)), np.zeros((3, AXIS_INTS), dtype=np.int64)
    vertices, simplices, grids = [np.empty((0, VERTEX))], [np.empty((0, SIMPLEX))], [np.empty(0)]
    points = cells = count = 0
    for axis, table in enumerate(composition.tables):
        ints[axis, DIMENSION] = -1
        if table is None:
            continue
        numbered = table.triangulation.numbered
        simplex = numbered.simplex.copy()
        simplex[:, :NEIGHBOUR] += points
        simplex[:, NEIGHBOUR:STATE] += np.where(simplex[:, NEIGHBOUR:STATE] >= 0, count, 0)
        simplex[:, STATE] = table.state[numbered.simplex_order]
        floats[axis], ints[axis] = numbered.floats, numbered.ints
        floats[axis, SCALE : SCALE + 3], ints[axis, FIRST_CELL] = table.scale, cells
        vertices.append(_vertices(table))
        simplices.append(simplex)
        grids.append(numbered.grid + count)
        points, count = points + len(numbered.place), count + len(simplex)
        cells += len(numbered.grid)
    at_rest = composition.at_rest
    return Packed(
        np.ascontiguousarray(np.concatenate(vertices)),
        np.ascontiguousarray(np.concatenate(simplices).astype(np.int32)),
        np.concatenate(grids).astype(np.int32),
        floats,
        ints,
        *_pack_cuts([cuts[0] if cuts else None for cuts in composition.cuts]),
        np.stack((at_rest.displacement, at_rest.bar)),
        CLEAN * composition.scale,
    )


def _vertices(table: AxisTable) -> Floats:
    """Return what each point of an axis knows, in its numbered order, shape (n, VERTEX)."""
    numbered, own = table.triangulation.numbered, list(table.axis.outputs)
    order, dimension = numbered.point_order, table.triangulation.dimension
    vertex = np.zeros((len(order), VERTEX))
    vertex[:, PLACE:VALUE] = numbered.place
    vertex[:, VALUE:SLOPE] = table.values[order][:, own]
    along = np.zeros((len(order), 4, 3))
    along[:, :, :dimension] = table.slopes[order][:, own] @ table.triangulation.basis.T
    vertex[:, SLOPE:REST] = along.reshape(-1, 12)
    vertex[:, REST:VERTEX] = table.rest[order][:, own]
    return vertex


def _pack_cuts(cuts: list[PureMomentCut | None]) -> tuple[NDArray, ...]:
    """Return stations, pieces, states and places of three cuts, one blank stretch between them."""
    stations, pieces, states = [], [], []
    where, first = np.zeros((3, 2), dtype=np.int64), 0
    for moment, cut in enumerate(cuts):
        count = 0 if cut is None else len(cut.stations)
        where[moment] = first, count
        first += count + (not count)
        if cut is None or not count:
            stations.append(np.zeros(1))
            pieces.append(np.zeros((1, 7, 6)))
            states.append(np.full(1, HOLE))
            continue
        stations.append(cut.stations)
        both = np.concatenate((cut.pieces, cut.rest), axis=1)
        pieces.append(np.concatenate((both, np.zeros((1, 7, 6)))))
        states.append(np.concatenate((cut.state, [HOLE])))
    return (
        np.concatenate(stations),
        np.ascontiguousarray(np.concatenate(pieces)),
        np.concatenate(states).astype(np.int32),
        where,
    )
