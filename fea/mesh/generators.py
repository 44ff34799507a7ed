"""Mesh generators: bar, plate and spring, each a plane section swept into 20-node hexahedra.

A section's corner nodes are numbered before its midside nodes, and its quadrilaterals run
counter-clockwise. Nodes are shared by their indices, without a comparison of coordinates, so no
node exists twice. Each generator is a frozen dataclass whose fields carry their unit and bounds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from wrenchbook.fea.mesh.mesh import CellBlock, FacetBlock, FacetGroup, Mesh
from wrenchbook.fea.spec.keys import Integer, Positive, key, table
from wrenchbook.fea.spec.mesh_source import Generator

_MIN_CORE = 0.6
"""Least radius of the core, over the section's.

A round bar's torsion with a core of one cell is 0.04 % off, and 0.12 and 0.22 % at 0.55 and 0.65;
of two cells it is 0.005 % off.
"""
_RING = 1.7
"""Width of the ring around a fine core, in cells of the core.

Edges then differ the least: by 4.0 in a core of four cells and by 6.9 of eight. With a width of 1
the ratios are 5.0 and 9.0, with 2.5 they are 4.6 and 7.4.
"""
_SPACE = 1.1  # least space for a round patch, in its diameters, so that its rings have a width
_ROUNDOFF = 1e-9  # rounding of a number of layers, which may be a product of decimal fractions
MAX_CELLS = 2_000_000
"""Largest number of cells: more than any machine solves, so probably a typing error."""


def too_many(cells: float, where: str) -> list[tuple[str, str]]:
    """Return the mistake of too many cells, if any, at the key `where` that makes most of them."""
    if cells <= MAX_CELLS:
        return []
    remedy = "write a larger size" if where == "mesh.size" else "write fewer"
    limit = f"{MAX_CELLS // 10**6} million"
    return [(where, f"makes {cells:.3g} cells, more than {limit}; {remedy}")]


@dataclass(frozen=True, eq=False)
class PlaneMesh:
    """A plane mesh."""

    # Shape (k, 2), m; the first `corners` of them are corner nodes, the others midside nodes
    points: np.ndarray
    # Shape (q, 8): four corners counter-clockwise, then the middles of the four edges
    quads: np.ndarray
    corners: int  # number of corner nodes

    @property
    def stride(self) -> int:
        """Number of nodes between a node and its image in the next layer of a sweep."""
        return len(self.points) + self.corners

    @property
    def edges(self) -> np.ndarray:
        """Nodes of the outline's edges, (e, 3): start, end, middle; the inside is on the left."""
        each = self.quads[:, [[0, 1, 4], [1, 2, 5], [2, 3, 6], [3, 0, 7]]].reshape(-1, 3)
        _, index, count = np.unique(each[:, 2], return_index=True, return_counts=True)
        return each[index[count == 1]]


def quadratic(points: np.ndarray, quads: np.ndarray) -> PlaneMesh:
    """Return the section of straight-sided `quads` with added midside nodes.

    points: shape (c, 2), m: corner nodes.
    quads: shape (q, 4), counter-clockwise.
    """
    ends = np.stack([quads, np.roll(quads, -1, axis=1)], axis=-1)
    pairs, number = np.unique(np.sort(ends.reshape(-1, 2), axis=1), axis=0, return_inverse=True)
    middles = points[pairs].mean(axis=1)
    edge_nodes = len(points) + number.reshape(-1, 4)
    return PlaneMesh(
        np.concatenate([points, middles]), np.hstack([quads, edge_nodes]), corners=len(points)
    )


def rectangle(x: np.ndarray, y: np.ndarray) -> PlaneMesh:
    """Return the grid with lines at ascending `x` and `y`, shapes (nx,) and (ny,), m."""
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    return quadratic(points, grid_quads(len(x), len(y)))


def disc(radius: float, core: int) -> PlaneMesh:
    """Return a round section: `core` x `core` quadrilaterals and a ring of 4 `core` around them.

    Its outline is 4 `core` parabolas, whose nodes all lie on one circle. That circle is a little
    larger than `radius` (0.6 % for ``core = 1``, 0.04 % for ``core = 2``), so that the section has
    the true circle's area; with its nodes on the true circle 5 quadrilaterals would have 2.4 %
    less stiffness in torsion.

    radius: m.
    """
    points, quads = round_corners(radius, core)
    section = quadratic(points, quads)
    bend_circle(section, core)
    return section


