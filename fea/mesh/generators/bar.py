"""A straight bar of rectangular section along x."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wrenchbook.fea.mesh.generators.parameters import count, metres, too_many
from wrenchbook.fea.mesh.generators.plane import rectangle
from wrenchbook.fea.mesh.generators.sweep import sweep
from wrenchbook.fea.mesh.mesh import Mesh

Array = np.ndarray


@dataclass(frozen=True)
class Bar:
    """Parameters of generator "bar"; lengths in metres.

    The bar lies along x from 0 to `length`, centred on the axis. Facet groups: ``start``
    (x = 0), ``end`` (x = `length`), ``side``.
    """

    # length, width, height: Along x, y, z
    length: float = metres()
    width: float = metres()
    height: float = metres()
    # cells_along, cells_across: number of cells along x, and along each of y and z
    cells_along: int = count(40)
    cells_across: int = count(2)

    def mistakes(self) -> list[tuple[str, str]]:
        """Return (key, message) for what will not do: too many cells."""
        key = "cells_along" if self.cells_along > self.cells_across else "cells_across"
        return too_many(float(self.cells_along) * self.cells_across**2, key)

    def mesh(self) -> Mesh:
        """Return the mesh, of 20-node hexahedra."""
        half = np.linspace(-0.5, 0.5, self.cells_across + 1)
        section = rectangle(self.width * half, self.height * half)

        def place(flat: Array, fraction: Array) -> Array:
            return np.column_stack([self.length * fraction, flat])

        swept = sweep(section, self.cells_along, place)
        groups = {"start": swept.start(), "end": swept.end(), "side": swept.side()}
        return Mesh(swept.points, (swept.cells,), facet_groups=groups)
