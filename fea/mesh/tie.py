"""Ties of two surfaces whose meshes do not match: the mortar method with dual multipliers.

The displacement of the secondary surface satisfies int lambda (u - u_main) = 0 for each multiplier
lambda. The multipliers are biorthogonal to transformed shape functions with positive integrals: of
a corner N + alpha (those of its two edges), of an edge (1 - 2 alpha) N (Popp, Wohlmuth, Gitterle
and Wall 2012). So each secondary node follows nearby main nodes alone, and a linear displacement
passes exactly. The integrals are over the overlaps of both surfaces' facets, projected on the mean
plane of the secondary facet.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree
from skfem.quadrature import get_quadrature
from skfem.refdom import RefTri

from wrenchbook.fea.mesh.dependents import CircularError, Dependents
from wrenchbook.fea.mesh.facets import TRIANGLES, corners_of, missing
from wrenchbook.fea.mesh.mesh import FacetBlock, FacetGroup, Mesh
from wrenchbook.fea.mesh.reference_cell import node_coordinates, reference_element, tabulate
from wrenchbook.fea.spec.problems import BundleProblem, point_text
from wrenchbook.fea.spec.schema import Tie

Array = np.ndarray

DISTANCE = 0.1
"""Of the facets' mean edge, the distance within which surfaces are tied unless it is given: cells
with straight edges, eight round a circle, are 0.097 of an edge off it."""

_ALPHA = 0.2  # any in (0, 1/3) makes the integrals positive; Popp's choice
_COVER = 0.5  # of a facet, and of a node's integral: less is an extrapolation from a strip
_FACING = 0.5  # cosine between the facets' normals: 60 degrees, beyond which they do not face
_PAIRS = 10_000  # triangles that are cut at a time: about 50 MB
_STEPS = 20  # of Newton's method for a point in a facet, which takes three to five
_EXACT = 1e-12  # relative to the size of a facet
_SAME = 1e-9  # of a projector: axes are written to about so many digits
_RULE = get_quadrature(RefTri, 6)  # two serendipity functions have together this degree


@dataclass(frozen=True, eq=False)
class TiedNodes:
    """Secondary nodes that follow a main surface."""

    # Nodes, masters and weights as of `fea.mesh.dependents.Dependents.of`
    entries: tuple[Array, Array, Array]
    nodes: Array  # shape (t,), int64, ascending
    untied: int  # number of the secondary surface's other nodes
    gap: float  # the largest distance between the surfaces where they are tied, m
    distance: float  # within which they are, m

    def of(self, chosen: Array) -> TiedNodes:
        """Return those of its nodes that are chosen, (t,), bool."""
        nodes = self.nodes[chosen]
        among = np.isin(self.entries[0], nodes)
        rows, masters, weights = (part[among] for part in self.entries)
        untied = self.untied + len(self.nodes) - len(nodes)
        return replace(self, entries=(rows, masters, weights), nodes=nodes, untied=untied)


@dataclass(frozen=True, eq=False)
class _Surface:
    """Facets of one kind, split into triangles."""

    kind: str
    nodes: Array  # shape (f, k)
    at: Array  # their points, shape (f, k, 3), m
    facet: Array  # of each triangle, shape (t,)
    corners: Array  # of the triangles, shape (t, 3, 3), m

    @classmethod
    def of(cls, points: Array, block: FacetBlock) -> _Surface:
        """Return the facets of a block, split through midside nodes where edges are curved."""
        at, count = points[block.nodes], corners_of(block.kind)
        middles = at[:, count : 2 * count]
        straight = 0.5 * (at[:, :count] + np.roll(at[:, :count], -1, axis=1))[:, : len(middles[0])]
        extent = float(np.ptp(at.reshape(-1, 3), axis=0).max())
        curved = np.abs(middles - straight).max(initial=0.0) > 1e-9 * extent
        split = np.array(TRIANGLES[block.kind if curved else {3: "tri3", 4: "quad4"}[count]])
        facet = np.repeat(np.arange(len(at)), len(split))
        return cls(block.kind, block.nodes, at, facet, at[:, split].reshape(-1, 3, 3))

    @property
    def planes(self) -> Array:
        """Axes of each facet's mean plane and its normal, rows of shape (f, 3, 3)."""
        a, b, c = self.corners.swapaxes(0, 1)
        normal = np.zeros((len(self.at), 3))
        np.add.at(normal, self.facet, np.cross(b - a, c - a))
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        first = self.at[:, 1] - self.at[:, 0]
        first -= (first * normal).sum(axis=1)[:, None] * normal
        first /= np.linalg.norm(first, axis=1)[:, None]
        return np.stack([first, np.cross(normal, first), normal], axis=1)


