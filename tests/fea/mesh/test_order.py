"""First-order cells: refused, or given midside nodes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.fea.boxes import box, volumes
from tests.fea.check.test_check_findings import messages, write_inp
from tests.fea.components import component
from wrenchbook.fea.bundle.read import BundleError, bundle_of, read_bundle
from wrenchbook.fea.check import report
from wrenchbook.fea.component import build
from wrenchbook.fea.failure import SolveFailed
from wrenchbook.fea.mesh.dependents import Dependents
from wrenchbook.fea.mesh.element_order import first_order_problems, second_order
from wrenchbook.fea.mesh.facets import outer_surface
from wrenchbook.fea.mesh.mapping import area_weights, cell_problems, determinants
from wrenchbook.fea.mesh.mesh import NODES_PER_CELL, CellBlock, Mesh
from wrenchbook.fea.mesh.reference_cell import node_coordinates, reference_element
from wrenchbook.fea.mesh.refine import halved
from wrenchbook.fea.solve import Solver, solve

FIRST = ("hex8", "tet4", "wedge6")
YOUNG, POISSON, LENGTH, SIDE = 210e9, 0.3, 0.1, 0.01
# Timoshenko, the shear coefficient of a square section after Cowper (1966).
SHEAR = YOUNG / 2 / (1 + POISSON) * SIDE**2 * 10 * (1 + POISSON) / (12 + 11 * POISSON)
BENT = LENGTH**3 / (3 * YOUNG * SIDE**4 / 12) + LENGTH / SHEAR


def bending(mesh):
    """Tip displacement of a clamped bar under a unit force across it, over beam theory's."""
    built = component(mesh, young=YOUNG, poisson=POISSON, coupling="distributed")
    return Solver(built).compliance[0, 0] / BENT


@pytest.mark.parametrize(("kind", "told"), [("hex8", 0.69), ("wedge6", 0.67), ("tet4", 0.35)])
def test_plain_first_order_cells_lock_as_the_documentation_says(kind, told):
    mesh = box(kind, (2, 2, 10), (SIDE, SIDE, LENGTH))
    assert bending(mesh) == pytest.approx(told, abs=0.005)


@pytest.mark.parametrize("kind", FIRST)
def test_with_midside_nodes_the_same_mesh_bends_as_beam_theory_says(kind):
    mesh = second_order(box(kind, (2, 2, 10), (SIDE, SIDE, LENGTH)))
    assert bending(mesh) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("kind", FIRST)
def test_a_raised_mesh_is_the_second_order_mesh_of_the_same_box(kind):
    raised = second_order(box(kind, (2, 3, 2)))
    right = box(raised.blocks[0].kind, (2, 3, 2))
    assert len(raised.points) == len(right.points)
    np.testing.assert_array_equal(
        np.unique(raised.points.round(12), axis=0), np.unique(right.points.round(12), axis=0)
    )
    assert volumes(raised.points, raised.blocks[0]).sum() == pytest.approx(1.0, rel=1e-12)
    assert set(raised.facet_groups) == set(right.facet_groups)
    for name, group in raised.facet_groups.items():
        nodes, weights = area_weights(raised.points, group)
        other, areas = area_weights(right.points, right.facet_groups[name])
        order = np.lexsort(raised.points[nodes].T.round(9))
        same = np.lexsort(right.points[other].T.round(9))
        np.testing.assert_allclose(raised.points[nodes][order], right.points[other][same])
        np.testing.assert_allclose(weights[order], areas[same], atol=1e-15)


def test_a_node_group_gets_the_nodes_between_its_own():
    mesh = box("hex8", (2, 2, 2))
    ids = mesh.facet_groups["x0"].node_ids
    raised = second_order(
        Mesh(mesh.points, mesh.blocks, mesh.regions, mesh.facet_groups, {"held": ids})
    )
    np.testing.assert_array_equal(raised.node_groups["held"], raised.facet_groups["x0"].node_ids)


