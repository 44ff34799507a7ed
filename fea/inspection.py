"""Shapes of cells, connected bodies and warnings of a mesh, from the component alone.

Four measures of a cell's shape, each with the worst cell and where it is:

``scaled_jacobian``
    Least over the corners of the volume its three edges span, over that of the ideal cell with
    edges of those lengths: 1 for cubes, regular tetrahedra and right wedges on regular triangles,
    0 for flat cells (the measure of Knupp, "Algebraic mesh quality metrics", 2001).
``jacobian_ratio``
    Least over largest det(dx/dxi) over a cell's nodes and quadrature points: 1 for straight
    parallelepipeds and straight tetrahedra; 0 or less is a cell that folds over, an error.
``aspect_ratio``
    Longest over shortest edge.
``edge_curvature``
    Distance of a midside node from the middle of its edge over the edge's length: 0.1 on a circle
    cut in eight, 0.21 on one cut in four, 0.25 for a node at the quarter point.

The warnings are those of `fea.check`, and the notes of every solution of the embedded solver. They
cost one pass over the cells and two searches among the nodes of the surface: less than the symbolic
analysis before a solve.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.mesh.bolts import BoltCut
from wrenchbook.fea.mesh.facets import (
    EDGES,
    FACES,
    TRIANGLES,
    corners_of_cell,
    facets_within,
    outer_surface,
)
from wrenchbook.fea.mesh.mapping import extreme_determinants
from wrenchbook.fea.mesh.mesh import CellBlock, Mesh, row_numbers
from wrenchbook.fea.mesh.reference_cell import node_coordinates
from wrenchbook.fea.mesh.surface import connected
from wrenchbook.fea.spec.problems import BundleProblem, point_text
from wrenchbook.fea.tensors import determinant

Array = np.ndarray

_IDEAL_VOLUME = {"tet": 0.5**0.5, "pyr": 0.5**0.5, "wed": 0.75**0.5, "hex": 1.0}
"""Volume that the three edges of length 1 at a corner of the ideal cell span, by kind of cell."""
_NO_LENGTH = 1e-300  # m: replaces a length of 0 in a divisor


@dataclass(frozen=True)
class Measure:
    """One measure of the shape of cells."""

    name: str  # key of the measure in the report
    # From points of shape (n, 3), m, and a block of m cells to the values, shape (m,), no unit
    of: Callable[[Array, CellBlock], Array]
    # limit, larger_is_worse: the limit of a bad cell, and on which side of it cells are bad
    limit: float
    larger_is_worse: bool
    description: str  # the description of a bad cell


def scaled_jacobian(points: Array, block: CellBlock) -> Array:
    """Return the least scaled Jacobian of each cell's corners, shape (m,)."""
    # For each corner itself and its three neighbours, right-handed.
    coordinates = node_coordinates(block.kind)
    pairs = EDGES[block.kind]
    triples = []
    for corner in range(corners_of_cell(block.kind)):
        ends = [b if a == corner else a for a, b in pairs if corner in (a, b)][:3]
        edges = coordinates[ends] - coordinates[corner]
        triples.append([corner, *(ends if np.linalg.det(edges) > 0 else ends[::-1])])
    at = points[block.nodes]
    triples = np.array(triples)
    edges = at[:, triples[:, 1:]] - at[:, triples[:, :1]]
    volume = determinant(edges)
    length = np.linalg.norm(edges, axis=3).prod(axis=2)
    scaled = np.divide(volume, length, out=np.zeros_like(volume), where=length > 0)
    return np.minimum(scaled.min(axis=1) / _IDEAL_VOLUME[block.kind[:3]], 1.0)


def jacobian_ratio(points: Array, block: CellBlock) -> Array:
    """Return the least over the largest determinant of each cell, shape (m,)."""
    least, largest = extreme_determinants(points, block)
    return np.divide(least, largest, out=np.zeros(len(block)), where=largest > 0)


def aspect_ratio(points: Array, block: CellBlock) -> Array:
    """Return the longest over the shortest edge of each cell, shape (m,)."""
    lengths = edge_lengths(points, block)
    shortest = np.maximum(lengths.min(axis=1), _NO_LENGTH)
    return lengths.max(axis=1) / shortest