def mean_edge(points: Array, group: FacetGroup) -> float:
    """Return the mean length between the corners of facets, m."""
    lengths = [
        np.linalg.norm(at - np.roll(at, -1, axis=1), axis=2).ravel()
        for at in (points[nodes[:, : corners_of(kind)]] for kind, nodes in group.blocks)
    ]
    return float(np.concatenate(lengths).mean())


def joined(
    mesh: Mesh,
    ties: Sequence[Tie],
    held: Array,
    sections: Mapping[str, Array],
    problems: list[BundleProblem],
) -> tuple[Mesh, tuple[TiedNodes, ...]]:
    """Return a mesh whose tied nodes follow others, and lie where these put them, and the ties.

    So a gap is closed by moving secondary nodes, and no rotation strains the tie. Fixed nodes stay
    fixed. Sliding ones follow main nodes that are held in the same directions, as on a plane of
    symmetry, which was ten times as exact there as to leave them out; else they stay held.

    held: projectors on the directions in which nodes are held, (n, 3, 3).
    sections: nodes that follow a frame, by the key of the bundle.
    """
    entries, done, free = [], [], np.trace(held, axis1=1, axis2=2) < 3 - _SAME
    if mesh.dependents is not None:
        entries.append(mesh.dependents.entries)
        free[mesh.dependents.nodes] = False
    for i, pair in enumerate(ties):
        key, names = f"tie[{i}]", list(mesh.facet_groups)
        sides = {"secondary": pair.secondary, "main": pair.main}
        lost = [
            missing(f"{key}.{side}", name, "facet group", names)
            for side, name in sides.items()
            if name not in names
        ]
        if lost:
            problems += lost
            continue
        secondary, main = (mesh.facet_groups[name] for name in sides.values())
        may = free.copy()
        may[main.node_ids] = False  # a common node holds the two together as it is
        tied = tied_nodes(mesh.points, secondary, main, pair.distance, may)
        rows, masters, _ = tied.entries
        apart = np.abs(held[rows] @ (np.eye(3) - held[masters])).max(axis=(1, 2), initial=0.0)
        alike = (apart < _SAME) & np.isin(masters, main.node_ids)
        tied = tied.of(np.isin(tied.nodes, rows[alike]))
        if not tied.nodes.size:
            tree = KDTree(mesh.points[main.node_ids])
            gap = tree.query(mesh.points[secondary.node_ids])[0].min()
            message = (
                f'no facet of "{pair.secondary}" with free nodes faces "{pair.main}" within '
                f"{tied.distance:.3g} m; their nearest nodes are {gap:.3g} m apart. Correct the "
                "groups, or write a larger distance"
            )
            problems.append(BundleProblem(key, message))
        for where, nodes in sections.items():
            if (shared := np.intersect1d(tied.nodes, nodes)).size:
                message = (
                    f"{len(shared)} secondary nodes, such as the one at "
                    f"{point_text(mesh.points[shared[0]])} m, are of {where}: a node can follow "
                    "one only. Swap secondary and main, or leave cells between the two"
                )
                problems.append(BundleProblem(key, message))
        free[tied.nodes] = False
        entries.append(tied.entries)
        done.append(tied)
    if not done:
        return mesh, ()
    try:
        rows, masters, weights = (np.concatenate(parts) for parts in zip(*entries, strict=True))
        dependents = Dependents.of(len(mesh.points), (rows, masters, weights))
    except CircularError as error:
        at = point_text(mesh.points[error.node])
        message = f"the node at {at} m follows itself by several ties; swap the groups of one"
        problems.append(BundleProblem("tie", message))
        return mesh, ()
    points, nodes = mesh.points.copy(), np.concatenate([tied.nodes for tied in done])
    points[nodes] = dependents.expanded(points)[nodes]
    return replace(mesh, points=points, dependents=dependents), tuple(done)


