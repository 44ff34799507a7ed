"""The three axes of straight direction influence as the arrays of a packed table.

Points and simplices are numbered along a space-filling curve, so that what lies close together in
the load range lies close together in the file. A simplex and a point take 128 bytes each, two cache
lines.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import accumulate, chain

import numpy as np
from numpy.typing import NDArray

from ..axes.axes import Axes
from ..axes.axis_table import LARGEST, AxisTable
from ..error_law import FEWEST
from ..table.rows import Floats
from .numbering import DIMENSION, FIRST_CELL, FLOATS, INTS, SCALE, buckets_of, numbered_of

SIMPLEX, VERTEX = 16, 16  # doubles of a simplex and of a point: wb_simplex, wb_vertex

Array = NDArray[np.generic]


def axes_arrays(axes: Axes, members: Sequence[tuple[int, ...]]) -> Iterator[tuple[str, Array]]:
    """Yield the names and arrays of the axes, of the default space."""
    tables = axes.tables
    first_simplex = _first([0 if table is None else len(table.state) for table in tables])
    # Points, simplices and hulls, of all axes one after another.
    first_point = _first([0 if table is None else len(table.values) for table in tables])
    each = zip(tables, first_point, first_simplex, strict=False)
    yield "simplex", _joined([_simplices(*one) for one in each], (0, SIMPLEX))
    states = [table.state[_order(table)[1]] for table in tables if table is not None]
    yield "state", _joined(states, (0,)).astype(np.uint8)
    yield "vertex", _joined([_vertices(table) for table in tables], (0, VERTEX))
    slopes = [table.slopes[_order(table)[0]] for table in tables if table is not None]
    yield "slopes", _joined(slopes, (0, 6, 3))
    facets = [_facets(table) for table in tables]
    for index, facet in enumerate(facets):
        facet[:, :3] += first_point[index]
        facet[:, 3] += first_simplex[index]
    yield "facets", _joined(facets, (0, 4)).astype(np.int32)
    yield "point_first", np.array(first_point, dtype=np.int32)
    yield "simplex_first", np.array(first_simplex, dtype=np.int32)
    yield "facet_first", np.array(_first([len(facet) for facet in facets]), dtype=np.int32)
    floats, ints = np.zeros((3, FLOATS)), np.zeros((3, INTS), dtype=np.int32)
    ints[:, DIMENSION] = -1
    grids, cells = [np.empty(0, dtype=np.int32)], 0
    for axis, table in enumerate(tables):
        if table is None:
            continue
        numbered = numbered_of(table.triangulation)
        floats[axis], ints[axis] = numbered.floats, numbered.ints
        floats[axis, SCALE : SCALE + 3], ints[axis, FIRST_CELL] = table.scale, cells
        grids.append((numbered.grid + first_simplex[axis]).astype(np.int32))
        cells += len(grids[-1])
    yield "floats", floats
    yield "ints", ints
    yield "grid", np.concatenate(grids)
    together = [0 if table is None else table.together for table in tables]
    yield "together", np.array(together, dtype=np.int32)
    yield "fewest", np.array([0 if table is None else table.fewest for table in tables], np.int32)
    left_out = [0 if table is None else table.errors_shown for table in tables]
    yield "left_out", np.array([*left_out, FEWEST], dtype=np.int32)
    yield "largest", np.array([LARGEST[dimension] for dimension in range(4)])
    yield "span", np.array([_span(table) for table in tables])
    yield "rest_point", np.stack((axes.at_rest.displacement, axes.at_rest.error))
    yield "error", np.array([_error(table) for table in tables])
    for moment, cuts in enumerate(axes.cuts):
        for cut in cuts:
            name, count = f"cut{moment}{cut.column - 1}", len(cut.state)
            yield f"{name}/state", cut.state.astype(np.int32)
            yield f"{name}/stations", cut.stations if count else np.empty(0)
            yield f"{name}/outputs", cut.outputs.reshape(count, 2, 6)
            yield f"{name}/stated", cut.stated.reshape(count, 2, 6)
            yield f"{name}/unit", cut.unit_errors.reshape(count, 3)
            bucket, start = buckets_of(cut.stations if count else np.empty(0))
            yield f"{name}/bucket", bucket
            yield f"{name}/start", start
    sizes, numbers = [np.zeros(1, dtype=np.intp)], [np.empty(0, dtype=np.int64)]
    for table in tables:
        if table is None:
            continue
        order = _order(table)[0]
        point, place = _members_of(table.rows.members, order)
        behind, row = _members_of(members, place)
        numbers.append(row[np.lexsort((row, point[behind]))])
        sizes.append(np.bincount(point[behind], minlength=len(order)))
    yield "member_first", np.cumsum(np.concatenate(sizes)).astype(np.int32)
    yield "members", np.concatenate(numbers)


def _first(counts: list[int]) -> list[int]:
    return list(accumulate(counts, initial=0))


def _joined(parts: Sequence[Array | None], shape: tuple[int, ...]) -> NDArray:
    """Return the parts that there are as one array; an empty one of a shape without any."""
    return np.concatenate([np.empty(shape), *(part for part in parts if part is not None)])


def _order(table: AxisTable) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the old number of each point and of each simplex."""
    numbered = numbered_of(table.triangulation)
    return numbered.point_order, numbered.simplex_order


def _simplices(table: AxisTable | None, point: int, simplex: int) -> Floats | None:
    if table is None:
        return None
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


def _vertices(table: AxisTable | None) -> Floats | None:
    if table is None:
        return None
    order = numbered_of(table.triangulation).point_order
    place = table.triangulation.points[order]
    unused = np.zeros((len(order), 1))
    return np.concatenate((place, unused, table.values[order], table.uncertainty[order]), axis=1)


def _error(table: AxisTable | None) -> Floats:
    """Return A and C of the error of interpolation, sqrt(A + C S^2), shape (2, 6), m² and rad²."""
    if table is None:
        return np.full((2, 6), np.nan)
    return np.stack((table.noise_variance, table.curvature_variance))


def _facets(table: AxisTable | None) -> NDArray[np.intp]:
    """Return the hull's facets (f, 4): vertices and the simplex behind, in their new numbers."""
    if table is None or not table.triangulation.dimension:
        return np.zeros((0, 4), dtype=np.intp)
    shape, (points, simplices) = table.triangulation, _order(table)
    found = np.zeros((len(shape.hull), 4), dtype=np.intp)
    found[:, : shape.dimension] = np.argsort(points)[shape.hull]
    found[:, 3] = np.argsort(simplices)[shape.behind_hull]
    return found


def _span(table: AxisTable | None) -> Floats:
    """Return the smallest and largest of an axis' three loads, (3, 2), N and N·m."""
    if table is None:
        return np.zeros((3, 2))
    loads = table.rows.points * table.scale
    return np.stack((loads.min(axis=0), loads.max(axis=0)), axis=1)


def _members_of(
    groups: Sequence[tuple[int, ...]], which: NDArray[np.integer]
) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
    """Return the members of some groups (k,): the place in `which` of each, and the member."""
    sizes = np.fromiter(map(len, groups), np.int64, len(groups))
    members = np.fromiter(chain.from_iterable(groups), np.int64, int(sizes.sum()))
    ends, counts = np.cumsum(sizes), sizes[which]
    owner = np.repeat(np.arange(len(which)), counts)
    return owner, members[(ends[which] - np.cumsum(counts))[owner] + np.arange(len(owner))]
