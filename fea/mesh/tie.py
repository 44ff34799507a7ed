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
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import KDTree

from wrenchbook.fea.mesh.dependents import CircularError, Dependents, Entries
from wrenchbook.fea.mesh.facets import corners_of
from wrenchbook.fea.mesh.groups import no_facets
from wrenchbook.fea.mesh.mapping import jacobians
from wrenchbook.fea.mesh.mesh import FacetBlock, FacetGroup, Mesh
from wrenchbook.fea.mesh.overlaps import overlaps
from wrenchbook.fea.mesh.reference_cell import reference_element
from wrenchbook.fea.spec.problems import BundleProblem, point_text
from wrenchbook.fea.spec.schema import Tie

_GAP = 0.1  # part of the mean edge: straight edges, eight round a circle, are 0.097 off it
# Parameter of Popp's transformation: any value in (0, 1/3) makes the integrals positive.
_ALPHA = 0.2
_MIN_COVERED = 1 / 3
"""Least covered part of a facet: a facet with less is not tied.

Of 24 plates and blocks, lapped or on plates with cells as large as the block, half was up to 36 %
too soft and a third 13 %; a smaller limit makes most of them stiffer.
"""

# Part of a node's integral over the tied facets: with less the tie extrapolates from a strip.
_MIN_INTEGRAL = 0.1
_UNSURE = 0.02  # part of a facet, covered or not: roundoff, and gaps between curved facets
# Part of a main facet that counts as all of it: on a round surface its projection is as small, at
# 25 degrees.
_COMPLETE = 0.9
_NEIGHBOURS = 8  # main nodes beside a sliding node, some on its plane of symmetry if the surface is
_ROUNDOFF = 1e-9  # part of a projector: axes are written to about as many digits

_OF_TIE = (
    "{count} secondary nodes, such as the one at {at} m, also belong to {where}, but a node can "
    "follow one only. Swap secondary and main, or leave cells between the two"
)
_OF_DECK = (
    "{count} nodes of {where}, such as the one at {at} m, follow others by *EQUATION or *MPC of "
    "the deck; remove them from that constraint, or from {where}"
)


@dataclass(frozen=True, eq=False)
class TiedNodes:
    """Secondary nodes that depend on a main surface."""

    nodes: np.ndarray  # shape (t,), int64, ascending
    untied: int  # number of the other nodes of the secondary surface
    max_gap: float  # the largest distance between the surfaces where they are tied, m
    distance: float  # largest distance of tied facets, m
    # Number of facets that the main surface covers in part: there the tie ends at a facet's edge.
    cut: int
    # Largest distance, m, of secondary facets that are left out, all or in part, because they are
    # farther than `distance`; or 0
    beyond: float
    within: float  # size of the largest main facet that is covered in part, over the tie's, or 0


def tie_surfaces(
    mesh: Mesh,
    ties: Sequence[Tie],
    held: np.ndarray,
    sections: Sequence[tuple[str, np.ndarray]],
    problems: list[BundleProblem],
) -> tuple[Mesh, tuple[TiedNodes, ...]]:
    """Return a mesh whose tied nodes depend on others, and lie where these put them, and the ties.

    A gap is closed by moving secondary nodes, so that no rotation strains the tie. Fixed nodes stay
    fixed. Sliding ones depend on main nodes that are held in the same directions, as on a plane of
    symmetry, where this was ten times as exact as leaving them out; otherwise they stay held.

    held: projectors on the directions in which nodes are held, (n, 3, 3).
    sections: keys of the bundle, and the nodes that depend on the frame of each.
    problems: gets the mistakes; a tie without its two groups is left out.
    """
    entries: list[Entries] = []
    done: list[TiedNodes] = []
    follows = np.zeros(len(mesh.points), dtype=bool)
    if mesh.dependents is not None:
        entries.append(mesh.dependents.entries)
        follows[mesh.dependents.nodes] = True
        used = [("[supports]", np.flatnonzero(held.any(axis=(1, 2)))), *sections]
        problems += _shared_nodes(mesh, mesh.dependents.nodes, used, "mesh", _OF_DECK)

    for i, pair in enumerate(ties):
        key = f"tie[{i}]"
        sides = {"secondary": pair.secondary, "main": pair.main}
        lost = {side: name for side, name in sides.items() if name not in mesh.facet_groups}
        if lost:
            problems += [no_facets(mesh, f"{key}.{side}", name) for side, name in lost.items()]
            continue

        secondary, main = mesh.facet_groups[pair.secondary], mesh.facet_groups[pair.main]
        bound, nearest = _bound_nodes(mesh, pair, held, follows)
        may_follow = np.zeros(len(mesh.points), dtype=bool)
        may_follow[secondary.node_ids] = ~np.any([*bound.values()], axis=0)
        tied, follow = tied_nodes(mesh.points, secondary, main, pair.distance, may_follow)
        if not tied.nodes.size:
            problems.append(BundleProblem(key, _why_untied(pair, tied, nearest, bound)))
        problems += _shared_nodes(mesh, tied.nodes, sections, key, _OF_TIE)
        follows[tied.nodes] = True
        entries.append(follow)
        done.append(tied)
    if not done:
        return mesh, ()

    try:
        dependents = Dependents.of(len(mesh.points), Entries.concatenate(entries))
    except CircularError as error:
        at = point_text(mesh.points[error.node])
        message = f"the node at {at} m follows itself by several ties; swap the groups of a tie"
        problems.append(BundleProblem("tie", message))
        return mesh, ()
    points = mesh.points.copy()
    nodes = np.concatenate([tied.nodes for tied in done])
    points[nodes] = dependents.expanded(points)[nodes]
    return replace(mesh, points=points, dependents=dependents), tuple(done)