def edge_curvature(points: Array, block: CellBlock) -> Array:
    """Return the largest relative offset of a midside node of each cell, shape (m,)."""
    pairs = np.array(EDGES[block.kind])
    corners = corners_of_cell(block.kind)
    if block.nodes.shape[1] < corners + len(pairs):
        return np.zeros(len(block))
    ends = points[block.nodes[:, pairs]]
    middle = points[block.nodes[:, corners : corners + len(pairs)]]
    offset = np.linalg.norm(middle - ends.mean(axis=2), axis=2)
    return (offset / np.maximum(edge_lengths(points, block), _NO_LENGTH)).max(axis=1)


def edge_lengths(points: Array, block: CellBlock) -> Array:
    """Return the straight lengths of each cell's edges, shape (m, edges), m."""
    ends = points[block.nodes[:, EDGES[block.kind]]]
    return np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2)


MEASURES = (
    Measure("scaled_jacobian", scaled_jacobian, 0.1, False, "nearly flat at a corner"),
    Measure("jacobian_ratio", jacobian_ratio, 0.1, False, "strongly distorted"),
    Measure("aspect_ratio", aspect_ratio, 50.0, True, "long and thin"),
    Measure("edge_curvature", edge_curvature, 0.25, True, "curved too far along an edge"),
)


def quality(mesh: Mesh) -> dict[str, dict[str, Any]]:
    """Return each measure's worst value, that cell's centre (m), and the number of bad cells."""
    return {measure.name: _worst(mesh, measure) for measure in MEASURES}


def quality_warnings(measured: dict[str, dict[str, Any]]) -> list[str]:
    """Return a sentence for each measure with cells beyond its limit."""
    warnings = []
    for measure in MEASURES:
        worst = measured[measure.name]
        if worst["bad"]:
            warnings.append(
                f"{worst['bad']} cells are {measure.description} ({measure.name.replace('_', ' ')} "
                f"{'over' if measure.larger_is_worse else 'under'} {measure.limit:g}; the worst, a "
                f"{worst['kind']} near {point_text(worst['at'])} m, has {worst['worst']:.3g}); "
                "stresses and stiffness there are not to be trusted"
            )
    return warnings


def _worst(mesh: Mesh, measure: Measure) -> dict[str, Any]:
    """Return a measure's worst value with its cell, and the number of cells beyond its limit."""
    sign = 1.0 if measure.larger_is_worse else -1.0  # times a value: the worst is the largest
    bad = 0
    worst_of_blocks = []
    for block in mesh.blocks:
        values = sign * measure.of(mesh.points, block)
        bad += int((values > sign * measure.limit).sum())
        if len(values):
            cell = int(values.argmax())
            worst_of_blocks.append((float(values[cell]), block.kind, block.nodes[cell]))
    worst, kind, nodes = max(worst_of_blocks, key=lambda entry: entry[0])
    return {
        "worst": sign * worst,
        "at": mesh.points[nodes].mean(axis=0).tolist(),
        "kind": kind,
        "bad": bad,
        "limit": measure.limit,
    }


_COINCIDENT = 1e-2
"""Fraction of the shortest edge within which two nodes count as coincident."""

_OPPOSITE = np.array([(0, 1), (2, 4), (3, 5)])
"""Opposite faces of a hexahedron, in the order of `fea.mesh.facets.FACES`."""


@dataclass(frozen=True, eq=False)
class Bodies:
    """Groups of cells that are connected by faces."""

    count: int  # number of bodies; numbered from the body with the most cells
    cells: Array  # number of cells of each body, shape (count,), int64
    nodes: list[Array]  # the nodes of each body, shape (k,), int64: indices, ascending


