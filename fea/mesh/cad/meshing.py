"""From a geometry file to its faces, and to a mesh of ten-node tetrahedra, the same every time."""

from __future__ import annotations

import contextlib
import io
import json
import pickle
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any, Final

import numpy as np

from wrenchbook.fea.mesh.cad.entities import METRES
from wrenchbook.fea.mesh.io.raw import RawMesh, to_mesh
from wrenchbook.fea.mesh.mapping import cell_problems
from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.spec.problems import BundleError, BundleProblem
from wrenchbook.fea.spec.schema import GeometryMeshing

_ATTEMPTS: Final = ((True, 1.0), (False, 1.0), (True, 0.97), (True, 1.03))
"""Optimisation of curved cells, and times the cell size. The optimiser aborts where it cannot turn
a single cell back; another size puts the cells elsewhere."""


class _GmshError(BundleError):
    """gmsh aborted, or raised an error."""


def mesh_geometry(path: Path, geometry: GeometryMeshing) -> Mesh:
    """Mesh the bodies of a geometry file.

    The same file and keys give the same nodes, in whatever process, with the same version of gmsh
    and its geometry kernel; another version may put them elsewhere, within what a mesh of that
    size leaves open anyway. Where gmsh fails, or leaves cells inside out, `_ATTEMPTS` follow.

    Raises BundleError if the file cannot be read or meshed, or a group or region names nothing.
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
        points = arrays.pop("points")
        nodes = [arrays[str(i)] for i in range(len(arrays))]
        blocks = [("tet10" if rows.shape[1] == 10 else "tri6", rows) for rows in nodes]
        sets = {
            name: [np.arange(len(rows) if i in chosen else 0) for i, rows in enumerate(nodes)]
            for name, chosen in fields["sets"].items()
        }
        mesh = to_mesh(RawMesh(points, blocks, sets), METRES)
        if not cell_problems(mesh):
            return mesh
        folded = folded or mesh
    if folded is not None:
        return folded  # `fea.component.build` names its cells
    message = (
        f"{failure} with cells of {geometry.size:g} m, also without optimisation and with cells "
        "3 % smaller and larger. Take another size, such as a third smaller, or heal the "
        "geometry (tiny edges, faces that overlap) where it was drawn"
    )
    raise BundleError([BundleProblem("mesh.size", message)])


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
        request, process.stdin = process.stdin, None  # open until the child has answered
        assert request is not None
        with request:
            with contextlib.suppress(BrokenPipeError):  # its exit status says why
                request.write(pickle.dumps((path, geometry, optimise)))
            output, errors = process.communicate()
    if process.returncode:
        lines = errors.decode(errors="replace").split("\n")
        why = next((line.strip() for line in reversed(lines) if line.strip()), "no message")
        limit = -process.returncode in (signal.SIGKILL, signal.SIGXCPU)
        if limit or re.search("bad_alloc|MemoryError", why):  # another attempt reaches it too
            why = "gmsh needs more memory or time than it may take; give a larger size"
            raise BundleError([BundleProblem("mesh.size", why)])
        why = f'gmsh fails on "{path.name}" ({why[:200]})' + (
            "" if geometry else "; export it anew"
        )
        raise _GmshError([BundleProblem("mesh.file", why)])
    with np.load(io.BytesIO(output), allow_pickle=False) as answer:
        arrays = {name: answer[name] for name in answer.files}
    fields = json.loads(arrays.pop("head").tobytes())
    if "problems" in fields:
        raise BundleError([BundleProblem(**problem) for problem in fields["problems"]])
    return fields, arrays
