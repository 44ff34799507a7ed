"""A right-handed helical spring of round wire."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wrenchbook.fea.mesh.generators.parameters import count, metres, positive, too_many
from wrenchbook.fea.mesh.generators.plane import disc
from wrenchbook.fea.mesh.generators.sweep import sweep
from wrenchbook.fea.mesh.mesh import Mesh

Array = np.ndarray


@dataclass(frozen=True)
class Spring:
    """Parameters of generator "spring"; lengths in metres.

    The wire's centre line climbs about the z axis from (D/2, 0, 0) to the height `free_length`,
    turning from x to y. Both ends are cut square to the wire. Facet groups: ``bottom``, ``top``
    (the two cuts), ``side``.
    """

    # wire_diameter, mean_diameter, free_length: of the wire, of the helix of its centre line, and
    # that helix's height.
    wire_diameter: float = metres()
    mean_diameter: float = metres()
    free_length: float = metres()
    active_turns: float = positive("turns")  # Turns from cut to cut
    cells_per_turn: int = count(26, least=6)  # Layers of cells in one turn
    core: int = count(1)  # cells across the core of the section, which has core^2 + 4 core cells

    def mistakes(self) -> list[tuple[str, str]]:
        """Return (key, message) for what does not fit together, or makes too many cells."""
        key = "cells_per_turn" if self.cells_per_turn > self.core else "core"
        layers = self.cells_per_turn * self.active_turns
        problems = too_many(layers * (self.core**2 + 4.0 * self.core), key)
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
