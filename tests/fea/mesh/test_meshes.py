"""The generated meshes: right-side-out cells, no node twice, the areas and volumes of the part."""

from dataclasses import replace

import numpy as np
import pytest

from wrenchbook.fea.bundle.read import read_bundle
from wrenchbook.fea.bundle.shipped import SHIPPED
from wrenchbook.fea.coupling.section import section_of_facets
from wrenchbook.fea.mesh.facets import outer_surface
from wrenchbook.fea.mesh.generators import Bar, Plate, Spring, disc, equal_area_factor
from wrenchbook.fea.mesh.mesh import FacetBlock, FacetGroup
from wrenchbook.fea.mesh.refine import refined

WIRE, COIL, HEIGHT, TURNS = 1.4e-3, 22.6e-3, 88e-3, 5.5
WIRE_LENGTH = 400.2926730568362e-3  # ../shared/reference/spring.json

MESHES = {
    "bar": Bar(1.0, 0.02, 0.03).mesh(),
    "plate": Plate(0.4, 0.5, 0.01, 0.12).mesh(),
    "thin plate": Plate(0.4, 0.4, 0.004, 0.12, cells=3, rings=2, corner_cells=2, layers=1).mesh(),
    "plainest plate": Plate(1.0, 1.0, 0.1, 0.5, cells=2, rings=1, layers=1).mesh(),
    "spring": Spring(WIRE, COIL, HEIGHT, TURNS, cells_per_turn=12, core=2).mesh(),
    "coarse spring": Spring(WIRE, COIL, HEIGHT, 2.25, cells_per_turn=8, core=1).mesh(),
    "fine spring": Spring(WIRE, COIL, HEIGHT, 1.0, cells_per_turn=12, core=3).mesh(),
}

# The 20 nodes in VTK order, on [-1, 1]^3: written out here to check against, not taken from fea.
NODES = np.array(
    [
        *[(-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1)],
        *[(-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1)],
        *[(0, -1, -1), (1, 0, -1), (0, 1, -1), (-1, 0, -1)],
        *[(0, -1, 1), (1, 0, 1), (0, 1, 1), (-1, 0, 1)],
        *[(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)],
    ]
)


def shape(at):
    """Serendipity shape functions (Zienkiewicz and Taylor) at `at`, shape (3,)."""
    factors = np.where(NODES == 0, 1 - at**2, (1 + at * NODES) / 2)
    product = factors.prod(axis=1)
    corner = (NODES != 0).all(axis=1)
    return np.where(corner, product * (at * NODES).sum(axis=1) - 2 * product * corner, product)


def jacobians(mesh, at):
    """det(dx/dxi) of every cell at one place, by the complex step, which has no roundoff."""
    where = mesh.points[mesh.blocks[0].nodes]
    slopes = [shape(at + 1e-30j * np.eye(3)[i]).imag / 1e-30 for i in range(3)]
    return np.linalg.det(np.einsum("mad,ia->mid", where, np.array(slopes)))


def volume(mesh):
    places, weights = np.polynomial.legendre.leggauss(4)
    grid = [(x, y, z) for x in range(4) for y in range(4) for z in range(4)]
    return sum(
        weights[list(i)].prod() * jacobians(mesh, places[list(i)]).sum()
        for i in map(np.array, grid)
    )


def area(mesh, group):
    return section_of_facets(mesh.points, mesh.facet_groups[group]).area


def test_the_shape_functions_of_this_check_are_one_at_their_node_and_nought_at_the_others():
    values = np.array([shape(node.astype(float)) for node in NODES])
    np.testing.assert_allclose(values, np.eye(20), atol=1e-15)


@pytest.mark.parametrize("name", MESHES)
def test_cells_are_right_side_out_at_their_corners_midsides_and_middle(name):
    mesh = MESHES[name]
    for place in [*NODES, np.zeros(3)]:
        values = jacobians(mesh, place.astype(float))
        assert values.min() > 0.0


@pytest.mark.parametrize("name", MESHES)
def test_no_node_is_there_twice_or_unused(name):
    mesh = MESHES[name]
    size = np.ptp(mesh.points, axis=0).max()
    assert len(np.unique(np.round(mesh.points / size, 9), axis=0)) == len(mesh.points)
    assert np.array_equal(np.unique(mesh.blocks[0].nodes), np.arange(len(mesh.points)))
    assert mesh.unknowns == 3 * len(mesh.points)


