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

import numpy as np

from ..jit import compiled

# Columns of a vertex: place (3, in the triangulation's own coordinates), the four outputs of its
# axis, their slopes along those coordinates (4 x 3), and the rest of their error bars (4).
PLACE, VALUE, SLOPE, REST, VERTEX = 0, 3, 7, 19, 23
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
def find(x, vertex, simplex, grid, floats, ints, shares, slopes):
    """Return the simplex of a point, `OUTSIDE` or `LOST`.

    Parameters
    ----------
    x : ndarray, shape (3,)
        The point in the triangulation's own coordinates.
    vertex, simplex, grid, floats, ints
        The tables of the axis; see the columns above.
    shares : ndarray, shape (4,)
        Filled with the barycentric coordinates.
    slopes : ndarray, shape (4, 3)
        Filled with their slopes.
    """
    dimension = ints[DIMENSION]
    here = _hint(x, grid, floats, ints)
    for _ in range(MOST_STEPS):
        if simplex[here, STATE] == DEGENERATE:
            return LOST
        _shares_at(x, here, dimension, vertex, simplex, shares, slopes)
        worst, least = 0, shares[0]
        for corner in range(1, dimension + 1):
            if shares[corner] < least:
                worst, least = corner, shares[corner]
        if least >= INSIDE:
            return here
        there = simplex[here, NEIGHBOUR + worst]
        if there < 0:
            return here if least >= -ON_HULL else OUTSIDE
        here = there
    return LOST


@compiled
def _hint(x, grid, floats, ints):
    cell = 0
    for way in range(ints[DIMENSION]):
        cells = ints[CELLS + way]
        place = int((x[way] - floats[CORNER + way]) * floats[DENSITY + way])
        cell = cell * cells + min(max(place, 0), cells - 1)
    return grid[ints[FIRST_CELL] + cell]


@compiled
def _shares_at(x, here, dimension, vertex, simplex, shares, slopes):
    """Fill barycentric coordinates and their slopes, by Cramer's rule from the last vertex."""
    last = simplex[here, dimension]
    if dimension == 0:
        shares[0] = 1.0
        return
    a = simplex[here, 0]
    p0, e0 = x[0] - vertex[last, 0], vertex[a, 0] - vertex[last, 0]
    if dimension == 1:
        slopes[0, 0] = 1.0 / e0
        shares[0] = p0 * slopes[0, 0]
    else:
        b = simplex[here, 1]
        p1, e1 = x[1] - vertex[last, 1], vertex[a, 1] - vertex[last, 1]
        f0, f1 = vertex[b, 0] - vertex[last, 0], vertex[b, 1] - vertex[last, 1]
        if dimension == 2:
            over = 1.0 / (e0 * f1 - e1 * f0)
            slopes[0, 0], slopes[0, 1] = f1 * over, -f0 * over
            slopes[1, 0], slopes[1, 1] = -e1 * over, e0 * over
            for corner in range(2):
                shares[corner] = slopes[corner, 0] * p0 + slopes[corner, 1] * p1
        else:
            c = simplex[here, 2]
            p2, e2 = x[2] - vertex[last, 2], vertex[a, 2] - vertex[last, 2]
            f2 = vertex[b, 2] - vertex[last, 2]
            g0, g1 = vertex[c, 0] - vertex[last, 0], vertex[c, 1] - vertex[last, 1]
            g2 = vertex[c, 2] - vertex[last, 2]
            fg0, fg1, fg2 = f1 * g2 - f2 * g1, f2 * g0 - f0 * g2, f0 * g1 - f1 * g0
            over = 1.0 / (e0 * fg0 + e1 * fg1 + e2 * fg2)
            slopes[0, 0], slopes[0, 1], slopes[0, 2] = fg0 * over, fg1 * over, fg2 * over
            slopes[1, 0] = (g1 * e2 - g2 * e1) * over
            slopes[1, 1] = (g2 * e0 - g0 * e2) * over
            slopes[1, 2] = (g0 * e1 - g1 * e0) * over
            slopes[2, 0] = (e1 * f2 - e2 * f1) * over
            slopes[2, 1] = (e2 * f0 - e0 * f2) * over
            slopes[2, 2] = (e0 * f1 - e1 * f0) * over
            for corner in range(3):
                shares[corner] = (
                    slopes[corner, 0] * p0 + slopes[corner, 1] * p1 + slopes[corner, 2] * p2
                )
    rest = 1.0
    for way in range(dimension):
        slopes[dimension, way] = 0.0
    for corner in range(dimension):
        rest -= shares[corner]
        for way in range(dimension):
            slopes[dimension, way] -= slopes[corner, way]
    shares[dimension] = rest


@compiled
def read(x, here, dimension, vertex, simplex, shares, outputs, bends, rests):
    """Read outputs (4,), bends (4,) and rests of the bars (4,) in a simplex.

    Outputs are barycentric; a bend is half of what the vertices' first-order expansions, blended
    alike, add to them (`slope_recovery`).
    """
    for k in range(4):
        outputs[k], bends[k], rests[k] = 0.0, 0.0, 0.0
    for corner in range(dimension + 1):
        row, share = simplex[here, corner], shares[corner]
        for k in range(4):
            outputs[k] += share * vertex[row, VALUE + k]
            rests[k] += share * vertex[row, REST + k]
            rise = 0.0
            for way in range(dimension):
                rise += vertex[row, SLOPE + 3 * k + way] * (x[way] - vertex[row, way])
            bends[k] += 0.5 * share * rise


@compiled
def place(x, flat, vertex, simplex, grid, floats, ints, shares, slopes):
    """Return the simplex of scaled inputs (3,), `OUTSIDE` or `LOST`; fill `flat` with them."""
    dimension = ints[DIMENSION]
    if dimension < 0:
        return OUTSIDE
    if dimension == 3:
        flat[0], flat[1], flat[2] = x[0], x[1], x[2]
        return find(flat, vertex, simplex, grid, floats, ints, shares, slopes)
    for way in range(dimension):
        flat[way] = 0.0
        for load in range(3):
            flat[way] += (x[load] - floats[ORIGIN + load]) * floats[BASIS + 3 * way + load]
    for load in range(3):
        off = x[load] - floats[ORIGIN + load]
        for way in range(dimension):
            off -= flat[way] * floats[BASIS + 3 * way + load]
        if abs(off) > floats[SLACK]:
            return OUTSIDE
    return find(flat, vertex, simplex, grid, floats, ints, shares, slopes)


@compiled
def locate_many(points, order, vertex, simplex, grid, floats, ints, back, found):
    """Fill the simplex of each point (k, 3), by the numbers that `back`, (m,), gives it."""
    shares, slopes, flat = np.empty(4), np.empty((4, 3)), np.empty(3)
    for row in order:
        here = place(points[row], flat, vertex, simplex, grid, floats, ints, shares, slopes)
        found[row] = back[here] if here >= 0 else here
