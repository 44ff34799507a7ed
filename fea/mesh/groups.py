"""Groups of a mesh by their names: nodes, and the problems of wrong names and points."""

from __future__ import annotations

import numpy as np

from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.spec.problems import BundleProblem, suggest

CHOOSE = "CHOOSE"  # stands for a group that `wrenchbook new` cannot infer
_NO_FACETS = (
    " (it has none at all: choose facets by [mesh.groups.NAME]; "
    "`wrenchbook check FOLDER --faces` lists the faces with the lines to write)"
)
_NO_CELLS = (
    " (it has none at all: make a cell group in the mesher, or, with a STEP file, "
    "[mesh.regions.NAME])"
)
_MAX_LISTED = 30  # names of groups in a message: about three lines of a terminal


def group_nodes(mesh: Mesh, key: str, name: str, problems: list[BundleProblem]) -> np.ndarray:
    """Return the nodes of a facet group or node group, shape (k,), int64, sorted.

    A missing group is a problem at `key`; then k = 0.
    """
    if name in mesh.facet_groups:
        return mesh.facet_groups[name].node_ids
    if name in mesh.node_groups:
        return np.unique(mesh.node_groups[name])
    problems.append(no_facets(mesh, key, name, or_nodes=True))
    return np.empty(0, dtype=np.int64)


def no_facets(mesh: Mesh, key: str, name: str, *, or_nodes: bool = False) -> BundleProblem:
    """Return the problem of a name that is no facet group, nor a node group with `or_nodes`."""
    if mesh.deck is not None and name in mesh.deck.left_out:
        return BundleProblem(key, f'"{name}" is not there: {mesh.deck.left_out[name]}')
    kind = "facet or node group" if or_nodes else "facet group"
    groups = [*mesh.facet_groups, *(mesh.node_groups if or_nodes else ())]
    for members, named in (("cells", mesh.regions), ("nodes", mesh.node_groups)):
        if name in named:
            message = f'"{name}" is a group of {members}; name a {kind}{_listed(groups)}'
            return BundleProblem(key, message)
    return missing(key, name, kind, groups)


def missing(key: str, name: str, kind: str, groups: list[str]) -> BundleProblem:
    """Return the problem of a missing group, with the nearest name and all names."""
    if name == CHOOSE and groups:
        return BundleProblem(key, f"is open: choose one of {', '.join(groups[:_MAX_LISTED])}")
    listed = _listed(groups, _NO_CELLS if kind == "cell group" else _NO_FACETS)
    return BundleProblem(key, f'the mesh has no {kind} "{name}"{suggest(name, groups)}{listed}')


def near_message(
    point: tuple[float, float, float], kind: str, nearest: list[int], distance: float, size: float
) -> str | None:
    """Return the reason for which a point names no single face or body: too far, or between two."""
    at = ", ".join(f"{x:g}" for x in point)
    if distance > size:
        return f"({at}) m is {distance:.3g} m from the nearest {kind} ({nearest[0]}); correct it"
    if len(nearest) > 1:
        named = ", ".join(map(str, nearest))
        return f"({at}) m lies on the edge between {kind} {named}; move it into one of them"
    return None


def _listed(groups: list[str], if_none: str = _NO_FACETS) -> str:
    """Return the names of groups in brackets, or the way to make one if there is none."""
    if not groups:
        return if_none
    more = f" and {len(groups) - _MAX_LISTED} more" if len(groups) > _MAX_LISTED else ""
    return f" (it has {', '.join(groups[:_MAX_LISTED])}{more})"