@pytest.mark.parametrize("name", MESHES)
def test_facets_of_groups_are_faces_of_cells_and_look_outwards(name):
    mesh = MESHES[name]
    (kind, outer), *rest = outer_surface(mesh.blocks).blocks
    assert kind == "quad8"
    assert not rest
    faces = {
        frozenset(face): normal
        for face, normal in zip(outer.tolist(), normals(mesh, outer), strict=True)
    }
    for group in mesh.facet_groups.values():
        ((_, nodes),) = group.blocks
        for face, normal in zip(nodes.tolist(), normals(mesh, nodes), strict=True):
            np.testing.assert_allclose(normal, faces[frozenset(face)], rtol=1e-12, atol=1e-18)


def normals(mesh, nodes):
    corners = mesh.points[nodes]
    return np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])


@pytest.mark.parametrize("name", MESHES)
def test_the_outer_surface_is_closed(name):
    mesh = MESHES[name]
    ((_, outer),) = outer_surface(mesh.blocks).blocks
    total = np.abs(normals(mesh, outer)).sum()
    np.testing.assert_allclose(normals(mesh, outer).sum(axis=0), 0.0, atol=1e-12 * total)
    edges = outer[:, [4, 5, 6, 7]]
    _, times = np.unique(edges, return_counts=True)
    assert (times == 2).all()


def test_the_bar_has_its_volume_and_its_end_areas():
    mesh = MESHES["bar"]
    assert volume(mesh) == pytest.approx(1.0 * 0.02 * 0.03, rel=1e-12)
    assert area(mesh, "start") == pytest.approx(0.02 * 0.03, rel=1e-12)
    assert area(mesh, "end") == pytest.approx(0.02 * 0.03, rel=1e-12)
    assert area(mesh, "side") == pytest.approx(2 * (0.02 + 0.03), rel=1e-12)
    section = section_of_facets(mesh.points, mesh.facet_groups["end"])
    np.testing.assert_allclose(section.centre, [1.0, 0.0, 0.0], atol=1e-15)


def test_the_plate_has_its_volume_and_facets_cover_the_patch_and_corners_exactly():
    mesh = MESHES["plate"]
    assert volume(mesh) == pytest.approx(0.4 * 0.5 * 0.01, rel=1e-12)
    assert area(mesh, "patch") == pytest.approx(np.pi / 4 * 0.12**2, rel=1e-12)
    assert area(mesh, "corners") == pytest.approx(4 * 0.04**2, rel=1e-12)
    assert area(mesh, "rim") == pytest.approx(2 * (0.4 + 0.5) * 0.01, rel=1e-12)
    assert area(mesh, "top") == pytest.approx(0.4 * 0.5, rel=1e-12)
    section = section_of_facets(mesh.points, mesh.facet_groups["patch"])
    np.testing.assert_allclose(section.centre, [0.0, 0.0, 0.01], atol=1e-15)
    reach = np.hypot(*mesh.points[section.node_ids, :2].T).max()
    assert reach == pytest.approx(0.06, rel=1e-5)
    corners = mesh.points[mesh.facet_groups["corners"].node_ids]
    np.testing.assert_allclose(np.abs(corners[:, :2]).min(axis=0), [0.16, 0.21], rtol=1e-12)
    assert (corners[:, 2] == 0.0).all()


@pytest.mark.parametrize("name", ["plate", "thin plate", "plainest plate"])
@pytest.mark.parametrize("mirror", [[-1, 1, 1], [1, -1, 1]])
def test_the_plate_is_symmetric(name, mirror):
    points = np.round(MESHES[name].points, 9) + 0.0
    mirrored = np.round(MESHES[name].points * mirror, 9) + 0.0
    assert set(map(tuple, mirrored)) == set(map(tuple, points))


