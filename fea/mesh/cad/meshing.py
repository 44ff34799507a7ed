"""From a geometry file to a mesh of ten-node tetrahedra, the same one every time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from wrenchbook.fea.mesh.cad.entities import bodies_of, faces_of
from wrenchbook.fea.mesh.cad.select import choose_bodies, choose_faces
from wrenchbook.fea.mesh.cad.session import METRES, one_line, opened
from wrenchbook.fea.mesh.generators.parameters import too_many
from wrenchbook.fea.mesh.io.raw import Block, RawMesh, to_mesh
from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.spec.problems import BundleError, BundleProblem
from wrenchbook.fea.spec.schema import GeometryMeshing

Array = np.ndarray

_TET10, _TRI6 = 11, 9
# gmsh has the last two midside nodes of a tetrahedron the other way round than VTK.
_TO_VTK = [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]
_REGULAR = 6 * 2**0.5
"""Volume of a cube over that of the regular tetrahedron with the same edge."""
_FINEST = 0.05
"""Least edge that curvature asks for, as a fraction of the cell size."""


def mesh_geometry(path: Path, geometry: GeometryMeshing) -> Mesh:
    """Mesh the bodies of a geometry file.

    The same file and keys give the same nodes, in whatever process, with the same version of gmsh
    and its geometry kernel; another version may place them differently, within what a mesh of that
    size leaves open anyway.

    Raises
    ------
    BundleError
        If the file cannot be read or meshed, or a group or region names nothing.
    """
    problems: list[BundleProblem] = []
    with opened(path) as gmsh:
        bodies = bodies_of(gmsh)
        size = geometry.size
        groups = choose_faces(gmsh, faces_of(gmsh), geometry.groups, size, problems)
        regions = choose_bodies(gmsh, bodies, geometry.regions, size, problems)
        volume = sum(body.volume for body in bodies)
        cells = too_many(_REGULAR * volume / size**3, "mesh.size")
        problems += [BundleProblem(*mistake) for mistake in cells]
        if problems:
            raise BundleError(problems)
        _generate(gmsh, path, geometry)
        return to_mesh(_collected(gmsh, groups, regions), METRES)


def _generate(gmsh: Any, path: Path, geometry: GeometryMeshing) -> None:
    size = geometry.size / METRES
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    gmsh.option.setNumber("Mesh.MeshSizeMin", _FINEST * size)
    gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", geometry.curvature)
    try:
        gmsh.model.mesh.generate(3)
    except Exception as error:
        message = (
            f'gmsh could not mesh "{path.name}" ({one_line(error)}); a smaller size may help, '
            "or heal the geometry (tiny edges, faces that overlap) where it was drawn"
        )
        raise BundleError([BundleProblem("mesh.file", message)]) from None


def _collected(
    gmsh: Any, groups: Mapping[str, list[int]], regions: Mapping[str, list[int]]
) -> RawMesh:
    """Return the mesh in gmsh, each body's cells and each chosen face's facets as one block."""
    tags, places, _ = gmsh.model.mesh.getNodes()
    row = np.full(int(tags.max()) + 1, -1, dtype=np.int64)
    row[tags.astype(np.int64)] = np.arange(len(tags))
    faces = sorted({number for numbers in groups.values() for number in numbers})
    bodies = [number for _, number in gmsh.model.getEntities(3)]
    blocks: list[Block] = [("tet10", _cells(gmsh, _TET10, n, row)[:, _TO_VTK]) for n in bodies]
    blocks += [("tri6", _cells(gmsh, _TRI6, n, row)) for n in faces]
    sets = {}
    for name in {**groups, **regions}:
        chosen = [n in regions.get(name, ()) for n in bodies]
        chosen += [n in groups.get(name, ()) for n in faces]
        pairs = zip(blocks, chosen, strict=True)
        sets[name] = [np.arange(len(nodes) if taken else 0) for (_, nodes), taken in pairs]
    return RawMesh(places.reshape(-1, 3), blocks, sets)


def _cells(gmsh: Any, kind: int, entity: int, row: Array) -> Array:
    _, nodes = gmsh.model.mesh.getElementsByType(kind, entity)
    return row[nodes.astype(np.int64)].reshape(-1, 10 if kind == _TET10 else 6)