def bodies_of(mesh: Mesh) -> Bodies:
    """Group the cells that share faces; cells that share only an edge or a point do not join."""
    # A graph of cells, then faces, with an edge from each cell to each of its faces.
    faces, owners = _faces(mesh)
    total = sum(len(block) for block in mesh.blocks)
    size = total + int(faces.max(initial=-1)) + 1
    label = connected(owners, total + faces, size)[:total]
    count = int(label.max(initial=-1)) + 1

    # Number bodies from the one with the most cells.
    sizes = np.bincount(label, minlength=count)
    order = np.argsort(-sizes, kind="stable")
    rank = np.empty(count, dtype=np.int64)
    rank[order] = np.arange(count)
    number = rank[label]

    # The nodes of each body: pairs of body and node as one number, body * nodes + node.
    pairs = []
    first = 0
    for block in mesh.blocks:
        bodies = np.repeat(number[first : first + len(block)], block.nodes.shape[1])
        pairs.append(bodies * len(mesh.points) + block.nodes.ravel())
        first += len(block)
    bodies, nodes = np.divmod(np.unique(np.concatenate(pairs)), len(mesh.points))
    cuts = np.searchsorted(bodies, np.arange(1, count))
    return Bodies(count, sizes[order], np.split(nodes, cuts))


def _faces(mesh: Mesh) -> tuple[Array, Array]:
    """Return a face number for each face of each cell, equal for equal corners, and the cell."""
    corners = []
    owners = []
    first = 0
    for block in mesh.blocks:
        for face in FACES[block.kind]:
            several = 3 if len(face) in (3, 6) else 4
            row = np.full((len(block), 4), -1)
            row[:, :several] = block.nodes[:, face[:several]]
            corners.append(np.sort(row, axis=1))
            owners.append(first + np.arange(len(block)))
        first += len(block)
    return row_numbers(np.concatenate(corners)), np.concatenate(owners)


def stacked_singly(mesh: Mesh) -> Array:
    """Return the middles of hex20 cells that are stacked singly, without cells at their sides.

    Shape (k, 3), m. Two or more cells in a row, each joined to others along one direction only, are
    a stack.
    """
    if all(block.kind != "hex20" for block in mesh.blocks):
        return np.empty((0, 3))
    number, _ = _faces(mesh)
    is_shared = np.bincount(number)[number] > 1
    # Cells that are joined to others along one direction at most: their faces, (6, k), and middles.
    first = 0
    single_faces = []
    middles = []
    for block in mesh.blocks:
        faces = slice(first, first + len(FACES[block.kind]) * len(block))
        first = faces.stop
        if block.kind == "hex20":
            joined = is_shared[faces].reshape(-1, len(block))[_OPPOSITE].any(axis=1)
            single = joined.sum(axis=0) <= 1
            single_faces.append(number[faces].reshape(-1, len(block))[:, single])
            middles.append(mesh.points[block.nodes[single]].mean(axis=1))
    # Of these, cells that share a face with another of them.
    faces_of_single = np.hstack(single_faces)
    times = np.bincount(faces_of_single.ravel(), minlength=int(number.max()) + 1)
    return np.concatenate(middles)[(times[faces_of_single] > 1).any(axis=0)]


def coincident_nodes(mesh: Mesh) -> Array:
    """Return pairs of coincident surface nodes that share no unknowns and do not depend on others.

    Shape (k, 2), int64: indices of nodes.
    """
    surface = outer_surface(mesh.blocks).node_ids
    shortest = min(float(edge_lengths(mesh.points, b).min()) for b in mesh.blocks if len(b))
    tree = KDTree(mesh.points[surface])
    pairs = tree.query_pairs(_COINCIDENT * shortest, output_type="ndarray")
    pairs = np.sort(surface[pairs], axis=1) if len(pairs) else np.empty((0, 2), dtype=np.int64)
    return pairs if mesh.dependents is None else pairs[~mesh.dependents.among(pairs)]


def gap(mesh: Mesh, nodes: Array, others: Array) -> float:
    """Return the least distance, m, between two sets of nodes, each of shape (k,), int64."""
    tree = KDTree(mesh.points[nodes])
    return float(tree.query(mesh.points[others])[0].min())


# Pairs of bodies with unmerged nodes in the warnings; the message counts the others.
_MAX_REPORTED = 5
# Usual ranges. Pa: soft rubber to nearly diamond (1.1e12). kg/m^3: light foam (15) to more than
# osmium (22,600); steel in MPa, GPa or g/cm^3 (7.85) is far below.
_USUAL = {
    "youngs_modulus": (1e6, 1e12, "Pa", "softer than rubber or stiffer than diamond", "MPa or GPa"),
    "density": (10, 3e4, "kg/m^3", "lighter than foam or heavier than osmium", "g/cm^3 or t/mm^3"),
}
# Largest lever over the mesh's diagonal: longer ones are probably millimetres read as metres.
_LONGEST_LEVER = 3.0


