"""The composition in one compiled pass: locate, read, compose.

It says what `Composition.evaluate` says, to rounding, of every wrench whose axes all hold it in
sound or weak simplices. Of any other it says that it does not know, and the array version answers.
"""

from __future__ import annotations

import numpy as np

from ..interpolation.walk import (
    DIMENSION,
    SCALE,
    STATE,
    find,
    place,
    read,
)
from ..jit import compiled

UNSOUND = 2  # from where on a state says that there is no answer here
UNKNOWN = 99  # the state of a wrench that the array version must answer
ON_HULL = 1e-9  # of the range: a moment that far beyond the last station counts as on it


@compiled
def compose(wrenches, p, moved, bend, squares, state):
    """Fill outputs, bends and squared rests, (n, 6), and the worst state, (n,), of each wrench.

    `p` is a `Packed`. Axis after axis, so that one triangulation at a time is in the cache; rows
    are named by number, not cut out: a view for each would cost more than what is read.
    """
    _start(wrenches, p, moved, bend, squares, state)
    for axis in range(3):
        floats, ints = p.floats[axis], p.ints[axis]
        for row in range(len(wrenches)):
            if state[row] < UNKNOWN:
                found = _add_axis(wrenches, row, axis, p, floats, ints, moved, bend, squares)
                if found > state[row]:
                    state[row] = found


@compiled
def _start(wrenches, p, moved, bend, squares, state):
    """Fill what no load and single moments answer, and how sound that is."""
    for row in range(len(wrenches)):
        for load in range(6):
            moved[row, load] = p.rest_point[0, load]
            bend[row, load] = 0.0
            squares[row, load] = p.rest_point[1, load] ** 2
        worst = 0
        for moment in range(3):
            if abs(wrenches[row, 3 + moment]) <= p.small[3 + moment]:
                continue
            along = wrenches[row, 3 + moment] / p.floats[(moment + 2) % 3, SCALE + 1]
            first, count = p.cut_ints[moment, 0], p.cut_ints[moment, 1]
            stretch = _stretch(along, first, count, p.stations)
            if stretch < 0 or p.cut_state[stretch] >= UNSOUND:
                worst = UNKNOWN
                break
            worst = max(worst, p.cut_state[stretch])
            y, times = along - p.stations[stretch], -1.0
            # The two axes that this moment loads: the one it comes first in, then the other.
            for axis in ((moment + 2) % 3, (moment + 1) % 3):
                if _is_alone(wrenches, row, axis, p.small):
                    times += 1.0
                    _put_alone(row, axis, y, p.pieces, stretch, moved, bend, squares)
            if times != 0.0:
                _add_turns(row, y, stretch, times, p, moved, bend, squares)
        state[row] = worst


@compiled
def _is_alone(wrenches, row, axis, small):
    """Whether one moment is all that loads an axis that a moment loads."""
    j, k = 3 + (axis + 1) % 3, 3 + (axis + 2) % 3
    both = abs(wrenches[row, j]) > small[j] and abs(wrenches[row, k]) > small[k]
    return abs(wrenches[row, axis]) <= small[axis] and not both


@compiled
def _add_axis(wrenches, row, axis, p, floats, ints, moved, bend, squares):
    """Add what an axis answers to its loads; return how sound that is."""
    j, k = 3 + (axis + 1) % 3, 3 + (axis + 2) % 3
    force, first, second = wrenches[row, axis], wrenches[row, j], wrenches[row, k]
    if abs(force) <= p.small[axis] and (abs(first) <= p.small[j] or abs(second) <= p.small[k]):
        return 0  # no load, or a moment alone: added already
    x, y, z, held = place(
        force / floats[SCALE], first / floats[SCALE + 1], second / floats[SCALE + 2], floats, ints
    )
    if not held:
        return UNKNOWN
    here, a, b, c, last = find(x, y, z, p.maps, p.simplex, p.grid, floats, ints)
    if here < 0:
        return UNKNOWN
    u, rx, ry, rz, bu, bx, by, bz, du, dx, dy, dz = read(
        x, y, z, here, ints[DIMENSION], a, b, c, last, p.vertex, p.simplex
    )
    moved[row, axis], bend[row, axis], squares[row, axis] = u, bu, du * du
    moved[row, 3] += rx - p.rest_point[0, 3]
    moved[row, 4] += ry - p.rest_point[0, 4]
    moved[row, 5] += rz - p.rest_point[0, 5]
    bend[row, 3] += bx
    bend[row, 4] += by
    bend[row, 5] += bz
    squares[row, 3] += dx * dx
    squares[row, 4] += dy * dy
    squares[row, 5] += dz * dz
    return p.simplex[here, STATE]


