"""The child process in which gmsh lists and meshes a geometry file; run as a program.

It reads a request from standard input, writes plain arrays and JSON, and ends with its parent. It
numbers faces and bodies so that a bundle can name them, and finds the bodies of its regions.
"""

from __future__ import annotations

import json
import os
import pickle
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wrenchbook.fea.mesh.facets import Face
from wrenchbook.fea.mesh.generators import too_many
from wrenchbook.fea.mesh.groups import near_message
from wrenchbook.fea.spec.mesh_source import UNITS, BodySelector, GeometryMeshing
from wrenchbook.fea.spec.problems import BundleError, BundleProblem

METRES = UNITS["mm"]
"""gmsh works in mm here: its geometry kernel's tolerances are absolute and made for mm."""

_LIBRARIES = "libgl1 libglu1-mesa libxrender1 libxcursor1 libxft2 libxinerama1 libgomp1"

_SETTINGS = {
    "General.Terminal": 0,
    # With several threads the numbering of the mesh depends on their timing.
    "General.NumThreads": 1,
    "Mesh.MaxNumThreads1D": 1,
    "Mesh.MaxNumThreads2D": 1,
    "Mesh.MaxNumThreads3D": 1,
    "Mesh.RandomSeed": 1,
    "Mesh.Algorithm": 6,  # frontal Delaunay, the most even triangles
    "Mesh.Algorithm3D": 1,  # Delaunay
    "Mesh.Optimize": 1,
    "Mesh.ElementOrder": 2,
    "Mesh.HighOrderOptimize": 1,  # repairs cells that curved edges turn inside out
    "Mesh.MeshSizeFromPoints": 0,
}

_TET10, _TRI6 = 11, 9
# gmsh has the last two midside nodes of a tetrahedron in the opposite order to VTK.
_TO_VTK = [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]
_REGULAR = 6 * 2**0.5
"""Volume of a cube over that of the regular tetrahedron with the same edge."""
_FINEST = 0.05
"""Least edge on curved surfaces, as a fraction of the cell size."""


def main() -> None:
    """Answer a request: a path, meshing options (None lists the file), with optimisation or not.

    The request is a trusted pickle of the parent; the answer is no pickle, because a file could
    forge it.
    """
    path, geometry, optimise = pickle.load(sys.stdin.buffer)
    threading.Thread(target=lambda: os.read(0, 1) or os._exit(1), daemon=True).start()
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # the geometry kernel prints to standard output
    arrays: dict[str, Any] = {}
    try:
        with open_geometry(path) as gmsh:
            if geometry is None:
                shapes = {"faces": faces_of(gmsh), "bodies": bodies_of(gmsh)}
                fields = {
                    key: [asdict(entity) for entity in entities] for key, entities in shapes.items()
                }
            else:
                fields, arrays = _mesh(gmsh, geometry, optimise)
    except BundleError as error:
        fields = {"problems": [asdict(problem) for problem in error.problems]}
    head = np.frombuffer(json.dumps(fields).encode(), dtype=np.uint8)
    with output:
        np.savez(output, head=head, **arrays)


