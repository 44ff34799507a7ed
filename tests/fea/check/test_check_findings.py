"""What the check says of meshes that an FEA engineer would send back."""

import numpy as np
import pytest

from tests.fea.boxes import box
from tests.fea.components import component
from wrenchbook.fea.check.findings import describe, free_motions
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.inspection import (
    aspect_ratio,
    bodies_of,
    coincident_nodes,
    edge_curvature,
    jacobian_ratio,
    scaled_jacobian,
)
from wrenchbook.fea.mesh.mesh import CellBlock, FacetBlock, FacetGroup, Mesh
from wrenchbook.fea.mesh.reference_cell import node_coordinates
from wrenchbook.fea.solve import Solver


def joined(first, second, merged=()):
    """Two meshes in one; `merged` maps nodes of the second to nodes of the first."""
    shift = len(first.points)
    points = np.concatenate([first.points, second.points])
    number = shift + np.arange(len(second.points))
    for mine, other in dict(merged).items():
        number[mine] = other
    used, flat = np.unique(
        np.concatenate([first.blocks[0].nodes, number[second.blocks[0].nodes]]),
        return_inverse=True,
    )
    renumber = np.full(len(points), -1)
    renumber[used] = np.arange(len(used))
    cells = flat.reshape(-1, first.blocks[0].nodes.shape[1])
    groups = {f"first {n}": moved(g, renumber) for n, g in first.facet_groups.items()}
    groups |= {f"second {n}": moved(g, renumber[number]) for n, g in second.facet_groups.items()}
    return Mesh(points[used], (CellBlock(first.blocks[0].kind, cells),), {}, groups, {})


def moved(group, number):
    return FacetGroup(tuple(FacetBlock(kind, number[nodes]) for kind, nodes in group.blocks))


def cubes(offset=(1.0, 0.0, 0.0), merge=None):
    """Two unit cubes, the second moved; `merge` says which coincident nodes become one."""
    first, second = box("hex20", (2, 2, 2)), box("hex20", (2, 2, 2))
    second = Mesh(second.points + offset, second.blocks, {}, second.facet_groups, {})
    same = np.abs(second.points[:, None] - first.points[None]).max(axis=2) < 1e-9
    pairs = np.argwhere(same)
    kept = [(a, b) for a, b in pairs.tolist() if merge is not None and merge(second.points[a])]
    return joined(first, second, kept)


def motions(mesh, **options):
    built = component(mesh, **options)
    return free_motions(built, bodies_of(mesh))


def test_cells_joined_by_faces_are_one_body_and_by_an_edge_or_point_two():
    assert bodies_of(cubes(merge=lambda x: True)).count == 1
    assert bodies_of(cubes(merge=lambda x: x[2] == 0)).count == 2
    assert bodies_of(cubes(merge=None)).count == 2
    assert bodies_of(box("tet10", (2, 2, 2))).count == 1
    assert bodies_of(box("wedge15", (2, 2, 2))).count == 1


def test_a_second_body_without_supports_has_all_six_motions():
    held, loose = motions(cubes(), fixed="first x0", section="first x1")
    assert len(held) == 0
    assert len(loose) == 6


def test_bodies_joined_on_one_edge_are_a_hinge_about_it():
    mesh = cubes(merge=lambda x: x[2] == 0)
    held, loose = motions(mesh, fixed="first x0", section="second x1")
    assert (len(held), len(loose)) == (0, 1)
    size = np.linalg.norm([2, 1, 1])
    words = describe(loose[0], np.array([1, 0.5, 0.5]), size)
    assert words == "turn about the line through (1, 0.5, 0) m along (0, 1, 0)"