def _bound_nodes(
    mesh: Mesh, pair: Tie, held: np.ndarray, follows: np.ndarray
) -> tuple[dict[str, np.ndarray], float]:
    """Return which secondary nodes, (k,), must not be tied, by the reason.

    The second result is the least distance of nodes of the two surfaces, m.

    held: projectors on the directions in which nodes are held, (n, 3, 3).
    follows: shape (n,), bool: nodes that already depend on others.
    """
    nodes, main = mesh.facet_groups[pair.secondary].node_ids, mesh.facet_groups[pair.main].node_ids
    tree: Any = KDTree(mesh.points[main])
    # A list of ranks keeps the result two-dimensional for one neighbour.
    ranks = range(1, 1 + min(_NEIGHBOURS, main.size))
    distances, neighbours = tree.query(mesh.points[nodes], ranks)
    # Directions in which a node is held, but its neighbours are not.
    unmatched = held[nodes][:, None] @ (np.eye(3) - held[main[neighbours]])
    bound = {
        # This node connects both surfaces.
        f'are in "{pair.main}"': np.isin(nodes, main),
        "are fixed": np.trace(held[nodes], axis1=1, axis2=2) >= 3 - _ROUNDOFF,
        "already follow others": follows[nodes],
        "slide where it does not": (np.abs(unmatched).max(axis=(2, 3)) > _ROUNDOFF).all(axis=1),
    }
    return bound, float(distances.min())


def _shared_nodes(
    mesh: Mesh, nodes: np.ndarray, uses: Sequence[tuple[str, np.ndarray]], key: str, text: str
) -> Iterator[BundleProblem]:
    """Yield a problem at `key` for each use, a key and nodes, that has some of `nodes`.

    text: the message, with the fields count, at and where.
    """
    for where, used in uses:
        shared = np.intersect1d(nodes, used)
        if shared.size:
            at = point_text(mesh.points[shared[0]])
            yield BundleProblem(key, text.format(count=shared.size, at=at, where=where))


def _why_untied(pair: Tie, tied: TiedNodes, nearest: float, bound: Mapping[str, np.ndarray]) -> str:
    """Return the reason for which no node is tied.

    nearest: the least distance of nodes of the two surfaces, m.
    bound: reasons for which secondary nodes must not be tied, each with a mask of shape (k,).
    """
    reasons: list[str] = []
    free = np.ones(len(next(iter(bound.values()))), dtype=bool)
    for why, mask in bound.items():
        count = int((free & mask).sum())
        if count:
            reasons.append(f"{count} {why}")
        free &= ~mask
    if not free.any():
        return (
            f'no node of "{pair.secondary}" is free to follow "{pair.main}": {", ".join(reasons)}. '
            "Leave the tie out, or name other facets"
        )

    is_largest = pair.distance is not None and pair.distance > tied.distance
    remedy = "move the surfaces together in the mesh" if is_largest else "write a larger distance"
    limit = f"{tied.distance:.3g} m"
    if is_largest:
        limit += " (the facets' mean edge, the most)"
    if nearest > tied.distance:
        return (
            f'no facet of "{pair.secondary}" with free nodes faces "{pair.main}" within {limit}; '
            f"their nearest nodes are {nearest:.3g} m apart. Correct the groups, or {remedy}"
        )
    if tied.beyond:
        return (
            f'the facets of "{pair.secondary}" are up to {tied.beyond:.3g} m off '
            f'"{pair.main}", beyond the distance of {limit}; {remedy}'
        )
    return (
        f'"{pair.main}" covers at most a third of each facet of "{pair.secondary}". '
        "Swap the two groups, or split these facets there"
    )


