"""Reference elements: scikit-fem's shape functions in VTK node order, and quadrature."""

import numpy as np
import pytest

from tests.fea.boxes import box
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.mesh.mapping import area_weights, cell_gradients
from wrenchbook.fea.mesh.mesh import NODES_PER_CELL, NODES_PER_FACET
from wrenchbook.fea.mesh.reference_cell import node_coordinates, reference_element

ALL = [*NODES_PER_CELL, *NODES_PER_FACET]
CELLS = list(NODES_PER_CELL)


@pytest.mark.parametrize("kind", ALL)
def test_every_affine_field_is_reproduced_with_its_gradient(kind):
    element = reference_element(kind)
    places = node_coordinates(kind)
    field = places @ [2.0, -3.0, 5.0][: places.shape[1]] + 7.0
    gradient = np.einsum("qad,a->qd", element.slopes, field)
    np.testing.assert_allclose(gradient, [[2.0, -3.0, 5.0][: places.shape[1]]] * len(gradient))
    np.testing.assert_allclose(element.values.sum(axis=1), 1.0)


@pytest.mark.parametrize("kind", ["hex20", "hex27", "tet10", "wedge15", "quad8", "quad9", "tri6"])
def test_second_order_kinds_reproduce_every_quadratic_field(kind):
    element, places = reference_element(kind), node_coordinates(kind)
    points = element.values @ places
    for i in range(places.shape[1]):
        for j in range(i, places.shape[1]):
            field = places[:, i] * places[:, j]
            np.testing.assert_allclose(
                element.values @ field, points[:, i] * points[:, j], atol=1e-14
            )


@pytest.mark.parametrize("kind", ALL)
def test_the_weights_sum_to_the_reference_volume(kind):
    volume = {"hex": 1, "tet": 1 / 6, "wed": 1 / 2, "qua": 1, "tri": 1 / 2}[kind[:3]]
    element = reference_element(kind)
    assert element.weights.sum() == pytest.approx(volume, rel=1e-13)
    assert (element.weights > 0).all()


def test_hex20_has_eight_points_reduced_and_twenty_seven_full():
    assert len(reference_element("hex20", "reduced").weights) == 8
    assert len(reference_element("hex20", "full").weights) == 27


@pytest.mark.parametrize("kind", CELLS)
def test_cells_fill_the_volume_they_mesh_and_facets_its_surface(kind):
    mesh = box(kind, (2, 3, 2), (2.0, 3.0, 4.0))
    gradients = cell_gradients(mesh.points, mesh.blocks[0], "full")
    assert gradients.weights.sum() == pytest.approx(24.0, rel=1e-13)
    areas = [area_weights(mesh.points, group)[1].sum() for group in mesh.facet_groups.values()]
    np.testing.assert_allclose(areas, [12, 12, 8, 8, 6, 6], rtol=1e-13)


def test_a_corner_of_an_eight_node_facet_stands_for_a_negative_area():
    mesh = box("hex20", (1, 1, 1))
    _, weights = area_weights(mesh.points, mesh.facet_groups["z1"])
    np.testing.assert_allclose(np.sort(weights), [-1 / 12] * 4 + [1 / 3] * 4)


def test_a_cell_turned_inside_out_is_named():
    mesh = box("hex8", (2, 1, 1))
    mesh.blocks[0].nodes[1] = mesh.blocks[0].nodes[1][[4, 5, 6, 7, 0, 1, 2, 3]]
    with pytest.raises(SolveFailed, match=r"1 of 2 hex8 cells .* \(cell numbers 1\)") as caught:
        cell_gradients(mesh.points, mesh.blocks[0], "full")
    assert caught.value.kind == "inverted_elements"
