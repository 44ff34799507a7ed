"""Nodes of the groups that a bundle names, and the problems of names that are not there."""

from __future__ import annotations

import numpy as np

from wrenchbook.fea.mesh.mesh import Mesh
from wrenchbook.fea.spec.problems import BundleProblem, suggest

Array = np.ndarray


def group_nodes(mesh: Mesh, key: str, name: str, problems: list[BundleProblem]) -> Array:
    """Return the nodes of a facet group or node group, shape (k,), int64, sorted.

    It is a problem at `key` if there is none; then k = 0.
    """
    if name in mesh.facet_groups:
        return mesh.facet_groups[name].node_ids
    if name in mesh.node_groups:
        return np.unique(mesh.node_groups[name])
    groups = [*mesh.facet_groups, *mesh.node_groups]
    if name in mesh.regions:
        message = f'"{name}" is a group of cells; name a group of facets or nodes{_listed(groups)}'
        problems.append(BundleProblem(key, message))
    else:
        problems.append(missing(key, name, "facet or node group", groups))
    return np.empty(0, dtype=np.int64)


def missing(key: str, name: str, kind: str, groups: list[str]) -> BundleProblem:
    """Return the problem of a group that is not there, with the nearest and all that are."""
    message = f'the mesh has no {kind} "{name}"{suggest(name, groups)}{_listed(groups)}'
    return BundleProblem(key, message)


def _listed(groups: list[str]) -> str:
    return f" (it has {', '.join(groups)})" if groups else " (it has none at all)"