def _mesh(
    gmsh: Any, geometry: GeometryMeshing, optimise: bool
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Mesh the geometry; each body's cells, then each face's facets, are one block."""
    problems: list[BundleProblem] = []
    size = geometry.size
    faces = faces_of(gmsh)
    bodies = bodies_of(gmsh)
    regions = choose_bodies(gmsh, bodies, geometry.regions, size, problems)
    volume = sum(body.volume for body in bodies)
    cells = too_many(_REGULAR * volume / size**3, "mesh.size")
    problems += [BundleProblem(*mistake) for mistake in cells]
    if problems:
        raise BundleError(problems)

    gmsh.option.setNumber("Mesh.MeshSizeMax", size / METRES)
    gmsh.option.setNumber("Mesh.MeshSizeMin", _FINEST * size / METRES)
    gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", geometry.curvature or 0)
    gmsh.option.setNumber("Mesh.MinimumCircleNodes", geometry.circle)
    if not optimise:
        gmsh.option.setNumber("Mesh.HighOrderOptimize", 0)

    gmsh.model.mesh.generate(3)
    tags, points, _ = gmsh.model.mesh.getNodes()
    row = np.full(int(tags.max()) + 1, -1, dtype=np.int64)
    row[tags.astype(np.int64)] = np.arange(len(tags))
    numbers = [body.number for body in bodies]
    blocks = [_cells(gmsh, _TET10, n, row)[:, _TO_VTK] for n in numbers]
    blocks += [_cells(gmsh, _TRI6, face.number, row) for face in faces]
    sets = {
        name: np.flatnonzero(np.isin(numbers, chosen)).tolist() for name, chosen in regions.items()
    }
    content = {str(i): nodes for i, nodes in enumerate(blocks)}
    fields = {"sets": sets, "faces": [asdict(face) for face in faces]}
    return fields, {"points": points.reshape(-1, 3)} | content


def _cells(gmsh: Any, kind: int, entity: int, row: np.ndarray) -> np.ndarray:
    _, nodes = gmsh.model.mesh.getElementsByType(kind, entity)
    return row[nodes.astype(np.int64)].reshape(-1, 10 if kind == _TET10 else 6)


@contextmanager
def open_geometry(path: Path) -> Iterator[Any]:
    """Open a geometry file, bodies that touch glued to each other; yields the module gmsh.

    Raises BundleError if gmsh is not installed, the file cannot be read or has no solid body, or
    gmsh fails.
    """
    try:
        import gmsh
    except ImportError:
        message = 'geometry files need gmsh, not installed here; run: pip install "wrenchbook[cad]"'
        raise BundleError([BundleProblem("mesh.file", message)]) from None
    except OSError as error:
        message = (
            f"gmsh cannot load a library of the system ({error}); on Debian: "
            f"apt install {_LIBRARIES}"
        )
        raise BundleError([BundleProblem("mesh.file", message)]) from None

    gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        for name, value in _SETTINGS.items():
            gmsh.option.setNumber(name, value)
        gmsh.option.setString("Geometry.OCCTargetUnit", "MM")
        gmsh.model.add("part")
        try:
            # With the format's name, because gmsh knows the ending in lower case only.
            shapes = gmsh.model.occ.importShapes(str(path), format="step")
            bodies = [shape for shape in shapes if shape[0] == 3]
            if len(bodies) > 1:
                gmsh.model.occ.fragment(bodies, [])
            gmsh.model.occ.synchronize()
        except Exception as error:
            why = " ".join(str(error).split())[:200] or type(error).__name__
            message = f'"{path.name}" cannot be read as a STEP file ({why}); export it again'
            raise BundleError([BundleProblem("mesh.file", message)]) from None
        if not gmsh.model.getEntities(3):
            there = "surfaces only" if gmsh.model.getEntities(2) else "no shapes"
            message = f'"{path.name}" holds no solid body ({there}); export the part as a solid'
            raise BundleError([BundleProblem("mesh.file", message)])
        yield gmsh
    finally:
        gmsh.finalize()


_TOUCHING = 1e-3
"""Fraction of the cell size within which two points count as equal."""


def choose_bodies(
    gmsh: Any,
    bodies: Sequence[Solid],
    regions: Mapping[str, BodySelector],
    size: float,
    problems: list[BundleProblem],
) -> dict[str, list[int]]:
    """Return the numbers of the bodies of each region in the open file; add mistakes to `problems`.

    size: cell size, m: the scale of nearness.
    """
    chosen = {}
    there = [body.number for body in bodies]
    for name, choice in regions.items():
        where = f"mesh.regions.{name}"
        for number in set(choice.bodies) - set(there):
            message = f"there is no body {number}; write numbers from 1 to {len(there)}"
            problems.append(BundleProblem(f"{where}.bodies", message))
        numbers = set(choice.bodies)
        for point in choice.near:
            vertex = gmsh.model.occ.addPoint(*(x / METRES for x in point))
            off = [gmsh.model.occ.getDistance(0, vertex, 3, n)[0] * METRES for n in there]
            gmsh.model.occ.remove([(0, vertex)])
            close = [
                n for n, each in zip(there, off, strict=True) if each <= min(off) + _TOUCHING * size
            ]
            if message := near_message(point, "body", close, min(off), size):
                problems.append(BundleProblem(f"{where}.near", message))
            numbers.update(close)
        chosen[name] = sorted(numbers)
    return chosen


@dataclass(frozen=True)
class Solid:
    """One solid body: its number, volume (m^3) and centre of mass (m)."""

    number: int
    volume: float
    centre: tuple[float, float, float]


def bodies_of(gmsh: Any) -> tuple[Solid, ...]:
    """Return the solid bodies of the open file."""
    return tuple(
        Solid(
            number,
            gmsh.model.occ.getMass(3, number) * METRES**3,
            _metres(gmsh.model.occ.getCenterOfMass(3, number)),
        )
        for _, number in gmsh.model.getEntities(3)
    )


def faces_of(gmsh: Any) -> tuple[Face, ...]:
    """Return the faces of the bodies of the open file."""
    bounding = {
        tag
        for _, body in gmsh.model.getEntities(3)
        for _, tag in gmsh.model.getBoundary([(3, body)], oriented=False)
    }
    # Older versions of gmsh only have getType.
    type_of = getattr(gmsh.model, "getEntityType", None) or gmsh.model.getType
    faces = []
    for number in sorted(bounding):
        kind, radius = type_of(2, number), None
        if kind == "Cylinder":  # the inverse of its larger principal curvature
            middle = _middle(gmsh, number)
            largest, smallest, _, _ = gmsh.model.getPrincipalCurvatures(number, middle)
            radius = METRES / max(abs(float(largest[0])), abs(float(smallest[0])))
        area = gmsh.model.occ.getMass(2, number) * METRES**2
        centre = _metres(gmsh.model.occ.getCenterOfMass(2, number))
        normal = _outward(gmsh, number) if kind == "Plane" else None
        faces.append(Face(number, kind, area, centre, normal, radius))
    return tuple(faces)


def _metres(point: Any) -> tuple[float, float, float]:
    """Return a point of gmsh, mm, in m."""
    x, y, z = (float(coordinate) * METRES for coordinate in point)
    return x, y, z


def _middle(gmsh: Any, number: int) -> list[float]:
    """Return the middle of a face's ranges of parameters."""
    low, high = gmsh.model.getParametrizationBounds(2, number)
    return [0.5 * (a + b) for a, b in zip(low, high, strict=True)]


def _outward(gmsh: Any, number: int) -> tuple[float, float, float]:
    """Return a plane's unit normal, away from its body (the first one where two share it)."""
    normal = np.array(gmsh.model.getNormal(number, _middle(gmsh, number)))
    inside = _point_on(gmsh, number)
    body = int(gmsh.model.getAdjacencies(2, number)[0][0])
    # Small against the body behind the face.
    step = 1e-4 * np.sqrt(gmsh.model.occ.getMass(2, number))
    if gmsh.model.isInside(3, body, (inside + step * normal).tolist()):
        normal = -normal
    x, y, z = (round(float(component), 12) + 0.0 for component in normal)  # + 0.0: no -0.0
    return x, y, z


def _point_on(gmsh: Any, number: int) -> np.ndarray:
    """Return a point within the edges of a face (its centre may lie in a hole), mm."""
    low, high = gmsh.model.getParametrizationBounds(2, number)
    for fraction in _FRACTIONS:
        parameters = [a + s * (b - a) for a, b, s in zip(low, high, fraction, strict=True)]
        if gmsh.model.isInside(2, number, parameters, parametric=True):
            return np.array(gmsh.model.getValue(2, number, parameters))
    return np.array(gmsh.model.occ.getCenterOfMass(2, number))


# The middle, then points that fill the square evenly: additive recurrence of the plastic number
# (Roberts 2018, "The unreasonable effectiveness of quasirandom sequences").
_FRACTIONS = [((0.5 + 0.7548776662 * i) % 1, (0.5 + 0.5698402910 * i) % 1) for i in range(200)]


if __name__ == "__main__":
    main()
