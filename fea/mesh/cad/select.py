"""Which faces and bodies a bundle's groups and regions name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from wrenchbook.fea.mesh.cad.entities import METRES, Face, Solid
from wrenchbook.fea.spec.problems import BundleProblem
from wrenchbook.fea.spec.schema import Selector

_AXES = "xyz"
_NEAR = 1e-3
"""Fraction of the cell size within which a place counts as the given one."""

Place = tuple[float, float, float]


def choose_faces(
    gmsh: Any,
    faces: Sequence[Face],
    groups: Mapping[str, Selector],
    size: float,
    problems: list[BundleProblem],
) -> dict[str, list[int]]:
    """Return the numbers of the faces of each group; notes choices that name none.

    Parameters
    ----------
    gmsh
        With the file open.
    faces
        All there are.
    groups
        What the bundle says.
    size
        Cell size, m: the scale of what counts as near.
    problems
        Mistakes are added.
    """
    chosen = {}
    for name, choice in groups.items():
        where = f"mesh.groups.{name}"
        found = _by_number(faces, choice, f"{where}.faces", "face", problems)
        found += _by_plane(faces, choice, where, size, problems)
        found += _by_radius(faces, choice, where, problems)
        for point in choice.near:
            found += _nearest(gmsh, faces, point, where, size, problems)
        chosen[name] = sorted(set(found))
    return chosen


def choose_bodies(
    gmsh: Any,
    bodies: Sequence[Solid],
    regions: Mapping[str, Selector],
    size: float,
    problems: list[BundleProblem],
) -> dict[str, list[int]]:
    """Return the numbers of the bodies of each region; as `choose_faces`."""
    chosen = {}
    for name, choice in regions.items():
        where = f"mesh.regions.{name}"
        found = _by_number(bodies, choice, f"{where}.bodies", "body", problems)
        for point in choice.near:
            found += _nearest(gmsh, bodies, point, where, size, problems)
        chosen[name] = sorted(set(found))
    return chosen


def _by_number(
    shapes: Sequence[Face | Solid],
    choice: Selector,
    where: str,
    kind: str,
    problems: list[BundleProblem],
) -> list[int]:
    there = [shape.number for shape in shapes]
    for number in choice.numbers:
        if number not in there:
            message = f"there is no {kind} {number}; the geometry has {_spans(there)}"
            problems.append(BundleProblem(where, message))
    return [number for number in choice.numbers if number in there]


def _by_plane(
    faces: Sequence[Face], choice: Selector, where: str, size: float, problems: list[BundleProblem]
) -> list[int]:
    if choice.plane is None:
        return []
    axis, at = choice.plane
    square = [f for f in faces if f.normal is not None and abs(f.normal[axis]) > 1 - 1e-9]
    found = [f.number for f in square if abs(f.centre[axis] - at) < _NEAR * size]
    if not found:
        places = sorted({round(f.centre[axis], 9) for f in square})
        listed = ", ".join(f"{place:g}" for place in places) or "none anywhere"
        message = f"no plane face at {_AXES[axis]} = {at:g} m (there are at: {listed})"
        problems.append(BundleProblem(f"{where}.plane", message))
    return found


def _by_radius(
    faces: Sequence[Face], choice: Selector, where: str, problems: list[BundleProblem]
) -> list[int]:
    if choice.radius is None:
        return []
    round_ones = [(f.radius, f.number) for f in faces if f.radius is not None]
    found = [n for radius, n in round_ones if abs(radius - choice.radius) < 1e-3 * choice.radius]
    if not found:
        listed = ", ".join(f"{r:g}" for r in sorted({float(f"{r:.6g}") for r, _ in round_ones}))
        message = f"no cylinder of radius {choice.radius:g} m (there are: {listed or 'none'})"
        problems.append(BundleProblem(f"{where}.radius", message))
    return found


def _nearest(
    gmsh: Any,
    shapes: Sequence[Face] | Sequence[Solid],
    point: Place,
    where: str,
    size: float,
    problems: list[BundleProblem],
) -> list[int]:
    """Return the face or body nearest to a point; two as near, or none near, are refused."""
    kind, dimension = ("face", 2) if isinstance(shapes[0], Face) else ("body", 3)
    # Distances from a point, m, of all the shapes that can be nearest.
    margin = _NEAR * size
    bound = {s.number: _to_box(point, s.low, s.high) for s in shapes}
    distances: dict[int, float] = {}
    vertex = gmsh.model.occ.addPoint(*(x / METRES for x in point))
    for number in sorted(bound, key=lambda n: bound[n]):
        if distances and bound[number] > min(distances.values()) + margin:
            break
        distances[number] = gmsh.model.occ.getDistance(0, vertex, dimension, number)[0] * METRES
    gmsh.model.occ.remove([(0, vertex)])
    least = min(distances.values())
    found = [n for n, distance in distances.items() if distance <= least + _NEAR * size]
    at = ", ".join(f"{x:g}" for x in point)
    if least > size:
        message = f"({at}) m is {least:.3g} m off the nearest {kind} ({found[0]}); correct it"
    elif len(found) > 1:
        named = ", ".join(map(str, found))
        message = f"({at}) m lies on the edge between {kind} {named}; move it off the edge"
    else:
        return found
    problems.append(BundleProblem(f"{where}.near", message))
    return []


def _to_box(point: Place, low: Place, high: Place) -> float:
    p, a, b = np.array(point), np.array(low), np.array(high)
    return float(np.linalg.norm(np.maximum(0.0, np.maximum(a - p, p - b))))


def _spans(numbers: list[int]) -> str:
    """Return ``1 to 9`` for whole runs, else the numbers."""
    if len(numbers) > 2 and numbers == list(range(numbers[0], numbers[-1] + 1)):
        return f"{numbers[0]} to {numbers[-1]}"
    return ", ".join(map(str, numbers))
