"""An even choice of the points of one axis, where there are more than a triangulation should hold.

A triangulation of n points in three dimensions has some 6.7 n tetrahedra: with what answers need
of each, 1.5 kB a point, and 45 µs a point to make. A table of a million rows would take gigabytes
and minutes, for neighbours that are closer than any response bends. So beyond a bound a half, a
quarter, ... of the points is triangulated, and the others tell whether its bars hold.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .rows import Floats

# Of one axis: three triangulations of as many stay below 300 MB and take some 10 s, and neighbours
# are a fortieth of the range apart.
MOST_POINTS = 60_000
# In each of these directions the outermost point stays, so that the hull does: 400 directions are
# 10 degrees apart, and what a rounded hull loses between them is a part in 250.
DIRECTIONS = 400
CHUNK = 5000  # points at once: their places along all directions fit 20 MB
# Odd factors of Knuth's multiplicative hashing (The Art of Computer Programming 3, 6.4), one a
# coordinate.
_FACTORS = np.uint64(0x9E3779B97F4A7C15) * np.arange(1, 13, 2, dtype=np.uint64)
_HALF = np.uint64(32)


def evenly_chosen(points: Floats) -> NDArray[np.bool_]:
    """Return which points (n, 3), dimensionless, stand for all, shape (n,).

    By a hash of each point alone, so that a new row moves no other in or out until their number
    passes the next double of `MOST_POINTS`.
    """
    halvings = 0
    while len(points) > MOST_POINTS << halvings:
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
    most = np.full(len(directions), -np.inf)
    place = np.zeros(len(directions), dtype=np.intp)
    for start in range(0, len(points), CHUNK):
        along = directions @ points[start : start + CHUNK].T
        best = along.argmax(axis=1)
        value = along[np.arange(len(best)), best]
        better = value > most
        most[better], place[better] = value[better], start + best[better]
    chosen[place] = True
    return chosen


def hashes(numbers: Floats) -> NDArray[np.uint64]:
    """Return a hash of each line of (k, d), d at most 6, shape (k,); -0.0 counts as 0.0.

    Lines are of any unit; hashes are dimensionless.
    """
    bits = np.ascontiguousarray(numbers + 0.0).view(np.uint64)
    mixed = (bits ^ (bits >> _HALF)) * _FACTORS[: bits.shape[1]]
    return np.bitwise_xor.reduce(mixed ^ (mixed >> _HALF), axis=1)