def test_an_edge_shared_with_a_second_order_cell_keeps_its_node():
    quadratic, linear = box("hex20", (1, 1, 1)), box("hex8", (1, 1, 1))
    corners = quadratic.blocks[0].nodes[0, [1, 2, 6, 5]]
    added = len(quadratic.points) + np.arange(4)
    beside = [
        corners[0],
        added[0],
        added[1],
        corners[1],
        corners[3],
        added[2],
        added[3],
        corners[2],
    ]
    shift = np.array([[2.0, 0, 0], [2, 1, 0], [2, 0, 1], [2, 1, 1]])
    points = np.concatenate([quadratic.points, shift])
    blocks = (quadratic.blocks[0], CellBlock("hex8", np.array([beside])))
    raised = second_order(Mesh(points, blocks))
    assert linear.unknowns == 24
    assert len(raised.points) == 20 + 20 - 8
    (first, second) = raised.blocks
    assert len(np.intersect1d(first.nodes, second.nodes)) == 8
    assert sum(len(nodes) for _, nodes in outer_surface(raised.blocks).blocks) == 10


def test_second_order_cells_stay_as_they_are():
    mesh = box("tet10", (1, 1, 1))
    raised = second_order(mesh)
    np.testing.assert_array_equal(raised.points, mesh.points)
    assert raised.blocks[0] is mesh.blocks[0]
    assert not first_order_problems(mesh)


def test_cells_of_two_blocks_of_one_kind_are_counted_together():
    mesh = box("hex20", (1, 1, 3))
    cells = box("hex8", (1, 1, 2)).blocks[0].nodes
    both = replace(mesh, blocks=(*mesh.blocks, CellBlock("hex8", cells)), regions={})
    assert second_order(both).cell_counts == {"hex20": 5}


CUBE = Path(__file__).with_name("cube.inp").read_text("utf-8")


def cube(folder, **mesh):
    (folder / "cube.inp").write_text(CUBE)
    table = {
        "name": "cube",
        "title": "C",
        "mesh": {"file": "cube.inp", "unit": "mm"} | mesh,
        "material": [{"region": "block", "youngs_modulus": 1e9, "poisson_ratio": 0.0}],
        "supports": {"fixed": ["foot"]},
        "interface": {"section": "top", "coupling": "distributed"},
        "analysis": {"nonlinear": False, "integration": "full"},
        "range": {"force": [1, 1, 1], "moment": [1, 1, 1]},
    }
    return bundle_of(table, folder)


def test_a_bundle_with_first_order_cells_is_refused_with_the_way_out(tmp_path):
    with pytest.raises(BundleError, match=r"1 hex8 cells are of first order.*order = 2") as caught:
        build(cube(tmp_path))
    assert [problem.where for problem in caught.value.problems] == ["mesh"]


def test_order_2_in_the_bundle_solves_it_and_is_in_the_fingerprint(tmp_path):
    built = build(cube(tmp_path, order=2))
    assert built.mesh.cell_counts == {"hex20": 1}
    assert len(built.fixed_nodes) == len(built.interfaces[0].section.node_ids) == 8
    assert Solver(built).compliance[2, 2] == pytest.approx(0.01 / 1e-4 / 1e9, rel=1e-9)
    assert cube(tmp_path, order=2).fingerprint != cube(tmp_path).fingerprint


def bent_cell(kind):
    """One cell with all nodes moved, so that its edges are curved, in groups of each sort."""
    places = node_coordinates(kind)
    points = places + 0.04 * np.random.default_rng(0).normal(size=places.shape)
    blocks = (CellBlock(kind, np.arange(len(points))[None]),)
    groups = {"skin": outer_surface(blocks)}
    return Mesh(points, blocks, {"all": (np.array([0]),)}, groups, {"all": np.arange(len(points))})


def filled_by(mesh):
    (block,) = mesh.blocks
    element = reference_element(block.kind, "mass")
    maps = np.einsum("pad,cai->cpid", element.slopes, mesh.points[block.nodes])
    return np.linalg.det(maps) @ element.weights


@pytest.mark.parametrize("kind", [kind for kind in NODES_PER_CELL if kind[:3] != "pyr"])
def test_eight_cells_fill_the_one_they_come_from(kind):
    whole = bent_cell(kind)
    split = halved(whole)
    assert len(split.blocks[0]) == 8
    assert (filled_by(split) > 0).all()
    assert filled_by(split).sum() == pytest.approx(filled_by(whole).sum(), rel=1e-13)


