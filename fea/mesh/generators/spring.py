"""A right-handed helical spring of round wire."""

from __future__ import annotations

from typing import Literal

import numpy as np

from wrenchbook.fea.mesh.generators.parameters import too_many
from wrenchbook.fea.mesh.generators.plane import disc
from wrenchbook.fea.mesh.generators.sweep import sweep
from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.spec.keys import Positive, Whole, key, table
from wrenchbook.fea.spec.schema import Generator

Array = np.ndarray


@table
class Spring(Generator):
    """Parameters of generator "spring"; lengths in metres.

    The wire's centre line climbs about the z axis from (D/2, 0, 0) to the height `free_length`,
    turning from x to y. Both ends are cut square to the wire. Facet groups: ``bottom``, ``top``
    (the two cuts), ``side``.
    """

    wire_diameter: Positive = key("spring", "m", "0.002")
    mean_diameter: Positive = key("spring: of the helix of the wire's centre line", "m", "0.02")
    free_length: Positive = key("spring: height of that helix", "m", "0.05")
    active_turns: Positive = key("spring: from cut to cut", "turns", "5.5")
    cells_per_turn: Whole = key(
        "spring: layers of cells in one turn", "cells", "12", default=26, ge=6
    )
    # The section has core^2 + 4 core cells
    core: Whole = key(
        "spring: across the core of the wire's section", "cells", "2", default=1, ge=1
    )
    generator: Literal["spring"] = key(
        "`bar`, `plate` or `spring`, with its parameters",
        example='"spring"',
        default="spring",
        kw_only=True,
        absent="none",
    )

    def mistakes(self) -> list[tuple[str, str]]:
        """Return (key, message) for what does not fit together, or makes too many cells."""
        most = "cells_per_turn" if self.cells_per_turn > self.core else "core"
        layers = self.cells_per_turn * self.active_turns
        problems = too_many(layers * (self.core**2 + 4.0 * self.core), most)
        if self.wire_diameter >= self.mean_diameter:
            problems.append(
                ("wire_diameter", "must be below mean_diameter, or the wire meets itself")
            )
        if self.free_length <= self.active_turns * self.wire_diameter:
            problems.append(
                ("free_length", "must be above active_turns x wire_diameter, or turns touch")
            )
        return problems

    def mesh(self) -> Mesh:
        """Return the mesh, of 20-node hexahedra."""
        layers = int(np.ceil(self.cells_per_turn * self.active_turns - 1e-9))
        wire = sweep(disc(self.wire_diameter / 2.0, self.core), layers, self._place)
        groups = {"bottom": wire.start(), "top": wire.end(), "side": wire.side()}
        return Mesh(wire.points, (wire.cells,), facet_groups=groups)

    def _place(self, flat: Array, fraction: Array) -> Array:
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
