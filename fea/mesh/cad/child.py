"""The child process in which gmsh lists and meshes a geometry file.

Run as a program. It reads one request from standard input and writes arrays of plain numbers and
JSON to standard output. It ends when its parent closes the input.
"""

from __future__ import annotations

import json
import os
import pickle
import sys
import threading
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from wrenchbook.fea.mesh.cad.entities import bodies_of, faces_of
from wrenchbook.fea.mesh.cad.select import choose_bodies, choose_faces
from wrenchbook.fea.mesh.cad.session import METRES, opened
from wrenchbook.fea.mesh.generators.parameters import too_many
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


def main() -> None:
    """Answer the request: a path, and how to mesh it (None lists it) with or without optimisation.

    The parent wrote the request, so a pickle is safe; the answer, which a file can forge, is none.
    """
    path, geometry, optimise = pickle.load(sys.stdin.buffer)
    threading.Thread(target=lambda: os.read(0, 1) or os._exit(1), daemon=True).start()
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # the geometry kernel prints
    arrays: dict[str, Any] = {}
    try:
        with opened(path) as gmsh:
            if geometry is None:
                shapes = {"faces": faces_of(gmsh), "bodies": bodies_of(gmsh)}
                fields = {key: [asdict(one) for one in own] for key, own in shapes.items()}
            else:
                fields, arrays = _meshed(gmsh, path, geometry, optimise)
    except BundleError as error:
        fields = {"problems": [asdict(problem) for problem in error.problems]}
    head = np.frombuffer(json.dumps(fields).encode(), dtype=np.uint8)
    with output:
        np.savez(output, head=head, **arrays)


def _meshed(
    gmsh: Any, path: Path, geometry: GeometryMeshing, optimise: bool
) -> tuple[dict[str, Any], dict[str, Any]]:
    problems: list[BundleProblem] = []
    size = geometry.size
    groups = choose_faces(gmsh, faces_of(gmsh), geometry.groups, size, problems)
    bodies = bodies_of(gmsh)
    regions = choose_bodies(gmsh, bodies, geometry.regions, size, problems)
    volume = sum(body.volume for body in bodies)
    cells = too_many(_REGULAR * volume / size**3, "mesh.size")
    problems += [BundleProblem(*mistake) for mistake in cells]
    if problems:
        raise BundleError(problems)
    gmsh.option.setNumber("Mesh.MeshSizeMax", size / METRES)
    gmsh.option.setNumber("Mesh.MeshSizeMin", _FINEST * size / METRES)
    gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", geometry.curvature)
    gmsh.option.setNumber("Mesh.MinimumCircleNodes", geometry.circle)
    if not optimise:
        gmsh.option.setNumber("Mesh.HighOrderOptimize", 0)
    gmsh.model.mesh.generate(3)
    return _collected(gmsh, groups, regions)


def _collected(
    gmsh: Any, groups: Mapping[str, list[int]], regions: Mapping[str, list[int]]
) -> tuple[dict[str, Any], dict[str, Array]]:
    """Return the mesh in gmsh, each body's cells and each chosen face's facets as one block.

    ``sets`` has for each group and region the numbers of its blocks.
    """
    tags, places, _ = gmsh.model.mesh.getNodes()
    row = np.full(int(tags.max()) + 1, -1, dtype=np.int64)
    row[tags.astype(np.int64)] = np.arange(len(tags))
    faces = sorted({number for numbers in groups.values() for number in numbers})
    bodies = [number for _, number in gmsh.model.getEntities(3)]
    blocks = [_cells(gmsh, _TET10, n, row)[:, _TO_VTK] for n in bodies]
    blocks += [_cells(gmsh, _TRI6, n, row) for n in faces]
    sets = {}
    for name in {**groups, **regions}:
        chosen = [n in regions.get(name, ()) for n in bodies]
        chosen += [n in groups.get(name, ()) for n in faces]
        sets[name] = np.flatnonzero(chosen).tolist()
    arrays = {str(i): nodes for i, nodes in enumerate(blocks)}
    return {"sets": sets}, {"points": places.reshape(-1, 3)} | arrays


def _cells(gmsh: Any, kind: int, entity: int, row: Array) -> Array:
    _, nodes = gmsh.model.mesh.getElementsByType(kind, entity)
    return row[nodes.astype(np.int64)].reshape(-1, 10 if kind == _TET10 else 6)


if __name__ == "__main__":
    main()
