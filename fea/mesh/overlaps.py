"""Overlaps of the facets of two surfaces, on the planes of the first, cut into triangles."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree
from skfem.quadrature import get_quadrature
from skfem.refdom import RefTri

from wrenchbook.fea.mesh.facets import TRIANGLES, corners_of
from wrenchbook.fea.mesh.mesh import FacetBlock
from wrenchbook.fea.mesh.reference_cell import node_coordinates, tabulate

_PAIRS = 10_000  # triangles that are cut at a time: about 50 MB
_MAX_STEPS = 20  # largest number of Newton steps for a point in a facet, which takes three to five
_EXACT = 1e-12  # relative to the size of a facet: roundoff
_PARALLEL = 1e-9  # rad between sides: roundoff would put their crossing anywhere along both
_POINTS, _WEIGHTS = get_quadrature(RefTri, 6)  # two serendipity functions have together this degree
_BARYCENTRIC = np.array([1 - _POINTS.sum(axis=0), *_POINTS])


class Overlaps(NamedTuple):
    """Triangles in which facets of two surfaces overlap, on the planes of the first."""

    first: np.ndarray  # shape (s,), int64: facet of the first surface
    second: np.ndarray  # shape (s,), int64: facet of the second
    weights: np.ndarray  # shape (s, q), m^2: weights of q quadrature points
    here: np.ndarray  # shape (s, q, k): shape functions of the first facet at these points
    there: np.ndarray  # shape (s, q, l): shape functions of the second facet
    gaps: np.ndarray  # shape (s, q), m: distance between both facets


def overlaps(
    points: np.ndarray, first: FacetBlock, second: FacetBlock, plane: np.ndarray, distance: float
) -> Iterator[Overlaps]:
    """Yield overlaps of facets of two surfaces within a distance, m, some triangles at a time.

    plane: shape (f, 3, 2): directions in the plane of each of the first facets.
    """
    ours, theirs = _triangles(points, first), _triangles(points, second)
    radii = ours.radii + theirs.radii.max() + distance
    nearby = KDTree(theirs.middles).query_ball_point(ours.middles, radii)
    i = np.repeat(np.arange(len(nearby)), [len(others) for others in nearby])
    j = np.array([other for others in nearby for other in others], dtype=np.int64)
    apart = np.linalg.norm(ours.middles[i] - theirs.middles[j], axis=1)
    pairs = np.stack([i, j])[:, apart <= ours.radii[i] + theirs.radii[j] + distance]

    for start in range(0, pairs.shape[1], _PAIRS):
        i, j = pairs[:, start : start + _PAIRS]
        flat = plane[ours.facets[i]]
        pair, cuts = _intersections(ours.corners[i] @ flat, theirs.corners[j] @ flat)
        facet, other = ours.facets[i[pair]], theirs.facets[j[pair]]
        flat = flat[pair]

        at = np.einsum("cq,sci->sqi", _BARYCENTRIC, cuts)
        weights = np.abs(np.linalg.det(cuts[:, 1:] - cuts[:, :1]))[:, None] * _WEIGHTS
        nodes, opposite = points[first.nodes[facet]], points[second.nodes[other]]
        here, converged = _functions_at(first.kind, nodes @ flat, at)
        there, converged_there = _functions_at(second.kind, opposite @ flat, at)
        gaps = np.linalg.norm(here @ nodes - there @ opposite, axis=2)
        met = converged & converged_there & (gaps.max(axis=1) <= distance)
        yield Overlaps(facet[met], other[met], weights[met], here[met], there[met], gaps[met])


class _Triangles(NamedTuple):
    """Facets cut into t triangles."""

    corners: np.ndarray  # shape (t, 3, 3), m
    middles: np.ndarray  # shape (t, 3), m
    radii: np.ndarray  # shape (t,), m: from the middle to the farthest corner
    facets: np.ndarray  # shape (t,), int64: the facet of each


def _triangles(points: np.ndarray, block: FacetBlock) -> _Triangles:
    """Return the facets of a block as triangles between their corners."""
    split = np.array(TRIANGLES["tri3" if corners_of(block.kind) == 3 else "quad4"])
    corners = points[block.nodes[:, split]].reshape(-1, 3, 3)
    middles = corners.mean(axis=1)
    radii = np.linalg.norm(corners - middles[:, None], axis=2).max(axis=1)
    return _Triangles(corners, middles, radii, np.arange(len(corners)) // len(split))


def _functions_at(kind: str, nodes: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the shape functions (s, q, k) of flat facets (s, k, 2) at points (s, q, 2).

    By Newton's method; also whether it converges at all points of each facet, (s,), bool.
    """
    local = np.broadcast_to(node_coordinates(kind).mean(axis=0), at.shape).copy()
    size = np.ptp(nodes, axis=1).max(axis=1)[:, None]
    values = np.empty(0)
    converged = np.zeros((1, 1), dtype=bool)
    for _ in range(_MAX_STEPS):
        values, slopes = tabulate(kind, local.reshape(-1, 2))
        values = values.reshape(*at.shape[:2], -1)
        off = at - values @ nodes
        converged = np.linalg.norm(off, axis=2) <= _EXACT * size
        if converged.all():
            break
        columns = np.einsum("ski,sqkj->jsqi", nodes, slopes.reshape(*values.shape, 2))
        area = _cross(*columns)
        step = np.stack([_cross(off, columns[1]), _cross(columns[0], off)], axis=-1)
        local += np.clip(step / np.where(area == 0, 1.0, area)[..., None], -1.0, 1.0)
    return values, np.asarray(converged.all(axis=1))


