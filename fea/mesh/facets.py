"""The edges and faces of each kind of cell, and the outer surface of a mesh."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from wrenchbook.fea.mesh.mesh import CellBlock, FacetBlock, FacetGroup, row_numbers

_HEX_FACES = ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))
_HEX_EDGES = (
    *((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4)),
    *((0, 4), (1, 5), (2, 6), (3, 7)),
)
# Nodes of hex27 in the middle of each of _HEX_FACES; VTK numbers these x-, x+, y-, y+, z-, z+.
_HEX_MIDDLES = (24, 25, 22, 21, 23, 20)
_TET_FACES = ((0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3))
_TET_EDGES = ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))
_WEDGE_FACES = ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5))
_WEDGE_EDGES = ((0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5))
_PYRAMID_FACES = ((0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4))
_PYRAMID_EDGES = ((0, 1), (1, 2), (2, 3), (3, 0), (0, 4), (1, 4), (2, 4), (3, 4))

_KIND_OF_FACET = {3: "tri3", 4: "quad4", 6: "tri6", 8: "quad8", 9: "quad9"}


def _with_midsides(
    faces: tuple[tuple[int, ...], ...], edges: tuple[tuple[int, int], ...], corners: int
) -> tuple[tuple[int, ...], ...]:
    """Append to each face the midside nodes of its edges, in their order round the face."""
    middle = {frozenset(edge): corners + i for i, edge in enumerate(edges)}
    complete = []
    for face in faces:
        sides = zip(face, face[1:] + face[:1], strict=True)
        complete.append((*face, *(middle[frozenset(side)] for side in sides)))
    return tuple(complete)


EDGES: dict[str, tuple[tuple[int, int], ...]] = {
    **dict.fromkeys(("hex8", "hex20", "hex27"), _HEX_EDGES),
    **dict.fromkeys(("tet4", "tet10"), _TET_EDGES),
    **dict.fromkeys(("wedge6", "wedge15"), _WEDGE_EDGES),
    **dict.fromkeys(("pyramid5", "pyramid13"), _PYRAMID_EDGES),
}
"""Local corners of each edge; midside nodes follow the corners in this order."""

_HEX20_FACES = _with_midsides(_HEX_FACES, _HEX_EDGES, 8)

FACES: dict[str, tuple[tuple[int, ...], ...]] = {
    "hex8": _HEX_FACES,
    "hex20": _HEX20_FACES,
    "hex27": tuple((*f, m) for f, m in zip(_HEX20_FACES, _HEX_MIDDLES, strict=True)),
    "tet4": _TET_FACES,
    "tet10": _with_midsides(_TET_FACES, _TET_EDGES, 4),
    "wedge6": _WEDGE_FACES,
    "wedge15": _with_midsides(_WEDGE_FACES, _WEDGE_EDGES, 6),
    "pyramid5": _PYRAMID_FACES,
    "pyramid13": _with_midsides(_PYRAMID_FACES, _PYRAMID_EDGES, 5),
}
"""Local nodes of each face of each kind of cell, in VTK facet order, seen from outside."""

TRIANGLES: dict[str, tuple[tuple[int, int, int], ...]] = {
    "tri3": ((0, 1, 2),),
    "quad4": ((0, 1, 2), (0, 2, 3)),
    "tri6": ((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)),
    "quad8": ((0, 4, 7), (4, 1, 5), (5, 2, 6), (6, 3, 7), (4, 5, 7), (5, 6, 7)),
    "quad9": (
        *((0, 4, 8), (4, 1, 8), (1, 5, 8), (5, 2, 8)),
        *((2, 6, 8), (6, 3, 8), (3, 7, 8), (7, 0, 8)),
    ),
}
"""Triangles of each facet, seen from outside; quadratic ones are split through midside nodes."""


@dataclass(frozen=True)
class Face:
    """A face of a geometry file, or a connected smooth part of a mesh's surface."""

    number: int  # number of the face in ``faces = [...]``
    kind: str  # gmsh's kind, such as "Plane", "Cylinder" or "BSpline surface"; "Curved" for a mesh
    area: float  # m^2
    centre: tuple[float, float, float]  # area centre, m
    # Outward unit normal of a plane face; None for others
    normal: tuple[float, float, float] | None
    radius: float | None  # radius of a cylinder, m; None for others
    axis: tuple[float, float, float] | None = None  # axis of a cylinder in a mesh
    point: tuple[float, float, float] | None = None  # a point on that axis, m