def tied_nodes(
    points: np.ndarray,
    secondary: FacetGroup,
    main: FacetGroup,
    distance: float | None,
    free: np.ndarray,
) -> tuple[TiedNodes, Entries]:
    """Tie two surfaces; also return the dependences of the tied nodes.

    points: shape (n, 3), m.
    distance: facets farther from each other are not tied, m; None for a tenth of the mean edge.
    free: shape (n,), bool: nodes that may depend on others.
    """
    facets = [*secondary.blocks, *main.blocks]
    corners = [points[nodes[:, : corners_of(kind)]] for kind, nodes in facets]
    edges = [np.linalg.norm(at - np.roll(at, 1, axis=1), axis=2).ravel() for at in corners]
    edge = float(np.concatenate(edges).mean())
    distance = min(distance or _GAP * edge, edge)  # to close a larger gap would fold cells over
    main_areas = [_areas(points, block) for block in main.blocks]
    main_covered = [np.zeros(len(areas)) for areas in main_areas]  # tied area of each facet, m^2
    # Integrals of the transformed functions over the common area, and over all of tied facets.
    covered, complete = np.zeros(len(points)), np.zeros(len(points))
    ends = np.full((len(points), 2), -1)  # ends of the edge whose middle a node is
    entries: list[Entries] = []
    max_gap, cut, beyond = 0.0, 0, 0.0

    for block in secondary.blocks:
        kind, nodes = block
        transform = _transform(kind, nodes.shape[1])
        ends[nodes[:, transform.middles]] = nodes[:, transform.ends]
        plane, areas = _mean_planes(points, kind, nodes)
        mass, mixed, off = _integrals(points, block, main, plane, distance, edge)
        # Facets that are covered enough are tied, by dual functions on them.
        integrals = mass.sum(axis=2)  # the transformed functions sum to one
        ratio = integrals.sum(axis=1) / areas.sum(axis=1)
        taken = ratio > _MIN_COVERED
        cut += int(((ratio > _UNSURE) & (ratio < 1 - _UNSURE)).sum())
        beyond = max(beyond, float(off[ratio < 1 - _UNSURE].max(initial=0.0)))
        values = reference_element(kind).values
        np.add.at(complete, nodes[taken], (areas @ values @ transform.values)[taken])
        mass[~taken], integrals[~taken] = np.eye(len(transform.values)), 0.0
        np.add.at(covered, nodes, integrals)
        dual = integrals[:, :, None] * np.linalg.inv(mass)
        for part in mixed:
            is_tied = taken[part.facets]
            max_gap = max(max_gap, float(part.gaps[is_tied].max(initial=0.0)))
            np.add.at(main_covered[part.block], part.main_facets[is_tied], part.areas[is_tied])
            # Products of dual and main functions, m^2, are the weights of the secondary nodes.
            followers, masters, weights = np.broadcast_arrays(
                nodes[part.facets][:, :, None],
                part.masters[:, None],
                dual[part.facets] @ part.products,
            )
            entries.append(
                Entries(*(each[is_tied].ravel() for each in (followers, masters, weights)))
            )

    tied = free & (covered > _MIN_INTEGRAL * complete)
    follow = _entries_of_nodes(entries, tied, covered, ends)
    untied = len(secondary.node_ids) - int(tied.sum())
    # The size of the largest main facet that is covered in part: the diagonal of a square.
    areas, tied_areas = np.concatenate(main_areas), np.concatenate(main_covered)
    is_part = (_UNSURE * areas < tied_areas) & (tied_areas < _COMPLETE * areas)
    part_area = areas[is_part].max(initial=0.0)
    within = float(np.sqrt(2 * part_area / tied_areas.sum())) if part_area else 0.0
    return TiedNodes(np.flatnonzero(tied), untied, max_gap, distance, cut, beyond, within), follow


def _areas(points: np.ndarray, block: FacetBlock) -> np.ndarray:
    """Return each facet's area between its corners, (f,), m^2."""
    at = points[block.nodes[:, : corners_of(block.kind)]]
    across = np.cross(at, np.roll(at, -1, axis=1))
    return np.linalg.norm(across.sum(axis=1), axis=1) / 2


