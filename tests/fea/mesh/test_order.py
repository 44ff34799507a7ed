"""First-order cells: refused, or given midside nodes."""

import numpy as np
import pytest

from tests.fea.boxes import box
from tests.fea.components import component
from wrenchbook.fea.bundle.read import BundleError, bundle_of
from wrenchbook.fea.component import build
from wrenchbook.fea.mesh.element_order import first_order_problems, second_order
from wrenchbook.fea.mesh.facets import outer_surface
from wrenchbook.fea.mesh.mapping import area_weights, volumes
from wrenchbook.fea.mesh.mesh import CellBlock, Mesh
from wrenchbook.fea.solve import Solver

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


CUBE = """*NODE
1, 0, 0, 0
2, 10, 0, 0
3, 10, 10, 0
4, 0, 10, 0
5, 0, 0, 10
6, 10, 0, 10
7, 10, 10, 10
8, 0, 10, 10
*ELEMENT, TYPE=C3D8I, ELSET=block
1, 1, 2, 3, 4, 5, 6, 7, 8
*NSET, NSET=foot
1, 2, 3, 4
*NSET, NSET=top
5, 6, 7, 8
"""


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