# Main nodes of a secondary node that show a coarse side: 30 for cells of one size, 64 to 80 for
# half the size.
_FINER = 60
# Diagonal of a main facet over the tie's size: at 4 the tie lacks over half of its stiffness.
_WIDE = 3.0
# Part of the distance, a hundredth of an edge: the difference of two meshes of a round surface.
_CLOSED = 0.1


def warnings_of(component: ComponentModel) -> list[BundleProblem]:
    """Return all warnings of `fea.check` in its order, and stacks of single cells."""
    mesh = component.uncut_mesh
    bodies, pairs = bodies_of(mesh), coincident_nodes(mesh)
    shape = [BundleProblem("mesh", message) for message in quality_warnings(quality(mesh))]
    problems = shape + coincidence_warnings(mesh, bodies, pairs) + set_up_warnings(component)
    return problems + stack_problems(component)


def set_up_warnings(component: ComponentModel) -> list[BundleProblem]:
    """Return warnings about sections, supports and units of the component."""
    problems = section_warnings(component) + support_warnings(component) + unit_warnings(component)
    problems += tie_warnings(component) + bolt_warnings(component)
    for number, material in enumerate(component.bundle.materials):
        if material.thermal_expansion is not None and component.temperature is None:
            message = "has no effect without [inputs.temperature]; add it, or leave this key out"
            problems.append(BundleProblem(f"material[{number}].thermal_expansion", message))
    return problems


# Strain of a preload: bolts of steel and titanium yield at 0.01 at most, those of nylon at 0.05.
_STRAINED = 0.1
# rad: 5 % of the force pulls across; straight facets of a round shank show 1 degree.
_OBLIQUE = np.radians(3.0)


def bolt_warnings(component: ComponentModel) -> list[BundleProblem]:
    """Return warnings on preloads that are too large for the shank, and on oblique axes."""
    problems = []
    for bolt in component.bolts:
        strength = strength_at(component, bolt)
        stiffest = max(material.youngs_modulus for material in component.materials)
        if (strain := bolt.bolt.force / bolt.area / stiffest) > _STRAINED:
            message = (
                f"is a strain of {strain:.2g} or more in the shank, which no bolt can carry; write "
                "a smaller force, or correct a unit: force is in N, lengths are in the mesh's unit"
            )
            problems.append(BundleProblem(f"{bolt.key}.force", message))
        if strength is not None and bolt.bolt.force > strength * bolt.area:
            message = (
                f"is a mean stress of {bolt.bolt.force / bolt.area:.4g} Pa in the shank, above its "
                f"yield strength of {strength:.4g} Pa; yielding is not modelled, so write a "
                "smaller force"
            )
            problems.append(BundleProblem(f"{bolt.key}.force", message))
        angle, direction = shank_direction(component, bolt)
        if angle > _OBLIQUE:
            axis = (np.round(direction, 4) + 0.0).tolist()
            message = (
                f"is {np.degrees(angle):.2g} degrees off the shank's direction at the cut, so "
                f"{100 * np.sin(angle):.2g} % of the force pulls it sideways; write axis = {axis}, "
                "or move point to where the shank is straight"
            )
            problems.append(BundleProblem(f"{bolt.key}.axis", message))
    return problems


_SIDEWAYS = 0.1
"""Largest area of free facets across a shank's direction, over that of the middle direction: above
it they show no direction. A cone of 20 degrees has 0.06."""


