"""Which faces and bodies a bundle's groups and regions name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from wrenchbook.fea.mesh.cad.entities import METRES, Face, Solid
from wrenchbook.fea.spec.problems import BundleProblem
from wrenchbook.fea.spec.schema import BodySelector, FaceSelector

_AXES = "xyz"
_NEAR = 1e-3
"""Fraction of the cell size within which a place counts as the given one."""

Place = tuple[float, float, float]


def choose_faces(
    gmsh: Any,
    faces: Sequence[Face],
    groups: Mapping[str, FaceSelector],
    size: float,
    problems: list[BundleProblem],
) -> dict[str, list[int]]:
    """Return the numbers of the faces of each group; notes choices that name none.

    gmsh: with the file open.
    faces: all there are.
    groups: what the bundle says.
    size: Cell size, m: the scale of what counts as near.
    problems: Mistakes are added.
    """
    chosen = {}
    for name, choice in groups.items():
        where = f"mesh.groups.{name}"
        numbers = _by_number(faces, choice.faces, f"{where}.faces", "face", problems)
        if choice.plane is not None and choice.at is not None:
            axis, at = _AXES.index(choice.plane), choice.at
            square = [f for f in faces if f.normal is not None and abs(f.normal[axis]) > 1 - 1e-9]
            on_plane = [f.number for f in square if abs(f.centre[axis] - at) < _NEAR * size]
            if not on_plane:
                places = sorted({round(f.centre[axis], 9) for f in square})
                listed = ", ".join(f"{place:g}" for place in places) or "none anywhere"
                message = f"no plane face at {_AXES[axis]} = {at:g} m (there are at: {listed})"
                problems.append(BundleProblem(f"{where}.plane", message))
            numbers += on_plane
        if choice.radius is not None:
            round_ones = [(f.radius, f.number) for f in faces if f.radius is not None]
            limit = 1e-3 * choice.radius
            chosen_ones = [n for radius, n in round_ones if abs(radius - choice.radius) < limit]
            if not chosen_ones:
                listed = ", ".join(
                    f"{r:g}" for r in sorted({float(f"{r:.6g}") for r, _ in round_ones})
                )
                message = (
                    f"no cylinder of radius {choice.radius:g} m (there are: {listed or 'none'})"
                )
                problems.append(BundleProblem(f"{where}.radius", message))
            numbers += chosen_ones
        for point in choice.near:
            numbers += _nearest(gmsh, faces, point, where, size, problems)
        chosen[name] = sorted(set(numbers))
    return chosen


def choose_bodies(
    gmsh: Any,
    bodies: Sequence[Solid],
    regions: Mapping[str, BodySelector],
    size: float,
    problems: list[BundleProblem],
) -> dict[str, list[int]]:
    """Return the numbers of the bodies of each region; as `choose_faces`."""
    chosen = {}
    for name, choice in regions.items():
        where = f"mesh.regions.{name}"
        numbers = _by_number(bodies, choice.bodies, f"{where}.bodies", "body", problems)
        for point in choice.near:
            numbers += _nearest(gmsh, bodies, point, where, size, problems)
        chosen[name] = sorted(set(numbers))
    return chosen


def _by_number(
    shapes: Sequence[Face | Solid],
    numbers: tuple[int, ...],
    where: str,
    kind: str,
    problems: list[BundleProblem],
) -> list[int]:
    there = [shape.number for shape in shapes]
    for number in numbers:
        if number not in there:
            message = f"there is no {kind} {number}; the geometry has {_spans(there)}"
            problems.append(BundleProblem(where, message))
    return [number for number in numbers if number in there]


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
    place = np.array(point)
    offs = {s.number: np.maximum(np.array(s.low) - place, place - s.high) for s in shapes}
    bound = {number: float(np.linalg.norm(np.maximum(0.0, off))) for number, off in offs.items()}
    distances: dict[int, float] = {}
    vertex = gmsh.model.occ.addPoint(*(x / METRES for x in point))
    for number in sorted(bound, key=lambda n: bound[n]):
        if distances and bound[number] > min(distances.values()) + margin:
            break
        distances[number] = gmsh.model.occ.getDistance(0, vertex, dimension, number)[0] * METRES
    gmsh.model.occ.remove([(0, vertex)])
    least = min(distances.values())
    nearest = [n for n, distance in distances.items() if distance <= least + _NEAR * size]
    at = ", ".join(f"{x:g}" for x in point)
    if least > size:
        message = f"({at}) m is {least:.3g} m off the nearest {kind} ({nearest[0]}); correct it"
    elif len(nearest) > 1:
        named = ", ".join(map(str, nearest))
        message = f"({at}) m lies on the edge between {kind} {named}; move it off the edge"
    else:
        return nearest
    problems.append(BundleProblem(f"{where}.near", message))
    return []


def _spans(numbers: list[int]) -> str:
    """Return ``1 to 9`` for whole runs, else the numbers."""
    if len(numbers) > 2 and numbers == list(range(numbers[0], numbers[-1] + 1)):
        return f"{numbers[0]} to {numbers[-1]}"
    return ", ".join(map(str, numbers))
