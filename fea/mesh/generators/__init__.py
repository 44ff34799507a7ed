"""Mesh generators, each a frozen dataclass of parameters with `mistakes` and `mesh`."""

from __future__ import annotations

from typing import Protocol

from wrenchbook.fea.mesh.generators.bar import Bar
from wrenchbook.fea.mesh.generators.plate import Plate
from wrenchbook.fea.mesh.generators.spring import Spring
from wrenchbook.fea.mesh.mesh import Mesh


class Generator(Protocol):
    """What a generator offers besides its parameters."""

    def mistakes(self) -> list[tuple[str, str]]:
        """Return (key, message) for parameters that do not fit together."""
        ...

    def mesh(self) -> Mesh:
        """Return the mesh, metres."""
        ...


GENERATORS: dict[str, type[Bar] | type[Plate] | type[Spring]] = {
    "bar": Bar,
    "plate": Plate,
    "spring": Spring,
}
"""The generators a bundle can name."""
