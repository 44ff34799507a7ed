"""The outer surface as triangles."""

import numpy as np
import pytest

from tests.fea.boxes import box
from wrenchbook.fea.mesh.mesh import CellBlock, Mesh
from wrenchbook.fea.mesh.reference_cell import node_coordinates
from wrenchbook.fea.recovery.fields import surface_of

KINDS = ["hex8", "hex20", "hex27", "tet4", "tet10", "wedge6", "wedge15"]
SIDES = (0.2, 0.3, 0.5)


def volume(points, triangles):
    first, second, third = (points[triangles[:, i]] for i in range(3))
    return np.einsum("ij,ij->", first, np.cross(second, third)) / 6


def edges(triangles):
    return np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])


@pytest.mark.parametrize("kind", KINDS)
def test_the_triangles_look_outwards_and_hold_the_volume(kind):
    mesh = box(kind, (2, 3, 2), SIDES)
    found = surface_of(mesh)
    assert volume(mesh.points[found.nodes], found.triangles) == pytest.approx(0.03, rel=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_each_edge_has_one_triangle_on_each_side(kind):
    triangles = surface_of(box(kind, (2, 3, 2), SIDES)).triangles
    forward, times = np.unique(edges(triangles), axis=0, return_counts=True)
    assert (times == 1).all()
    assert {tuple(e) for e in forward.tolist()} == {tuple(e[::-1]) for e in forward.tolist()}


def test_midside_nodes_are_vertices():
    mesh = Mesh(node_coordinates("hex20"), (CellBlock("hex20", np.arange(20)[None]),))
    found = surface_of(mesh)
    assert found.nodes.tolist() == list(range(20))
    assert len(found.triangles) == 6 * 6


def test_a_node_within_is_no_vertex():
    mesh = box("hex8", (3, 3, 3))
    found = surface_of(mesh)
    assert (len(mesh.points), len(found.nodes), found.full_count) == (64, 56, 56)


def test_a_large_surface_is_simplified_and_says_so():
    mesh = box("hex20", (12, 12, 12), SIDES)
    whole, found = surface_of(mesh), surface_of(mesh, max_vertices=500)
    assert found.full_count == len(whole.nodes) > 2000
    assert 200 < len(found.nodes) <= 500
    assert set(found.nodes.tolist()) <= set(whole.nodes.tolist())
    points = mesh.points[found.nodes]
    assert volume(points, found.triangles) == pytest.approx(0.03, rel=0.25)
    assert (found.triangles.max(), found.triangles.min()) == (len(found.nodes) - 1, 0)
    corners = np.sort(found.triangles, axis=1)
    assert len(np.unique(corners, axis=0)) == len(corners)
    assert (np.diff(corners, axis=1) > 0).all()


def test_a_thin_plate_that_is_simplified_keeps_both_faces():
    mesh = box("hex8", (40, 40, 1), (0.4, 0.4, 0.004))
    found = surface_of(mesh, max_vertices=500)
    points = mesh.points[found.nodes]
    assert len(points) <= 500
    assert np.unique(points[:, 2]).tolist() == [0.0, 0.004]
    assert volume(points, found.triangles) == pytest.approx(0.4 * 0.4 * 0.004, rel=0.1)
