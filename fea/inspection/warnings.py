"""Warnings of what may make an answer wrong, from the component alone: nothing is solved.

These are the warnings of `fea.check`, and the notes of every solution of the embedded solver, so
that they reach every caller. They cost one pass over the cells and two searches among the nodes of
the surface: less than the symbolic analysis before a solve.
"""

from __future__ import annotations

import numpy as np

from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.inspection.bodies import (
    Bodies,
    bodies_of,
    coincident_nodes,
    stacked_singly,
)
from wrenchbook.fea.inspection.cells import quality, quality_warnings
from wrenchbook.fea.mesh.facets import facets_within, outer_surface
from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.spec.problems import BundleProblem

Array = np.ndarray

_MOST_REPORTED = 5
# Pa. From soft rubber to nearly diamond (1.1e12); steel written in MPa or GPa is far below.
_USUAL_YOUNGS_MODULUS = (1e6, 1e12)
# Of the mesh's diagonal. Longer levers than this are millimetres written where metres belong.
_LONGEST_LEVER = 3.0


def warnings_of(component: ComponentModel) -> list[BundleProblem]:
    """Return all that `fea.check` would warn of, in its order, and stacks of single cells."""
    mesh = component.mesh
    bodies, pairs = bodies_of(mesh), coincident_nodes(mesh)
    shape = [BundleProblem("mesh", message) for message in quality_warnings(quality(mesh))]
    problems = shape + coincidence_warnings(mesh, bodies, pairs) + set_up_warnings(component)
    return problems + stack_problems(component)


def set_up_warnings(component: ComponentModel) -> list[BundleProblem]:
    """Return warnings on what the bundle attaches to the mesh: sections, supports and units."""
    problems = place_warnings(component) + support_warnings(component) + unit_warnings(component)
    for number, material in enumerate(component.bundle.materials if component.bundle else ()):
        if material.thermal_expansion is not None and component.temperature is None:
            message = "counts for nothing without [inputs.temperature]"
            problems.append(BundleProblem(f"material[{number}].thermal_expansion", message))
    return problems


def stack_problems(component: ComponentModel) -> list[BundleProblem]:
    """Return a problem if hex20 cells of reduced integration follow each other singly.

    Such a stack is a mechanism (hourglass) where it is straight. A curved one is held by its
    curvature alone: an arch of 40 cells turned 24 times too far and buckled at 4e-5 of its load.
    """
    if component.analysis.integration != "reduced":
        return []
    middles = stacked_singly(component.mesh)
    if not len(middles):
        return []
    message = (
        f'{len(middles)} hex20 cells of integration = "reduced" follow each other singly, such as '
        f"the one at {place_in_words(middles[0])} m: such a stack has motions without resistance "
        '(hourglass). Write integration = "full", or mesh two cells across'
    )
    return [BundleProblem("analysis.integration", message)]


def coincidence_warnings(mesh: Mesh, bodies: Bodies, pairs: Array) -> list[BundleProblem]:
    """Return a warning for the unmerged nodes of each two bodies, and of slits within one.

    mesh, bodies: a mesh, and what it falls into.
    pairs: shape (k, 2), int64: indices of nodes in one place
    (`fea.inspection.bodies.coincident_nodes`).
    """
    owner = np.zeros(len(mesh.points), dtype=np.int64)
    for number, nodes in enumerate(bodies.nodes):
        owner[nodes] = number
    between = np.sort(owner[pairs], axis=1)
    problems = []
    for first, second in np.unique(between, axis=0)[:_MOST_REPORTED].tolist():
        here = pairs[(between == [first, second]).all(axis=1)]
        where = place_in_words(mesh.points[here[0, 0]])
        if first == second:
            what = f"inside part {first + 1}, which makes a slit there"
        else:
            what = f"of part {first + 1} and part {second + 1}, which touch without being joined"
        message = (
            f"{len(here)} pairs of nodes {what} (one near {where} m): each pair is in one place "
            "but not one node; merge them in the mesher (gmsh: Coherence Mesh or "
            "removeDuplicateNodes; Abaqus: merge nodes) if the material is to hold together there"
        )
        problems.append(BundleProblem("mesh", message))
    return problems


def place_warnings(component: ComponentModel) -> list[BundleProblem]:
    """Return warnings on where the section and the supports are."""
    mesh, constrained = component.mesh, component.fixed_nodes
    surface = outer_surface(mesh.blocks).node_ids
    problems = []
    for interface in component.interfaces:
        section, key = interface.section, f"{interface.key}.section"
        if not section.by_area:
            message = (
                "is a bare set of nodes that bounds no face, so every node counts the same; name "
                "a facet group, or all nodes of the face, for area weights"
            )
            problems.append(BundleProblem(key, message))
        inside = np.setdiff1d(section.node_ids, surface)
        if inside.size:
            message = f"{inside.size} of its nodes are inside the body, not on its surface"
            problems.append(BundleProblem(key, message))
        constrained = np.union1d(constrained, section.node_ids)
    between = sum(int(np.isin(block.nodes, constrained).all(axis=1).sum()) for block in mesh.blocks)
    if between:
        message = (
            f"{between} cells have every node fixed or in the section, so they do not deform; "
            "mesh more cells between section and supports"
        )
        problems.append(BundleProblem("mesh", message))
    return problems


def support_warnings(component: ComponentModel) -> list[BundleProblem]:
    """Return a warning if the supports hold single nodes only, which answer to mesh size."""
    surface, nodes = outer_surface(component.mesh.blocks), component.supported_nodes
    if not nodes.size:  # an interface is held in their place
        return []
    if facets_within(surface, nodes).blocks:
        return []
    message = (
        f"holds {len(nodes)} nodes and no whole face: elastic bodies give way "
        "without limit at points, so the answer depends on the mesh size; fix faces"
    )
    only_fixed = len(nodes) == len(component.fixed_nodes)
    return [BundleProblem("supports.fixed" if only_fixed else "supports", message)]


def unit_warnings(component: ComponentModel) -> list[BundleProblem]:
    """Return warnings on numbers that are rather written in another unit than SI."""
    problems = []
    low, high = _USUAL_YOUNGS_MODULUS
    for number, material in enumerate(component.materials):
        if not low <= material.youngs_modulus <= high:
            message = (
                f"is {material.youngs_modulus:.4g} Pa, softer than rubber or stiffer than "
                "diamond; if it was meant in MPa or GPa, write it in Pa"
            )
            problems.append(BundleProblem(f"material[{number}].youngs_modulus", message))
    points = component.mesh.points
    low_corner, high_corner = points.min(axis=0), points.max(axis=0)
    size = float(np.linalg.norm(high_corner - low_corner))
    source = component.bundle.mesh if component.bundle else None
    geometry = source.geometry if source else None
    if geometry is not None and geometry.size > size:
        message = (
            f"is {geometry.size:.4g} m, more than the part's {size:.4g} m; if it was meant in mm, "
            "write it in m"
        )
        problems.append(BundleProblem("mesh.size", message))
    for interface in component.interfaces:
        away = interface.point - np.clip(interface.point, low_corner, high_corner)
        lever = float(np.linalg.norm(away))
        if lever <= _LONGEST_LEVER * size:
            continue
        message = (
            f"is {lever:.4g} m away from a mesh {size:.4g} m large; if it was meant in the "
            "mesh's unit, write it in m"
        )
        problems.append(BundleProblem(f"{interface.key}.point", message))
    return problems


def place_in_words(place: Array) -> str:
    """Write a place, shape (3,), in m, to four digits."""
    return "(" + ", ".join(f"{x:.4g}" for x in place) + ")"
