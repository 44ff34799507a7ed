"""A straight bar of rectangular section along x."""

from __future__ import annotations

from typing import Literal

import numpy as np

from wrenchbook.fea.mesh.generators.parameters import too_many
from wrenchbook.fea.mesh.generators.plane import rectangle
from wrenchbook.fea.mesh.generators.sweep import sweep
from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.spec.keys import Positive, Whole, key, table
from wrenchbook.fea.spec.schema import Generator

Array = np.ndarray


@table
class Bar(Generator):
    """Parameters of generator "bar"; lengths in metres.

    The bar lies along x from 0 to `length`, centred on the axis. Facet groups: ``start``
    (x = 0), ``end`` (x = `length`), ``side``.
    """

    length: Positive = key("bar: along x", "m", "0.4")
    width: Positive = key("bar: along y", "m", "0.4")
    height: Positive = key("bar: along z", "m", "0.02")
    cells_along: Whole = key("bar: along x", "cells", "20", default=40, ge=1)
    cells_across: Whole = key("bar: along each of y and z", "cells", "3", default=2, ge=1)
    generator: Literal["bar"] = key(
        "`bar`, `plate` or `spring`, with its parameters",
        example='"bar"',
        default="bar",
        kw_only=True,
        absent="none",
    )

    def mistakes(self) -> list[tuple[str, str]]:
        """Return (key, message) for what will not do: too many cells."""
        most = "cells_along" if self.cells_along > self.cells_across else "cells_across"
        return too_many(float(self.cells_along) * self.cells_across**2, most)

    def mesh(self) -> Mesh:
        """Return the mesh, of 20-node hexahedra."""
        half = np.linspace(-0.5, 0.5, self.cells_across + 1)
        section = rectangle(self.width * half, self.height * half)

        def place(flat: Array, fraction: Array) -> Array:
            return np.column_stack([self.length * fraction, flat])

        swept = sweep(section, self.cells_along, place)
        groups = {"start": swept.start(), "end": swept.end(), "side": swept.side()}
        return Mesh(swept.points, (swept.cells,), facet_groups=groups)
