"""A flat rectangular plate with a round patch in its middle."""

from __future__ import annotations

from itertools import pairwise
from typing import Literal

import numpy as np

from wrenchbook.fea.mesh.generators.parameters import too_many
from wrenchbook.fea.mesh.generators.plane import (
    bend_circle,
    grid_quads,
    quadratic,
    rim_of_grid,
    ring_quads,
    round_corners,
)
from wrenchbook.fea.mesh.generators.sweep import sweep
from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.spec.keys import Positive, Whole, key, table
from wrenchbook.fea.spec.schema import Generator

Array = np.ndarray


@table
class Plate(Generator):
    """Parameters of generator "plate"; lengths in metres.

    The plate's middle is at x = y = 0; it reaches from z = 0 up to `thickness`. Facets cover the
    patch (whose outline has its exact area, see `fea.mesh.generators.plane.disc`) and the
    corner squares.
    Facet groups: ``patch`` (in the middle of the top face), ``corners`` (four squares of the
    bottom face), ``rim`` (the four sides), ``top``, ``bottom``.
    """

    length: Positive = key("plate: along x", "m", "0.4")
    width: Positive = key("plate: along y", "m", "0.4")
    thickness: Positive = key("plate: along z", "m", "0.01")
    patch: Positive = key("plate: diameter of the round patch, facet group `patch`", "m", "0.12")
    corner: Positive = key(
        "plate: side of the corner squares, facet group `corners`", "m", "0.03", default=0.04
    )
    cells: Whole = key(
        "plate: across the patch's core, and along each side between two corners",
        "cells",
        "8",
        default=6,
        ge=2,
    )
    rings: Whole = key("plate: from the patch out to the corners", "cells", "4", default=3, ge=1)
    corner_cells: Whole = key(
        "plate: along each side of a corner square", "cells", "2", default=1, ge=1
    )
    layers: Whole = key("plate: through the thickness", "cells", "3", default=2, ge=1)
    generator: Literal["plate"] = key(
        "`bar`, `plate` or `spring`, with its parameters",
        example='"plate"',
        default="plate",
        kw_only=True,
        absent="none",
    )

    def mistakes(self) -> list[tuple[str, str]]:
        """Return (key, message) for what does not fit together, or makes too many cells."""
        side = min(self.length, self.width)
        if 1.1 * self.patch + 2.0 * self.corner < side:
            lines = self.cells + 2.0 * self.corner_cells
            plan = lines**2 + 4.0 * self.cells * (self.rings + 1)
            counts = ("cells", "rings", "corner_cells", "layers")
            return too_many(plan * self.layers, max(counts, key=lambda name: getattr(self, name)))
        message = (
            f"patch ({self.patch:g} m) and two corner squares ({self.corner:g} m each) do not fit "
            f"along the shorter side ({side:g} m) with room between them; make one smaller"
        )
        return [("patch", message)]

    def mesh(self) -> Mesh:
        """Return the mesh, of 20-node hexahedra."""
        # The plan: the patch, rings out to a rectangle, and a frame as wide as `corner`.
        disc, disc_quads = round_corners(self.patch / 2.0, self.cells)
        grid = np.stack(
            np.meshgrid(self._lines(self.length), self._lines(self.width), indexing="ij"), axis=-1
        )
        # The frame's part of a grid of `lines` x `lines` nodes: its quadrilaterals, their nodes,
        # and the nodes of the inner rectangle, counter-clockwise from its lowest corner.
        lines = len(grid)
        first, last = self.corner_cells, self.corner_cells + self.cells
        quads = grid_quads(lines, lines)
        column, row = quads[:, 0] // lines, quads[:, 0] % lines
        inside = (first <= column) & (column < last) & (first <= row) & (row < last)
        column, row = np.divmod(rim_of_grid(self.cells), self.cells + 1)
        inner = (first + column) * lines + first + row
        frame, of_frame = quads[~inside], np.unique(quads[~inside])
        arcs = 4 * self.cells
        circle, rectangle = disc[-arcs:], grid.reshape(-1, 2)[inner]
        steps = np.arange(1, self.rings) / self.rings
        between = [circle + step * (rectangle - circle) for step in steps]
        on_frame = grid.reshape(-1, 2)[of_frame]
        points = np.concatenate([disc, *between, on_frame])

        first = len(points) - len(on_frame)
        number = np.full(len(grid) ** 2, -1)
        number[of_frame] = first + np.arange(len(of_frame))
        rows = [len(disc) - arcs + arcs * i + np.arange(arcs) for i in range(self.rings)]
        rows.append(number[inner])
        rings = [ring_quads(a, b) for a, b in pairwise(rows)]
        section = quadratic(points, np.concatenate([disc_quads, *rings, number[frame]]))
        bend_circle(section, self.cells)

        def place(flat: Array, fraction: Array) -> Array:
            return np.column_stack([flat, self.thickness * fraction])

        plate = sweep(section, self.layers, place)
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

    def _lines(self, length: float) -> Array:
        """Return the grid lines of the frame in one direction, symmetric about 0."""
        inner = length / 2.0 - self.corner
        corner = np.linspace(inner, length / 2.0, self.corner_cells + 1)[1:]
        middle = np.linspace(-inner, inner, self.cells + 1)
        return np.concatenate([-corner[::-1], middle, corner])