def _intersections(*pairs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the intersections of pairs of triangles, twice (p, 3, 2), cut into triangles.

    Result: the index of each one's pair, (s,), and its corners, (s, 3, 2).
    """
    corners = np.stack(pairs)
    clockwise = _cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0]) < 0
    corners[clockwise] = corners[clockwise][:, ::-1]
    sides = np.roll(corners, -1, axis=2) - corners
    least = _EXACT * _cross(sides[:, :, 0], sides[:, :, 1])

    # Corners inside the other triangle, and crossings of the sides.
    off = _cross(sides[::-1, :, None], corners[:, :, :, None] - corners[::-1, :, None])
    inside = np.asarray((off >= -least[::-1, :, None, None]).all(axis=3))
    first = sides[0][:, :, None]
    second = sides[1][:, None]
    between = corners[1][:, None] - corners[0][:, :, None]
    area = _cross(first, second)
    lengths = np.linalg.norm(first, axis=-1) * np.linalg.norm(second, axis=-1)
    area[np.abs(area) < _PARALLEL * lengths] = np.inf
    along, across = _cross(between, second) / area, _cross(between, first) / area
    met = (np.minimum(along, across) >= 0) & (np.maximum(along, across) <= 1) & np.isfinite(area)
    inside = np.concatenate([*inside, met.reshape(-1, 9)], axis=1)
    crossings = corners[0][:, :, None] + along[..., None] * first
    points = np.concatenate([*corners, crossings.reshape(-1, 9, 2)], axis=1)
    pair = np.flatnonzero(inside.sum(axis=1) > 2)
    points, inside = points[pair], inside[pair]

    # In order of the angle about their middle; outside points are last and replaced by the first.
    middle = (points * inside[..., None]).sum(axis=1) / inside.sum(axis=1)[:, None]
    x, y = np.moveaxis(points - middle[:, None], 2, 0)
    order = np.argsort(np.where(inside, np.arctan2(y, x), np.inf), axis=1)
    points = np.take_along_axis(points, order[..., None], axis=1)
    last = np.take_along_axis(inside, order, axis=1)[..., None]
    points = np.where(last, points, points[:, :1])

    # Triangles from the middle to each side; those without area are left out.
    middles = np.broadcast_to(middle[:, None], points.shape)
    cuts = np.stack([middles, points, np.roll(points, -1, axis=1)], axis=2)
    area = _cross(cuts[:, :, 1] - cuts[:, :, 0], cuts[:, :, 2] - cuts[:, :, 0])
    row, number = np.nonzero(area > least[0, pair, None])
    return pair[row], cuts[row, number]


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the cross products of vectors in a plane, (..., 2) each."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
