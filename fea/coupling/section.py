"""The nodes of a section and the area each of them stands for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wrenchbook.fea.element.mapping import area_weights
from wrenchbook.fea.mesh.mesh import FacetGroup

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class InterfaceSection:
    """The interface's nodes with area weights."""

    node_ids: Array  # sorted, shape (s,), int64
    # Shape (s,), m^2: the integral of each node's shape function over the section. Those of the
    # corners of quad8 facets are negative, as they must be for a constant traction.
    weights: Array
    area: float  # the sum of the weights, m^2
    centre: Array  # the area centre, shape (3,), m
    # False where a bare node group left nothing to integrate over: then every node has the same
    # weight, their sum is 1, and `area` says nothing.
    by_area: bool


def section_of_facets(
    points: Array, group: FacetGroup, node_ids: Array | None = None
) -> InterfaceSection:
    """Return the section that the facets of `group` make.

    points: shape (n, 3), m.
    group: at least one facet.
    node_ids: the section's nodes if it has more than the facets do; the others get no weight.
    """
    covered, areas = area_weights(points, group)
    ids = covered if node_ids is None else np.unique(node_ids)
    weights = np.zeros(len(ids))
    weights[np.searchsorted(ids, covered)] = areas
    area = float(areas.sum())
    # Isoparametric facets: the integral of x is the weighted sum of the nodes' places.
    centre = areas @ points[covered] / area
    return InterfaceSection(ids, weights, area, centre, by_area=True)


def section_of_nodes(points: Array, node_ids: Array) -> InterfaceSection:
    """Return the section of nodes that bound no facet: each counts the same.

    points: shape (n, 3), m.
    node_ids: shape (k,), int64; in any order, twice if so.
    """
    ids = np.unique(node_ids)
    weights = np.full(len(ids), 1.0 / len(ids))
    return InterfaceSection(ids, weights, 1.0, points[ids].mean(axis=0), by_area=False)
