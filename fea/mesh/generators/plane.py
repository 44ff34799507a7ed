"""Plane meshes of 8-node quadrilaterals: the sections that `fea.mesh.generators.sweep` draws out.

A section's corner nodes are numbered before its midside nodes, and its quadrilaterals run
counter-clockwise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class PlaneMesh:
    """A plane mesh."""

    # Shape (k, 2), m; the first `corners` of them are corner nodes, the others midside nodes
    points: Array
    quads: Array  # shape (q, 8): four corners counter-clockwise, then the middles of the four edges
    corners: int  # number of corner nodes

    @property
    def edges(self) -> Array:
        """The edges of the outline: start, end, middle; the inside is on the left.

        Shape (e, 3), indices of nodes.
        """
        each = self.quads[:, [[0, 1, 4], [1, 2, 5], [2, 3, 6], [3, 0, 7]]].reshape(-1, 3)
        _, index, count = np.unique(each[:, 2], return_index=True, return_counts=True)
        return each[index[count == 1]]


def quadratic(points: Array, quads: Array) -> PlaneMesh:
    """Return the section of straight-sided `quads` with their midside nodes put in.

    points: Corner nodes, shape (c, 2), m.
    quads: shape (q, 4), counter-clockwise.
    """
    ends = np.stack([quads, np.roll(quads, -1, axis=1)], axis=-1)
    pairs, number = np.unique(np.sort(ends.reshape(-1, 2), axis=1), axis=0, return_inverse=True)
    middles = points[pairs].mean(axis=1)
    edge_nodes = len(points) + number.reshape(-1, 4)
    return PlaneMesh(
        np.concatenate([points, middles]), np.hstack([quads, edge_nodes]), corners=len(points)
    )


def rectangle(x: Array, y: Array) -> PlaneMesh:
    """Return the grid with lines at ascending `x` and `y`, shapes (nx,) and (ny,), m."""
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    return quadratic(points, grid_quads(len(x), len(y)))


def disc(radius: float, core: int) -> PlaneMesh:
    """Return a round section: `core` x `core` quadrilaterals and a ring of 4 `core` around them.

    Its outline is 4 `core` parabolas, whose nodes all lie on one circle. That circle is a little
    larger than `radius` (0.6 % for ``core = 1``, 0.04 % for ``core = 2``), so that the section has
    the area of the true one; with its nodes on the true circle 5 quadrilaterals would have 2.4 %
    less stiffness in torsion.

    radius: m.
    core: number of quadrilaterals across the core.
    """
    points, quads = round_corners(radius, core)
    section = quadratic(points, quads)
    bend_circle(section, core)
    return section


def round_corners(radius: float, core: int) -> tuple[Array, Array]:
    """Return the corner nodes and quadrilaterals of `disc`.

    Shapes (c, 2), m, and (q, 4), indices of nodes; the radius is in m.

    The last 4 `core` nodes are those of the circle, counter-clockwise from -135 degrees, and the
    last 4 `core` quadrilaterals those along it, each with its second side there.
    """
    # The core's nodes are halfway between a square and a disc. Its fraction of the radius makes the
    # ring about as wide as the cells of a fine core; for a core of one or two cells it is the
    # fraction that gave the most exact torsion of a wire.
    line = np.linspace(-1.0, 1.0, core + 1)
    s, t = np.meshgrid(line, line, indexing="ij")
    square = np.stack([s, t], axis=-1) / np.sqrt(2.0)
    # The elliptical map of a square to a disc; it keeps the four corners on the circle.
    round_ = np.stack([s * np.sqrt(1.0 - t**2 / 2.0), t * np.sqrt(1.0 - s**2 / 2.0)], axis=-1)
    fraction = max(0.6, core / (core + 1.7))
    inner = fraction * radius * (0.5 * (square + round_)).reshape(-1, 2)
    arcs = 4 * core
    angles = -0.75 * np.pi + 2.0 * np.pi * np.arange(arcs) / arcs
    outer = radius * equal_area_factor(arcs) * directions(angles)
    ring = ring_quads(rim_of_grid(core), len(inner) + np.arange(arcs))
    return np.concatenate([inner, outer]), np.concatenate([grid_quads(core + 1, core + 1), ring])


def bend_circle(section: PlaneMesh, core: int) -> None:
    """Move the middles of the disc's outer edges from the chord out to the circle.

    The section's first quadrilaterals are those of `round_corners`.
    """
    along = section.quads[core * core : core * core + 4 * core]
    ends, middles = section.points[along[:, 1]], along[:, 5]
    chord = section.points[middles]
    stretch = np.hypot(*ends.T) / np.hypot(*chord.T)
    section.points[middles] = chord * stretch[:, None]


def equal_area_factor(arcs: int) -> float:
    """Return the radius at which `arcs` parabolas enclose the area of the unit circle.

    Each parabola runs through three points of a circle; it encloses two thirds of its chord times
    its height beyond the triangle to the centre (Archimedes).
    """
    half = np.pi / arcs
    triangle = np.sin(half) * np.cos(half)
    segment = 4.0 / 3.0 * np.sin(half) * (1.0 - np.cos(half))
    return float(np.sqrt(np.pi / (arcs * (triangle + segment))))


def grid_quads(nx: int, ny: int) -> Array:
    """Return the quadrilaterals of a grid of nx x ny nodes, numbered along y first.

    Shape ((nx - 1) (ny - 1), 4), int64: indices of nodes, counter-clockwise.
    """
    grid = np.arange(nx * ny).reshape(nx, ny)
    quads = [grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]]
    return np.stack(quads, axis=-1).reshape(-1, 4)


def rim_of_grid(core: int) -> Array:
    """Return the outer nodes of a (core + 1)^2 grid, counter-clockwise from its lowest corner.

    Shape (4 core,), int64, indices.
    """
    grid = np.arange((core + 1) ** 2).reshape(core + 1, core + 1)
    sides = [grid[:-1, 0], grid[-1, :-1], grid[:0:-1, -1], grid[0, :0:-1]]
    return np.concatenate(sides)


def ring_quads(inner: Array, outer: Array) -> Array:
    """Return the quadrilaterals between two closed rows of nodes, counter-clockwise.

    Shapes (k,) and (k,) to (k, 4), int64, all indices of nodes.
    """
    return np.stack([inner, outer, np.roll(outer, -1), np.roll(inner, -1)], axis=-1)


def directions(angles: Array) -> Array:
    """Return unit vectors at `angles` (rad) from x towards y, shape (k, 2)."""
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)