class _Mixed(NamedTuple):
    """Integrals over s overlaps of secondary facets with facets of a block of the main surface."""

    block: int  # index of the main block
    facets: np.ndarray  # shape (s,), int64: the secondary facet
    main_facets: np.ndarray  # shape (s,), int64: the facet of the main block
    masters: np.ndarray  # shape (s, l), int64: nodes of the main facet
    # Shape (s, k, l), m^2: of transformed functions and those of the main facet
    products: np.ndarray
    gaps: np.ndarray  # shape (s, q), m: distance between both facets
    areas: np.ndarray  # shape (s,), m^2


def _integrals(
    points: np.ndarray,
    block: FacetBlock,
    main: FacetGroup,
    plane: np.ndarray,
    distance: float,
    edge: float,
) -> tuple[np.ndarray, list[_Mixed], np.ndarray]:
    """Integrate over the overlaps of the f facets of a secondary block with the main surface.

    Returns the products of transformed functions, (f, k, k), m^2, those with functions of main
    facets, and the largest distance of each facet to main facets too far from it, (f,), m.

    plane: shape (f, 3, 2): directions in the mean plane of each facet of the block.
    distance: largest distance of tied facets, m. edge: largest distance of facets considered, m.
    """
    transform = _transform(block.kind, block.nodes.shape[1]).values
    mass = np.zeros((len(block.nodes), *transform.shape))
    off = np.zeros(len(block.nodes))
    mixed: list[_Mixed] = []
    for index, main_block in enumerate(main.blocks):
        for facing in overlaps(points, block, main_block, plane, edge):
            farthest = facing.gaps.max(axis=1)
            near = farthest <= distance
            np.maximum.at(off, facing.first[~near], farthest[~near])
            first, second, weights = facing.first[near], facing.second[near], facing.weights[near]
            functions = facing.here[near] @ transform
            weighted = (weights[..., None] * functions).swapaxes(1, 2)
            np.add.at(mass, first, weighted @ functions)
            products = weighted @ facing.there[near]
            masters, gaps = main_block.nodes[second], facing.gaps[near]
            areas = weights.sum(axis=1)
            mixed.append(_Mixed(index, first, second, masters, products, gaps, areas))
    return mass, mixed, off


class _Transform(NamedTuple):
    """Popp's transformation of the unknowns of a facet of k nodes, e of them midside nodes."""

    values: np.ndarray  # shape (k, k): nodal values by transformed unknowns
    middles: np.ndarray  # shape (e,): local indices of midside nodes
    ends: np.ndarray  # shape (e, 2): local indices of both ends of their edges


def _transform(kind: str, size: int) -> _Transform:
    """Return the transformation of a facet of k = `size` nodes."""
    count = corners_of(kind)
    corner = np.arange(count if size > count else 0)
    ends = np.stack([corner, (corner + 1) % count], axis=1)
    transform = np.eye(size)
    transform[count + corner, count + corner] = 1 - 2 * _ALPHA
    transform[count + corner[:, None], ends] = _ALPHA
    return _Transform(transform, count + corner, ends)


def _mean_planes(points: np.ndarray, kind: str, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two directions in the mean plane of each facet, (f, 3, 2), unit vectors in columns.

    The second result is the area, m^2, of each quadrature point in that plane, (f, q).
    """
    at = points[nodes]
    element = reference_element(kind)
    count = corners_of(kind)
    arms = at[:, :count] - at[:, :count].mean(axis=1)[:, None]
    normal = np.cross(arms, np.roll(arms, -1, axis=1)).sum(axis=1)
    plane = np.linalg.qr(np.stack([normal, arms[:, 0], arms[:, 1]], axis=2)).Q[:, :, 1:]
    areas = np.linalg.det(jacobians(at @ plane, element.slopes))
    return plane, np.abs(areas) * element.weights


def _entries_of_nodes(
    entries: Sequence[Entries], tied: np.ndarray, covered: np.ndarray, ends: np.ndarray
) -> Entries:
    """Return the dependences of the tied nodes from those of transformed unknowns.

    entries: with products of dual and main functions, m^2, as weights.
    tied, covered: shape (n,): which nodes are tied, and the integrals of their functions, m^2.
    ends: shape (n, 2): ends of the edge whose middle a node is, -1 for a corner.
    """
    empty = Entries(np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64), np.empty(0))
    rows, masters, weights = Entries.concatenate([empty, *entries])
    rows, masters, weights = rows[tied[rows]], masters[tied[rows]], weights[tied[rows]]
    halved = ends[:, 0] >= 0
    weights = weights / covered[rows] * np.where(halved[rows], 1 - 2 * _ALPHA, 1.0)
    edges = np.flatnonzero(tied & halved)
    return Entries(
        np.append(rows, np.repeat(edges, 2)),
        np.append(masters, ends[edges]),
        np.append(weights, np.full(2 * len(edges), _ALPHA)),
    )