def faces_of(blocks: tuple[CellBlock, ...]) -> dict[str, np.ndarray]:
    """Return every face of every cell by facet kind, shape (f, k), int64: indices of its nodes."""
    by_kind: dict[str, list[np.ndarray]] = {}
    for block in blocks:
        for face in FACES[block.kind]:
            by_kind.setdefault(_KIND_OF_FACET[len(face)], []).append(block.nodes[:, face])
    return {kind: np.concatenate(parts) for kind, parts in by_kind.items()}


@lru_cache(maxsize=1)  # a solve needs the surface of its single mesh four times
def outer_surface(blocks: tuple[CellBlock, ...]) -> FacetGroup:
    """Return the faces that only one cell has."""
    outer = []
    for kind, nodes in faces_of(blocks).items():
        numbers = row_numbers(np.sort(nodes, axis=1))
        outer.append(FacetBlock(kind, nodes[np.bincount(numbers)[numbers] == 1]))
    return FacetGroup(tuple(outer))


def facets_within(surface: FacetGroup, node_ids: np.ndarray) -> FacetGroup:
    """Return the facets of `surface` whose nodes are all among `node_ids`.

    `node_ids` are indices, shape (k,), int64.
    """
    inner = []
    for kind, nodes in surface.blocks:
        inside = np.isin(nodes, node_ids).all(axis=1)
        if inside.any():
            inner.append(FacetBlock(kind, nodes[inside]))
    return FacetGroup(tuple(inner))


class FaceFinder:
    """Finds the face of a cell that has given corners.

    A group may have 4-node or 9-node facets on 20-node hexahedra; they are replaced by faces of the
    cells.
    """

    def __init__(self, blocks: tuple[CellBlock, ...]) -> None:
        self._by_corners: dict[int, list[FacetBlock]] = {3: [], 4: []}
        for kind, nodes in faces_of(blocks).items():
            self._by_corners[corners_of(kind)].append(FacetBlock(kind, nodes))

    def find(self, kind: str, nodes: np.ndarray) -> tuple[list[FacetBlock], int]:
        """Return the faces with the corners of the facets `nodes`, and the number without any.

        nodes: shape (f, k): indices of their nodes, corners first.
        """
        count = corners_of(kind)
        sought = np.unique(np.sort(nodes[:, :count], axis=1), axis=0)
        blocks = []
        for face_kind, faces in self._by_corners[count]:
            corners = np.sort(faces[:, :count], axis=1)
            numbers = row_numbers(np.concatenate([sought, corners]))
            keys, first = np.unique(numbers[len(sought) :], return_index=True)
            chosen = first[np.isin(keys, numbers[: len(sought)])]
            if len(chosen):
                blocks.append(FacetBlock(face_kind, faces[np.sort(chosen)]))
            sought = sought[~np.isin(numbers[: len(sought)], keys)]
        return blocks, len(sought)


def triangles_of(group: FacetGroup) -> np.ndarray:
    """Return the facets cut into triangles, seen from outside, (t, 3), int64: nodes."""
    rows = [nodes[:, TRIANGLES[kind]].reshape(-1, 3) for kind, nodes in group.blocks]
    return np.concatenate([np.empty((0, 3), dtype=np.int64), *rows])


def corners_of(kind: str) -> int:
    """Return the number of corners of a kind of facet."""
    return 3 if kind.startswith("tri") else 4


def corners_of_cell(kind: str) -> int:
    """Return the number of corners of a kind of cell."""
    return int(np.max(EDGES[kind])) + 1
