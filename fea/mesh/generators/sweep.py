"""Drawing a plane section out along a line into 20-node hexahedra.

Nodes are shared by their numbers, not by comparing coordinates, so none is there twice.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from wrenchbook.fea.mesh.generators.plane import PlaneMesh
from wrenchbook.fea.mesh.mesh import CellBlock, FacetBlock, FacetGroup

Array = np.ndarray
Place = Callable[[Array, Array], Array]


@dataclass(frozen=True, eq=False)
class Sweep:
    """A section drawn out into `layers` layers of cells."""

    section: PlaneMesh
    layers: int
    points: Array  # shape (n, 3), m
    # One block of hex20: layer after layer, within each in the order of the section
    cells: CellBlock

    def start(self, quads: Array | slice = slice(None)) -> FacetGroup:
        """Return the facets of the section's `quads` at the start, outwards.

        `quads` are indices of shape (k,), or a mask of shape (q,); all if not given.
        """
        nodes = self.section.quads[quads][:, [0, 3, 2, 1, 7, 6, 5, 4]]
        return FacetGroup((FacetBlock("quad8", nodes),))

    def end(self, quads: Array | slice = slice(None)) -> FacetGroup:
        """Return the facets of the section's `quads` at the end, outwards.

        `quads` are indices of shape (k,), or a mask of shape (q,); all if not given.
        """
        nodes = self.section.quads[quads] + self.layers * _stride(self.section)
        return FacetGroup((FacetBlock("quad8", nodes),))

    def side(self) -> FacetGroup:
        """Return the facets drawn out by the section's outline, looking outwards."""
        start, end, middle = self.section.edges.T
        between = len(self.section.points)
        stride = _stride(self.section)
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


def sweep(section: PlaneMesh, layers: int, place: Place) -> Sweep:
    """Draw `section` out into `layers` layers of cells.

    section: Counter-clockwise about the direction of drawing.
    layers: number of layers.
    place: from section points, shape (k, 2), and the fraction of the way, shape (k,) and from 0 to
    1, to points in space, shape (k, 3). Called once, so that any line will do.
    """
    stride, between = _stride(section), len(section.points)
    level_of = np.concatenate([np.zeros(between), np.ones(section.corners)])
    flat = np.concatenate([section.points, section.points[: section.corners]])
    levels = (level_of + 2.0 * np.arange(layers + 1)[:, None]).ravel()
    points = place(np.tile(flat, (layers + 1, 1)), levels / (2.0 * layers))
    quads = section.quads
    columns = [
        *quads[:, :4].T,
        *(quads[:, :4] + stride).T,
        *quads[:, 4:].T,
        *(quads[:, 4:] + stride).T,
        *(quads[:, :4] + between).T,
    ]
    cells = CellBlock("hex20", _each_layer(columns, stride, layers))
    # The last level has no layer above it, so the nodes between are left off.
    return Sweep(section, layers, points[: len(points) - section.corners], cells)


def _stride(section: PlaneMesh) -> int:
    """Return how many nodes lie between a node and its image one layer on."""
    return len(section.points) + section.corners


def _each_layer(columns: list[Array], stride: int, layers: int) -> Array:
    first = np.stack(columns, axis=-1).astype(np.int64)
    shifts = stride * np.arange(layers, dtype=np.int64)
    return (first + shifts[:, None, None]).reshape(-1, first.shape[-1])