def tied_nodes(
    points: Array, secondary: FacetGroup, main: FacetGroup, distance: float | None, free: Array
) -> TiedNodes:
    """Tie two surfaces.

    points: shape (n, 3), m.
    distance: facets farther from each other are not tied, m; None: a tenth of the longer mean edge.
    free: shape (n,), bool: nodes that may follow others.
    """
    if distance is None:
        distance = DISTANCE * max(mean_edge(points, group) for group in (secondary, main))
    # Integrals of the transformed functions where the surfaces meet, and over the whole facets.
    covered, complete = np.zeros(len(points)), np.zeros(len(points))
    rows, masters, values, gap = [], [], [], 0.0
    ends: list[Array] = [np.empty((0, 3), dtype=np.int64)]
    for block in secondary.blocks:
        surface = _Surface.of(points, block)
        transform, pairs = _transform(surface.kind)
        ends += [surface.nodes[:, pairs].reshape(-1, 3)]
        element, planes = reference_element(surface.kind), surface.planes
        flat = surface.at @ planes[:, :2].swapaxes(1, 2)
        areas = np.linalg.det(np.einsum("fki,qkj->fqij", flat, element.slopes)) * element.weights
        whole = areas @ (element.values @ transform)
        np.add.at(complete, surface.nodes, whole)
        size = surface.nodes.shape[1]
        mass, mixed = np.zeros((len(flat), size, size)), []
        for other in main.blocks:
            across = _Surface.of(points, other)
            for of, to, weights, values_of, values_to, far in _overlaps(surface, across, distance):
                functions = weights[..., None] * (values_of @ transform)
                np.add.at(mass, of, functions.swapaxes(1, 2) @ (values_of @ transform))
                mixed.append((of, across.nodes[to], functions.swapaxes(1, 2) @ values_to, far))
        integrals = mass.sum(axis=2)  # the transformed functions sum to one
        taken = integrals.sum(axis=1) > _COVER * areas.sum(axis=1)
        mass[~taken], integrals[~taken] = np.eye(size), 0.0
        np.add.at(covered, surface.nodes, integrals)
        dual = integrals[:, :, None] * np.linalg.inv(mass)
        for of, to, products, far in mixed:
            gap = max(gap, float(far[taken[of]].max(initial=0.0)))
            weights = dual[of] @ products
            chosen = np.broadcast_to(taken[of][:, None, None], weights.shape)
            rows.append(np.broadcast_to(surface.nodes[of][:, :, None], weights.shape)[chosen])
            masters.append(np.broadcast_to(to[:, None, :], weights.shape)[chosen])
            values.append(weights[chosen])
    tied = free & (covered > _COVER * complete)
    none = np.empty(0, dtype=np.int64)
    rows, masters, values = (np.concatenate([none, *parts]) for parts in (rows, masters, values))
    chosen = tied[rows]
    rows, masters, values = rows[chosen], masters[chosen], values[chosen] / covered[rows[chosen]]
    # From the transformed unknown of an edge to its node's displacement.
    edges = np.unique(np.concatenate(ends), axis=0)
    edges = edges[tied[edges[:, 0]]]
    scale = np.ones(len(points))
    scale[edges[:, 0]] = 1 - 2 * _ALPHA
    edges = edges[np.unique(edges[:, 0], return_index=True)[1]]
    entries = (
        np.concatenate([rows, np.repeat(edges[:, 0], 2)]),
        np.concatenate([masters, edges[:, 1:].ravel()]),
        np.concatenate([values * scale[rows], np.full(2 * len(edges), _ALPHA)]),
    )
    nodes = np.flatnonzero(tied)
    return TiedNodes(entries, nodes, len(secondary.node_ids) - len(nodes), gap, distance)


def _transform(kind: str) -> tuple[Array, Array]:
    """Return nodal values by transformed unknowns, (k, k), and edges: node and ends, (e, 3)."""
    size, count = len(node_coordinates(kind)), corners_of(kind)
    number = np.arange(count if size > count else 0)
    pairs = np.stack([count + number, number, (number + 1) % count], axis=1)
    transform = np.eye(size)
    transform[pairs[:, 0], pairs[:, 0]] = 1 - 2 * _ALPHA
    transform[pairs[:, :1], pairs[:, 1:]] = _ALPHA
    return transform, pairs


def _overlaps(surface: _Surface, other: _Surface, distance: float) -> Iterator[tuple[Array, ...]]:
    """Yield overlaps of facets of two surfaces, s triangles at a time.

    Each: the facets (s,), (s,), weights at q points (s, q), m^2, the shape functions of the first
    (s, q, k) and the second (s, q, l) there, and the distance between both, (s, q), m.
    """
    centres = [side.corners.mean(axis=1) for side in (surface, other)]
    radii = [
        np.linalg.norm(side.corners - centre[:, None], axis=2).max(axis=1)
        for side, centre in zip((surface, other), centres, strict=True)
    ]
    planes, normals = surface.planes, other.planes[:, 2]
    reach = radii[0] + radii[1].max() + distance
    near = KDTree(centres[1]).query_ball_point(centres[0], reach)
    first = np.repeat(np.arange(len(near)), [len(each) for each in near])
    second = np.concatenate([np.empty(0, dtype=np.int64), *map(np.array, near)]).astype(np.int64)
    apart = np.linalg.norm(centres[0][first] - centres[1][second], axis=1)
    facing = np.abs((planes[surface.facet[first], 2] * normals[other.facet[second]]).sum(axis=1))
    chosen = (apart <= radii[0][first] + radii[1][second] + distance) & (facing > _FACING)
    first, second = first[chosen], second[chosen]
    for start in range(0, len(first), _PAIRS):
        of, to = first[start : start + _PAIRS], second[start : start + _PAIRS]
        plane = planes[surface.facet[of], :2].swapaxes(1, 2)
        pair, cuts = _intersections(surface.corners[of] @ plane, other.corners[to] @ plane)
        of, to, plane = surface.facet[of[pair]], other.facet[to[pair]], plane[pair]
        corners = np.array([1 - _RULE[0].sum(axis=0), *_RULE[0]])
        at = np.einsum("cq,sci->sqi", corners, cuts)
        sides = cuts[:, 1:] - cuts[:, :1]
        weights = np.abs(np.linalg.det(sides))[:, None] * _RULE[1]
        values, there, ends = [], np.ones(len(of), dtype=bool), []
        for side, facet in ((surface, of), (other, to)):
            functions, found = _located(side.kind, side.at[facet] @ plane, at)
            values.append(functions)
            ends.append(functions @ side.at[facet])
            there &= found
        far = np.linalg.norm(ends[0] - ends[1], axis=2)
        there &= far.max(axis=1) <= distance
        yield of[there], to[there], weights[there], values[0][there], values[1][there], far[there]


