"""One geometry file open in gmsh."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from wrenchbook.fea.spec.problems import BundleError, BundleProblem

METRES = 1e-3
"""gmsh works in mm here: its geometry kernel's tolerances are absolute and made for mm."""

EXTRA = 'pip install "wrenchbook[cad]"'

_LIBRARIES = "libgl1 libglu1-mesa libxrender1 libxcursor1 libxft2 libxinerama1 libgomp1"

_SETTINGS = {
    "General.Terminal": 0,
    "General.NumThreads": 1,  # several threads number the mesh by who comes first
    "Mesh.MaxNumThreads1D": 1,
    "Mesh.MaxNumThreads2D": 1,
    "Mesh.MaxNumThreads3D": 1,
    "Mesh.RandomSeed": 1,
    "Mesh.Algorithm": 6,  # frontal Delaunay, the most even triangles
    "Mesh.Algorithm3D": 1,  # Delaunay
    "Mesh.Optimize": 1,
    "Mesh.ElementOrder": 2,
    "Mesh.HighOrderOptimize": 1,  # turns back cells that curved edges turn inside out
    "Mesh.MeshSizeFromPoints": 0,
}


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """Open a geometry file, bodies that touch glued to each other; yields the module gmsh.

    Raises
    ------
    BundleError
        If gmsh is not there, the file cannot be read or holds no solid body, or gmsh fails.
    """
    gmsh = _gmsh()
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        for name, value in _SETTINGS.items():
            gmsh.option.setNumber(name, value)
        gmsh.option.setString("Geometry.OCCTargetUnit", "MM")
        _read(gmsh, path)
        yield gmsh
    finally:
        gmsh.finalize()


def _gmsh() -> Any:
    try:
        import gmsh
    except ImportError:
        message = f"geometry files need gmsh, which is not installed: {EXTRA}"
        raise BundleError([BundleProblem("mesh.file", message)]) from None
    except OSError as error:
        message = (
            f"gmsh cannot load a library of the system ({error}); on Debian: "
            f"apt install {_LIBRARIES}"
        )
        raise BundleError([BundleProblem("mesh.file", message)]) from None
    return gmsh


def _read(gmsh: Any, path: Path) -> None:
    gmsh.model.add("part")
    try:
        # Named, because gmsh knows the ending in lower case only.
        shapes = gmsh.model.occ.importShapes(str(path), format="step")
        bodies = [shape for shape in shapes if shape[0] == 3]
        if len(bodies) > 1:
            gmsh.model.occ.fragment(bodies, [])
        gmsh.model.occ.synchronize()
    except Exception as error:
        message = f'"{path.name}" cannot be read as a STEP file ({one_line(error)}); export it anew'
        raise BundleError([BundleProblem("mesh.file", message)]) from None
    if not gmsh.model.getEntities(3):
        there = "surfaces only" if gmsh.model.getEntities(2) else "no shapes"
        message = f'"{path.name}" holds no solid body ({there}); export the part as a solid'
        raise BundleError([BundleProblem("mesh.file", message)])


def one_line(error: Exception) -> str:
    """Return gmsh's own message as one short line."""
    return " ".join(str(error).split())[:200] or type(error).__name__