@pytest.mark.parametrize("kind", [kind for kind in NODES_PER_CELL if kind[:3] != "pyr"])
def test_groups_hold_what_they_held(kind):
    split = halved(halved(bent_cell(kind)))
    skin = outer_surface(split.blocks).node_ids
    np.testing.assert_array_equal(split.facet_groups["skin"].node_ids, skin)
    np.testing.assert_array_equal(split.node_groups["all"], np.arange(len(split.points)))
    assert len(split.regions["all"][0]) == 64


@pytest.mark.parametrize("kind", [kind for kind in NODES_PER_CELL if kind[:3] != "pyr"])
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
    own, fine = (component(item, integration="full") for item in (mesh, halved(mesh)))
    more = Solver(fine).linear.compliance - Solver(own).linear.compliance
    assert (np.linalg.eigvalsh(0.5 * (more + more.T)) > 0).all()


def test_nodes_that_follow_others_still_do_so_in_a_raised_mesh():
    mesh = box("tet4", (1, 1, 1))
    entries = np.array([1]), np.array([0]), np.array([1.0])
    mesh = replace(mesh, dependents=Dependents.of(len(mesh.points), entries))
    raised = second_order(mesh)
    assert raised.dependents is not None
    assert raised.dependents.nodes.tolist() == [1]
    assert raised.dependents.map.shape[1] == len(raised.points)


FOLDED = "are inverted or flat"


def with_swapped_corners(mesh, count):
    """Swap the first two corners of the first `count` cells."""
    nodes = mesh.blocks[0].nodes.copy()
    nodes[:count, [0, 1]] = nodes[:count, [1, 0]]
    block = CellBlock(mesh.blocks[0].kind, nodes)
    return Mesh(mesh.points, (block,), mesh.regions, mesh.facet_groups, mesh.node_groups)


def bar():
    return box("hex20", (10, 2, 2), (1.0, 0.1, 0.1))


@pytest.mark.parametrize("count", [1, 40])
def test_swapped_corners_that_no_quadrature_point_sees_are_an_error_of_the_check(tmp_path, count):
    mesh = with_swapped_corners(bar(), count)
    assert (determinants(mesh.points, mesh.blocks[0]) > 0).all()
    reported = report(write_inp(tmp_path, mesh))
    assert not reported["ok"]
    assert any(f"{count} of 40 hex20 cells {FOLDED}" in m for m in messages(reported, "problems"))


def test_a_bundle_with_a_folded_cell_is_neither_built_nor_solved(tmp_path):
    bundle = read_bundle(write_inp(tmp_path, with_swapped_corners(bar(), 1)))
    for refuse in (build, lambda bundle: solve(bundle, [0, 0, 1, 0, 0, 0])):
        with pytest.raises(BundleError, match=FOLDED):
            refuse(bundle)


def test_a_component_made_without_a_bundle_is_not_solved_with_a_folded_cell():
    part = component(with_swapped_corners(bar(), 1), fixed="x0", section="x1")
    with pytest.raises(SolveFailed, match=FOLDED) as caught:
        Solver(part)
    assert caught.value.kind == "inverted_elements"


def test_a_cell_flat_but_for_roundoff_at_a_node_is_folded():
    mesh = box("hex20", (1, 1, 1))
    points = mesh.points.copy()
    nodes = mesh.blocks[0].nodes[0]
    points[nodes[8]] = 0.75 * points[nodes[0]] + 0.25 * points[nodes[1]]  # a quarter point
    points[nodes[8], 0] += 1e-15
    (problem,) = cell_problems(Mesh(points, mesh.blocks, {}, {}, {}))
    assert FOLDED in problem.message


@pytest.mark.exact("of cells that are alike, the worst is named: check and solve see the same bits")
@pytest.mark.parametrize("nonlinear", [False, True])
def test_what_the_check_warns_of_stands_in_the_notes_of_every_solution(tmp_path, nonlinear):
    folder = write_inp(tmp_path, box("hex20", (2, 2, 2), (1.0, 0.005, 0.005)), young="2e12")
    text = (folder / "component.toml").read_text()
    text = text.replace("nonlinear = false", f"nonlinear = {str(nonlinear).lower()}")
    (folder / "component.toml").write_text(text)
    warned = [f"{entry['where']}: {entry['message']}" for entry in report(folder)["warnings"]]
    assert any("long and thin" in words for words in warned)
    solution = solve(read_bundle(folder), np.array([0, 0, 1e-9, 0, 0, 0]))
    assert list(solution.notes[: len(warned)]) == warned