def _located(kind: str, nodes: Array, at: Array) -> tuple[Array, Array]:
    """Return the shape functions (s, q, k) of flat facets (s, k, 2) at points (s, q, 2).

    By Newton's method; also whether each facet has its points, (s,), bool.
    """
    local = np.broadcast_to(node_coordinates(kind).mean(axis=0), at.shape).copy()
    size = np.ptp(nodes, axis=1).max(axis=1)[:, None]
    values, found = np.empty(0), np.empty(0)
    for _ in range(_STEPS):
        values, slopes = tabulate(kind, local.reshape(-1, 2))
        values = values.reshape(*at.shape[:2], -1)
        off = at - values @ nodes
        found = np.linalg.norm(off, axis=2) <= _EXACT * size
        if found.all():
            break
        jacobian = np.einsum("ski,sqkj->sqij", nodes, slopes.reshape(*values.shape, 2))
        (a, b), (c, d) = np.moveaxis(jacobian, (2, 3), (0, 1))
        x, y = np.moveaxis(off, 2, 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = np.stack([d * x - b * y, a * y - c * x], axis=-1) / (a * d - b * c)[..., None]
        local += np.clip(np.nan_to_num(step), -1.0, 1.0)
    return values, np.asarray(found.all(axis=1))


def _intersections(first: Array, second: Array) -> tuple[Array, Array]:
    """Return the intersections of pairs of triangles (p, 3, 2), cut into triangles.

    Result: the pair of each, (s,), and its corners, (s, 3, 2).
    """
    first, second = (_anticlockwise(corners) for corners in (first, second))
    points, inside = [], []
    for corners, others in ((first, second), (second, first)):
        sides = np.roll(others, -1, axis=1) - others
        off = _cross(sides[:, None], corners[:, :, None] - others[:, None])
        area = _cross(sides[:, 0], sides[:, 1])
        points.append(corners)
        inside.append((off >= -_EXACT * area[:, None, None]).all(axis=2))
    sides = [(np.roll(corners, -1, axis=1) - corners) for corners in (first, second)]
    one, two = sides[0][:, :, None], sides[1][:, None]
    between = second[:, None] - first[:, :, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        along = [_cross(between, side) / _cross(one, two) for side in (two, one)]
        points.append((first[:, :, None] + along[0][..., None] * one).reshape(-1, 9, 2))
    inside.append(np.all([(a >= 0) & (a <= 1) for a in along], axis=0).reshape(-1, 9))
    points, inside = np.concatenate(points, axis=1), np.concatenate(inside, axis=1)
    pair = np.flatnonzero(inside.sum(axis=1) > 2)
    points, inside = points[pair], inside[pair]
    points[~inside] = 0.0
    centre = points.sum(axis=1) / inside.sum(axis=1)[:, None]
    x, y = np.moveaxis(points - centre[:, None], 2, 0)
    order = np.argsort(np.where(inside, np.arctan2(y, x), np.inf), axis=1)
    points = np.take_along_axis(points, order[..., None], axis=1)
    inside = np.take_along_axis(inside, order, axis=1)
    points = np.where(inside[..., None], points, points[:, :1])
    triangles = np.stack(
        [np.broadcast_to(centre[:, None], points.shape), points, np.roll(points, -1, axis=1)], 2
    )
    area = _cross(triangles[:, :, 1] - centre[:, None], triangles[:, :, 2] - centre[:, None])
    all_of = _cross(*np.moveaxis(first[pair][:, 1:] - first[pair][:, :1], 1, 0))
    row, number = np.nonzero(area > _EXACT * all_of[:, None])
    return pair[row], triangles[row, number]


def _anticlockwise(corners: Array) -> Array:
    turned = _cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) < 0
    return np.where(turned[:, None, None], corners[:, ::-1], corners)


def _cross(a: Array, b: Array) -> Array:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
