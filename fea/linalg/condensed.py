"""What an eliminated substructure hands on: its boundary's stiffness as a lower triangle.

It is stored in block columns, each without the rows above it: five eighths of the square at four
columns. It waits until the other half of the cut is done, and after the factor it is the most of a
solve's memory: as a square the peak of a block of 42,500 unknowns is some 30 MB of 335 higher.

The sign is reversed, W^T W - C in place of C - W^T W: then the product comes first and is written
once, and the pivot block, gone by then, and this never take memory together.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np

Array = np.ndarray

_WIDTH = 256
"""Unknowns in a block column, about; wide enough for BLAS (measured level from 192 to 384)."""

_ONE_COLUMN = 768
"""Unknowns below which a boundary is one block column, a square.

In columns of 256 a flange whose largest is 705 takes 10 % longer, to save 2 MB of 210.
"""


class Condensed(NamedTuple):
    """Minus the condensed stiffness of one boundary, N/m; above its diagonal nothing is meant.

    Attributes
    ----------
    starts
        First unknown of each block column, and after the last one.
    blocks
        For each block column from a to b of n unknowns, shape (n - a, b - a), in Fortran's order.
    """

    starts: list[int]
    blocks: list[Array]

    def holding(self, unknown: int) -> tuple[int, Array]:
        """Return where the block column of an unknown starts, and it: shape (n - a, b - a), N/m."""
        own = bisect_right(self.starts, unknown) - 1
        return self.starts[own], self.blocks[own]


class Route(NamedTuple):
    """Where what a child hands on goes in its parent.

    Attributes
    ----------
    places
        Shape (n,), ascending: of the child's unknowns among the m + b of the parent.
    pivots
        How many of them are eliminated in the parent.
    stretches
        First, last + 1 and place of the first: unknowns whose places have no gap, in one block
        column of the child and one of the parent, in their order.
    """

    places: Array
    pivots: int
    stretches: list[tuple[int, int, int]]


def columns_of(unknowns: int) -> list[int]:
    """Return where the block columns of a boundary start, and its end."""
    count = round(unknowns / _WIDTH) if unknowns >= _ONE_COLUMN else 1
    return [unknowns * i // count for i in range(count + 1)]


def products(left: Array, right: Array, square: Callable[[Array], Array] | None) -> Condensed:
    """Return the lower triangle of left^T right, which is symmetric.

    Parameters
    ----------
    left, right
        Shape (m, n): N^0.5/m^0.5 both, or N/m and dimensionless; in Fortran's order.
    square
        Gives the lower triangle of X^T X for the columns X of `right` faster than the product,
        where `left` is `right`.
    """
    count = right.shape[1]
    starts = columns_of(count)
    blocks = []
    for a, b in pairwise(starts):
        columns = right[:, a:b]
        diagonal = square(columns) if square and columns.size else left[:, a:b].T @ columns
        if b - a == count:
            blocks.append(diagonal)
            continue
        block = np.empty((b - a, count - a)).T
        block[: b - a] = diagonal
        np.matmul(columns.T, left[:, b:], out=block.T[:, b - a :])
        blocks.append(block)
    return Condensed(starts, blocks)


def add_leaf(target: Condensed, matrix: Array) -> None:
    """Take a leaf's own stiffness of its boundary, shape (n, n), N/m, from minus the condensed."""
    for (a, b), block in zip(pairwise(target.starts), target.blocks, strict=True):
        block -= matrix[a:, a:b]


def route(part: Condensed, places: Array, eliminated: int, boundary: int) -> Route:
    """Return where a child's unknowns go: `places`, indices, shape (n,), in its parent's m + b."""
    pivots = int(places.searchsorted(eliminated))
    gaps = np.flatnonzero(places[1:] - places[:-1] != 1) + 1
    bounds = {*gaps.tolist(), *part.starts, pivots}
    columns = columns_of(boundary)
    if len(columns) > 2:
        bounds.update(places.searchsorted([eliminated + column for column in columns]).tolist())
    ordered = sorted(bounds)
    firsts = places[ordered[:-1]].tolist()
    return Route(places, pivots, list(zip(ordered, ordered[1:], firsts, strict=False)))


def add_to_pivots(A: Array, B: Array, part: Condensed, way: Route) -> None:
    """Add what a child hands on to the rows of the pivots.

    A stretch of columns at a time, whose rows in A may have gaps: stretch by stretch in both
    directions would be thousands of additions of a few numbers each.

    Parameters
    ----------
    A
        Shape (m, m), N/m: stiffness of the unknowns that are eliminated, the lower triangle.
    B
        Shape (m, b), N/m: the same with the boundary.
    part, way
        Of the child.
    """
    places, count, stretches = way
    across = [
        (slice(low - count, high - count), slice(to - len(A), to - len(A) + high - low))
        for low, high, to in stretches
        if low >= count
    ]
    for low, high, to in stretches:
        if low >= count:
            break
        a, block = part.holding(low)
        target = slice(to, to + high - low)
        own = block[low - a :, low - a : high - a]
        A[places[low:count], target] -= own[: count - low]
        below = own[count - low :]
        for source, column in across:
            B[target, column] -= below[source].T


def add_to_boundary(total: Condensed, part: Condensed, way: Route, eliminated: int) -> None:
    """Add what a child hands on to what its parent does."""
    for low, high, to in way.stretches:
        if low < way.pivots:
            continue
        a, block = part.holding(low)
        first, target = total.holding(to - eliminated)
        shift = eliminated + first
        columns = slice(to - shift, to - shift + high - low)
        target[way.places[low:] - shift, columns] += block[low - a :, low - a : high - a]
