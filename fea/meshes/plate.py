"""A flat rectangular plate with a square patch in its middle."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fea.mesh import Mesh
from fea.meshes.parameters import count, metres
from fea.meshes.plane import rectangle
from fea.meshes.sweep import sweep

Array = np.ndarray


@dataclass(frozen=True)
class Plate:
    """Parameters of generator "plate"; lengths in metres.

    The plate's middle is at x = y = 0; it reaches from z = 0 up to `thickness`. Grid lines run
    along the edges of the patch and of the corner squares, so facets cover both exactly. Facet
    groups: ``patch`` (the middle of the top face), ``corners`` (four squares of the bottom face),
    ``rim`` (the four sides), ``top``, ``bottom``.

    Attributes
    ----------
    length, width, thickness
        Along x, y, z.
    patch
        Side of the square patch.
    corner
        Side of the corner squares.
    cell_size
        The largest side of a cell in the plane.
    layers
        Number of cells through the thickness.
    """

    length: float = metres()
    width: float = metres()
    thickness: float = metres()
    patch: float = metres()
    corner: float = metres(0.04)
    cell_size: float = metres(0.025)
    layers: int = count(2)

    def mistakes(self) -> list[tuple[str, str]]:
        """Return (key, message) for what does not fit together."""
        side = min(self.length, self.width)
        if self.patch + 2.0 * self.corner < side * (1.0 - 1e-9):
            return []
        message = (
            f"patch ({self.patch:g} m) and two corner squares ({self.corner:g} m each) do not fit "
            f"along the shorter side ({side:g} m) with room between them; make one smaller"
        )
        return [("patch", message)]

    def mesh(self) -> Mesh:
        """Return the mesh, of 20-node hexahedra."""
        x, y = self._lines(self.length), self._lines(self.width)
        section = rectangle(x, y)

        def place(flat: Array, fraction: Array) -> Array:
            return np.column_stack([flat, self.thickness * fraction])

        plate = sweep(section, self.layers, place)
        half = np.full(2, self.patch / 2.0)
        groups = {
            "patch": plate.end(section.within(-half, half)),
            "corners": plate.start(self._corner_quads(section.points[section.quads[:, :4]])),
            "rim": plate.side(),
            "top": plate.end(),
            "bottom": plate.start(),
        }
        return Mesh(plate.points, (plate.cells,), facet_groups=groups)

    def _lines(self, length: float) -> Array:
        """Return the grid lines of one direction, symmetric about 0."""
        stops = [self.patch / 2.0, length / 2.0 - self.corner, length / 2.0]
        middle = self._steps(-stops[0], stops[0])
        side = [self._steps(a, b)[1:] for a, b in pairwise(stops)]
        right = np.concatenate(side)
        return np.concatenate([-right[::-1], middle, right])

    def _steps(self, start: float, stop: float) -> Array:
        cells = max(1, int(np.ceil((stop - start) / self.cell_size - 1e-9)))
        return np.linspace(start, stop, cells + 1)

    def _corner_quads(self, corners: Array) -> Array:
        middle = np.abs(corners.mean(axis=1))
        inner = np.array([self.length, self.width]) / 2.0 - self.corner
        return np.flatnonzero((middle > inner).all(axis=1))