def shank_direction(component: ComponentModel, bolt: BoltCut) -> tuple[float, Array]:
    """Return the angle from a bolt's axis to its shank, rad, and the shank's unit vector, (3,).

    The free facets of a shank at the cut run along it. Without such facets, as at a cone, the angle
    is 0.
    """
    mesh = component.uncut_mesh
    squares = np.zeros((3, 3))
    for kind, nodes in outer_surface(mesh.blocks).blocks:
        x = mesh.points[nodes[np.isin(nodes, bolt.nodes).any(axis=1)][:, TRIANGLES[kind]]]
        normals = np.cross(x[:, :, 1] - x[:, :, 0], x[:, :, 2] - x[:, :, 0]).sum(axis=1)
        squares += normals.T @ (normals / np.linalg.norm(normals, axis=1, keepdims=True))
    sizes, axes = np.linalg.eigh(squares)
    direction = axes[:, 0] * (-1.0 if axes[:, 0] @ bolt.axis < 0 else 1.0)
    if sizes[0] > _SIDEWAYS * sizes[1]:
        direction = bolt.axis
    return float(np.arccos(np.clip(direction @ bolt.axis, -1.0, 1.0))), direction


def strength_at(component: ComponentModel, bolt: BoltCut) -> float | None:
    """Return the least yield strength of the cells at a bolt's cut, Pa; None if unknown."""
    pairs = zip(component.material_of_cells, bolt.cells, strict=True)
    numbers = np.unique(np.concatenate([block[cells] for block, cells in pairs])).tolist()
    strengths = [component.materials[number].yield_strength for number in numbers]
    return min((strength for strength in strengths if strength is not None), default=None)


def stack_problems(component: ComponentModel) -> list[BundleProblem]:
    """Return a problem if hex20 cells of reduced integration are stacked singly.

    A straight stack is a mechanism (hourglass). A curved stack is held by its curvature alone: an
    arch of 40 cells turned 24 times too far and buckled at 4e-5 of its load.
    """
    if component.analysis.integration != "reduced":
        return []
    middles = stacked_singly(component.uncut_mesh)
    if not len(middles):
        return []
    message = (
        f'{len(middles)} hex20 cells with integration = "reduced" form stacks that are one cell '
        f"wide, such as at {point_text(middles[0])} m; these have motions without resistance "
        '(hourglass). Write integration = "full", or mesh two cells across'
    )
    return [BundleProblem("analysis.integration", message)]


def coincidence_warnings(mesh: Mesh, bodies: Bodies, pairs: Array) -> list[BundleProblem]:
    """Return a warning for the unmerged nodes of each two bodies, and of slits within a body.

    mesh, bodies: a mesh, and its connected bodies.
    pairs: shape (k, 2), int64: indices of coincident nodes (`fea.inspection.coincident_nodes`).
    """
    owner = np.zeros(len(mesh.points), dtype=np.int64)
    for number, nodes in enumerate(bodies.nodes):
        owner[nodes] = number
    between = np.sort(owner[pairs], axis=1)
    problems = []
    for first, second in np.unique(between, axis=0)[:_MAX_REPORTED].tolist():
        here = pairs[(between == [first, second]).all(axis=1)]
        where = point_text(mesh.points[here[0, 0]])
        if first == second:
            kind = f"inside part {first + 1}"
        else:
            kind = f"of part {first + 1} and part {second + 1}"
        message = (
            f"{len(here)} pairs of nodes {kind} (one near {where} m) have the same coordinates but "
            "are not joined; if the material is joined there, merge them in the mesher (gmsh: "
            "removeDuplicateNodes)"
        )
        problems.append(BundleProblem("mesh", message))
    return problems


def section_warnings(component: ComponentModel) -> list[BundleProblem]:
    """Return warnings about the positions of the section and the supports."""
    mesh, constrained = component.mesh, component.fixed_nodes
    surface = outer_surface(mesh.blocks).node_ids
    problems = []
    for interface in component.interfaces:
        section = interface.section
        key = f"{interface.key}.section"
        if not section.by_area:
            message = (
                "is a set of nodes that bounds no face, so all nodes have equal weights; for area "
                "weights name a facet group, or all nodes of the face"
            )
            problems.append(BundleProblem(key, message))
        inside = np.setdiff1d(section.node_ids, surface)
        if inside.size:
            message = (
                f"{inside.size} of its nodes, such as the one at "
                f"{point_text(mesh.points[inside[0]])} m, are inside the body; name nodes of its "
                "surface"
            )
            problems.append(BundleProblem(key, message))
        constrained = np.union1d(constrained, section.node_ids)

    rigid_cells = [
        block.nodes[np.isin(block.nodes, constrained).all(axis=1), 0] for block in mesh.blocks
    ]
    corners = np.concatenate(rigid_cells)  # one node of each rigid cell
    if corners.size:
        message = (
            f"{corners.size} cells cannot deform, such as one near "
            f"{point_text(mesh.points[corners[0]])} m, because all their nodes are fixed or in the "
            "section; mesh more cells between section and supports"
        )
        problems.append(BundleProblem("mesh", message))
    return problems


