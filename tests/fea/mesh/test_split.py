"""Uniform refinement of every kind of cell."""

from dataclasses import replace

import numpy as np
import pytest

from tests.fea.boxes import box
from tests.fea.components import component
from wrenchbook.fea.mesh.facets import outer_surface
from wrenchbook.fea.mesh.mesh import NODES_PER_CELL, CellBlock, Mesh
from wrenchbook.fea.mesh.reference_cell import node_coordinates, reference_element
from wrenchbook.fea.mesh.refine import halved
from wrenchbook.fea.solve import Solver


def bent_cell(kind):
    """One cell with all nodes moved, so that its edges are curved, in groups of each sort."""
    places = node_coordinates(kind)
    points = places + 0.04 * np.random.default_rng(0).normal(size=places.shape)
    blocks = (CellBlock(kind, np.arange(len(points))[None]),)
    groups = {"skin": outer_surface(blocks)}
    return Mesh(points, blocks, {"all": (np.array([0]),)}, groups, {"all": np.arange(len(points))})


def volumes(mesh):
    (block,) = mesh.blocks
    element = reference_element(block.kind, "mass")
    maps = np.einsum("pad,cai->cpid", element.slopes, mesh.points[block.nodes])
    return np.linalg.det(maps) @ element.weights


@pytest.mark.parametrize("kind", NODES_PER_CELL)
def test_eight_cells_fill_the_one_they_come_from(kind):
    whole = bent_cell(kind)
    split = halved(whole)
    assert len(split.blocks[0]) == 8
    assert (volumes(split) > 0).all()
    assert volumes(split).sum() == pytest.approx(volumes(whole).sum(), rel=1e-13)


@pytest.mark.parametrize("kind", NODES_PER_CELL)
def test_groups_hold_what_they_held(kind):
    split = halved(halved(bent_cell(kind)))
    skin = outer_surface(split.blocks).node_ids
    np.testing.assert_array_equal(split.facet_groups["skin"].node_ids, skin)
    np.testing.assert_array_equal(split.node_groups["all"], np.arange(len(split.points)))
    assert len(split.regions["all"][0]) == 64


@pytest.mark.parametrize("kind", NODES_PER_CELL)
def test_neighbours_share_the_nodes_between_them(kind):
    mesh = box(kind, (2, 2, 2), (1.0, 1.0, 1.0))
    split = halved(mesh)
    assert len(np.unique(np.round(split.points, 9), axis=0)) == len(split.points)
    corners = outer_surface(split.blocks).node_ids
    inside = np.delete(split.points, corners, axis=0)
    assert ((inside > 0) & (inside < 1)).all()


def test_parts_that_only_touch_stay_apart():
    one = box("hex20", (1, 1, 1), (1.0, 1.0, 1.0))
    nodes = np.concatenate([one.blocks[0].nodes, one.blocks[0].nodes + len(one.points)])
    points = np.vstack([one.points, one.points + np.array([1, 0, 0])])
    both = Mesh(points, (CellBlock("hex20", nodes),))
    assert len(halved(both).points) == 2 * len(halved(one).points)


def test_a_node_group_of_two_faces_does_not_get_what_lies_within():
    mesh = box("hex20", (1, 1, 1), (1.0, 1.0, 1.0))
    ends = np.flatnonzero((mesh.points[:, 0] == 0) | (mesh.points[:, 0] == 1))
    split = halved(replace(mesh, node_groups={"ends": ends}))
    places = split.points[split.node_groups["ends"], 0]
    assert set(places.tolist()) == {0.0, 1.0}
    assert len(places) == 2 * 21  # four quad8 facets at each end


@pytest.mark.parametrize("kind", ["hex20", "hex27", "tet10", "wedge15"])
def test_a_finer_mesh_yields_more_as_it_holds_the_fields_of_the_coarser_one(kind):
    mesh = box(kind, (2, 2, 2), (0.1, 0.1, 0.2))
    own, fine = (component(one, integration="full") for one in (mesh, halved(mesh)))
    more = Solver(fine).linear.compliance - Solver(own).linear.compliance
    assert (np.linalg.eigvalsh(0.5 * (more + more.T)) > 0).all()