def test_a_rigid_section_over_two_bodies_joins_them_and_a_mean_one_does_not():
    mesh = cubes()
    both = FacetGroup(mesh.facet_groups["first z1"].blocks + mesh.facet_groups["second z1"].blocks)
    groups = {**mesh.facet_groups, "both": both}
    mesh = Mesh(mesh.points, mesh.blocks, {}, groups, {})
    rigid = motions(mesh, fixed="first x0", section="both", coupling="rigid")
    mean = motions(mesh, fixed="first x0", section="both", coupling="distributed")
    assert [len(own) for own in rigid] == [0, 0]
    assert [len(own) for own in mean] == [0, 6]


@pytest.mark.parametrize("coupling", ["rigid", "distributed"])
@pytest.mark.parametrize(
    ("locked", "left"), [((), 6), (("ux",), 5), (("ux", "uy", "uz"), 3), (("rx", "rz", "uy"), 3)]
)
def test_a_guide_holds_the_body_of_its_section(coupling, locked, left):
    mesh = cubes()
    options = {"section": "second x1", "coupling": coupling, "locked": locked}
    held, guided = motions(mesh, fixed="first x0", **options)
    assert (len(held), len(guided)) == (0, left)


def test_what_the_check_calls_a_mechanism_the_solver_calls_one_too():
    for merge, count in ((None, 6), (lambda x: x[2] == 0, 1)):
        mesh = cubes(merge=merge)
        built = component(mesh, fixed="first x0", section="second x1")
        assert len(free_motions(built, bodies_of(mesh))[1]) == count
        with pytest.raises(SolveFailed, match="mechanism"):
            _ = Solver(built).compliance


def test_unmerged_nodes_are_found_and_near_ones_are_not_taken_for_them():
    pairs = coincident_nodes(cubes())
    assert len(pairs) == 21
    assert len(coincident_nodes(cubes(offset=(1.001, 0, 0)))) == 21  # 0.2 % of an edge
    assert len(coincident_nodes(cubes(offset=(1.01, 0, 0)))) == 0
    assert len(coincident_nodes(box("hex20", (2, 2, 2)))) == 0


# Edges of the regular tetrahedron and of the right wedge on a regular triangle, from one corner.
HIGH = 0.75**0.5
REGULAR = {
    "hex": np.eye(3),
    "tet": np.array([[1, 0, 0], [0.5, HIGH, 0], [0.5, HIGH / 3, (2 / 3) ** 0.5]]),
    "wed": np.array([[1, 0, 0], [0.5, HIGH, 0], [0, 0, 1]]),
}


@pytest.mark.parametrize("kind", ["hex8", "hex20", "hex27", "tet4", "tet10", "wedge6", "wedge15"])
def test_ideal_cells_measure_one_however_they_lie(kind):
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    points = node_coordinates(kind) @ REGULAR[kind[:3]] @ turn
    block = CellBlock(kind, np.arange(len(points))[None])
    assert scaled_jacobian(points, block)[0] == pytest.approx(1.0, rel=1e-12)
    assert jacobian_ratio(points, block)[0] == pytest.approx(1.0, rel=1e-12)
    assert aspect_ratio(points, block)[0] == pytest.approx(1.0, rel=1e-12)
    assert edge_curvature(points, block)[0] == pytest.approx(0.0, abs=1e-12)


def test_flat_long_and_bent_cells_are_measured():
    block = CellBlock("hex20", np.arange(20)[None])
    places = node_coordinates("hex20")
    sheared = places + np.outer(places[:, 0], [0, 1.0, 0])  # corners of 45 degrees
    assert scaled_jacobian(sheared, block)[0] == pytest.approx(0.5**0.5, rel=1e-12)
    assert aspect_ratio(places * [5, 1, 1], block)[0] == pytest.approx(5.0)
    bent = places.copy()
    bent[8] += [0, 0.3, 0]
    assert edge_curvature(bent, block)[0] == pytest.approx(0.3)
    quarter = places.copy()
    quarter[8, 0] = 0.25
    assert jacobian_ratio(quarter, block)[0] == pytest.approx(0.0, abs=1e-12)
