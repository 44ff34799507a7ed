"""Orthotropic directions about the axis of a cylinder."""

from dataclasses import replace

import numpy as np
import pytest

from tests.fea.supports import TABLE
from tests.validation.materials import CENTRE, TURN, WOUND, orthotropic_beam, wound_tube
from wrenchbook.fea.bundle.read import bundle_of
from wrenchbook.fea.solve import Solver
from wrenchbook.fea.spec.material import Cylinder
from wrenchbook.fea.spec.problems import BundleError

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
    found = WOUND.directions(np.array(CENTRE))
    np.testing.assert_allclose(found @ found.T, np.eye(3), atol=1e-14)


def test_an_axis_far_away_has_the_directions_of_a_plane():
    beam = orthotropic_beam("hex20")
    own = beam.materials[0].orthotropic
    far = np.array(own.axes[0]) * -1e7
    cylinder = Cylinder(tuple(far.tolist()), tuple(own.axes[2].tolist()))
    curved = replace(own, axes=np.eye(3), cylinder=cylinder)
    found = Solver(replace(beam, materials=(curved,))).compliance
    expected = Solver(beam).compliance
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-7 * np.abs(expected).max())


def test_a_tube_of_many_blocks_with_axes_of_their_own_comes_near():
    one = wound_tube((1, 24, 5))
    (nodes,) = (block.nodes for block in one.mesh.blocks)
    directions = WOUND.directions(one.mesh.points[nodes].mean(axis=1))
    flat = [replace(WOUND, cylinder=None, axes=own) for own in directions]
    blocks = replace(one, materials=tuple(flat), material_of_cells=(np.arange(len(nodes)),))
    found, expected = Solver(one).compliance, Solver(blocks).compliance
    np.testing.assert_allclose(np.diag(found), np.diag(expected), rtol=5e-3)


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
            "leave it or cylinder out",
        ),
    ],
)
def test_what_is_no_cylinder_is_refused_by_name(tmp_path, wrong, words):
    with pytest.raises(BundleError, match=words):
        bundle(tmp_path, **wrong)
