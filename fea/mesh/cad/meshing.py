"""Faces of a geometry file, and its reproducible mesh of ten-node tetrahedra."""

from __future__ import annotations

import contextlib
import io
import json
import pickle
import re
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from wrenchbook.fea.mesh.face_choice import choose
from wrenchbook.fea.mesh.facets import Face
from wrenchbook.fea.mesh.io.raw import RawMesh, to_mesh
from wrenchbook.fea.mesh.mapping import cell_problems
from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.mesh.surface import Surface
from wrenchbook.fea.spec.mesh_source import UNITS, GeometryMeshing
from wrenchbook.fea.spec.problems import BundleError, BundleProblem

_ATTEMPTS: Final = ((True, 1.0), (False, 1.0), (True, 0.97), (True, 1.03))
"""Attempts: whether curved cells are optimised, and a factor on the cell size.

The optimiser aborts if it cannot repair a single cell; another size puts the cells elsewhere.
"""

_SURFACE = " of the geometry"  # name of the group of all its facets in the child's answer


class _GmshError(BundleError):
    """gmsh aborted, or raised an error."""


def mesh_geometry(path: Path, geometry: GeometryMeshing) -> Mesh:
    """Mesh the bodies of a geometry file, with their groups.

    Raises BundleError if the file cannot be read or meshed, or a group or region names nothing.
    """
    return choose(surface_of_geometry(path, geometry), geometry.groups)


def surface_of_geometry(path: Path, geometry: GeometryMeshing) -> Surface:
    """Mesh the bodies of a geometry file; the surface has the mesh, without groups.

    The same file and keys give the same nodes in every process, with the same version of gmsh and
    its geometry kernel; another version may move them, within the freedom of a mesh of that size.
    gmsh repairs cells in the order of their addresses, so nodes there differ from run to run. If
    gmsh fails, or leaves cells inside out, `_ATTEMPTS` follow.

    Raises BundleError as `mesh_geometry`, except for groups.
    """
    folded = failure = None
    for optimise, times in _ATTEMPTS:
        try:
            fields, arrays = _in_child(
                path, geometry.sized(times * geometry.size, geometry.circle), optimise
            )
        except _GmshError as error:
            failure = failure or error.problems[0].message
            continue
        surface = _surface(fields, arrays)
        if not cell_problems(surface.mesh):
            return surface
        folded = folded or surface
    if folded is not None:
        return folded  # `fea.component.build` names its cells
    message = (
        f"{failure} with cells of {geometry.size:g} m, also without optimisation and with cells 3 "
        "% smaller or larger. Write a size a third smaller, or repair the geometry (tiny edges, "
        "overlapping faces) in the CAD program"
    )
    raise BundleError([BundleProblem("mesh.size", message)])


def _surface(fields: dict[str, Any], arrays: dict[str, np.ndarray]) -> Surface:
    """Return the mesh, and the number of each facet's face, from the answer of `child`."""
    points = arrays.pop("points")
    nodes = [arrays[str(i)] for i in range(len(arrays))]
    blocks = [("tet10" if rows.shape[1] == 10 else "tri6", rows) for rows in nodes]
    sets = {
        name: [np.arange(len(rows) if i in chosen else 0) for i, rows in enumerate(nodes)]
        for name, chosen in fields["sets"].items()
    }
    faces = [Face(**face) for face in fields["faces"]]
    facets = [block for block in blocks if block[0] == "tri6"]
    mesh = to_mesh(RawMesh(points, blocks, sets, facet_sets={_SURFACE: facets}), UNITS["mm"])
    # The cells' own faces replace gmsh's facets, in the order of the cells.
    group = mesh.facet_groups[_SURFACE]
    owners = np.repeat([face.number for face in faces], [len(rows) for _, rows in facets])
    used = np.unique(np.concatenate([rows for kind, rows in blocks if kind == "tet10"]))
    drawn = np.searchsorted(used, np.concatenate([rows for _, rows in facets]))
    numbers = np.zeros(len(owners), dtype=np.int64)
    numbers[_order(group.blocks[0].nodes)] = owners[_order(drawn)]
    return Surface(replace(mesh, facet_groups={}), group, numbers, tuple(faces))


def _order(facets: np.ndarray) -> np.ndarray:
    """Return the order of facets (f, k) by their corners, in any rotation, (f,)."""
    return np.lexsort(np.sort(facets[:, :3], axis=1).T)


def list_shape(path: Path) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the faces and bodies of a geometry file, with the fields of `Face` and `Solid`.

    Raises BundleError if it cannot be read.
    """
    fields, _ = _in_child(path, None)
    return fields["faces"], fields["bodies"]


def _in_child(
    path: Path, geometry: GeometryMeshing | None, optimise: bool = True
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return the answer of `child`: fields of JSON, and arrays.

    The child inherits the limits of this process, and ends with it.
    """
    command = [sys.executable, "-P", "-m", "wrenchbook.fea.mesh.cad.child"]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, bufsize=0) as process:
        request = process.stdin  # stays open until the child has answered
        process.stdin = None
        assert request is not None
        with request:
            with contextlib.suppress(BrokenPipeError):  # its exit status has the cause
                request.write(pickle.dumps((path, geometry, optimise)))
            output, errors = process.communicate()

    if process.returncode:
        lines = errors.decode(errors="replace").split("\n")
        why = next((line.strip() for line in reversed(lines) if line.strip()), "no message")
        limit = -process.returncode in (signal.SIGKILL, signal.SIGXCPU)
        # Another attempt would reach the limit too.
        if limit or re.search("bad_alloc|MemoryError", why):
            of = "time" if -process.returncode == signal.SIGXCPU else "memory"
            why = f'gmsh exceeds its limit of {of} on "{path.name}"'
            if geometry is None:
                why += "; leave threads and small rounds out of the geometry"
                raise BundleError([BundleProblem("mesh.file", why)])
            why += f" with cells of {geometry.size:g} m; write a larger size"
            raise BundleError([BundleProblem("mesh.size", why)])
        remedy = "" if geometry else "; export it again from the CAD program"
        why = f'gmsh fails on "{path.name}" ({why[:200]}){remedy}'
        raise _GmshError([BundleProblem("mesh.file", why)])
    with np.load(io.BytesIO(output), allow_pickle=False) as answer:
        arrays = {name: answer[name] for name in answer.files}
    fields = json.loads(arrays.pop("head").tobytes())
    if "problems" in fields:
        raise BundleError([BundleProblem(**problem) for problem in fields["problems"]])
    return fields, arrays