@compiled
def _stretch(along, first, count, stations):
    """Return the stretch of a cut that holds a scaled moment, or -1."""
    if count < 2 or along < stations[first] - ON_HULL:
        return -1
    if along > stations[first + count - 1] + ON_HULL:
        return -1
    low, high = first, first + count - 1
    while high - low > 1:
        middle = (low + high) // 2
        if stations[middle] <= along:
            low = middle
        else:
            high = middle
    return low


@compiled
def _put_alone(row, axis, y, pieces, stretch, moved, bend, squares):
    """Put an axis' translation under one moment alone."""
    moved[row, axis] = pieces[stretch, 0, axis] + y * pieces[stretch, 1, axis]
    curved = pieces[stretch, 3, axis] + y * pieces[stretch, 4, axis]
    bend[row, axis] = pieces[stretch, 2, axis] + y * curved
    squares[row, axis] = (pieces[stretch, 5, axis] + y * pieces[stretch, 6, axis]) ** 2


@compiled
def _add_turns(row, y, stretch, times, p, moved, bend, squares):
    """Add the rotation under one moment alone, so many times."""
    for turn in range(3, 6):
        told = p.pieces[stretch, 0, turn] + y * p.pieces[stretch, 1, turn]
        moved[row, turn] += times * (told - p.rest_point[0, turn])
        curved = p.pieces[stretch, 3, turn] + y * p.pieces[stretch, 4, turn]
        bend[row, turn] += times * (p.pieces[stretch, 2, turn] + y * curved)
        rest = times * (p.pieces[stretch, 5, turn] + y * p.pieces[stretch, 6, turn])
        squares[row, turn] += rest * rest


@compiled
def judge(
    moved, bend, squares, state, best, own, mode, bent, off_hull, displacement, error, coverage
):
    """Fill displacements and bars, (n, 6), m and rad, and coverage, (n,), from what was composed.

    The bar is |answer - reference| + bar of the reference, which is by `mode`: 0, the outputs with
    their bends; 1, those and `best`, what they miss, with bar `own`; 2, `best` itself.
    """
    for row in range(len(moved)):
        off = state[row] >= off_hull
        coverage[row] = 2 if off else 1 if state[row] > 0 else 0
        for k in range(6):
            value = moved[row, k] + (bend[row, k] if bent else 0.0)
            if mode == 2:
                wrong, rest = value - best[row, k], own[row, k]
            else:
                wrong = value - moved[row, k] - bend[row, k]
                rest = squares[row, k]
                if mode == 1:
                    wrong -= best[row, k]
                    rest += own[row, k] * own[row, k]
                rest = np.sqrt(rest)
            bar = abs(wrong) + rest
            if off:  # it may be as wrong as the step from the hull is long
                step = np.sqrt(squares[row, k])
                if step > bar or np.isnan(step):  # of unknown length: the bar is unknown too
                    bar = step
            displacement[row, k] = value
            error[row, k] = bar


@compiled
def one(p, wrench, best, own, mode, bent, off_hull):
    """Return six displacements, six bars, m and rad, and the coverage of one wrench (6,).

    Numbers in and numbers out of `compose` and `judge`; the coverage is `UNKNOWN` if that is what
    the composition says.
    """
    asked, work = np.empty((1, 6)), np.empty((5, 1, 6))
    for load in range(6):
        asked[0, load] = wrench[load]
    moved, bend, squares, displacement, error = work[0], work[1], work[2], work[3], work[4]
    state, coverage = np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.uint8)
    compose(asked, p, moved, bend, squares, state)
    judge(
        moved, bend, squares, state, best, own, mode, bent, off_hull, displacement, error, coverage
    )
    u, b, told = displacement[0], error[0], float(coverage[0])
    if state[0] == UNKNOWN:
        told = float(UNKNOWN)
    return u[0], u[1], u[2], u[3], u[4], u[5], b[0], b[1], b[2], b[3], b[4], b[5], told
