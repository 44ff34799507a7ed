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
    place,
    read,
)
from ..jit import compiled

UNKNOWN = 99  # the state of a wrench that the array version must answer
ON_HULL = 1e-9  # of the range: a moment that far beyond the last station counts as on it


@compiled
def compose(
    wrenches,
    vertex,
    simplex,
    grid,
    floats,
    ints,
    stations,
    pieces,
    cut_state,
    cut_ints,
    rest_point,
    small,
    moved,
    bend,
    squares,
    state,
):
    """Fill outputs, bends and squared rests, (n, 6), and the worst state, (n,), of each wrench."""
    x, flat = np.empty(3), np.empty(3)
    shares, slopes = np.empty(4), np.empty((4, 3))
    outputs, bends, rests = np.empty(4), np.empty(4), np.empty(4)
    alone, times = np.empty((3, 18)), np.empty(3)
    loaded = np.empty(6, dtype=np.bool_)
    for row in range(len(wrenches)):
        worst = 0
        for load in range(6):
            loaded[load] = abs(wrenches[row, load]) > small[load]
            moved[row, load] = rest_point[0, load]
            bend[row, load] = 0.0
            squares[row, load] = rest_point[1, load] ** 2
        for moment in range(3):
            times[moment] = 0.0
            if loaded[3 + moment]:
                times[moment] = -1.0
                along = wrenches[row, 3 + moment] / floats[(moment + 2) % 3, SCALE + 1]
                sound = _alone(along, moment, stations, pieces, cut_state, cut_ints, alone)
                worst = max(worst, sound)
        for axis in range(3):
            i, j, k = axis, 3 + (axis + 1) % 3, 3 + (axis + 2) % 3
            if not (loaded[i] or loaded[j] or loaded[k]):
                continue
            if not loaded[i] and loaded[j] != loaded[k]:
                moment = j - 3 if loaded[j] else k - 3
                times[moment] += 1.0
                moved[row, axis] = alone[moment, axis]
                bend[row, axis] = alone[moment, 6 + axis]
                squares[row, axis] = alone[moment, 12 + axis] ** 2
                continue
            x[0] = wrenches[row, i] / floats[axis, SCALE]
            x[1] = wrenches[row, j] / floats[axis, SCALE + 1]
            x[2] = wrenches[row, k] / floats[axis, SCALE + 2]
            here = place(x, flat, vertex, simplex, grid, floats[axis], ints[axis], shares, slopes)
            if here < 0:
                worst = UNKNOWN
                break
            worst = max(worst, simplex[here, STATE])
            read(flat, here, ints[axis, DIMENSION], vertex, simplex, shares, outputs, bends, rests)
            moved[row, axis], bend[row, axis] = outputs[0], bends[0]
            squares[row, axis] = rests[0] * rests[0]
            for turn in range(1, 4):
                moved[row, 2 + turn] += outputs[turn] - rest_point[0, 2 + turn]
                bend[row, 2 + turn] += bends[turn]
                squares[row, 2 + turn] += rests[turn] * rests[turn]
        for moment in range(3):
            if times[moment] != 0.0:
                for turn in range(3, 6):
                    moved[row, turn] += times[moment] * (alone[moment, turn] - rest_point[0, turn])
                    bend[row, turn] += times[moment] * alone[moment, 6 + turn]
                    squares[row, turn] += (times[moment] * alone[moment, 12 + turn]) ** 2
        state[row] = worst


@compiled
def _alone(along, moment, stations, pieces, cut_state, cut_ints, alone):
    """Fill outputs, bends and rests (18,) of one moment alone; return how sound they are."""
    first, count = cut_ints[moment, 0], cut_ints[moment, 1]
    if count < 2 or along < stations[first] - ON_HULL:
        return UNKNOWN
    if along > stations[first + count - 1] + ON_HULL:
        return UNKNOWN
    low, high = first, first + count - 1
    while high - low > 1:
        middle = (low + high) // 2
        if stations[middle] <= along:
            low = middle
        else:
            high = middle
    y = along - stations[low]
    for k in range(6):
        alone[moment, k] = pieces[low, 0, k] + y * pieces[low, 1, k]
        alone[moment, 6 + k] = pieces[low, 2, k] + y * (pieces[low, 3, k] + y * pieces[low, 4, k])
        alone[moment, 12 + k] = pieces[low, 5, k] + y * pieces[low, 6, k]
    return cut_state[low] if cut_state[low] < 2 else UNKNOWN
