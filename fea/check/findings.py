"""What is wrong with a mesh and its supports, in an FEA engineer's words."""

from __future__ import annotations

from typing import Any

import numpy as np

from wrenchbook.fea.check.motions import describe, free_motions, middle, simplest, size_of
from wrenchbook.fea.component import ComponentModel
from wrenchbook.fea.inspection.bodies import Bodies, gap
from wrenchbook.fea.inspection.warnings import place_in_words
from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.spec.problems import BundleProblem

Array = np.ndarray

_MOST_BODIES = 40
_MOST_REPORTED = 5


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


def motion_problems(component: ComponentModel, bodies: Bodies, pairs: Array) -> list[BundleProblem]:
    """Return a problem for each body that supports and coupling do not hold.

    Parameters
    ----------
    component, bodies
        What is looked at, and the bodies it falls into.
    pairs
        Shape (k, 2), int64: indices of nodes in one place
        (`fea.inspection.bodies.coincident_nodes`).
    """
    if bodies.count > _MOST_BODIES:
        message = (
            f"falls into {bodies.count} parts that share no face with each other; merge the nodes "
            "in the mesher before exporting"
        )
        return [BundleProblem("mesh", message)]
    motions = free_motions(component, bodies)
    loose = [number for number, own in enumerate(motions) if len(own)]
    if not loose:
        return []
    if bodies.count == 1:
        return [_too_few_supports(component, motions[0])]
    problems = [_free_part(component, bodies, n, motions[n], pairs) for n in loose[:_MOST_REPORTED]]
    if len(loose) > _MOST_REPORTED:
        problems.append(BundleProblem("mesh", f"{len(loose) - _MOST_REPORTED} more parts are free"))
    return problems


def _too_few_supports(component: ComponentModel, motions: Array) -> BundleProblem:
    words = f"the part is a mechanism, {_motions_in_words(component, motions)}"
    if len(component.sliding[0]) or component.bushings:
        return BundleProblem("supports", f"{words}; hold these as well")
    message = f"{words}; fix at least three points that are not on one line"
    return BundleProblem("supports.fixed", message)


def _free_part(
    component: ComponentModel, bodies: Bodies, number: int, motions: Array, pairs: Array
) -> BundleProblem:
    mesh, nodes = component.mesh, bodies.nodes[number]
    size = " x ".join(f"{1e3 * x:.4g}" for x in np.ptp(mesh.points[nodes], axis=0))
    message = (
        f"part {number + 1} of {bodies.count} ({bodies.cells[number]} cells, {size} mm, middle at "
        f"{place_in_words(middle(mesh.points[nodes]))} m) is free: "
        f"{_motions_in_words(component, motions)}. {_neighbour(mesh, bodies, number, pairs)}"
    )
    return BundleProblem("mesh", message)


def _motions_in_words(component: ComponentModel, motions: Array) -> str:
    if len(motions) == 6:
        return "it can move in all six ways, nothing holds it"
    points = component.mesh.points
    told = [describe(one, middle(points), size_of(points)) for one in simplest(motions)]
    if len(told) == 1:
        return f"it can {told[0]}"
    return f"{len(told)} of its six rigid motions meet no resistance: {', '.join(told)}"


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
