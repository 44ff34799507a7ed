"""What is wrong with a mesh and its supports, in an FEA engineer's words."""

from __future__ import annotations

from typing import Any

import numpy as np

from fea.check.bodies import Bodies, gap
from fea.check.motions import describe, free_motions, middle, size_of
from fea.component import Component
from fea.mesh.facets import facets_within, outer_surface
from fea.mesh.mesh import Mesh
from fea.spec.problems import Problem

Array = np.ndarray

_MOST_BODIES = 40
_MOST_TOLD = 5


def parts(mesh: Mesh, bodies: Bodies) -> list[dict[str, Any]]:
    """Return number, cells, size (m) and middle (m) of the largest bodies."""
    return [
        {
            "part": number + 1,
            "cells": int(bodies.cells[number]),
            "size": np.ptp(mesh.points[bodies.nodes[number]], axis=0).tolist(),
            "middle": middle(mesh.points[bodies.nodes[number]]).tolist(),
        }
        for number in range(min(bodies.count, _MOST_BODIES))
    ]


def coincidence_warnings(mesh: Mesh, bodies: Bodies, pairs: Array) -> list[Problem]:
    """Return a warning for the unmerged nodes of each two bodies, and of slits within one."""
    owner = np.zeros(len(mesh.points), dtype=np.int64)
    for number, nodes in enumerate(bodies.nodes):
        owner[nodes] = number
    between = np.sort(owner[pairs], axis=1)
    told = []
    for first, second in np.unique(between, axis=0)[:_MOST_TOLD].tolist():
        here = pairs[(between == [first, second]).all(axis=1)]
        where = _place(mesh.points[here[0, 0]])
        if first == second:
            what = f"inside part {first + 1}, which makes a slit there"
        else:
            what = f"of part {first + 1} and part {second + 1}, which touch without being joined"
        message = (
            f"{len(here)} pairs of nodes {what} (one near {where} m): each pair is in one place "
            "but not one node; merge them in the mesher (gmsh: Coherence Mesh or "
            "removeDuplicateNodes; Abaqus: merge nodes) if the material is to hold together there"
        )
        told.append(Problem("mesh", message))
    return told


def motion_problems(component: Component, bodies: Bodies, pairs: Array) -> list[Problem]:
    """Return a problem for each body that supports and coupling do not hold."""
    if bodies.count > _MOST_BODIES:
        message = (
            f"falls into {bodies.count} parts that share no face with each other; merge the nodes "
            "in the mesher before exporting"
        )
        return [Problem("mesh", message)]
    motions = free_motions(component, bodies)
    loose = [number for number, own in enumerate(motions) if len(own)]
    if not loose:
        return []
    if bodies.count == 1:
        return [_too_few_supports(component, motions[0])]
    told = [_free_part(component, bodies, n, motions[n], pairs) for n in loose[:_MOST_TOLD]]
    if len(loose) > _MOST_TOLD:
        told.append(Problem("mesh", f"{len(loose) - _MOST_TOLD} more parts are free"))
    return told


def _too_few_supports(component: Component, motions: Array) -> Problem:
    message = (
        f"the part is a mechanism, {_motions_in_words(component, motions)}; fix at least three "
        "points that are not on one line"
    )
    return Problem("supports.fixed", message)


def _free_part(
    component: Component, bodies: Bodies, number: int, motions: Array, pairs: Array
) -> Problem:
    mesh, nodes = component.mesh, bodies.nodes[number]
    size = " x ".join(f"{1e3 * x:.4g}" for x in np.ptp(mesh.points[nodes], axis=0))
    message = (
        f"part {number + 1} of {bodies.count} ({bodies.cells[number]} cells, {size} mm, middle at "
        f"{_place(middle(mesh.points[nodes]))} m) is free: "
        f"{_motions_in_words(component, motions)}. {_neighbour(mesh, bodies, number, pairs)}"
    )
    return Problem("mesh", message)


def _motions_in_words(component: Component, motions: Array) -> str:
    if len(motions) == 6:
        return "it can move in all six ways, nothing holds it"
    points = component.mesh.points
    if len(motions) == 1:
        return f"it can {describe(motions[0], middle(points), size_of(points))}"
    return f"{len(motions)} of its six rigid motions meet no resistance"


def _neighbour(mesh: Mesh, bodies: Bodies, number: int, pairs: Array) -> str:
    """Say how a free body lies to the others: apart, on shared nodes, or on coincident ones."""
    own = bodies.nodes[number]
    others = [n for n in range(bodies.count) if n != number]
    shared = {n: len(np.intersect1d(own, bodies.nodes[n])) for n in others}
    joined = max(shared, key=lambda n: shared[n])
    if shared[joined]:
        return (
            f"It hangs on part {joined + 1} by {shared[joined]} nodes on one line or point only: "
            "a hinge; join them by whole faces"
        )
    mine = np.isin(pairs, own)
    twins = int((mine[:, 0] != mine[:, 1]).sum())
    if twins:
        return f"It has {twins} nodes in the places of another part's nodes: merge them"
    gaps = {n: gap(mesh, own, bodies.nodes[n]) for n in others}
    nearest = min(gaps, key=lambda n: gaps[n])
    return (
        f"The nearest is part {nearest + 1}, {1e3 * gaps[nearest]:.3g} mm away and without a "
        "common node: mesh them as one, leave the part out or fix it"
    )


def place_warnings(component: Component) -> list[Problem]:
    """Return warnings on where the section and the supports are."""
    mesh, section = component.mesh, component.section
    told = []
    if not section.by_area:
        message = (
            "is a bare set of nodes that bounds no face, so every node counts the same; name a "
            "facet group, or all nodes of the face, for area weights"
        )
        told.append(Problem("interface.section", message))
    surface = outer_surface(mesh.blocks).node_ids
    inside = np.setdiff1d(section.node_ids, surface)
    if inside.size:
        message = f"{inside.size} of its nodes are inside the body, not on its surface"
        told.append(Problem("interface.section", message))
    held = np.union1d(component.fixed_nodes, section.node_ids)
    between = sum(int(np.isin(block.nodes, held).all(axis=1).sum()) for block in mesh.blocks)
    if between:
        message = (
            f"{between} cells have every node fixed or in the section, so they do not deform; "
            "mesh more cells between section and supports"
        )
        told.append(Problem("mesh", message))
    return told


def support_areas(component: Component) -> list[Problem]:
    """Return a warning if the supports hold single nodes only, which answer to mesh size."""
    surface = outer_surface(component.mesh.blocks)
    if facets_within(surface, component.fixed_nodes).blocks:
        return []
    message = (
        f"holds {len(component.fixed_nodes)} nodes and no whole face: elastic bodies give way "
        "without limit at points, so the answer depends on the mesh size; fix faces"
    )
    return [Problem("supports.fixed", message)]


def _place(place: Array) -> str:
    return "(" + ", ".join(f"{x:.4g}" for x in place) + ")"
