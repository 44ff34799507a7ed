"""Find the simplex of a point by walking, and read what its vertices hold: the compiled kernels.

The walk starts from a simplex that a regular grid names for the point's cell and steps through the
face opposite the most negative barycentric coordinate (the visibility walk of Devillers, Pion and
Teillaud 2002, which always ends in a Delaunay triangulation). With vertices and simplices numbered
along a space-filling curve one query of a batch reads what the one before it has brought into the
cache.

Numba compiles these functions when it is installed (extra ``fast``). Without it `COMPILED` is false
and the array version (`composition`) answers, with the same numbers to 1e-12.
"""

from __future__ import annotations

from ..jit import compiled

# Columns of a vertex: place (3, in the triangulation's own coordinates), the four outputs of its
# axis, their slopes along those coordinates (3 x 4), and the rest of their error bars (4).
PLACE, VALUE, SLOPE, REST, VERTEX = 0, 3, 7, 19, 23
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

OUTSIDE, LOST = -1, -2
DEGENERATE = 2

INSIDE = -1e-13  # a barycentric coordinate above which rounding may have put a point outside
ON_HULL = 1e-9  # the same on the hull: a load that far beyond the range counts as on it
MOST_STEPS = 100_000  # a walk of more steps goes in circles, between flat simplices


@compiled
def find(x, y, z, maps, simplex, grid, floats, ints):
    """Return the simplex of a point, or `OUTSIDE` or `LOST`, and its barycentric coordinates.

    Parameters
    ----------
    x, y, z : float
        The point in the triangulation's own coordinates; those it has not are zero.
    maps, simplex, grid, floats, ints
        The tables of the axis; see the columns above.

    Returns
    -------
    tuple of int and four floats
    """
    dimension = ints[DIMENSION]
    here = _hint(x, y, z, grid, floats, ints)
    for _ in range(MOST_STEPS):
        if simplex[here, STATE] == DEGENERATE:
            break
        p, q, r = x - maps[here, 9], y - maps[here, 10], z - maps[here, 11]
        a = maps[here, 0] * p + maps[here, 1] * q + maps[here, 2] * r
        b = maps[here, 3] * p + maps[here, 4] * q + maps[here, 5] * r
        c = maps[here, 6] * p + maps[here, 7] * q + maps[here, 8] * r
        last = 1.0 - a - b - c
        worst, least = 0, a
        if b < least and dimension > 1:
            worst, least = 1, b
        if c < least and dimension > 2:
            worst, least = 2, c
        if last < least:
            worst, least = dimension, last
        there = here
        if least < INSIDE:
            there = simplex[here, NEIGHBOUR + worst]
            if there < 0 and least < -ON_HULL:
                return OUTSIDE, a, b, c, last
        if there == here or there < 0:
            return here, a, b, c, last
        here = there
    return LOST, 0.0, 0.0, 0.0, 0.0


@compiled
def _hint(x, y, z, grid, floats, ints):
    i = _cell((x - floats[CORNER]) * floats[DENSITY], ints[CELLS])
    j = _cell((y - floats[CORNER + 1]) * floats[DENSITY + 1], ints[CELLS + 1])
    k = _cell((z - floats[CORNER + 2]) * floats[DENSITY + 2], ints[CELLS + 2])
    return grid[ints[FIRST_CELL] + (i * ints[CELLS + 1] + j) * ints[CELLS + 2] + k]


@compiled
def _cell(place, cells):
    return min(max(int(place), 0), cells - 1)


@compiled
def read(x, y, z, here, dimension, a, b, c, last, vertex, simplex):
    """Return outputs, bends and rests of the bars in a simplex, four numbers each.

    Outputs are barycentric; a bend is half of what the vertices' first-order expansions, blended
    alike, add to them (`slope_recovery`).
    """
    u0 = u1 = u2 = u3 = 0.0
    b0 = b1 = b2 = b3 = 0.0
    r0 = r1 = r2 = r3 = 0.0
    for corner in range(dimension + 1):
        share = last
        if corner < dimension:
            share = a if corner == 0 else b if corner == 1 else c
        v = simplex[here, corner]
        u0 += share * vertex[v, VALUE]
        u1 += share * vertex[v, VALUE + 1]
        u2 += share * vertex[v, VALUE + 2]
        u3 += share * vertex[v, VALUE + 3]
        r0 += share * vertex[v, REST]
        r1 += share * vertex[v, REST + 1]
        r2 += share * vertex[v, REST + 2]
        r3 += share * vertex[v, REST + 3]
        half = 0.5 * share
        p, q, r = half * (x - vertex[v, 0]), half * (y - vertex[v, 1]), half * (z - vertex[v, 2])
        b0 += vertex[v, SLOPE] * p + vertex[v, SLOPE + 4] * q + vertex[v, SLOPE + 8] * r
        b1 += vertex[v, SLOPE + 1] * p + vertex[v, SLOPE + 5] * q + vertex[v, SLOPE + 9] * r
        b2 += vertex[v, SLOPE + 2] * p + vertex[v, SLOPE + 6] * q + vertex[v, SLOPE + 10] * r
        b3 += vertex[v, SLOPE + 3] * p + vertex[v, SLOPE + 7] * q + vertex[v, SLOPE + 11] * r
    return u0, u1, u2, u3, b0, b1, b2, b3, r0, r1, r2, r3


@compiled
def place(x, y, z, floats, ints):
    """Return scaled inputs in the triangulation's own coordinates, and whether they lie in it."""
    dimension = ints[DIMENSION]
    if dimension == 3:
        return x, y, z, True
    if dimension < 0:
        return x, y, z, False
    x, y, z = x - floats[ORIGIN], y - floats[ORIGIN + 1], z - floats[ORIGIN + 2]
    p = x * floats[BASIS] + y * floats[BASIS + 1] + z * floats[BASIS + 2]
    q = x * floats[BASIS + 3] + y * floats[BASIS + 4] + z * floats[BASIS + 5]
    x -= p * floats[BASIS] + q * floats[BASIS + 3]
    y -= p * floats[BASIS + 1] + q * floats[BASIS + 4]
    z -= p * floats[BASIS + 2] + q * floats[BASIS + 5]
    return p, q, 0.0, max(abs(x), abs(y), abs(z)) <= floats[SLACK]


@compiled
def locate_many(points, order, maps, simplex, grid, floats, ints, back, found):
    """Fill the simplex of each point (k, 3), by the numbers that `back`, (m,), gives it."""
    for row in order:
        x, y, z, held = place(points[row, 0], points[row, 1], points[row, 2], floats, ints)
        here = OUTSIDE
        if held:
            here, _, _, _, _ = find(x, y, z, maps, simplex, grid, floats, ints)
        found[row] = back[here] if here >= 0 else here