def round_corners(radius: float, core: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the corner nodes and quadrilaterals of `disc`.

    Shapes (c, 2), m, and (q, 4), indices of nodes; the radius is in m.

    The last 4 `core` nodes are those of the circle, counter-clockwise from -135 degrees, and the
    last 4 `core` quadrilaterals those along it, each with its second side there.
    """
    # The core's nodes are halfway between a square and a disc.
    line = np.linspace(-1.0, 1.0, core + 1)
    s, t = np.meshgrid(line, line, indexing="ij")
    square = np.stack([s, t], axis=-1) / np.sqrt(2.0)
    # The elliptical map of a square to a disc; it keeps the four corners on the circle.
    round_ = np.stack([s * np.sqrt(1.0 - t**2 / 2.0), t * np.sqrt(1.0 - s**2 / 2.0)], axis=-1)
    fraction = max(_MIN_CORE, core / (core + _RING))
    inner = fraction * radius * (0.5 * (square + round_)).reshape(-1, 2)
    arcs = 4 * core
    angles = -0.75 * np.pi + 2.0 * np.pi * np.arange(arcs) / arcs
    outer = radius * equal_area_factor(arcs) * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    ring = ring_quads(rim_of_grid(core), len(inner) + np.arange(arcs))
    return np.concatenate([inner, outer]), np.concatenate([grid_quads(core + 1, core + 1), ring])


def bend_circle(section: PlaneMesh, core: int) -> None:
    """Move the middles of the disc's outer edges from the chord out to the circle.

    The section's first quadrilaterals are those of `round_corners`.
    """
    along = section.quads[core * core : core * core + 4 * core]
    ends = section.points[along[:, 1]]
    middles = along[:, 5]
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


def grid_quads(nx: int, ny: int) -> np.ndarray:
    """Return the quadrilaterals of a grid of nx x ny nodes, numbered along y first.

    Shape ((nx - 1) (ny - 1), 4), int64: indices of nodes, counter-clockwise.
    """
    grid = np.arange(nx * ny).reshape(nx, ny)
    quads = [grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]]
    return np.stack(quads, axis=-1).reshape(-1, 4)


def rim_of_grid(core: int) -> np.ndarray:
    """Return the outer nodes of a (core + 1)^2 grid, counter-clockwise from its lowest corner.

    Shape (4 core,), int64, indices.
    """
    grid = np.arange((core + 1) ** 2).reshape(core + 1, core + 1)
    sides = [grid[:-1, 0], grid[-1, :-1], grid[:0:-1, -1], grid[0, :0:-1]]
    return np.concatenate(sides)


def ring_quads(inner: np.ndarray, outer: np.ndarray) -> np.ndarray:
    """Return the quadrilaterals between two closed rows of nodes, counter-clockwise.

    Shapes (k,) and (k,) to (k, 4), int64, all indices of nodes.
    """
    return np.stack([inner, outer, np.roll(outer, -1), np.roll(inner, -1)], axis=-1)


# Section points and fraction of the way to points in space, see `sweep`.
PointMap = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class Sweep:
    """A section swept into `layers` layers of cells."""

    section: PlaneMesh
    layers: int
    points: np.ndarray  # shape (n, 3), m
    # One block of hex20: layer after layer, within each in the order of the section
    cells: CellBlock

    def start(self, quads: np.ndarray | slice = slice(None)) -> FacetGroup:
        """Return the facets of the section's `quads` at the start, outwards.

        `quads` are indices of shape (k,), or a mask of shape (q,); all if not given.
        """
        nodes = self.section.quads[quads][:, [0, 3, 2, 1, 7, 6, 5, 4]]
        return FacetGroup((FacetBlock("quad8", nodes),))

    def end(self, quads: np.ndarray | slice = slice(None)) -> FacetGroup:
        """Return the facets of the section's `quads` at the end, outwards.

        `quads` are indices of shape (k,), or a mask of shape (q,); all if not given.
        """
        nodes = self.section.quads[quads] + self.layers * self.section.stride
        return FacetGroup((FacetBlock("quad8", nodes),))

    def side(self) -> FacetGroup:
        """Return the facets swept by the section's outline, looking outwards."""
        start, end, middle = self.section.edges.T
        between = len(self.section.points)
        stride = self.section.stride
        columns = [
            start,
            end,
            end + stride,
            start + stride,
            middle,
            end + between,
            middle + stride,
            start + between,
        ]
        return FacetGroup((FacetBlock("quad8", _each_layer(columns, stride, self.layers)),))


def sweep(section: PlaneMesh, layers: int, to_space: PointMap) -> Sweep:
    """Sweep `section` into `layers` layers of cells.

    section: counter-clockwise about the direction of the sweep.
    to_space: from section points, shape (k, 2), and the fraction of the way, shape (k,), from 0 to
    1, to points in space, shape (k, 3). Called once, so that any line is possible.
    """
    stride = section.stride
    between = len(section.points)
    level_of = np.concatenate([np.zeros(between), np.ones(section.corners)])
    flat = np.concatenate([section.points, section.points[: section.corners]])
    levels = (level_of + 2.0 * np.arange(layers + 1)[:, None]).ravel()
    points = to_space(np.tile(flat, (layers + 1, 1)), levels / (2.0 * layers))
    quads = section.quads
    columns = [
        *quads[:, :4].T,
        *(quads[:, :4] + stride).T,
        *quads[:, 4:].T,
        *(quads[:, 4:] + stride).T,
        *(quads[:, :4] + between).T,
    ]
    cells = CellBlock("hex20", _each_layer(columns, stride, layers))
    # The last level has no layer above it, so its intermediate nodes are left out.
    return Sweep(section, layers, points[: len(points) - section.corners], cells)


def _each_layer(columns: list[np.ndarray], stride: int, layers: int) -> np.ndarray:
    """Return the nodes of all layers by those of the first, k columns of (q,): (layers q, k)."""
    first = np.stack(columns, axis=-1).astype(np.int64)
    shifts = stride * np.arange(layers, dtype=np.int64)
    return (first + shifts[:, None, None]).reshape(-1, first.shape[-1])


@table
class Bar(Generator):
    """Parameters of generator "bar"; lengths in metres.

    The bar lies along x from 0 to `length`, centred on the axis. Facet groups: ``start``
    (x = 0), ``end`` (x = `length`), ``side``.
    """

    length: Positive = key("m", "0.4")
    """bar, plate: along x"""
    width: Positive = key("m", "0.4")
    """bar, plate: along y"""
    height: Positive = key("m", "0.02")
    """bar: along z"""
    cells_along: Integer = key("cells", "20", default=40, ge=1)
    """bar: along x"""
    cells_across: Integer = key("cells", "3", default=2, ge=1)
    """bar: along each of y and z"""
    generator: Literal["bar"] = key("", '"bar"', default="bar", kw_only=True, default_text="none")
    """`bar`, `plate` or `spring`, with its parameters"""

    def mistakes(self) -> list[tuple[str, str]]:
        """Return (key, message) for wrong parameters: too many cells."""
        name = "cells_along" if self.cells_along > self.cells_across else "cells_across"
        return too_many(float(self.cells_along) * self.cells_across**2, name)

    def mesh(self) -> Mesh:
        """Return the mesh, of 20-node hexahedra."""
        half = np.linspace(-0.5, 0.5, self.cells_across + 1)
        section = rectangle(self.width * half, self.height * half)

        def to_space(flat: np.ndarray, fraction: np.ndarray) -> np.ndarray:
            return np.column_stack([self.length * fraction, flat])

        swept = sweep(section, self.cells_along, to_space)
        groups = {"start": swept.start(), "end": swept.end(), "side": swept.side()}
        return Mesh(swept.points, (swept.cells,), facet_groups=groups)


@table
class Plate(Generator):
    """Parameters of generator "plate"; lengths in metres.

    The plate's middle is at x = y = 0; it reaches from z = 0 up to `thickness`. Facets cover the
    patch (whose outline has its exact area, see `disc`) and the corner squares.
    Facet groups: ``patch`` (in the middle of the top face), ``corners`` (four squares of the bottom
    face), ``rim`` (the four sides), ``top``, ``bottom``.
    """

    length: Positive = key("m", "0.4")
    """bar, plate: along x"""
    width: Positive = key("m", "0.4")
    """bar, plate: along y"""
    thickness: Positive = key("m", "0.01")
    """plate: along z"""
    patch: Positive = key("m", "0.12")
    """plate: diameter of the round patch, facet group `patch`"""
    corner: Positive = key("m", "0.03", default=0.04)
    """plate: side of the corner squares, facet group `corners`"""
    cells: Integer = key("cells", "8", default=6, ge=2)
    """plate: across the patch's core, and along each side between two corners"""
    rings: Integer = key("cells", "4", default=3, ge=1)
    """plate: from the patch out to the corners"""
    corner_cells: Integer = key("cells", "2", default=1, ge=1)
    """plate: along each side of a corner square"""
    layers: Integer = key("cells", "3", default=2, ge=1)
    """plate: through the thickness"""
    generator: Literal["plate"] = key(
        "", '"plate"', default="plate", kw_only=True, default_text="none"
    )
    """`bar`, `plate` or `spring`, with its parameters"""

    def mistakes(self) -> list[tuple[str, str]]:
        """Return (key, message) for contradictory parameters, or too many cells."""
        side = min(self.length, self.width)
        if _SPACE * self.patch + 2.0 * self.corner < side:
            lines = self.cells + 2.0 * self.corner_cells
            plan = lines**2 + 4.0 * self.cells * (self.rings + 1)
            counts = ("cells", "rings", "corner_cells", "layers")
            return too_many(plan * self.layers, max(counts, key=lambda name: getattr(self, name)))
        message = (
            f"patch ({self.patch:g} m) and two corner squares ({self.corner:g} m each) do not fit "
            f"beside each other on the shorter side ({side:g} m); make one smaller"
        )
        return [("patch", message)]

    def mesh(self) -> Mesh:
        """Return the mesh, of 20-node hexahedra."""
        # The plan: the patch, rings out to a rectangle, and a frame as wide as `corner`.
        patch, patch_quads = round_corners(self.patch / 2.0, self.cells)
        grid = np.stack(
            np.meshgrid(self._lines(self.length), self._lines(self.width), indexing="ij"), axis=-1
        )
        frame, inner = self._frame(len(grid))
        of_frame = np.unique(frame)
        arcs = 4 * self.cells
        circle = patch[-arcs:]
        outline = grid.reshape(-1, 2)[inner]
        steps = np.arange(1, self.rings) / self.rings
        between = [circle + step * (outline - circle) for step in steps]
        on_frame = grid.reshape(-1, 2)[of_frame]
        points = np.concatenate([patch, *between, on_frame])

        first = len(points) - len(on_frame)
        number = np.full(len(grid) ** 2, -1)
        number[of_frame] = first + np.arange(len(of_frame))
        rows = [len(patch) - arcs + arcs * i + np.arange(arcs) for i in range(self.rings)]
        rows.append(number[inner])
        rings = [ring_quads(a, b) for a, b in pairwise(rows)]
        section = quadratic(points, np.concatenate([patch_quads, *rings, number[frame]]))
        bend_circle(section, self.cells)

        def to_space(flat: np.ndarray, fraction: np.ndarray) -> np.ndarray:
            return np.column_stack([flat, self.thickness * fraction])

        plate = sweep(section, self.layers, to_space)
        on_patch = np.arange(self.cells**2 + 4 * self.cells)
        middle = np.abs(section.points[section.quads[:, :4]].mean(axis=1))
        edge = np.array([self.length, self.width]) / 2.0 - self.corner
        groups = {
            "patch": plate.end(on_patch),
            "corners": plate.start(np.flatnonzero((middle > edge).all(axis=1))),
            "rim": plate.side(),
            "top": plate.end(),
            "bottom": plate.start(),
        }
        return Mesh(plate.points, (plate.cells,), facet_groups=groups)

    def _frame(self, lines: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the frame's quadrilaterals, (q, 4), in a grid of `lines` x `lines` nodes.

        The second result has the nodes of the inner rectangle, (k,), counter-clockwise from its
        lowest corner.
        """
        first = self.corner_cells
        last = self.corner_cells + self.cells
        quads = grid_quads(lines, lines)
        column = quads[:, 0] // lines
        row = quads[:, 0] % lines
        inside = (first <= column) & (column < last) & (first <= row) & (row < last)
        column, row = np.divmod(rim_of_grid(self.cells), self.cells + 1)
        return quads[~inside], (first + column) * lines + first + row

    def _lines(self, length: float) -> np.ndarray:
        """Return the grid lines of the frame in one direction, symmetric about 0."""
        inner = length / 2.0 - self.corner
        corner = np.linspace(inner, length / 2.0, self.corner_cells + 1)[1:]
        middle = np.linspace(-inner, inner, self.cells + 1)
        return np.concatenate([-corner[::-1], middle, corner])


@table
class Spring(Generator):
    """Parameters of generator "spring"; lengths in metres.

    The wire's centre line climbs about the z axis from (D/2, 0, 0) to the height `free_length`,
    turning from x to y. Both ends are cut square to the wire. Facet groups: ``bottom``, ``top``
    (the two cuts), ``side``.
    """

    wire_diameter: Positive = key("m", "0.002")
    """spring"""
    mean_diameter: Positive = key("m", "0.02")
    """spring: of the helix of the wire's centre line"""
    free_length: Positive = key("m", "0.05")
    """spring: height of that helix"""
    active_turns: Positive = key("turns", "5.5")
    """spring: from cut to cut"""
    cells_per_turn: Integer = key("cells", "12", default=26, ge=6)
    """spring: layers of cells in one turn"""
    # The section has core^2 + 4 core cells.
    core: Integer = key("cells", "2", default=1, ge=1)
    """spring: across the core of the wire's section"""
    generator: Literal["spring"] = key(
        "", '"spring"', default="spring", kw_only=True, default_text="none"
    )
    """`bar`, `plate` or `spring`, with its parameters"""

    def mistakes(self) -> list[tuple[str, str]]:
        """Return (key, message) for contradictory parameters, or too many cells."""
        name = "cells_per_turn" if self.cells_per_turn > self.core else "core"
        layers = self.cells_per_turn * self.active_turns
        problems = too_many(layers * (self.core**2 + 4.0 * self.core), name)
        if self.wire_diameter >= self.mean_diameter:
            limit = f"mean_diameter, {self.mean_diameter:g} m"
            message = f"must be below {limit}, not {self.wire_diameter:g}; write a thinner wire"
            problems.append(("wire_diameter", message))
        if self.free_length <= (solid := self.active_turns * self.wire_diameter):
            limit = f"active_turns x wire_diameter, {solid:g} m"
            message = f"must be above {limit}, not {self.free_length:g}; write a longer spring"
            problems.append(("free_length", message))
        return problems

    def mesh(self) -> Mesh:
        """Return the mesh, of 20-node hexahedra."""
        layers = max(int(np.ceil(self.cells_per_turn * self.active_turns - _ROUNDOFF)), 1)
        wire = sweep(disc(self.wire_diameter / 2.0, self.core), layers, self._to_space)
        groups = {"bottom": wire.start(), "top": wire.end(), "side": wire.side()}
        return Mesh(wire.points, (wire.cells,), facet_groups=groups)

    def _to_space(self, flat: np.ndarray, fraction: np.ndarray) -> np.ndarray:
        """Put section points onto the cuts square to the helix.

        A section's first coordinate runs along the helix's normal (towards its axis), the second
        along its binormal: the Frenet frame, in which every section looks alike.
        """
        radius = self.mean_diameter / 2.0
        angle = 2.0 * np.pi * self.active_turns * fraction
        rise = self.free_length / (2.0 * np.pi * self.active_turns)
        cos, sin = np.cos(angle), np.sin(angle)
        normal = np.column_stack([-cos, -sin, np.zeros_like(angle)])
        scaled_binormal = np.column_stack([rise * sin, -rise * cos, np.full_like(angle, radius)])
        binormal = scaled_binormal / np.hypot(radius, rise)
        centre = np.column_stack([radius * cos, radius * sin, rise * angle])
        return centre + flat[:, :1] * normal + flat[:, 1:] * binormal


GENERATORS: dict[str, type[Bar] | type[Plate] | type[Spring]] = {
    "bar": Bar,
    "plate": Plate,
    "spring": Spring,
}
"""The generators a bundle can name: tables of parameters with `mistakes`, `mesh`."""
