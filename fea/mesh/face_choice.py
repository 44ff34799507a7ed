"""Facet groups by geometry: the rules by which keys of a bundle choose facets of a surface."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from graphlib import CycleError, TopologicalSorter
from itertools import combinations
from typing import Any, NoReturn

import numpy as np

from wrenchbook.fea.mesh.facets import Face, corners_of
from wrenchbook.fea.mesh.groups import group_nodes, near_message
from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.mesh.surface import NEAR, Point, Surface, unit
from wrenchbook.fea.spec.mesh_source import FaceSelector
from wrenchbook.fea.spec.problems import BundleError, BundleProblem, point_text
from wrenchbook.fea.tensors import TINY

# Part of a facet's size: its triangles deviate less from a round face, at 16 cells a turn.
_CHORD_ERROR = 2e-2
_DEFAULT_ANGLE = 10.0  # degrees: tolerance of `normal` without `angle`
# Part of the side of a square of the chosen area: a thinner wall has two sides in a box.
_THIN = 0.5
_MAX_ALONG = 0.5  # cosine of a cylinder's axis and a facet's normal: its ends have 1, its side 0
_OPPOSED = -0.99  # cosine of the normals of two sides of a wall: 8 degrees
_ROUNDING = 1e-9  # relative: bundles write directions and positions with about as many digits
_ALIGNED = 1 - 1e-6  # cosine of a normal with a plane's: 0.08 degrees


def choose(surface: Surface, groups: Mapping[str, FaceSelector]) -> Mesh:
    """Return the mesh with facet groups by the keys of ``[mesh.groups.NAME]``.

    Raises BundleError if a key selects nothing, or probably more than intended.
    """
    masks: dict[str, np.ndarray] = {}
    problems: list[BundleProblem] = []
    existing = {*surface.mesh.node_groups, *surface.mesh.facet_groups}
    enclosing = {name: {*groups} & {choice.inside} for name, choice in groups.items()}
    try:
        order = [*TopologicalSorter(enclosing).static_order()]
    except CycleError as error:
        message = f"{' inside '.join(error.args[1])} is circular; remove one inside key"
        _refuse(f"mesh.groups.{error.args[1][0]}.inside", message)

    for name in order:
        where = f"mesh.groups.{name}"
        inside = groups[name].inside
        mask = None
        if name in existing:
            message = "the mesh file already has a group of this name; choose another name"
            problems.append(BundleProblem(where, message))
        if inside in groups:
            mask = masks.get(inside or "")
        elif inside is not None:
            mask = _of_file(surface, inside, f"{where}.inside", problems)
        if inside is not None and mask is None:
            continue  # that group has its own problem
        try:
            masks[name] = _chosen(surface, groups[name], where, mask)
        except BundleError as error:
            problems += error.problems
    if problems:
        raise BundleError(problems)
    chosen = {name: surface.group(masks[name]) for name in groups}
    return replace(surface.mesh, facet_groups={**surface.mesh.facet_groups, **chosen})


def _of_file(
    surface: Surface, name: str, where: str, problems: list[BundleProblem]
) -> np.ndarray | None:
    """Return the facets of a group of the mesh file, a mask of shape (f,)."""
    if (group := surface.mesh.facet_groups.get(name)) is not None:
        blocks = [nodes[:, : corners_of(kind)].tolist() for kind, nodes in group.blocks]
        facets = {frozenset(corners) for block in blocks for corners in block}
        return np.fromiter((frozenset(row) in facets for row in surface.corners.tolist()), bool)
    nodes = group_nodes(surface.mesh, where, name, problems)
    return np.asarray(np.isin(surface.corners, nodes).all(axis=1)) if len(nodes) else None


def _chosen(
    surface: Surface, choice: FaceSelector, where: str, inside: np.ndarray | None
) -> np.ndarray:
    """Return the facets of a group within `inside`, masks of shape (f,)."""
    if lost := {*choice.faces} - {face.number for face in surface.faces}:
        message = f"there is no face {min(lost)}; write numbers from 1 to {len(surface.faces)}"
        _refuse(f"{where}.faces", message)
    adding = [np.isin(surface.numbers, choice.faces)] if choice.faces else []
    numbers = [_nearest(surface, point, f"{where}.near") for point in choice.near]
    adding += [surface.numbers == number for number in numbers]
    if choice.plane is not None:
        adding.append(_in_plane(surface, choice, f"{where}.plane"))
    if choice.radius is not None:
        adding.append(_on_cylinder(surface, choice, f"{where}.radius"))
    chosen = np.any(adding, axis=0) if adding else np.ones(len(surface.areas), dtype=bool)

    for key, allowed, excess, meaning in _restrictions(surface, choice, inside):
        if not (chosen & allowed).any():
            index = np.flatnonzero(chosen)[excess[chosen].argmin()]
            message = (
                f"keeps none of the {chosen.sum()} facets that the other keys select; the nearest, "
                f"at {point_text(surface.middles[index])} m, is {excess[index]:.3g} {meaning}; "
                "change one of the keys"
            )
            _refuse(f"{where}.{key}", message)
        chosen &= allowed
    if choice.box is not None and choice.normal is None and not adding:
        _check_sides(surface, chosen, f"{where}.box")
    return chosen


def _restrictions(
    surface: Surface, choice: FaceSelector, inside: np.ndarray | None
) -> Iterator[tuple[str, np.ndarray, np.ndarray, str]]:
    """Yield each key of a choice that restricts it, and the facets that it allows, (f,), bool.

    Then come the distance of each facet from being allowed, (f,), and the unit and meaning of the
    distance. `inside` is as of `_chosen`.
    """
    if choice.box is not None:
        points, (low, high) = surface.mesh.points[surface.corners], np.array(choice.box)
        outside = np.maximum(low - points, points - high).max(axis=(1, 2))
        yield "box", outside <= NEAR * surface.sizes, outside, "m out of it by a corner"
    if choice.normal is not None:
        angles = np.degrees(np.arccos(np.clip(surface.normals @ choice.normal, -1, 1)))
        yield "normal", angles <= (choice.angle or _DEFAULT_ANGLE), angles, "degrees from it"
    if inside is not None:
        apart = np.linalg.norm(surface.middles - surface.middles[inside].mean(axis=0), axis=1)
        yield "inside", inside, apart, f"m from the middle of {choice.inside}"


def _nearest(surface: Surface, point: Point, where: str) -> int:
    """Return the number of the face nearest to a point; raise BundleError unless one is."""
    off = np.linalg.norm(surface.middles - np.array(point), axis=1)
    limit = (off + surface.sizes).min() + _CHORD_ERROR * surface.sizes.max()
    close = (off - surface.sizes <= limit)[surface.owners]
    owners = surface.owners[close]
    normals = unit(surface.vectors[close])
    x = surface.mesh.points[surface.triangles[close]] - np.array(point)
    edges = np.roll(x, -1, axis=1) - x
    # Above the inside of a triangle it is the distance to its plane, else that to an edge.
    sides = np.einsum("tex,tx->te", np.cross(x, edges), normals)
    along = -np.einsum("tex,tex->te", x, edges) / np.maximum((edges**2).sum(axis=2), TINY)
    to_edges = np.linalg.norm(x + np.clip(along, 0, 1)[:, :, None] * edges, axis=2).min(axis=1)
    height = np.abs(np.einsum("tx,tx->t", x[:, 0], normals))
    distance = np.where((sides >= 0).all(axis=1), height, to_edges)
    least = distance.min()
    size = surface.sizes[owners[distance.argmin()]]
    near = distance <= least + (_CHORD_ERROR * size if least <= size else 0.0)
    numbers = np.unique(surface.numbers[owners[near]]).tolist()
    if message := near_message(point, "face", numbers, least, size):
        _refuse(where, message)
    return numbers[0]


def _in_plane(surface: Surface, choice: FaceSelector, where: str) -> np.ndarray:
    """Return the facets in the plane of a choice, a mask of shape (f,)."""
    plane = choice.plane
    normal = np.eye(3)["xyz".index(plane)] if isinstance(plane, str) else np.array(plane)
    at = float(normal @ choice.at) if isinstance(choice.at, tuple) else float(choice.at or 0)
    heights = surface.mesh.points[surface.corners] @ normal - at
    # A facet of a round face that touches the plane is parallel to it too.
    plane_faces = [face.number for face in surface.faces if face.kind in ("Plane", "Curved")]
    level = np.abs(heights).max(axis=1) <= NEAR * surface.sizes
    level &= np.isin(surface.numbers, plane_faces)
    if not level.any():
        parallel = [f for f in surface.faces if f.normal and abs(normal @ f.normal) > _ALIGNED]
        positions = sorted({round(float(normal @ face.centre), 9) for face in parallel})
        listed = ", ".join(f"{position:g}" for position in positions)
        along = plane if isinstance(plane, str) else f"x . {point_text(normal)}"
        remedy = f"choose one at: {listed}" if listed else "none is parallel; use near or faces"
        _refuse(where, f"there is no plane face at {along} = {at:g} m; {remedy}")
    return level


def _on_cylinder(surface: Surface, choice: FaceSelector, where: str) -> np.ndarray:
    """Return the facets on a cylinder, or on all of a radius, a mask of shape (f,)."""
    radius = float(choice.radius or 0)
    if choice.cylinder is None:
        radii = {face.number: face.radius for face in surface.faces if face.radius is not None}
        chosen = [n for n, other in radii.items() if abs(other - radius) < NEAR * radius]
        if not chosen:
            listed = ", ".join(dict.fromkeys(f"{r:.6g}" for r in sorted(radii.values())))
            remedy = f"choose one of {listed}" if listed else "none is round; use near or faces"
            _refuse(where, f"there is no cylinder of radius {radius:g} m; {remedy}")
        return np.isin(surface.numbers, chosen)
    axis = np.array(choice.cylinder.axis)
    arms = np.cross(surface.mesh.points[surface.corners] - choice.cylinder.point, axis)
    off = np.abs(np.linalg.norm(arms, axis=2) - radius).max(axis=1)
    on = (off < NEAR * radius) & (np.abs(surface.normals @ axis) < _MAX_ALONG)
    if not on.any():
        message = (
            f"no facet lies on the cylinder of radius {radius:g} m about this axis; the "
            f"nearest is {off.min():.3g} m off, at {point_text(surface.middles[off.argmin()])} m; "
            "correct it"
        )
        _refuse(where, message)
    return on


def _check_sides(surface: Surface, chosen: np.ndarray, where: str) -> None:
    """Refuse a box round both sides of a thin wall."""
    planes = [face for face in surface.faces if face.normal is not None]
    parts = {face: chosen & (surface.numbers == face.number) for face in planes}
    for a, b in combinations([face for face, part in parts.items() if part.any()], 2):
        normal = np.array(a.normal)
        gap = float(normal @ np.subtract(a.centre, b.centre))
        least = min(surface.areas[parts[a]].sum(), surface.areas[parts[b]].sum())
        if normal @ b.normal < _OPPOSED and 0 < gap < _THIN * np.sqrt(least):
            message = (
                f"has both sides of a wall {gap:.3g} m thick: {parts[a].sum()} facets of face "
                f"{a.number} and {parts[b].sum()} of face {b.number}; add normal = "
                f"{_short(*normal)} for one side, or faces = [{a.number}, {b.number}] for both"
            )
            _refuse(where, message)


def toml_line(surface: Surface, face: Face) -> str:
    """Return the TOML that selects a face alone, in the simplest form."""
    members = surface.numbers == face.number
    centre = _short(*face.centre)
    selectors: list[dict[str, Any]] = []  # keys of a `FaceSelector`, the simplest first
    if face.normal is not None:
        axis = int(np.abs(face.normal).argmax())
        if abs(face.normal[axis]) > 1 - _ROUNDING:
            selectors.append({"plane": "xyz"[axis], "at": centre[axis]})
        else:
            selectors.append({"plane": _short(*face.normal), "at": centre})
    if face.radius is not None:
        selectors.append({"radius": float(f"{face.radius:.6g}")})
    middles = surface.middles[members]
    nearest = middles[np.linalg.norm(middles - face.centre, axis=1).argmin()]
    selectors += {"near": _short(*nearest)}, {"faces": [face.number]}
    for keys in selectors:
        with contextlib.suppress(BundleError):
            if np.array_equal(_chosen(surface, FaceSelector(**keys), "", None), members):
                return f"{{{', '.join(f'{key} = {json.dumps(keys[key])}' for key in keys)}}}"
    raise AssertionError(face)  # its number selects it


def _refuse(where: str, message: str) -> NoReturn:
    raise BundleError([BundleProblem(where, message)])


def _short(*values: float) -> list[float]:
    """Round numbers to six digits of the largest."""
    digits = 5 - int(np.floor(np.log10(max(*map(abs, values), 1e-12))))
    return [round(float(value), digits) + 0.0 for value in values]