def support_warnings(component: ComponentModel) -> list[BundleProblem]:
    """Return a warning if supports hold single nodes only: the answer depends on the mesh size."""
    surface = outer_surface(component.mesh.blocks)
    nodes = component.supported_nodes
    if not nodes.size:  # a held interface replaces the supports
        return []
    if facets_within(surface, nodes).blocks:
        return []
    message = (
        f"has no complete face (nodes: {len(nodes)}); an elastic body has no finite displacement "
        "at a point load, so the answer depends on the mesh size. Fix the nodes of a face"
    )
    only_fixed = len(nodes) == len(component.fixed_nodes)
    return [BundleProblem("supports.fixed" if only_fixed else "supports", message)]


def tie_warnings(component: ComponentModel) -> list[BundleProblem]:
    """Return warnings about untied nodes, gaps that a tie closes, and a coarse side."""
    problems = []
    dependents = component.mesh.dependents
    for i, tie in enumerate(component.ties):
        texts = []
        loose = f"{tie.untied} secondary nodes are not tied"
        if tie.beyond and tie.untied:
            off = f"facets up to {tie.beyond:.3g} m off are beyond the distance, {tie.distance:.3g}"
            texts.append(f"{off} m: {loose}; write a larger distance if they belong together")
        elif tie.cut and tie.untied:
            ends = f"the main surface ends within {tie.cut} facets, and the tie at their edges"
            texts.append(f"{ends}: {loose}; split the surface there, or swap the two groups")
        elif tie.untied:
            why = "they are held, or the main surface does not cover them"
            texts.append(f"{loose}: {why}; extend the main surface, or hold fewer nodes")
        if tie.within > _WIDE:
            wide = f"a main facet is {tie.within:.2g} times as large as the tie"
            texts.append(f"{wide}, over {_WIDE:g}: mesh the main surface finer there")
        if tie.gap > _CLOSED * tie.distance:
            gap = f"closes gaps of up to {tie.gap:.3g} m by moving nodes"
            texts.append(f"{gap}; write a smaller distance if the gaps are real")
        if dependents is not None and dependents.map[tie.nodes].nnz > _FINER * len(tie.nodes):
            swap = "swap the two groups, which is faster and more exact"
            texts.append(f"the secondary surface is coarser than the main surface: {swap}")
        problems += [BundleProblem(f"tie[{i}]", text) for text in texts]
    return problems


def unit_warnings(component: ComponentModel) -> list[BundleProblem]:
    """Return warnings about numbers that are probably in another unit than SI."""
    problems = []
    for number, material in enumerate(component.materials):
        for key, (low, high, si, kind, unit) in _USUAL.items():
            if (value := getattr(material, key)) is not None and not low <= value <= high:
                text = f"is {value:.4g} {si}, {kind}; if it is in {unit}, convert it to {si}"
                problems.append(BundleProblem(f"material[{number}].{key}", text))

    points = component.mesh.points
    low_corner, high_corner = points.min(axis=0), points.max(axis=0)
    size = float(np.linalg.norm(high_corner - low_corner))
    source = component.bundle.mesh
    geometry = source and source.geometry
    if geometry is not None and geometry.size > size:
        message = (
            f"is {geometry.size:.4g} m, more than the part's size of {size:.4g} m; if the number "
            "is in mm, convert it to m"
        )
        problems.append(BundleProblem("mesh.size", message))
    for interface in component.interfaces:
        away = interface.point - np.clip(interface.point, low_corner, high_corner)
        lever = float(np.linalg.norm(away))
        if lever <= _LONGEST_LEVER * size:
            continue
        message = (
            f"is {lever:.4g} m away from a mesh that is {size:.4g} m large; if the number is in "
            "the mesh's unit, convert it to m"
        )
        problems.append(BundleProblem(f"{interface.key}.point", message))
    return problems
