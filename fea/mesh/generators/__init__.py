"""Mesh generators, each a table of parameters with `mistakes` and `mesh`."""

from __future__ import annotations

from wrenchbook.fea.mesh.generators.bar import Bar
from wrenchbook.fea.mesh.generators.plate import Plate
from wrenchbook.fea.mesh.generators.spring import Spring

GENERATORS: dict[str, type[Bar] | type[Plate] | type[Spring]] = {
    "bar": Bar,
    "plate": Plate,
    "spring": Spring,
}
"""The generators a bundle can name."""
