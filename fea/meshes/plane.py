"""Plane meshes of 8-node quadrilaterals: the sections that `fea.meshes.sweep` draws out.

A section's corner nodes are numbered before its midside nodes, and its quadrilaterals run
counter-clockwise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class Section:
    """A plane mesh.

    Attributes
    ----------
    points
        Shape (k, 2), m; the first `corners` of them are corner nodes, the others midside nodes.
    quads
        Shape (q, 8): four corners counter-clockwise, then the middles of the four edges.
    corners
        Number of corner nodes.
    """

    points: Array
    quads: Array
    corners: int

    @property
    def edges(self) -> Array:
        """The edges of the outline, shape (e, 3): start, end, middle; the inside is on the left."""
        each = self.quads[:, [[0, 1, 4], [1, 2, 5], [2, 3, 6], [3, 0, 7]]].reshape(-1, 3)
        _, index, count = np.unique(each[:, 2], return_index=True, return_counts=True)
        return each[index[count == 1]]

    def within(self, low: Array, high: Array) -> Array:
        """Return the numbers of the quadrilaterals whose middle lies in a box, shape (i,)."""
        middle = self.points[self.quads[:, :4]].mean(axis=1)
        return np.flatnonzero(((middle > low) & (middle < high)).all(axis=1))


def quadratic(points: Array, quads: Array) -> Section:
    """Return the section of straight-sided `quads` with their midside nodes put in.

    Parameters
    ----------
    points
        Corner nodes, shape (c, 2), m.
    quads
        Shape (q, 4), counter-clockwise.
    """
    ends = np.stack([quads, np.roll(quads, -1, axis=1)], axis=-1)
    pairs, number = np.unique(np.sort(ends.reshape(-1, 2), axis=1), axis=0, return_inverse=True)
    middles = points[pairs].mean(axis=1)
    edge_nodes = len(points) + number.reshape(-1, 4)
    return Section(
        np.concatenate([points, middles]), np.hstack([quads, edge_nodes]), corners=len(points)
    )


def rectangle(x: Array, y: Array) -> Section:
    """Return the grid with lines at the ascending coordinates `x` and `y`, m."""
    nx, ny = len(x), len(y)
    grid = np.arange(nx * ny).reshape(nx, ny)
    quads = [grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]]
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    return quadratic(points, np.stack(quads, axis=-1).reshape(-1, 4))


def disc(radius: float, core: int) -> Section:
    """Return a round section: `core` x `core` quadrilaterals and a ring of 4 `core` around them.

    All outer nodes, the midside ones too, lie on the circle; so ``core = 2`` (12 quadrilaterals)
    has 0.08 % less area than the circle, ``core = 1`` (5) 1.2 %, and the error falls with the
    fourth power of `core`.

    Parameters
    ----------
    radius
        m.
    core
        Number of quadrilaterals across the core.
    """
    inner = _core_points(radius, core)
    rim = _rim_of_grid(core)
    angles = -0.75 * np.pi + 0.5 * np.pi * np.arange(4 * core) / core
    outer = radius * _directions(angles)
    grid = np.arange((core + 1) ** 2).reshape(core + 1, core + 1)
    quads = np.stack([grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]], axis=-1)
    on_circle = len(inner) + np.arange(4 * core)
    ring = np.stack([rim, on_circle, np.roll(on_circle, -1), np.roll(rim, -1)], axis=-1)
    section = quadratic(
        np.concatenate([inner, outer]), np.concatenate([quads.reshape(-1, 4), ring])
    )
    # The middles of the ring's outer edges (its second) move from the chord to the circle.
    outer_middles = section.quads[core * core :, 5]
    section.points[outer_middles] = radius * _directions(angles + 0.25 * np.pi / core)
    return section


def _core_points(radius: float, core: int) -> Array:
    """Place the core's nodes halfway between a square and the disc of 0.6 of the radius."""
    line = np.linspace(-1.0, 1.0, core + 1)
    s, t = np.meshgrid(line, line, indexing="ij")
    square = np.stack([s, t], axis=-1) / np.sqrt(2.0)
    # The elliptical map of a square to a disc; it keeps the four corners on the circle.
    round_ = np.stack([s * np.sqrt(1.0 - t**2 / 2.0), t * np.sqrt(1.0 - s**2 / 2.0)], axis=-1)
    return 0.6 * radius * (0.5 * (square + round_)).reshape(-1, 2)


def _rim_of_grid(core: int) -> Array:
    """Return the outer nodes of a (core + 1)^2 grid, counter-clockwise from its lowest corner."""
    grid = np.arange((core + 1) ** 2).reshape(core + 1, core + 1)
    sides = [grid[:-1, 0], grid[-1, :-1], grid[:0:-1, -1], grid[0, :0:-1]]
    return np.concatenate(sides)


def _directions(angles: Array) -> Array:
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)
