"""Reference elements: scikit-fem's shape functions in VTK node order, and quadrature."""

from dataclasses import replace

import numpy as np
import pytest

from tests.fea.boxes import box
from tests.fea.supports import TABLE
from tests.validation.materials import CENTRE, TURN, WOUND, orthotropic_beam, wound_tube
from wrenchbook.fea.bundle.read import bundle_of
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.mesh.mapping import area_weights, cell_gradients
from wrenchbook.fea.mesh.mesh import NODES_PER_CELL, NODES_PER_FACET
from wrenchbook.fea.mesh.reference_cell import node_coordinates, reference_element
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.material import Cylinder
from wrenchbook.fea.spec.problems import BundleError

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


@pytest.mark.parametrize(
    "kind", ["hex20", "hex27", "tet10", "wedge15", "pyramid13", "quad8", "quad9", "tri6"]
)
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
    volume = {"hex": 1, "tet": 1 / 6, "wed": 1 / 2, "qua": 1, "tri": 1 / 2, "pyr": 1 / 3}[kind[:3]]
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


LAMINA = {
    "region": "all",
    "law": "orthotropic",
    "youngs_modulus": [9e9, 135e9, 10e9],
    "poisson_ratio": [0.02, 0.4, 0.3],
    "shear_modulus": [5e9, 3.2e9, 4.8e9],
}


def bundle(folder, **material):
    table = TABLE | {
        "supports": {"fixed": ["z0"]},
        "material": [LAMINA | material],
        "interface": {"section": "z1", "coupling": "rigid"},
        "analysis": {"nonlinear": False},
    }
    return bundle_of(table, folder)


def test_the_directions_are_radial_circumferential_and_axial():
    angle = np.radians(35.0)
    place = np.array(CENTRE) + TURN @ [2 * np.cos(angle), 2 * np.sin(angle), 5.0]
    expected = [
        TURN @ [np.cos(angle), np.sin(angle), 0],
        TURN @ [-np.sin(angle), np.cos(angle), 0],
        TURN[:, 2],
    ]
    np.testing.assert_allclose(WOUND.directions(place), expected, atol=1e-14)


def test_on_the_axis_the_directions_are_still_square_to_each_other():
    result = WOUND.directions(np.array(CENTRE))
    np.testing.assert_allclose(result @ result.T, np.eye(3), atol=1e-14)


def test_an_axis_far_away_has_the_directions_of_a_plane():
    beam = orthotropic_beam("hex20")
    own = beam.materials[0].orthotropic
    far = np.array(own.axes[0]) * -1e7
    cylinder = Cylinder(tuple(far.tolist()), tuple(own.axes[2].tolist()))
    curved = replace(own, axes=np.eye(3), cylinder=cylinder)
    result = Solver(replace(beam, materials=(curved,))).compliance
    expected = Solver(beam).compliance
    np.testing.assert_allclose(result, expected, rtol=1e-6, atol=1e-7 * np.abs(expected).max())


def test_a_tube_of_many_blocks_with_axes_of_their_own_comes_near():
    one = wound_tube((1, 24, 5))
    (nodes,) = (block.nodes for block in one.mesh.blocks)
    directions = WOUND.directions(one.mesh.points[nodes].mean(axis=1))
    flat = [replace(WOUND, cylinder=None, axes=own) for own in directions]
    blocks = replace(one, materials=tuple(flat), material_of_cells=(np.arange(len(nodes)),))
    result, expected = Solver(one).compliance, Solver(blocks).compliance
    np.testing.assert_allclose(np.diag(result), np.diag(expected), rtol=5e-3)


def test_a_bundle_gives_the_point_and_the_direction_of_the_axis(tmp_path):
    (material,) = bundle(tmp_path, cylinder={"point": [1, 2, 3], "axis": [0, 0, 2]}).materials
    assert (material.cylinder.point, material.cylinder.axis) == ((1.0, 2.0, 3.0), (0.0, 0.0, 1.0))


def test_a_cylinder_makes_another_setup_and_none_the_one_of_before(tmp_path):
    plain = bundle(tmp_path)
    wound = bundle(tmp_path, cylinder={"point": [0, 0, 0], "axis": [0, 0, 1]})
    assert plain.fingerprint != wound.fingerprint


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"cylinder": {"point": [0, 0, 0], "axis": [0, 0, 0]}}, "must be a direction"),
        ({"cylinder": {"point": [0, 0, 0]}}, "axis"),
        (
            {
                "cylinder": {"point": [0, 0, 0], "axis": [0, 0, 1]},
                "axes": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
            },
            "leave one of the two out",
        ),
    ],
)
def test_what_is_no_cylinder_is_refused_by_name(tmp_path, wrong, words):
    with pytest.raises(BundleError, match=words):
        bundle(tmp_path, **wrong)
