"""From a geometry file to its faces, and to a mesh of ten-node tetrahedra, the same every time."""

from __future__ import annotations

import contextlib
import io
import json
import pickle
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from wrenchbook.fea.mesh.cad.session import METRES
from wrenchbook.fea.mesh.io.raw import RawMesh, to_mesh
from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.mesh.quality import cell_problems
from wrenchbook.fea.spec.problems import BundleError, BundleProblem
from wrenchbook.fea.spec.schema import GeometryMeshing

_ATTEMPTS: Final = ((True, 1.0), (False, 1.0), (True, 0.97), (True, 1.03))
"""Optimisation of curved cells, and times the cell size. The optimiser aborts where it cannot turn
a single cell back; another size places the cells otherwise."""

_KILLED: Final = (signal.SIGKILL, signal.SIGXCPU, signal.SIGINT, signal.SIGTERM)
"""Ends that another attempt does not avoid: a limit of memory or time, or the user."""


class _GmshError(Exception):
    """gmsh aborted, or raised an error, at one size."""


def mesh_geometry(path: Path, geometry: GeometryMeshing) -> Mesh:
    """Mesh the bodies of a geometry file.

    The same file and keys give the same nodes, in whatever process, with the same version of gmsh
    and its geometry kernel; another version may place them differently, within what a mesh of that
    size leaves open anyway. Where gmsh fails, or leaves cells inside out, it tries again without
    its optimisation of curved cells and at sizes 3 % smaller and larger.

    Raises
    ------
    BundleError
        If the file cannot be read or meshed, or a group or region names nothing.
    MemoryError
        If gmsh needs more memory than there is.
    """
    folded, failures = None, []
    for optimise, times in _ATTEMPTS:
        try:
            mesh = _meshed(path, replace(geometry, size=times * geometry.size), optimise)
        except _GmshError as error:
            failures.append(str(error))
            continue
        if not cell_problems(mesh):
            return mesh
        folded = folded or mesh
    if folded is not None:
        return folded  # `fea.component.build` names its cells
    message = (
        f'gmsh fails to mesh "{path.name}" with cells of {geometry.size:g} m ({failures[0]}), and '
        f"also without optimisation and at {len(_ATTEMPTS) - 2} sizes near it. Take another size, "
        "such as one a third smaller; if that fails too, heal the geometry (tiny edges, faces that "
        "overlap) where it was drawn"
    )
    raise BundleError([BundleProblem("mesh.size", message)])


def list_shape(path: Path) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the faces and bodies of a geometry file, with the fields of `Face` and `Solid`.

    Raises
    ------
    BundleError
        If it cannot be read.
    """
    try:
        fields, _ = _in_child(path, None)
    except _GmshError as error:
        message = f'gmsh fails to read "{path.name}" ({error}); export it anew'
        raise BundleError([BundleProblem("mesh.file", message)]) from None
    return fields["faces"], fields["bodies"]


def _meshed(path: Path, geometry: GeometryMeshing, optimise: bool) -> Mesh:
    fields, arrays = _in_child(path, geometry, optimise)
    points = arrays.pop("points")
    nodes = [arrays[str(i)] for i in range(len(arrays))]
    blocks = [("tet10" if own.shape[1] == 10 else "tri6", own) for own in nodes]
    sets = {
        name: [np.arange(len(own) if i in chosen else 0) for i, own in enumerate(nodes)]
        for name, chosen in fields["sets"].items()
    }
    return to_mesh(RawMesh(points, blocks, sets), METRES)


def _in_child(
    path: Path, geometry: GeometryMeshing | None, optimise: bool = True
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return what `child` answers: fields of JSON, and arrays.

    The child inherits the limits of this process, and ends with it.
    """
    program = str(sys.modules["wrenchbook"].__file__)
    command = [sys.executable, "-P", program, "-m", "wrenchbook.fea.mesh.cad.child"]
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
        if "bad_alloc" in why or "MemoryError" in why:
            raise MemoryError("gmsh needs more memory than there is; give a larger size")
        if -process.returncode in _KILLED:
            message = f"signal {-process.returncode} ended gmsh: a limit of memory or time"
            raise BundleError([BundleProblem("mesh.size", message)])
        raise _GmshError(why[:200])
    with np.load(io.BytesIO(output), allow_pickle=False) as answer:
        arrays = {name: answer[name] for name in answer.files}
    fields = json.loads(arrays.pop("head").tobytes())
    if "problems" in fields:
        raise BundleError([BundleProblem(**problem) for problem in fields["problems"]])
    return fields, arrays
