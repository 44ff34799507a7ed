"""Warnings about a component's mesh, sections, supports, ties, bolts and units.

They are those of `fea.check`, and the notes of every solution of the embedded solver. They cost one
pass over the cells and two searches among the nodes of the surface: less than the symbolic analysis
before a solve.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.mesh.bodies import Bodies, bodies_of, coincident_nodes, stacked_singly
from wrenchbook.fea.mesh.bolts import BoltCut
from wrenchbook.fea.mesh.facets import TRIANGLES, facets_within, outer_surface
from wrenchbook.fea.mesh.groups import group_nodes
from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.mesh.quality import quality, quality_warnings
from wrenchbook.fea.spec.problems import BundleProblem, point_text
from wrenchbook.fea.spec.schema import Joint

# Pairs of bodies with unmerged nodes in the warnings; the message counts the others.
_MAX_REPORTED = 5
# Usual ranges. Pa: soft rubber to nearly diamond (1.1e12). kg/m^3: light foam (15) to more than
# osmium (22,600); steel in MPa, GPa or g/cm^3 (7.85) is far below.
_USUAL = {
    "youngs_modulus": (1e6, 1e12, "Pa", "softer than rubber or stiffer than diamond", "MPa or GPa"),
    "density": (10, 3e4, "kg/m^3", "lighter than foam or heavier than osmium", "g/cm^3 or t/mm^3"),
}
# Largest lever over the mesh's diagonal: longer ones are probably millimetres read as metres.
_MAX_LEVER = 3.0
# Main nodes of a secondary node that show a coarse side: 30 for cells of one size, 64 to 80 for
# half the size.
_FINER = 60
# Diagonal of a main facet over the tie's size: at 4 the tie lacks over half of its stiffness.
_WIDE = 3.0
# Part of the distance, a hundredth of an edge: the difference of two meshes of a round surface.
_CLOSED = 0.1
# Strain of a preload: bolts of steel and titanium yield at 0.01 at most, those of nylon at 0.05.
_STRAINED = 0.1
# rad: 5 % of the force pulls across; straight facets of a round shank show 1 degree.
_OBLIQUE = np.radians(3.0)
_SIDEWAYS = 0.1
"""Largest area of free facets across a shank's direction, over that of the middle direction: above
it they show no direction. A cone of 20 degrees has 0.06."""


def warnings_of(component: ComponentModel) -> list[BundleProblem]:
    """Return all warnings of `fea.check` in its order, and stacks of single cells."""
    mesh = component.uncut_mesh
    bodies, pairs = bodies_of(mesh), coincident_nodes(mesh)
    shape = [BundleProblem("mesh", message) for message in quality_warnings(quality(mesh))]
    unmerged = coincidence_warnings(mesh, bodies, pairs, component.bundle.joints)
    return [*shape, *unmerged, *set_up_warnings(component), *stack_problems(component)]


def set_up_warnings(component: ComponentModel) -> Iterator[BundleProblem]:
    """Yield warnings about sections, supports, units, ties and bolts of the component."""
    yield from section_warnings(component)
    yield from support_warnings(component)
    yield from unit_warnings(component)
    yield from tie_warnings(component)
    yield from bolt_warnings(component)
    for number, material in enumerate(component.bundle.materials):
        if material.thermal_expansion is not None and component.temperature is None:
            message = "has no effect without [inputs.temperature]; add it, or leave this key out"
            yield BundleProblem(f"material[{number}].thermal_expansion", message)


def bolt_warnings(component: ComponentModel) -> Iterator[BundleProblem]:
    """Yield warnings on preloads that are too large for the shank, and on oblique axes."""
    for bolt in component.bolts:
        strength = strength_at(component, bolt)
        stiffest = max(material.youngs_modulus for material in component.materials)
        if (strain := bolt.bolt.force / bolt.area / stiffest) > _STRAINED:
            message = (
                f"is a strain of {strain:.2g} or more in the shank, which no bolt can carry; write "
                "a smaller force, or correct a unit: force is in N, lengths are in the mesh's unit"
            )
            yield BundleProblem(f"{bolt.key}.force", message)
        if strength is not None and bolt.bolt.force > strength * bolt.area:
            message = (
                f"is a mean stress of {bolt.bolt.force / bolt.area:.4g} Pa in the shank, above its "
                f"yield strength of {strength:.4g} Pa; yielding is not modelled, so write a "
                "smaller force"
            )
            yield BundleProblem(f"{bolt.key}.force", message)
        angle, direction = shank_direction(component, bolt)
        if angle > _OBLIQUE:
            axis = (np.round(direction, 4) + 0.0).tolist()
            message = (
                f"is {np.degrees(angle):.2g} degrees off the shank's direction at the cut, so "
                f"{100 * np.sin(angle):.2g} % of the force pulls it sideways; write axis = {axis}, "
                "or move point to where the shank is straight"
            )
            yield BundleProblem(f"{bolt.key}.axis", message)


def shank_direction(component: ComponentModel, bolt: BoltCut) -> tuple[float, np.ndarray]:
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


def coincidence_warnings(
    mesh: Mesh, bodies: Bodies, pairs: np.ndarray, joints: Sequence[Joint]
) -> Iterator[BundleProblem]:
    """Yield a warning for the unmerged nodes of each two bodies, and of slits within a body.

    mesh, bodies: a mesh, and its connected bodies.
    pairs: shape (k, 2), int64: indices of coincident nodes (`fea.mesh.bodies.coincident_nodes`).
    joints: of the bundle; nodes of both groups of one need not be merged.
    """
    for joint in joints:
        first, second = (np.isin(pairs, group_nodes(mesh, "", name, [])) for name in joint.groups)
        pairs = pairs[~(first & second[:, ::-1]).any(axis=1)]
    owner = np.zeros(len(mesh.points), dtype=np.int64)
    for number, nodes in enumerate(bodies.nodes):
        owner[nodes] = number
    between = np.sort(owner[pairs], axis=1)
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
        yield BundleProblem("mesh", message)


def section_warnings(component: ComponentModel) -> Iterator[BundleProblem]:
    """Yield warnings about the positions of the section and the supports."""
    mesh, constrained = component.mesh, component.fixed_nodes
    surface = outer_surface(mesh.blocks).node_ids
    for interface in component.interfaces:
        section = interface.section
        key = f"{interface.key}.section"
        if section.area is None:
            message = (
                "is a set of nodes that bounds no face, so all nodes have equal weights; for area "
                "weights name a facet group, or all nodes of the face"
            )
            yield BundleProblem(key, message)
        inside = np.setdiff1d(section.node_ids, surface)
        if inside.size:
            message = (
                f"{inside.size} of its nodes, such as the one at "
                f"{point_text(mesh.points[inside[0]])} m, are inside the body; name nodes of its "
                "surface"
            )
            yield BundleProblem(key, message)
        constrained = np.union1d(constrained, section.node_ids)

    rigid_cells = [
        block.nodes[np.isin(block.nodes, constrained).all(axis=1), 0] for block in mesh.blocks
    ]
    corners = np.concatenate(rigid_cells)  # one node of each rigid cell
    if corners.size:
        cells = sum(len(block.nodes) for block in mesh.blocks)
        message = (
            f"{corners.size} of the {cells} cells cannot deform, such as the one near "
            f"{point_text(mesh.points[corners[0]])} m, because all their nodes are fixed or in the "
            "section; mesh more cells between section and supports"
        )
        yield BundleProblem("mesh", message)


def support_warnings(component: ComponentModel) -> Iterator[BundleProblem]:
    """Yield a warning if supports hold single nodes only: the answer depends on the mesh size."""
    surface = outer_surface(component.mesh.blocks)
    nodes = component.supported_nodes
    if not nodes.size:  # a held interface replaces the supports
        return
    if facets_within(surface, nodes).blocks:
        return
    message = (
        f"has no complete face (nodes: {len(nodes)}); an elastic body has no finite displacement "
        "at a point load, so the answer depends on the mesh size. Fix the nodes of a face"
    )
    only_fixed = len(nodes) == len(component.fixed_nodes)
    yield BundleProblem("supports.fixed" if only_fixed else "supports", message)


def tie_warnings(component: ComponentModel) -> Iterator[BundleProblem]:
    """Yield warnings about untied nodes, gaps that a tie closes, and a coarse side."""
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
        if tie.max_gap > _CLOSED * tie.distance:
            gap = f"closes gaps of up to {tie.max_gap:.3g} m by moving nodes"
            texts.append(f"{gap}; write a smaller distance if the gaps are real")
        if dependents is not None and dependents.map[tie.nodes].nnz > _FINER * len(tie.nodes):
            swap = "swap the two groups, which is faster and more exact"
            texts.append(f"the secondary surface is coarser than the main surface: {swap}")
        yield from (BundleProblem(f"tie[{i}]", text) for text in texts)


def unit_warnings(component: ComponentModel) -> Iterator[BundleProblem]:
    """Yield warnings about numbers that are probably in another unit than SI."""
    for number, material in enumerate(component.materials):
        for key, (low, high, si, kind, unit) in _USUAL.items():
            if (value := getattr(material, key)) is not None and not low <= value <= high:
                text = f"is {value:.4g} {si}, {kind}; if it is in {unit}, convert it to {si}"
                yield BundleProblem(f"material[{number}].{key}", text)

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
        yield BundleProblem("mesh.size", message)
    for interface in component.interfaces:
        away = interface.point - np.clip(interface.point, low_corner, high_corner)
        lever = float(np.linalg.norm(away))
        if lever <= _MAX_LEVER * size:
            continue
        message = (
            f"is {lever:.4g} m away from a mesh that is {size:.4g} m large; if the number is in "
            "the mesh's unit, convert it to m"
        )
        yield BundleProblem(f"{interface.key}.point", message)