def test_the_outer_nodes_of_the_wire_lie_on_one_circle_about_the_true_helix():
    mesh = MESHES["spring"]
    side = mesh.points[mesh.facet_groups["side"].node_ids]
    rise = HEIGHT / (2 * np.pi * TURNS)
    # The centre of each node's cut, by Newton on (point - centre) . tangent = 0 in the angle.
    angle = side[:, 2] / rise
    for _ in range(50):
        centre, tangent = helix(angle, rise)
        slope = rise**2 + COIL / 2 * (side[:, 0] * np.cos(angle) + side[:, 1] * np.sin(angle))
        angle = angle + ((side - centre) * tangent).sum(axis=1) / slope
    distance = np.linalg.norm(side - helix(angle, rise)[0], axis=1)
    np.testing.assert_allclose(distance, WIRE / 2 * equal_area_factor(8), rtol=1e-9)
    assert equal_area_factor(8) == pytest.approx(1.0, abs=4e-4)


def helix(angle, rise):
    radius = COIL / 2
    centre = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), rise * angle])
    tangent = np.column_stack([-radius * np.sin(angle), radius * np.cos(angle), 0 * angle + rise])
    return centre, tangent


def test_the_spring_is_right_handed_and_ends_at_its_height_square_to_the_wire():
    mesh = MESHES["spring"]
    rise = HEIGHT / (2 * np.pi * TURNS)
    for group, angle in (("bottom", 0.0), ("top", 2 * np.pi * TURNS)):
        section = section_of_facets(mesh.points, mesh.facet_groups[group])
        centre, tangent = helix(np.array([angle]), rise)
        np.testing.assert_allclose(section.centre, centre[0], atol=1e-12)
        offset = (mesh.points[section.node_ids] - centre) @ tangent[0]
        np.testing.assert_allclose(offset, 0.0, atol=1e-15)


def test_a_spring_of_hardly_any_turns_has_a_layer_of_cells():
    assert len(Spring(0.002, 0.02, 0.05, active_turns=1e-12).mesh().blocks[0]) == 5


def test_the_volume_of_the_spring_tends_to_wire_area_times_wire_length():
    exact = np.pi / 4 * WIRE**2 * WIRE_LENGTH
    springs = [Spring(WIRE, COIL, HEIGHT, TURNS, cells_per_turn=12 * n, core=n) for n in (1, 2)]
    errors = [volume(spring.mesh()) / exact - 1 for spring in springs]
    assert abs(errors[1]) < 5e-4
    # Sides curved both ways lose their x^2 y^2 term, so both ways must be refined together.
    assert abs(errors[0] / errors[1]) > 12.0  # fourth order is 16


@pytest.mark.parametrize("core", [1, 2, 3, 8])
def test_a_round_section_has_the_area_of_the_circle(core):
    section = disc(1.0, core)
    points = np.column_stack([section.points, np.zeros(len(section.points))])
    group = FacetGroup((FacetBlock("quad8", section.quads),))
    assert section_of_facets(points, group).area == pytest.approx(np.pi, rel=1e-12)
    assert len(section.quads) == core**2 + 4 * core
    reach = np.hypot(*section.points.T).max()
    # One parabola for an arc of angle 2 a misses the area a^5 / 30 to leading order.
    missing = 4 * core * (np.pi / 4 / core) ** 5 / 30 / np.pi
    assert reach - 1.0 == pytest.approx(missing / 2, rel=0.1)


def test_parameters_that_do_not_fit_together_are_named():
    assert Bar(1.0, 0.02, 0.02).mistakes() == []
    assert [key for key, _ in Plate(0.4, 0.4, 0.01, 0.33).mistakes()] == ["patch"]
    assert [key for key, _ in Spring(0.03, COIL, HEIGHT, TURNS).mistakes()] == [
        "wire_diameter",
        "free_length",
    ]


@pytest.mark.parametrize(("name", "fewest"), [("plate", {"cells": 2}), ("spring", {"core": 1})])
def test_a_coarser_mesh_has_no_fewer_cells_than_its_generator_takes(name, fewest):
    """The estimate of a plate of two cells failed: it asked for one cell."""
    bundle = read_bundle(SHIPPED / name)
    again = refined(replace(bundle, mesh=replace(bundle.mesh, **fewest)), 0.01)
    assert fewest.items() <= again.mesh.parameters.items()
    assert again.mesh.mesh().points.size
